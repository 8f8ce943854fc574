"""What to propose of what `upkeep` has found, in words and as settings."""

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple

from trolley.geometry import Pose2D
from trolley.messages import Proposal
from trolley_base.odometry.wheel_scales import WheelScales
from trolley_base.upkeep.correction import Correction, combined
from trolley_base.upkeep.evidence import ANGULAR, BEND, LINEAR, PARAMS, YAW, Errors, X, Y


@dataclass(frozen=True, slots=True)
class FindingParams:
    """What is worth a proposal; set by hand."""

    sure: float = 5.0
    """Number of standard deviations by which a figure must be off."""
    lidar_rad: float = math.radians(1.0)
    """The lidar's direction must be off by this [rad]."""
    lidar_m: float = 0.02
    """Its place must be off by this [m]."""
    wheel: float = 0.02
    """The wheels' sizes must differ by this share more or less than they should."""
    both: float = 0.05
    """Both wheels must be off by this share: rugs hold them back by some per cent as well."""
    track: float = 0.03
    """The same of the track."""
    stays: float = 0.7
    """What is proposed stays so while this share of what was needed is left."""


FINDING = FindingParams()


@dataclass(frozen=True, slots=True)
class InForce:
    """What robot.toml says, as base uses it.

    Attributes:
        base_T_laser: pose of the lidar.
        scales: of the wheels.
        half_track_m: half the distance between the wheels [m].
    """

    base_T_laser: Pose2D
    scales: WheelScales
    half_track_m: float


def find_proposals(
    errors: Errors, in_force: InForce, proposed: Collection[str] = ()
) -> list[Proposal]:
    """Return what should be corrected, or looked at.

    Args:
        errors: as they are known now.
        in_force: what they are errors of.
        proposed: the ids of what is proposed already.
    """
    if errors.misfit > PARAMS.loose * (FINDING.stays if "odometry" in proposed else 1.0):
        return [
            Proposal(
                id="odometry",
                message="Wheels and lidar no longer fit each other: their differences change from "
                "metre to metre. Look at the wheels, the encoders' cables, and whether the lidar "
                "sits firmly.",
            )
        ]

    found: list[Proposal] = []
    share = FINDING.stays if "lidar" in proposed else 1.0
    yaw, x, y = (errors.combined((index, 1.0)) for index in (YAW, X, Y))
    least = FINDING.lidar_rad, FINDING.lidar_m, FINDING.lidar_m
    if max(map(_excess, (yaw, x, y), least)) > share:
        found.append(_of_lidar(yaw, x, y, in_force))
    wheels = _wheels_that_are_off(errors, in_force.half_track_m, is_proposed="wheels" in proposed)
    if wheels is not None:
        found.append(_of_wheels(wheels, in_force))
    return found


def _excess(figure: tuple[float, float], least: float) -> float:
    """Return how far off a figure is, as a share of what is worth a proposal."""
    value, std = figure
    return abs(value) / max(least, FINDING.sure * std)


class _Wheels(NamedTuple):
    """By which share wheels and track are larger than robot.toml says; 0: not enough to tell."""

    both: float
    left: float
    right: float
    track: float


def _wheels_that_are_off(errors: Errors, half_m: float, *, is_proposed: bool) -> _Wheels | None:
    linear, linear_std = errors.combined((LINEAR, 1.0))
    uneven = errors.combined((BEND, 2.0 * half_m))
    track = errors.combined((LINEAR, 1.0), (ANGULAR, -1.0))
    # Which wheel it is shows in what both have lost. How much is told by their difference, since
    # rugs hold both back.
    is_left = linear * uneven[0] < 0.0
    one = -uneven[0] if is_left else uneven[0]
    excess = {"one": _excess(uneven, FINDING.wheel), "track": _excess(track, FINDING.track)}
    both = linear - 0.5 * one if excess["one"] > 1.0 else linear
    excess["both"] = _excess((both, linear_std), FINDING.both)
    worst = max(excess, key=lambda name: excess[name])
    off = {name for name, share in excess.items() if share > 1.0}
    if is_proposed and excess[worst] > FINDING.stays:
        off.add(worst)
    if not off:
        return None
    one = one if "one" in off else 0.0
    return _Wheels(
        both=both if "both" in off else 0.0,
        left=one if is_left else 0.0,
        right=0.0 if is_left else one,
        track=track[0] if "track" in off else 0.0,
    )


def _of_lidar(
    yaw: tuple[float, float], x: tuple[float, float], y: tuple[float, float], in_force: InForce
) -> Proposal:
    # A place that is not known better than it is written down stays as it is.
    dx, dy = (
        value if abs(value) > FINDING.stays * max(FINDING.lidar_m, FINDING.sure * std) else 0.0
        for value, std in (x, y)
    )
    dyaw = yaw[0] if abs(yaw[0]) > FINDING.stays * FINDING.sure * yaw[1] else 0.0
    before = in_force.base_T_laser
    pose = Pose2D(before.x + dx, before.y + dy, before.yaw + dyaw).wrapped()
    words = [f"turned by {math.degrees(dyaw):.1f}°"] if dyaw else []
    if dx or dy:
        words.append(f"moved by {100.0 * math.hypot(dx, dy):.0f} cm")
    return Proposal(
        id="lidar",
        message=f"The lidar is {' and '.join(words)} against what robot.toml says. Push it back, "
        "or take its pose over.",
        settings={
            "base.lidar.pose.x": round(pose.x, 4),
            "base.lidar.pose.y": round(pose.y, 4),
            "base.lidar.pose.yaw": round(pose.yaw, 4),
        },
    )


def _of_wheels(wheels: _Wheels, in_force: InForce) -> Proposal:
    named = ("left wheel", wheels.left), ("right wheel", wheels.right), ("track", wheels.track)
    words = [
        f"The {what} is {100.0 * abs(value):.1f} % {_more(what, value)} than robot.toml says."
        for what, value in named
        if value
    ]
    if wheels.both:
        words.insert(0, _of_both(wheels.both))
    message = f"{' '.join(words)} Take it over?"
    linear = 1.0 + wheels.both + 0.5 * (wheels.left + wheels.right)
    bend = (wheels.right - wheels.left) / (2.0 * in_force.half_track_m)
    scales = in_force.scales
    if scales.track_m is None:
        message += " Its wheel_ratio can only be proposed where [base.odometry] track_m is set."
        bend = 0.0
    to_be = combined(Correction(linear, linear - wheels.track, bend), scales)
    settings = {
        "base.odometry.linear_scale": round(to_be.linear, 4),
        "base.odometry.angular_scale": round(to_be.angular, 4),
    }
    if scales.track_m is not None:
        settings["base.odometry.wheel_ratio"] = round(to_be.wheel_ratio, 4)
    return Proposal(id="wheels", message=message, settings=settings)


def _of_both(value: float) -> str:
    percent = 100.0 * abs(value)
    if value > 0.0:
        return f"The wheels drive {percent:.1f} % further than robot.toml says: both are larger."
    return (
        f"The wheels drive {percent:.1f} % less far than robot.toml says: both are smaller, or "
        "rugs hold them back."
    )


def _more(what: str, value: float) -> str:
    if what == "track":
        return "wider" if value > 0.0 else "narrower"
    return "larger" if value > 0.0 else "smaller"
