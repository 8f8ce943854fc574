"""What the planner tells of its goal: status, path, trajectory, costmap."""

from trolley.config import PlannerConfig
from trolley.messages import GoalStatus, OccupancyGrid, Path
from trolley_planner import wire
from trolley_planner.context.costmap_manager import Surroundings
from trolley_planner.context.motion_state import Helm
from trolley_planner.driving.goal_execution import Drive
from trolley_planner.goals.goal_status import StatusBoard
from trolley_planner.sensing.inputs import Senses


class Report:
    """What is known of the goal and of the drive to it, and how that is told.

    Args:
        config: of the planner.
    """

    def __init__(self, config: PlannerConfig) -> None:
        self.config = config
        self.senses = Senses(config)
        self.board = StatusBoard(config.frame)
        self.surroundings = Surroundings(config, self.senses)
        self.helm = Helm(config, self.senses, self.surroundings)
        self.drive: Drive | None = None

    def status_of(self, goal_id: str, now_ns: int) -> GoalStatus | None:
        """Return the status of one of the last goals, None if it is not known."""
        if self.board.goal is not None and goal_id == self.board.goal.id:
            return self.status(now_ns)
        return self.board.book.read(goal_id)

    def status(self, now_ns: int) -> GoalStatus:
        """Return the status of the current goal."""
        return self.board.snapshot(now_ns, self.details(now_ns))

    @property
    def path_key(self) -> str:
        """What changes whenever the path does."""
        if self.drive is None or not self.board.is_active:
            return ""
        return self.drive.path_key

    def costmaps(self, now_ns: int) -> tuple[OccupancyGrid | None, OccupancyGrid | None]:
        """Return the whole costmap and the part around the robot, as far as they are known."""
        rig, here = self.surroundings.rig, self.senses.base_pose()
        return wire.costmap_messages(rig, here, self.senses.frame, now_ns)

    @property
    def trajectory(self) -> Path | None:
        """What the newest command leads to, None while nothing is driven."""
        if self.drive is None or self.board.state != "driving":
            return None
        return wire.trajectory_message(self.drive.rig, self.senses.frame, self.helm.commanded_ns)

    def path(self, now_ns: int) -> Path:
        """Return the path that is left, an empty one without a goal."""
        drive = self.drive if self.board.is_active else None
        return wire.path_left(drive, self.senses.frame, now_ns)

    def details(self, now_ns: int) -> GoalStatus | None:
        """Return distance, time and obstacles of the drive for a status."""
        motion = self.helm.motion()
        if self.drive is None or motion is None or self.board.goal is None:
            return None
        return wire.details(self.drive, motion, self.helm.limits(self.drive.goal.speed))
