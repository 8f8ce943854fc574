"""How much a gyro turns per turn of the wheels: a mean weighted by the turning, which forgets."""


class TurnRatio:
    """Learns the ratio from one interval after another.

    Args:
        min_turn_rate: slower turns say nothing of it [rad/s].
        forgetting_turn: older turns are forgotten over this much turning [rad].
        most: one interval says no more than this, either way.
    """

    def __init__(self, min_turn_rate: float, forgetting_turn: float, most: float) -> None:
        self._min_turn_rate = min_turn_rate
        self._forgetting_turn = forgetting_turn
        self._most = most
        self.turned = 0.0
        """Over how much turning it was learned [rad], at most what is remembered."""
        self.value = 0.0
        """The gyro's turn per turn of the wheels; 0 before the first."""

    def add(self, turn_rad: float, gyro_rad: float, seconds: float) -> None:
        """Take what wheels and gyro turned in the same interval."""
        turned = abs(turn_rad)
        if turned < self._min_turn_rate * seconds:
            return
        ratio = max(-self._most, min(self._most, gyro_rad / turn_rad))
        self.turned = min(self._forgetting_turn, self.turned + turned)
        self.value += (ratio - self.value) * min(1.0, turned / self.turned)
