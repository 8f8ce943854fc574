"""The robot's turn, from wheels that slip and a gyro that drifts.

Wheels show when the robot stands, but slip when it turns; a gyro measures every turn, but also
reports one where there is none. So the gyro's bias is measured whenever the robot stands, and while
it drives the two are averaged, weighted by how wrong each is after a second. A gyro that is silent,
saturated, stuck, not yet measured at rest, or that does not turn as the wheels do, is not used.
"""

import enum
import math
from collections import deque
from dataclasses import dataclass

from trolley_base.odometry.gyro_bias import GyroBias
from trolley_base.odometry.gyro_check import GyroCheck, GyroTrouble
from trolley_base.odometry.motion_ratio import MotionRatio


@dataclass(frozen=True, slots=True)
class YawFusionParams:
    """How wheels and gyro are weighed, and when the gyro is not used; by hand unless said."""

    hold_ns: int = 150_000_000
    """A reading holds for this long after its stamp; later the gyro counts as silent [ns]."""
    kept_ns: int = 1_000_000_000
    """Readings are kept for this long [ns]."""
    saturation: float = 4.2
    """The smallest range of common chips is 250 degrees per second, 4.36 rad/s [rad/s]."""
    stuck_ns: int = 1_000_000_000
    """A live gyro does not repeat one value to the last digit for this long [ns]."""
    gyro_scale_std: float = 0.01
    """Standard deviation of the gyro's scale, as a share of the turn."""
    yaw_slip_per_m: float = 0.015
    """Heading error of the wheels after a metre, a random walk [rad/m^0.5]."""
    max_difference: float = 0.3
    """Difference of the two turn rates above which one is wrong, if it also exceeds
    `max_difference_share`; there is no telling which [rad/s]."""
    max_difference_share: float = 0.5
    """Share of the turn rate that the difference must exceed, too."""
    trusted_after_ns: int = 1_000_000_000
    """After that, the gyro must follow for this long before it is used again [ns]."""
    disagrees_after_ns: int = 2_000_000_000
    """A difference that lasts this long is reported [ns]."""
    gyro_per_wheel_turn: tuple[float, float] = (0.5, 1.5)
    """What the gyro turns per turn of the wheels lies between these."""
    learning_turn: float = 0.5
    """That ratio is judged after this much turning [rad]."""
    forgetting_turn: float = 3.0
    """Older turns are forgotten over this much turning [rad]."""
    min_turn_rate: float = 0.05
    """Slower turns do not show whether the gyro follows [rad/s]."""
    most_ratio: float = 10.0
    """Greatest ratio of the turns that one interval may report, either way."""


PARAMS = YawFusionParams()


class GyroState(enum.Enum):
    """What the gyro was good for in an interval; the value is a counter's name."""

    USED = "gyro_used"
    LEARNING = "gyro_learning"
    SILENT = "gyro_silent"
    SATURATED = "gyro_saturated"
    STUCK = "gyro_stuck"
    DISAGREES = "gyro_disagrees"


@dataclass(frozen=True, slots=True)
class _Reading:
    stamp_ns: int
    wz: float


class YawFusion:
    """Averages the turn of wheels and gyro.

    Args:
        slip: the part of a turn that the wheels may be wrong by, as a standard deviation.
    """

    def __init__(self, slip: float) -> None:
        self._slip = slip
        self._readings: deque[_Reading] = deque()
        self._changed_ns: int | None = None
        self._still_ns = 0
        """When the gyro read exactly zero last while the wheels hardly turned."""
        self._bias = GyroBias()
        self._check = GyroCheck()
        self._ratio = MotionRatio(PARAMS.min_turn_rate, PARAMS.forgetting_turn, PARAMS.most_ratio)
        self._differs_since_ns: int | None = None
        self._differed_until_ns = 0
        self.state = GyroState.SILENT

    @property
    def bias(self) -> float | None:
        """What the gyro reads at rest [rad/s], None before it is known."""
        return self._bias.value

    @property
    def trouble(self) -> GyroTrouble | None:
        """How the gyro differs from the wheels, None where that is not known or it does not."""
        return self._check.trouble

    def add_gyro(self, stamp_ns: int, wz: float) -> None:
        """Take a reading [rad/s] about z; not finite or not newer than the last, it is dropped."""
        last = self._readings[-1] if self._readings else None
        if not math.isfinite(wz) or (last is not None and stamp_ns <= last.stamp_ns):
            return
        if last is None or wz != last.wz:
            self._changed_ns = stamp_ns
        self._readings.append(_Reading(stamp_ns, wz))
        while self._readings[0].stamp_ns < stamp_ns - PARAMS.kept_ns:
            self._readings.popleft()

    def gyro_rate(self, start_ns: int, end_ns: int) -> float | None:
        """Return the mean turn rate by the gyro alone [rad/s], None where it says nothing."""
        if end_ns <= start_ns or self._is_silent(start_ns, end_ns) or self._is_stuck(end_ns):
            return None
        turned, highest = self._integrate(start_ns, end_ns)
        if highest >= PARAMS.saturation:
            return None
        return turned / ((end_ns - start_ns) * 1e-9) - (self._bias.value or 0.0)

    def fuse(self, start_ns: int, end_ns: int, distance_m: float, turn_rad: float) -> float:
        """Return the turn between two moments [rad].

        Args:
            start_ns: where the interval before ended.
            end_ns: not before `start_ns`.
            distance_m: how far the wheels drove, to whatever side.
            turn_rad: how far they turned.
        """
        seconds = (end_ns - start_ns) * 1e-9
        if seconds <= 0.0:
            return turn_rad
        self._observe_rest(end_ns, is_still=distance_m == 0.0 and turn_rad == 0.0)
        self.state, gyro_rad = self._judge(start_ns, end_ns, turn_rad)
        if self.state is not GyroState.USED or (distance_m == 0.0 and turn_rad == 0.0):
            # Wheels that stand are right, unless somebody lifts the robot, and then all is lost.
            return turn_rad
        rate = abs(turn_rad) / seconds
        wheels_var = (self._slip * rate) ** 2 + PARAMS.yaw_slip_per_m**2 * distance_m / seconds
        gyro_var = (PARAMS.gyro_scale_std * rate) ** 2 + self._bias.rate_variance(end_ns)
        return (turn_rad * gyro_var + gyro_rad * wheels_var) / (gyro_var + wheels_var)

    def _observe_rest(self, end_ns: int, *, is_still: bool) -> None:
        if not is_still:
            self._bias.disturb(end_ns)
            return
        for reading in self._readings:
            if reading.stamp_ns <= end_ns:
                self._bias.observe(reading.stamp_ns, reading.wz)

    def _judge(self, start_ns: int, end_ns: int, turn_rad: float) -> tuple[GyroState, float]:
        """Say what the gyro is good for in an interval, and what it turned [rad]."""
        if self._is_silent(start_ns, end_ns):
            return GyroState.SILENT, 0.0
        raw_rad, highest = self._integrate(start_ns, end_ns)
        seconds = (end_ns - start_ns) * 1e-9
        gyro_rad = raw_rad - (self._bias.value or 0.0) * seconds
        self._check.add(turn_rad, gyro_rad, seconds)
        if highest >= PARAMS.saturation:
            return GyroState.SATURATED, 0.0
        if self._readings[-1].wz == 0.0 and abs(turn_rad) < PARAMS.min_turn_rate * seconds:
            self._still_ns = end_ns
        if self._is_stuck(end_ns):
            # Some boards report no turn below a rate that nobody notices: that tells nothing.
            is_stuck = end_ns - self._still_ns > PARAMS.stuck_ns
            return (GyroState.STUCK if is_stuck else GyroState.LEARNING), 0.0
        if self._check.trouble is not None:
            return GyroState.DISAGREES, 0.0
        if self._bias.value is None:
            return GyroState.LEARNING, 0.0
        self._ratio.add(turn_rad, gyro_rad, seconds)
        allowed = PARAMS.max_difference * seconds + PARAMS.max_difference_share * abs(turn_rad)
        differs = abs(gyro_rad - turn_rad) > allowed or not self._turns_alike()
        if not differs:
            self._differs_since_ns = None
            is_known = (
                self._ratio.covered >= PARAMS.learning_turn
                and end_ns - self._differed_until_ns > PARAMS.trusted_after_ns
            )
            return (GyroState.USED if is_known else GyroState.LEARNING), gyro_rad
        self._differed_until_ns = end_ns
        if self._differs_since_ns is None:
            self._differs_since_ns = start_ns
        if end_ns - self._differs_since_ns > PARAMS.disagrees_after_ns:
            return GyroState.DISAGREES, 0.0
        return GyroState.LEARNING, 0.0

    def _is_silent(self, start_ns: int, end_ns: int) -> bool:
        """Say whether there is a time in an interval at which no reading holds."""
        until_ns = end_ns
        for reading in reversed(self._readings):
            if until_ns - reading.stamp_ns > PARAMS.hold_ns:
                return True
            until_ns = min(until_ns, reading.stamp_ns)
            if until_ns <= start_ns:
                return False
        return not self._readings or until_ns - start_ns > PARAMS.hold_ns

    def _is_stuck(self, end_ns: int) -> bool:
        return self._changed_ns is None or end_ns - self._changed_ns > PARAMS.stuck_ns

    def _turns_alike(self) -> bool:
        least, most = PARAMS.gyro_per_wheel_turn
        return self._ratio.covered < PARAMS.learning_turn or least <= self._ratio.value <= most

    def _integrate(self, start_ns: int, end_ns: int) -> tuple[float, float]:
        """Return the readings' integral over an interval [rad] and their largest size [rad/s].

        Straight lines between readings, and each end one held.
        """
        total, highest = 0.0, 0.0
        at_ns, at_wz = start_ns, self._reading_at(start_ns)
        for reading in self._readings:
            if start_ns < reading.stamp_ns < end_ns:
                total += 0.5 * (at_wz + reading.wz) * (reading.stamp_ns - at_ns) * 1e-9
                at_ns, at_wz = reading.stamp_ns, reading.wz
                highest = max(highest, abs(at_wz))
        last = self._reading_at(end_ns)
        total += 0.5 * (at_wz + last) * (end_ns - at_ns) * 1e-9
        return total, max(highest, abs(last))

    def _reading_at(self, stamp_ns: int) -> float:
        before = self._readings[0]
        for reading in self._readings:
            if reading.stamp_ns >= stamp_ns:
                span_ns = reading.stamp_ns - before.stamp_ns
                part = (stamp_ns - before.stamp_ns) / span_ns if span_ns > 0 else 1.0
                return before.wz + min(1.0, max(0.0, part)) * (reading.wz - before.wz)
            before = reading
        return before.wz
