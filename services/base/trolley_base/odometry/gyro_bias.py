"""What a gyro reads while the robot stands, and how far that may have drifted since.

The wheels must have stood for a while, and the gyro be quiet: who is pushed or carried does not
rest. A first value needs two quiet seconds that agree; a second that says something else than what
was known throws that away, so a robot that is turned by hand leaves no wrong bias behind.
"""

import math

# After the wheels stop the body still rocks [ns].
SETTLE_NS = 500_000_000
BLOCK_NS = 1_000_000_000
MIN_READINGS = 8
# A gyro at rest is noisier than this only while somebody moves the robot [rad/s].
QUIET_RADPS = 0.03
# Cheap chips are off by up to 20 degrees per second.
LARGEST_RADPS = 0.4
# Two seconds at rest agree within this and five standard deviations [rad/s].
ALIKE_RADPS = 0.01
# What a second's mean cannot do better than, and the drift: 0.01 rad/s in ten minutes.
MEAN_FLOOR_RADPS = 5e-4
DRIFT_VAR_PER_S = 1.7e-7


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
        self._still_from_ns = now_ns + SETTLE_NS
        self._last_ns = max(self._last_ns, now_ns)
        self._block = []

    def observe(self, stamp_ns: int, wz: float) -> None:
        """Take a reading [rad/s] while the wheels stand; one that was taken before is ignored."""
        if stamp_ns <= self._last_ns:
            return
        self._last_ns = stamp_ns
        if self._still_from_ns is None:
            self._still_from_ns = stamp_ns + SETTLE_NS
        if stamp_ns < self._still_from_ns:
            return
        if not self._block:
            self._block_ns = stamp_ns
        self._block.append(wz)
        if stamp_ns - self._block_ns >= BLOCK_NS:
            block, self._block = self._block, []
            self._take(block, stamp_ns)

    def _take(self, block: list[float], now_ns: int) -> None:
        """Learn of a second in which the wheels stood."""
        if len(block) < MIN_READINGS:
            return
        mean = math.fsum(block) / len(block)
        noise_var = math.fsum((wz - mean) ** 2 for wz in block) / (len(block) - 1)
        drift = abs(math.fsum(block[: len(block) // 2]) / (len(block) // 2) - mean)
        if noise_var > QUIET_RADPS**2 or drift > QUIET_RADPS / 3.0 or abs(mean) > LARGEST_RADPS:
            self._candidate = None
            return
        mean_var = noise_var / len(block) + MEAN_FLOOR_RADPS**2
        known = self._candidate if self._value is None else self._value
        variance = mean_var if self._value is None else self._variance_at(now_ns)
        if known is None or abs(mean - known) > ALIKE_RADPS + 5.0 * math.sqrt(variance + mean_var):
            self._value, self._candidate = None, mean
            return
        gain = variance / (variance + mean_var)
        self._value, self._candidate = known + gain * (mean - known), None
        self._variance = (1.0 - gain) * variance
        # White noise adds up over a second as the root of its readings.
        self._noise_var = noise_var / len(block)
        self._known_ns = now_ns

    def _variance_at(self, now_ns: int) -> float:
        return self._variance + DRIFT_VAR_PER_S * max(0, now_ns - self._known_ns) * 1e-9
