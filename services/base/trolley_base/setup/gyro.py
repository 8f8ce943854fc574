"""Which axis of the gyro points up, and what its turns are worth."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.config.hardware import Axis
from trolley_base.setup.geometry import Estimate, Stretch
from trolley_base.setup.record import Record

Floats = NDArray[np.float64]
LETTERS = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class GyroParams:
    """When a gyro is believed; set by hand."""

    least_turns: int = 4
    """Number of turns that it needs."""
    least_turn_rad: float = 0.5
    """Shorter turns tell little [rad]."""
    least_share: float = 0.85
    """Share of the turns that one axis must show."""
    share_of_scale: float = 0.2
    """By how much its scale may be off 1 at most."""


PARAMS = GyroParams()


@dataclass(frozen=True, slots=True)
class Gyro:
    """A gyro that turns with the robot.

    Attributes:
        up: the axis, as base takes them now, that points up.
        scale: true radians per radian that it reports.
    """

    up: Axis
    scale: Estimate

    def axes(self, now: tuple[Axis, Axis, Axis]) -> tuple[Axis, Axis, Axis]:
        """Return forward, left and up of the chip, `now` being what the settings say.

        What points up was measured; forward stays as it is said to be where that is possible.
        """
        if self.up == "z":
            return now
        ups = _turned(self.up, now)
        first: Axis = next(axis for axis in now if axis[-1] != ups[-1])
        left: Axis = next(axis for axis in now if axis[-1] not in (ups[-1], first[-1]))
        for left_axis in (left, _opposite(left)):
            if _is_right_handed((first, left_axis, ups)):
                return first, left_axis, ups
        raise AssertionError("one of both is right-handed")


def find_gyro(record: Record, parts: list[Stretch]) -> Gyro | str | None:
    """Compare the gyro with how the lidar saw the robot turn.

    Returns:
        The gyro, a sentence that says why it cannot be used, or None where there is none.
    """
    if len(record.imu) < 20:
        return None
    stamps = np.array([one.stamp_ns for one in record.imu], np.int64)
    rates = np.array([one.angular_velocity for one in record.imu], np.float64)
    stands = record.stands
    still = np.zeros(len(stamps), bool)
    for stand in stands:
        still |= (stamps > stand.start_ns) & (stamps < stand.end_ns)
    if np.count_nonzero(still) < 10:
        return None
    rates = rates - rates[still].mean(axis=0)
    seconds = np.diff(stamps, prepend=stamps[0]) * 1e-9
    angles = np.cumsum(rates * seconds[:, None], axis=0)
    turned: list[Floats] = []
    true: list[float] = []
    for part in parts:
        if abs(part.seen_turn) < PARAMS.least_turn_rad:
            continue
        turned.append(
            np.array(
                [
                    np.interp(part.end_ns, stamps, angles[:, axis])
                    - np.interp(part.start_ns, stamps, angles[:, axis])
                    for axis in range(3)
                ]
            )
        )
        true.append(part.seen_turn)
    if len(true) < PARAMS.least_turns:
        return None
    return _judge(np.array(turned), np.array(true))


def _judge(turned: Floats, true: Floats) -> Gyro | str:
    along = turned.T @ true / float(true @ true)
    axis = int(np.argmax(np.abs(along)))
    size = float(np.linalg.norm(along))
    if size < 0.05:
        return (
            "The gyro does not turn with the robot: it is dead, or its values are not turn rates."
        )
    if abs(along[axis]) < PARAMS.least_share * size:
        return "The gyro is mounted askew: none of its axes points up. Mount it level."
    sign = math.copysign(1.0, along[axis])
    mine = sign * turned[:, axis]
    scale = float(true @ mine) / float(mine @ mine)
    spread = true - scale * mine
    std = math.sqrt(float(spread @ spread) / max(1, len(true) - 1) / float(mine @ mine))
    if abs(scale - 1.0) > PARAMS.share_of_scale:
        return (
            f"The gyro reports {1.0 / scale:.2f} times the angle that the robot turns: its range "
            "is set wrongly in the board's firmware."
        )
    name = LETTERS[axis]
    return Gyro(_axis(name, sign), Estimate(scale, std))


AXES: dict[str, Axis] = {"x": "x", "-x": "-x", "y": "y", "-y": "-y", "z": "z", "-z": "-z"}


def _axis(letter: str, sign: float) -> Axis:
    return AXES[letter if sign > 0.0 else f"-{letter}"]


def _opposite(axis: Axis) -> Axis:
    return AXES[axis[1:] if axis.startswith("-") else f"-{axis}"]


def _turned(axis: Axis, now: tuple[Axis, Axis, Axis]) -> Axis:
    """Return the chip's axis behind one of the robot's."""
    chip = now[LETTERS.index(axis[-1])]
    return _opposite(chip) if axis.startswith("-") else chip


def _is_right_handed(axes: tuple[Axis, Axis, Axis]) -> bool:
    vectors = np.zeros((3, 3))
    for row, axis in enumerate(axes):
        vectors[row, LETTERS.index(axis[-1])] = -1.0 if axis.startswith("-") else 1.0
    return bool(np.linalg.det(vectors) > 0.0)
