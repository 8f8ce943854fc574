"""What an explorer knows of a moment, what it may do, and what it decides."""

from collections.abc import Sequence
from dataclasses import dataclass

from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.messages import Zone
from trolley.messages.request_params import SendGoal
from trolley_mapper.explore.frontiers import (
    Clearance,
    Frontier,
    FrontierReport,
    find_frontiers,
)
from trolley_mapper.explore.traversable_area import TraversableArea, lay_out_area


@dataclass(frozen=True, slots=True)
class Limits:
    """What must not be exceeded, whatever glass doors seem to show."""

    radius_m: float
    """Greatest distance from home [m]."""
    area_m2: float
    """Greatest floor area: enough for any house [m^2]."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Map and robot at one moment."""

    grid: GridMap
    """The map as it is now."""
    pose: Pose2D
    """Pose of the robot in the map (`map_T_base`)."""
    is_lost: bool
    """Whether the mapper does not know where the robot is."""
    is_unsure: bool
    """Whether the mapper is unsure where the robot is."""
    zones: Sequence[Zone]
    """Those of the map that is being extended, and those that people have drawn."""
    home: Pose2D
    """Pose to return to in the end (`map_T_base`)."""


@dataclass(frozen=True, slots=True)
class Survey:
    """What there is left to explore at one moment."""

    area: TraversableArea
    report: FrontierReport
    clearance: Clearance
    """With which it was looked for."""


def survey(scene: Scene, clearance: Clearance, limits: Limits) -> Survey:
    """Find all frontiers, which takes some hundredths of a second."""
    within = scene.home, limits.radius_m
    area = lay_out_area(scene.grid, scene.zones, scene.pose, clearance.passing_m, within)
    return Survey(area, find_frontiers(area, scene.pose, clearance), clearance)


@dataclass(frozen=True, slots=True)
class Send:
    """Send a goal to the planner."""

    goal: SendGoal


@dataclass(frozen=True, slots=True)
class Cancel:
    """Cancel a goal of ours at the planner."""

    goal_id: str


Action = Send | Cancel


@dataclass(slots=True)
class ExplorationGoal:
    """A goal that was sent."""

    goal: SendGoal
    frontier: Frontier | None
    """The frontier that the goal is to show; None on the way home."""
    set_off: Pose2D
    """Where the robot was when the goal was chosen (`map_T_base`)."""
    sent_s: float
    """When the goal was chosen, robot time [s]."""
    limit_s: float
    """Time that the goal may take [s]."""
    area_m2: float
    """Floor that was known when the goal was chosen [m^2]."""
    heard_s: float
    """When the goal was last sent or heard of, robot time [s]."""

    stood_at: Pose2D | None = None
    """Where the robot has been since `stood_s` (`map_T_base`)."""
    stood_s: float = 0.0

    def standing_s(self, here: Pose2D, within_m: float, now_s: float) -> float:
        """Return for how long the robot has hardly moved [s].

        Args:
            here: map_T_base now.
            within_m: distance that counts as hardly [m].
            now_s: robot time [s].
        """
        if self.stood_at is None or self.stood_at.distance_to(here) > within_m:
            self.stood_at, self.stood_s = here, now_s
        return now_s - self.stood_s

    def is_turn(self, within_m: float) -> bool:
        """Say whether it lies where the robot set off, so that only turning may be in vain.

        Args:
            within_m: distance that counts as there [m].
        """
        pose = self.goal.pose
        return pose is not None and self.set_off.distance_to(pose) < within_m

    @property
    def id(self) -> str:
        """The goal's id."""
        return self.goal.id or ""
