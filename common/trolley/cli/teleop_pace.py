"""What the keys of `trolley teleop` mean, and how fast they drive."""

from collections.abc import Collection

from trolley.geometry import Twist2D
from trolley.messages import Robot

MOTIONS = {
    "w": (1, 0, 0),
    "s": (-1, 0, 0),
    "a": (0, 0, 1),
    "d": (0, 0, -1),
    "q": (1, 0, 1),
    "e": (1, 0, -1),
    "j": (0, 1, 0),
    "l": (0, -1, 0),
    "up": (1, 0, 0),
    "down": (-1, 0, 0),
    "left": (0, 0, 1),
    "right": (0, 0, -1),
}
"""What each key wants: forward, to the left, turning left."""
SLOW = 0.4
"""With Shift, this share of the speed."""
STEP = 1.25
"""One press of + or -."""
SLOWEST = 0.2


class Pace:
    """How fast the keys drive.

    Args:
        speed: [m/s].
        turn: [rad/s].
    """

    def __init__(self, speed: float, turn: float) -> None:
        self._speed, self._turn = speed, turn
        self._factor = 1.0

    def faster(self, robot: Robot) -> None:
        """Drive faster, until both speed and turn rate are at the robot's limits."""
        enough = max(robot.max_speed / self._speed, robot.max_wz / self._turn)
        self._factor = min(STEP * self._factor, max(self._factor, enough))

    def slower(self) -> None:
        """Drive slower."""
        self._factor = max(self._factor / STEP, SLOWEST)

    def limits(self, robot: Robot) -> tuple[float, float]:
        """Return speed [m/s] and turn rate [rad/s], never above the robot's limits."""
        return (
            min(self._factor * self._speed, robot.max_speed),
            min(self._factor * self._turn, robot.max_wz),
        )

    def twist(self, held: Collection[str], robot: Robot, *, is_slow: bool) -> Twist2D | None:
        """Return what the held keys want, None where none of them is for driving this robot."""
        can_sideways = robot.drive == "mecanum"
        motions = [motion for name in held if (motion := MOTIONS.get(name)) is not None]
        motions = [motion for motion in motions if can_sideways or motion[1] == 0]
        if not motions:
            return None
        forward, left, turning = (max(-1, min(1, sum(part))) for part in zip(*motions, strict=True))
        speed, turn = self.limits(robot)
        return Twist2D(forward * speed, left * speed, turning * turn).scaled(
            SLOW if is_slow else 1.0
        )
