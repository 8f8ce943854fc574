"""One spin in place for a robot that does not know where it is."""

from dataclasses import dataclass

from trolley.config import PlannerConfig
from trolley.geometry import Twist2D, circumscribed_radius, footprint_from_polygon
from trolley_planner.context.planning_context import free_all_round
from trolley_planner.control.rollout import Limits
from trolley_planner.driving.recovery import Spin
from trolley_planner.sensing.inputs import Inputs


@dataclass(frozen=True, slots=True)
class SpinParams:
    """The spin of a robot that looks for its pose; by hand."""

    room_m: float = 0.1
    """This much more than the robot's own circle must be free."""
    full_turn_rad: float = 6.4
    """Angle of the whole turn."""
    acceleration_radps2: float = 1.0
    """The turn begins gently."""


SPIN = SpinParams()


class SpinToLocalize:
    """Turns once when the localizer asks for it, the configuration allows it, and there is room.

    It turns at most once until the robot has found itself.

    Args:
        config: `turn_to_find`.
    """

    def __init__(self, config: PlannerConfig) -> None:
        self._is_allowed = config.turn_to_find
        self._turn: Spin | None = None
        self._is_spent = False
        self._rate = 0.0

    @property
    def is_turning(self) -> bool:
        """Whether it is about to turn, or turns."""
        return self._turn is not None

    def stop(self) -> None:
        """Stop spinning, as when somebody stops the robot."""
        if self._turn is not None:
            self._turn, self._is_spent, self._rate = None, True, 0.0

    def command(self, inputs: Inputs, limits: Limits | None, now_ns: int) -> Twist2D | None:
        """Return the velocity of the turn, None while there is nothing to turn for."""
        pose = inputs.pose
        if not self._is_allowed or pose is None or limits is None:
            return None
        if pose.state not in ("lost", "searching") or not pose.wants_turn:
            if pose.state == "localized":
                self._is_spent = False
            had, self._turn, self._rate = self._turn, None, 0.0
            return None if had is None else Twist2D.zero()
        base, odometry = inputs.base, inputs.odometry
        may = base is not None and base.mode == "ok" and base.source in (None, "planner")
        if self._is_spent or odometry is None:
            return None
        if not may or inputs.silence(now_ns) is not None:
            self.stop()
            return None
        if not self._has_room(inputs):
            # A person walks by, or stands there: the spin waits until there is room.
            self._rate = 0.0
            return None if self._turn is None else Twist2D.zero()
        if self._turn is None:
            self._turn = Spin(odometry.pose, SPIN.full_turn_rad)
        wanted = self._turn.command(odometry.pose, limits)
        if wanted is None:
            self.stop()
            return Twist2D.zero()
        self._rate = min(wanted.wz, self._rate + 0.05 * SPIN.acceleration_radps2)
        return Twist2D(0.0, 0.0, self._rate)

    def _has_room(self, inputs: Inputs) -> bool:
        """Say whether nothing stands in the circle that the robot turns in."""
        robot, scan, mounting = inputs.robot, inputs.scan, inputs.base_T_laser
        if robot is None or scan is None or mounting is None:
            return False
        radius = circumscribed_radius(footprint_from_polygon(robot.footprint))
        return free_all_round(scan, mounting, radius + SPIN.room_m)
