"""The velocity that the next command starts from."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from trolley.geometry import Pose2D, Twist2D, integrate_twist


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
        return self._follows(measured)(self._told[-1][1] if self._told else Twist2D.zero())

    def pose_when_obeyed(
        self, pose: Pose2D, measured: Twist2D, now_ns: int, delay_s: float
    ) -> Pose2D:
        """Return where the robot will be when it obeys a command that is given now.

        Until then it drives by the commands that are still under way.

        Args:
            pose: now.
            measured: velocity by the wheels.
            now_ns: robot time.
            delay_s: until the wheels follow a command; of more than `lag_s` only that counts.
        """
        driven = self._follows(measured)
        delay_ns = round(min(delay_s, VELOCITY.lag_s) * 1e9)
        begin_ns, twist = now_ns - delay_ns, Twist2D.zero()
        for told_ns, told in (*self._told, (now_ns, Twist2D.zero())):
            if told_ns > begin_ns:
                pose = integrate_twist(pose, driven(twist), (told_ns - begin_ns) * 1e-9)
                begin_ns = told_ns
            twist = told
        return pose

    def _follows(self, measured: Twist2D) -> Callable[[Twist2D], Twist2D]:
        """Return what becomes of a command: itself, or what the wheels do instead."""
        told = [twist for _, twist in self._told] or [Twist2D.zero()]
        follows = _is_among(measured.vx, [one.vx for one in told], VELOCITY.differs_mps)
        turns = _is_among(measured.wz, [one.wz for one in told], VELOCITY.differs_radps)
        return lambda one: Twist2D(
            one.vx if follows else measured.vx, 0.0, one.wz if turns else measured.wz
        )


def _is_among(measured: float, told: list[float], differs: float) -> bool:
    return min(told) - differs < measured < max(told) + differs
