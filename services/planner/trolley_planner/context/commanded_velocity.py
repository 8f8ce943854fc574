"""The velocity that the next command starts from."""

from collections import deque
from dataclasses import dataclass

from trolley.geometry import Twist2D


@dataclass(frozen=True, slots=True)
class VelocityParams:
    """How far the wheels may differ from the commands; by hand."""

    lag_s: float = 0.5
    """Longest time that the wheels take to follow a command."""
    differs_mps: float = 0.15
    """Difference from every recent command above which the wheels' speed counts as not following.
    """
    differs_radps: float = 0.5
    """Difference from every recent command above which the turn rate counts as not following."""


VELOCITY = VelocityParams()


class CommandedVelocity:
    """The last command, or what the wheels do where they do not follow it.

    Wheels follow late: while the robot brakes they are faster than its last command, and a command
    that started from them would speed it up again. So they are compared with all that they were
    told within their lag.
    """

    def __init__(self) -> None:
        self._told: deque[tuple[int, Twist2D]] = deque()

    def record(self, twist: Twist2D | None, now_ns: int) -> None:
        """Record a command, None for silence."""
        if twist is None:
            self._told.clear()
            return
        oldest_ns = now_ns - round(VELOCITY.lag_s * 1e9)
        while self._told and not oldest_ns <= self._told[0][0] <= now_ns:
            self._told.popleft()
        self._told.append((now_ns, twist))

    def velocity(self, measured: Twist2D) -> Twist2D:
        """Return the velocity to start from.

        Args:
            measured: by the wheels.
        """
        told = [twist for _, twist in self._told] or [Twist2D.zero()]
        return Twist2D(
            _reached(measured.vx, [one.vx for one in told], VELOCITY.differs_mps),
            0.0,
            _reached(measured.wz, [one.wz for one in told], VELOCITY.differs_radps),
        )


def _reached(measured: float, told: list[float], differs: float) -> float:
    follows = min(told) - differs < measured < max(told) + differs
    return told[-1] if follows else measured
