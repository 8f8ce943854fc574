"""What is wrong with a robot that does not do as it is told, and how to say it.

Told, wheels and gyro are three accounts of one motion; where two agree, the third is broken. The
gyro tells a dead motor from a dead encoder; without one both are named.
"""

import enum
import math
from dataclasses import dataclass
from typing import NamedTuple

from trolley.geometry import Twist2D
from trolley_base.differential import sides_of

NOT_STOPPED = "NOT STOPPED: the motor board does not obey"


@dataclass(frozen=True, slots=True)
class MotionDiagnosisParams:
    """When a part of the robot counts as broken; set by hand."""

    stands_share: float = 0.25
    """Share of its command below which, with `stands_slack`, a side does not turn."""
    stands_slack: float = 0.02
    """Speed below which, with `stands_share`, a side does not turn [m/s]."""
    told_speed: float = 0.04
    """Command below which a side is no evidence [m/s]."""
    witness_wz: float = 0.2
    """The gyro decides between two explanations whose turn rates differ by at least this
    [rad/s]."""
    witness_share: float = 0.3
    """Share of that difference within which it is near to one of them."""


PARAMS = MotionDiagnosisParams()
WRONG_TRACK = 0.15
"""By this share of the other side's speed a side may seem to turn, where the distance between the
wheels is a guess."""


class Fault(enum.IntEnum):
    """In which way the robot does not do as it is told; the gravest is the largest."""

    MOVES = 1
    """Moves without a command: pushed by hand, or by the board."""
    OTHERWISE = 2
    """Moves otherwise than commanded."""
    JUMPS = 3
    """Reports leaps of the odometry, over and over, that no robot can make."""
    DRIVES = 4
    """Drives without a command, evenly as motors do, or for long."""
    GOES_ON = 5
    """Does not brake on a command to stand."""


class Finding(NamedTuple):
    """What is wrong; the detail follows "does not obey:" in a sentence."""

    fault: Fault
    detail: str


MOVES_UNTOLD = Finding(
    Fault.MOVES, "nobody told it to move: it is pushed by hand, or it drives by itself"
)
JUMPS = Finding(
    Fault.JUMPS,
    "its encoders report leaps that no robot can make: look at their cables and at the board's "
    "supply",
)


def sentence(finding: Finding, *, is_moving: bool) -> str:
    """Say what is wrong, and what to do."""
    if is_moving:
        todo = "" if finding.fault is Fault.MOVES else " Switch off the motors."
        return f"{NOT_STOPPED}: {finding.detail}.{todo}"
    if finding.fault is Fault.MOVES:
        return f"The robot has just been moved: {finding.detail}. It waits for a second of rest."
    return (
        f"The motor board did not obey: {finding.detail}. Put that right, then `trolley resume` "
        "lets it drive."
    )


def drives_otherwise(
    told: Twist2D,
    wheels: Twist2D,
    gyro: float | None,
    half_track_m: float,
    still: tuple[bool, ...] = (False, False),
) -> Finding:
    """Return what is wrong with a robot whose wheels do not go as told.

    Args:
        told: what was commanded [m/s, rad/s].
        wheels: what the encoders say.
        gyro: the turn rate by the gyro [rad/s], None without a gyro.
        half_track_m: half of the distance between left and right wheels [m].
        still: whether left and right are known not to turn.
    """
    left, right = sides_of(wheels, half_track_m)
    told_left, told_right = sides_of(told, half_track_m)
    stands = [
        still[0] or _stands(left, told_left, right),
        still[1] or _stands(right, told_right, left),
    ]
    as_wheels = _is_nearer(gyro, wheels.wz, told.wz)
    as_told = _is_nearer(gyro, told.wz, wheels.wz)
    turns_back = wheels.wz * told.wz < 0.0 and abs(told.wz) > PARAMS.witness_wz
    if all(stands):
        detail = (
            "it turns, but its encoders count nothing: look at their cables"
            if as_told
            else "its wheels do not turn: look at what may hold the robot or block its wheels, at "
            "the motors' power, and at the encoders' cables"
        )
    elif any(stands):
        side = ("left", "right")[stands.index(True)]
        detail = f"its {side} wheel does not turn, or the encoder there counts nothing"
        if as_wheels:
            detail = (
                f"its {side} wheel does not turn: look at the motor there, and at what may block it"
            )
        if as_told and abs(told.wz) >= PARAMS.witness_wz:
            detail = f"its {side} encoder counts nothing, though the wheel turns: look at its cable"
        elif as_told:  # it drives straight on, or stands: neither is a turn
            detail = (
                f"its {side} encoder counts nothing, or that wheel is held and the other one "
                "slips: look at the encoder's cable, and at what may hold the robot"
            )
    elif turns_back and abs(wheels.vx - told.vx) < PARAMS.told_speed + 0.5 * abs(told.vx):
        detail = "it turns the wrong way: motors or encoders of left and right are swapped"
        if as_wheels:
            detail = "it turns the wrong way: the motors of left and right are swapped"
        if as_told:
            detail = (
                "its encoders say that it turns the wrong way, its gyro that it turns as told: the "
                "encoders of left and right are swapped"
            )
    else:
        detail = (
            f"it drives otherwise than told: {wheels.vx:.2f} m/s and {wheels.wz:.2f} rad/s instead "
            f"of {told.vx:.2f} m/s and {told.wz:.2f} rad/s"
        )
    return Finding(Fault.OTHERWISE, detail)


def _stands(speed: float, wanted: float, other: float) -> bool:
    """Whether a side that is told to go does not; a wrong track mixes it with the other side."""
    forward = math.copysign(speed, speed * wanted)
    least = -PARAMS.stands_slack - WRONG_TRACK * abs(other)
    return abs(wanted) > PARAMS.told_speed and least < forward and is_standing(forward, wanted)


def is_standing(speed: float, wanted: float) -> bool:
    """Say whether a side that is told to go by so much goes so little that it stands [m/s]."""
    return speed < PARAMS.stands_share * abs(wanted) + PARAMS.stands_slack


def _is_nearer(gyro: float | None, one: float, other: float) -> bool:
    """Whether the gyro says `one` rather than `other`; what is near to neither is no witness."""
    apart = abs(one - other)
    is_near = gyro is not None and abs(gyro - one) < PARAMS.witness_share * apart
    return is_near and apart >= PARAMS.witness_wz
