"""What the other services say of the robot: its pose, goal, base and the map in the making."""

from collections.abc import Callable

from trolley import codes, topics
from trolley.geometry import Pose2D
from trolley.messages import BaseState, GoalStatus, MappingStatus, PoseEstimate
from trolley.runtime.service import Service, Watch
from trolley.under_way import GOAL_GOES, MAPPER_SILENT_NS

PLANNER = "planner"
"""The service that drives goals, and the source of its velocity commands."""


class RobotState:
    """The latest pose estimate, goal, base state and mapping status, from `start` on."""

    pose: Watch[PoseEstimate]
    goal: Watch[GoalStatus]
    base: Watch[BaseState]
    mapping: Watch[MappingStatus]

    def __init__(self, service: Service) -> None:
        self._service = service

    def start(
        self,
        on_pose: Callable[[PoseEstimate], None],
        on_goal: Callable[[GoalStatus], None],
        on_base: Callable[[BaseState], None],
    ) -> None:
        """Watch the topics; a message of the first three is handed on once it is the latest."""
        self.pose = self._service.watch(topics.POSE, then=on_pose)
        self.pose.wakes = False  # what a pose decides can wait for the next period
        self.goal = self._service.watch(topics.GOAL, then=on_goal)
        self.base = self._service.watch(topics.BASE, then=on_base)
        self.mapping = self._service.watch(topics.MAPPING)

    @property
    def map_name(self) -> str | None:
        """The map that the robot is on, None while unknown."""
        return None if self.pose.latest is None else self.pose.latest.map

    @property
    def map_T_base(self) -> Pose2D | None:
        """Where the robot believes it is, None while unknown."""
        return None if self.pose.latest is None else self.pose.latest.pose

    @property
    def goal_id(self) -> str | None:
        """The id of the planner's present goal, None where there is none."""
        return None if self.goal.latest is None else self.goal.latest.id

    @property
    def command_source(self) -> str | None:
        """Whose velocity commands the base follows, None where nobody's."""
        return None if self.base.latest is None else self.base.latest.source

    @property
    def is_mapping(self) -> bool:
        """Whether its map is being made or extended."""
        latest, arrived_ns = self.mapping.latest, self.mapping.arrived_ns
        if latest is None or latest.state == "idle" or arrived_ns is None:
            return False
        return self._service.monotonic_ns - arrived_ns <= MAPPER_SILENT_NS

    @property
    def is_driven_by_hand(self) -> bool:
        """Whether the base follows other commands than the planner's."""
        return self.command_source not in (None, PLANNER)

    @property
    def occupation(self) -> str:
        """The code of what it does for somebody, trips apart; "" where it is free."""
        goal = self.goal.latest
        if goal is not None and goal.state in GOAL_GOES:
            return codes.BUSY
        if self.is_driven_by_hand:
            return codes.TAKEN_OVER
        return codes.MAPPING if self.is_mapping else ""
