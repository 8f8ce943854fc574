"""How much one sensor sees of what the wheels report: a mean weighted by that, which forgets."""


class MotionRatio:
    """Learns the ratio of turns [rad] or of ways [m] from one interval after another.

    Args:
        min_rate: slower motions say nothing of it [1/s].
        forgetting: older motions are forgotten over this much of motion.
        most: one interval says no more than this, either way.
    """

    def __init__(self, min_rate: float, forgetting: float, most: float) -> None:
        self._min_rate = min_rate
        self._forgetting = forgetting
        self._most = most
        self.covered = 0.0
        """Over how much motion it was learned, at most what is remembered."""
        self.value = 0.0
        """What is seen per motion of the wheels; 0 before the first."""

    def add(self, by_wheels: float, seen: float, seconds: float) -> None:
        """Take what the wheels reported of an interval and what was seen of it."""
        moved = abs(by_wheels)
        if moved < self._min_rate * seconds:
            return
        ratio = max(-self._most, min(self._most, seen / by_wheels))
        self.covered = min(self._forgetting, self.covered + moved)
        self.value += (ratio - self.value) * min(1.0, moved / self.covered)
