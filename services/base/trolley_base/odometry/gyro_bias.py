"""What a gyro reads while the robot stands, and how far that may have drifted since.

The wheels must have stood for a while, and the gyro be quiet: who is pushed or carried does not
rest. A first value needs two quiet seconds that agree; a second that says something other than what
was known throws that away, so a robot that is turned by hand leaves no wrong bias behind.
"""

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class GyroBiasParams:
    """When a gyro counts as resting, and how its bias drifts; by hand, for cheap MEMS chips."""

    settle_ns: int = 500_000_000
    """The body still rocks for this long after the wheels stop [ns]."""
    block_ns: int = 1_000_000_000
    """Readings are judged in blocks of this length [ns]."""
    min_readings: int = 8
    """A block of fewer readings is not judged."""
    quiet_std: float = 0.03
    """A gyro at rest is noisier than this only while somebody moves the robot [rad/s]."""
    max_bias: float = 0.4
    """A larger mean is no bias: cheap chips are off by up to 20 degrees per second [rad/s]."""
    agreement: float = 0.01
    """Two blocks agree within this and five standard deviations [rad/s]."""
    mean_std_floor: float = 5e-4
    """The mean of a block is never known better than this [rad/s]."""
    drift_variance_per_s: float = 1.7e-7
    """Random walk of the bias: 0.01 rad/s in ten minutes [rad^2/s^3]."""


PARAMS = GyroBiasParams()


class GyroBias:
    """A running estimate of the bias [rad/s], with its variance."""

    def __init__(self) -> None:
        self._value: float | None = None
        self._candidate: float | None = None
        self._variance = 0.0
        self._noise_var = 0.0
        self._known_ns = 0
        self._last_ns = 0
        self._still_from_ns: int | None = None
        self._block: list[float] = []
        self._block_ns = 0

    @property
    def value(self) -> float | None:
        """The bias [rad/s], None before it is known."""
        return self._value

    def rate_variance(self, now_ns: int) -> float:
        """Return how wrong a corrected turn is after a second, as a variance [rad^2]."""
        return self._noise_var + self._variance_at(now_ns)

    def disturb(self, now_ns: int) -> None:
        """The wheels turned up to `now_ns`: nothing up to then, and a little after, is rest."""
        self._still_from_ns = now_ns + PARAMS.settle_ns
        self._last_ns = max(self._last_ns, now_ns)
        self._block = []

    def observe(self, stamp_ns: int, wz: float) -> None:
        """Take a reading [rad/s] while the wheels stand; one that was taken before is ignored."""
        if stamp_ns <= self._last_ns:
            return
        self._last_ns = stamp_ns
        if self._still_from_ns is None:
            self._still_from_ns = stamp_ns + PARAMS.settle_ns
        if stamp_ns < self._still_from_ns:
            return
        if not self._block:
            self._block_ns = stamp_ns
        self._block.append(wz)
        if stamp_ns - self._block_ns >= PARAMS.block_ns:
            block, self._block = self._block, []
            self._update(block, stamp_ns)

    def _update(self, block: list[float], now_ns: int) -> None:
        """Correct the bias by a second in which the wheels stood."""
        if len(block) < PARAMS.min_readings:
            return
        mean = math.fsum(block) / len(block)
        noise_var = math.fsum((wz - mean) ** 2 for wz in block) / (len(block) - 1)
        drift = abs(math.fsum(block[: len(block) // 2]) / (len(block) // 2) - mean)
        if (
            noise_var > PARAMS.quiet_std**2
            or drift > PARAMS.quiet_std / 3.0
            or abs(mean) > PARAMS.max_bias
        ):
            self._candidate = None
            return
        mean_var = noise_var / len(block) + PARAMS.mean_std_floor**2
        known = self._candidate if self._value is None else self._value
        variance = mean_var if self._value is None else self._variance_at(now_ns)
        if known is None or abs(mean - known) > PARAMS.agreement + 5.0 * math.sqrt(
            variance + mean_var
        ):
            self._value, self._candidate = None, mean
            return
        gain = variance / (variance + mean_var)
        self._value, self._candidate = known + gain * (mean - known), None
        self._variance = (1.0 - gain) * variance
        # White noise adds up over a second as the root of its readings.
        self._noise_var = noise_var / len(block)
        self._known_ns = now_ns

    def _variance_at(self, now_ns: int) -> float:
        return self._variance + PARAMS.drift_variance_per_s * max(0, now_ns - self._known_ns) * 1e-9
