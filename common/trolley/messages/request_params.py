"""Parameters of the requests, one struct each, decoded strictly: unknown fields are refused."""

from typing import Annotated, Any

from msgspec import Meta, Struct

from trolley.geometry.pose import LARGEST, Pose2D
from trolley.messages.driving import GoalId
from trolley.messages.mapping import MapName
from trolley.messages.touring import Tour
from trolley.messages.types import Covariance, Point, Positive

_Line = Annotated[list[Point], Meta(min_length=2, max_length=2)]
PhotoName = Annotated[str, Meta(pattern=r"\A[a-z0-9]{1,12}-[0-9]{1,9}\Z")]


class Nothing(Struct, frozen=True, kw_only=True):
    """A request without parameters."""


class Capture(Struct, frozen=True, kw_only=True):
    """Ask where the robot is; with a `name`, save it, over an existing one only with `replace`."""

    name: str | None = None
    icon: str = ""
    replace: bool = False


class SetPose(Struct, frozen=True, kw_only=True):
    """Tell the robot that it is roughly at map_T_base `pose`."""

    pose: Pose2D
    covariance: Covariance | None = None


FINEST_XY_M, FINEST_YAW_RAD = 0.005, 0.01
"""Least tolerances of a goal: no robot stands finer, and would say that it cannot get on."""


class SendGoal(Struct, frozen=True, kw_only=True):
    """Drive to `pose` in `frame`, or to the saved place `name`: exactly one of the two.

    `xy_tolerance` [m], `yaw_tolerance` [rad] (pi or more: any heading), `speed` [m/s] at most.
    """

    id: GoalId | None = None
    pose: Pose2D | None = None
    name: str | None = None
    frame: str | None = None
    via: Annotated[list[Pose2D], Meta(max_length=1000)] = []
    xy_tolerance: Annotated[float, Meta(ge=FINEST_XY_M, le=LARGEST)] = 0.05
    yaw_tolerance: Annotated[float, Meta(ge=FINEST_YAW_RAD, le=LARGEST)] = 0.05
    speed: Positive | None = None

    def __post_init__(self) -> None:
        """Refuse a goal that names two places or none."""
        if (self.pose is None) == (self.name is None):
            raise ValueError("give either pose or name")


class FollowPerson(Struct, frozen=True, kw_only=True):
    """Follow the person nearest to `point` [m] in `frame`; without a point, the nearest one ahead.

    The robot keeps `distance` [m] behind them, from its middle to theirs, at `speed` [m/s] at most.
    """

    id: GoalId | None = None
    point: Point | None = None
    frame: str | None = None
    distance: Annotated[float, Meta(ge=0.8, le=2.0)] = 1.2
    speed: Positive | None = None


class WhichGoal(Struct, frozen=True, kw_only=True):
    """The goal with this id; without one, the current goal."""

    id: GoalId | None = None


class StartTour(Struct, frozen=True, kw_only=True):
    """Start the stored tour `name`, or the one given: exactly one of the two.

    It is driven at `speed` [m/s] at most, after a restart of the tour service, too.
    """

    name: str | None = None
    tour: Tour | None = None
    speed: Positive | None = None

    def __post_init__(self) -> None:
        """Refuse two tours or none."""
        if (self.name is None) == (self.tour is None):
            raise ValueError("give either name or tour")


class AskHistory(Struct, frozen=True, kw_only=True):
    """Past trips that started at or after `since` (ISO 8601), the newest `limit` of them."""

    since: str | None = None
    limit: Annotated[int, Meta(ge=1, le=1000)] = 100


class WhichPhoto(Struct, frozen=True, kw_only=True):
    """A photo of a past trip, by its name in the trip's `photos`."""

    name: PhotoName


class AskOffer(Struct, frozen=True, kw_only=True):
    """Ask how soon the robot could be at `pose` or at the saved place `name`."""

    pose: Pose2D | None = None
    name: str | None = None

    def __post_init__(self) -> None:
        """Refuse two places or none."""
        if (self.pose is None) == (self.name is None):
            raise ValueError("give either pose or name")


class Named(Struct, frozen=True, kw_only=True):
    """The thing of this name."""

    name: str


class LoadMap(Struct, frozen=True, kw_only=True):
    """Load the map `name`. The robot is at `pose` on it; if none is given, it searches the map.

    `mirrors` are those suspected while the map was made, from one end to the other in frame `map`.
    """

    name: MapName
    pose: Pose2D | None = None
    mirrors: Annotated[list[_Line], Meta(max_length=1000)] = []


class MapNamed(Struct, frozen=True, kw_only=True):
    """The map of this name, new or existing.

    With `explore`, the robot explores by itself, at `speed` [m/s] at most.
    """

    name: MapName
    explore: bool = False
    speed: Positive | None = None


class ExploreMap(Struct, frozen=True, kw_only=True):
    """Let the robot explore by itself (`on`), at `speed` [m/s] at most, or stop exploring."""

    on: bool = True
    speed: Positive | None = None


class SaveMap(Struct, frozen=True, kw_only=True):
    """Save the map that is being made, under another name if one is given."""

    name: MapName | None = None


class PauseMap(Struct, frozen=True, kw_only=True):
    """Pause mapping (`on`), or resume it."""

    on: bool = True


class UndoMap(Struct, frozen=True, kw_only=True):
    """Remove what was mapped in the last `seconds` of robot time."""

    seconds: Annotated[float, Meta(gt=0.0, le=86_400.0)] = 60.0


class JoinPart(Struct, frozen=True, kw_only=True):
    """Join the part that hangs loose to the map: the robot is about at `pose` on it."""

    pose: Pose2D


class Yield(Struct, frozen=True, kw_only=True):
    """Leave the shared topics to the mapper for another 3 s (`on`), or take them back.

    `hand_over` names the only map whose `map/load` may end this.
    """

    on: bool = True
    hand_over: MapName | None = None


class WhichChange(Struct, frozen=True, kw_only=True):
    """A proposed change of the map, by its `id` in `changes`."""

    id: str


class WhichProposal(Struct, frozen=True, kw_only=True):
    """A proposed correction of `robot.toml`, by its `id` in `proposals`."""

    id: str


class WhichConfig(Struct, frozen=True, kw_only=True):
    """The settings of a section such as `base.limits`, or one of them; without either, all."""

    section: str | None = None
    key: str | None = None


class SetConfig(Struct, frozen=True, kw_only=True):
    """Give settings of one section other values; `null` means the default.

    With `save` they are also written into robot.toml, whose comments stay.
    """

    section: str
    values: dict[str, Any]
    save: bool = True


class AnswerSetup(Struct, frozen=True, kw_only=True):
    """Answer the question `question` of a setup's `run`; `who` tells pages and programs apart."""

    run: Annotated[str, Meta(max_length=64)]
    question: int
    answer: Annotated[str, Meta(max_length=1000)]
    who: Annotated[str, Meta(min_length=1, max_length=64)]
