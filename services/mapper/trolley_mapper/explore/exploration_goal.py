"""What an explorer sees, what it may do, and what it wishes."""

from collections.abc import Sequence
from dataclasses import dataclass

from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.messages import Zone
from trolley.messages.request_params import SendGoal
from trolley_mapper.explore.frontiers import Body, Frontier, Outlook, look_out
from trolley_mapper.explore.traversable_area import Floor, lay_floor


@dataclass(frozen=True, slots=True)
class Limits:
    """What must not be exceeded, whatever glass doors seem to show."""

    radius_m: float
    """No farther from home than this."""
    area_m2: float
    """Enough floor for any house."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """What there is to be seen at one moment."""

    grid: GridMap
    """The map as it is now."""
    pose: Pose2D
    """map_T_base."""
    is_lost: bool
    """Whether the mapper does not know where the robot is."""
    is_unsure: bool
    """Whether it doubts it."""
    zones: Sequence[Zone]
    """Those of the map that is being extended, and those that people have drawn."""
    home: Pose2D
    """Where to drive in the end: map_T_base."""


@dataclass(frozen=True, slots=True)
class Sight:
    """What a look at the map has shown."""

    floor: Floor
    outlook: Outlook


def look(scene: Scene, body: Body, limits: Limits) -> Sight:
    """Look at the map, which takes some hundredths of a second."""
    within = scene.home, limits.radius_m
    floor = lay_floor(scene.grid, scene.zones, scene.pose, body.passes_m, within)
    return Sight(floor, look_out(floor, scene.pose, body))


@dataclass(frozen=True, slots=True)
class Send:
    """Send a goal to the planner."""

    goal: SendGoal


@dataclass(frozen=True, slots=True)
class Cancel:
    """Cancel a goal of ours at the planner."""

    goal_id: str


Wish = Send | Cancel


@dataclass(slots=True)
class Errand:
    """A goal that was sent."""

    goal: SendGoal
    target: Frontier | None
    """None: home."""
    sent_s: float
    limit_s: float
    area_m2: float
    """Floor that was known when it was chosen."""
    heard_s: float
    """When it was sent last, or something was heard of it."""

    @property
    def id(self) -> str:
        """The goal's."""
        return self.goal.id or ""
