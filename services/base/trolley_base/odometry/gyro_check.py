"""Whether a gyro turns as the wheels do, and if not, what that looks like."""

import enum
from dataclasses import dataclass

from trolley_base.odometry.motion_ratio import MotionRatio


@dataclass(frozen=True, slots=True)
class GyroCheckParams:
    """When a gyro is judged by the wheels, and how; set by hand."""

    min_turn_rate: float = 0.3
    """Slower turns say more of the bias than of the gyro [rad/s]."""
    judged_turn: float = 1.5
    """The gyro is judged after this much turning [rad]."""
    forgetting_turn: float = 4.0
    """Older turns are forgotten over this much turning [rad]."""
    reversed_below: float = -0.5
    """Turn by the gyro per turn of the wheels below which its sign is reversed."""
    still_below: float = 0.2
    """Turn by the gyro per turn of the wheels, either way, below which it does not turn."""
    still_turn: float = 0.5
    """Turning over which older turns are forgotten for that, short enough to notice at once that
    the robot was lifted [rad]."""
    degrees_above: float = 20.0
    """Turn by the gyro per turn of the wheels above which it measures degrees: 57 of them are a
    radian."""
    most: float = 100.0
    """Greatest turn by the gyro per turn of the wheels that one interval may report, either way."""


PARAMS = GyroCheckParams()


class GyroTrouble(enum.Enum):
    """How gyro and wheels differ; the value is a sentence."""

    REVERSED = (
        "The gyro turns the opposite way to the wheels: reverse two of [base.chassis] imu_axes "
        "([base.imu] axes), such as x and z, unless left and right are swapped. Its turn "
        "rate is not used."
    )
    STILL = (
        "According to the gyro the robot does not turn, although its wheels do: it has been "
        "lifted, its wheels slip, or [base.chassis] imu_axes ([base.imu] axes) names another axis. "
        "Its turn rate is not used."
    )
    DEGREES = (
        "The gyro reports degrees per second, not radians: its firmware needs another scale. Its "
        "turn rate is not used."
    )


class GyroCheck:
    """Learns how much the gyro turns per turn of the wheels."""

    def __init__(self) -> None:
        self._ratio = MotionRatio(PARAMS.min_turn_rate, PARAMS.forgetting_turn, PARAMS.most)
        self._lately = MotionRatio(PARAMS.min_turn_rate, PARAMS.still_turn, PARAMS.most)

    @property
    def trouble(self) -> GyroTrouble | None:
        """What is wrong, None while that is not known or nothing is."""
        lately, ratio = self._lately, self._ratio.value
        if lately.covered >= PARAMS.still_turn and abs(lately.value) < PARAMS.still_below:
            return GyroTrouble.STILL
        if self._ratio.covered < PARAMS.judged_turn:
            return None
        if ratio > PARAMS.degrees_above:
            return GyroTrouble.DEGREES
        if abs(ratio) < PARAMS.still_below:
            return GyroTrouble.STILL
        return GyroTrouble.REVERSED if ratio < PARAMS.reversed_below else None

    def add(self, turn_rad: float, gyro_rad: float, seconds: float) -> None:
        """Take what wheels and gyro turned in the same interval."""
        self._ratio.add(turn_rad, gyro_rad, seconds)
        self._lately.add(turn_rad, gyro_rad, seconds)
