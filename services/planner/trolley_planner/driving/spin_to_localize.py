"""One turn in place for a robot that does not know where it is."""

from trolley.config import PlannerConfig
from trolley.geometry import Twist2D, circumscribed_radius, footprint_from_polygon
from trolley_planner.context.costmap_manager import free_all_round
from trolley_planner.control.rollout import Limits
from trolley_planner.driving.recovery import TurnRound
from trolley_planner.sensing.inputs import Senses

ROOM_M = 0.1
"""So much more than the robot's own circle must be free."""
FULL_TURN = 6.4
MAX_ACCELERATION = 1.0


class LookRound:
    """Turns once when the localizer asks for it, the configuration allows it, and there is room.

    It turns at most once until the robot has found itself.

    Args:
        config: `turn_to_find`.
    """

    def __init__(self, config: PlannerConfig) -> None:
        self._is_allowed = config.turn_to_find
        self._turn: TurnRound | None = None
        self._is_spent = False
        self._rate = 0.0

    @property
    def is_turning(self) -> bool:
        """Whether it is about to turn, or turns."""
        return self._turn is not None

    def stop(self) -> None:
        """Turn no more, as when somebody stops the robot."""
        if self._turn is not None:
            self._turn, self._is_spent, self._rate = None, True, 0.0

    def command(self, senses: Senses, limits: Limits | None, now_ns: int) -> Twist2D | None:
        """Return the velocity of the turn, None while there is nothing to turn for."""
        pose = senses.pose
        if not self._is_allowed or pose is None or limits is None:
            return None
        if pose.state not in ("lost", "searching") or not pose.wants_turn:
            if pose.state == "localized":
                self._is_spent = False
            had, self._turn, self._rate = self._turn, None, 0.0
            return None if had is None else Twist2D.zero()
        base, odometry = senses.base, senses.odometry
        may = base is not None and base.mode == "ok" and base.source in (None, "planner")
        if self._is_spent or odometry is None:
            return None
        if not may or senses.silence(now_ns) is not None:
            self.stop()
            return None
        if not self._has_room(senses):
            # Somebody walks by, or stands there: the turn waits until there is room.
            self._rate = 0.0
            return None if self._turn is None else Twist2D.zero()
        if self._turn is None:
            self._turn = TurnRound(odometry.pose, FULL_TURN)
        wanted = self._turn.command(odometry.pose, limits)
        if wanted is None:
            self.stop()
            return Twist2D.zero()
        self._rate = min(wanted.wz, self._rate + 0.05 * MAX_ACCELERATION)
        return Twist2D(0.0, 0.0, self._rate)

    def _has_room(self, senses: Senses) -> bool:
        """Say whether nothing stands in the circle that the robot turns in."""
        robot, scan, mounting = senses.robot, senses.scan, senses.base_T_laser
        if robot is None or scan is None or mounting is None:
            return False
        radius = circumscribed_radius(footprint_from_polygon(robot.footprint))
        return free_all_round(scan, mounting, radius + ROOM_M)
