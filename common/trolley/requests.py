"""The one table of requests: key under `@do/`, parameters, reply, who answers, refusals."""

import dataclasses
from typing import Any, Generic, TypeVar, cast

import msgspec

from trolley import codes
from trolley import messages as m
from trolley.messages import request_params
from trolley.topics import ROOT

P = TypeVar("P", bound=msgspec.Struct)
R = TypeVar("R")


@dataclasses.dataclass(frozen=True)
class Request(Generic[P, R]):
    """A row of the table."""

    name: str
    params: type[P]
    reply: type[R]
    """What msgspec encodes as the answer."""
    owner: str
    """The service that answers."""
    refusals: tuple[str, ...] = ()
    """Codes that it may be refused with, besides those that any request may be refused with."""
    always: bool = False
    """Whether it is obeyed whatever the payload holds, and for all robots at once."""

    def key(self, robot: str) -> str:
        """The full key; "*" as robot is allowed only where the row says `always`."""
        return f"{ROOT}/{robot}/@do/{self.name}"


GOAL_REFUSALS = (
    codes.IN_OBSTACLE,
    codes.OUTSIDE_MAP,
    codes.KEEPOUT,
    codes.NO_PATH,
    codes.NOT_LOCALIZED,
    codes.WRONG_FRAME,
    codes.WRONG_MAP,
    codes.STOPPED,
    codes.TOUR_NOT_RUNNING,
)

POSE_CAPTURE = Request(
    "pose/capture",
    request_params.Capture,
    m.CapturedPose,
    "tour",
    (
        codes.LOST,
        codes.STALE,
        codes.MOVING,
        codes.NOT_CONVERGED,
        codes.EXISTS,
        codes.NOT_SAVED,
    ),
)
POSE_SET = Request(
    "pose/set",
    request_params.SetPose,
    m.PoseEstimate,
    "localizer",
    (codes.OUTSIDE_MAP, codes.IN_OBSTACLE, codes.MAPPING),
)
POSE_FIND = Request(
    "pose/find", request_params.Nothing, m.PoseEstimate, "localizer", (codes.MAPPING,)
)
GOAL_SEND = Request("goal/send", request_params.SendGoal, m.GoalStatus, "planner", GOAL_REFUSALS)
GOAL_PREVIEW = Request("goal/preview", request_params.SendGoal, m.Path, "planner", GOAL_REFUSALS)
GOAL_FOLLOW = Request(
    "goal/follow",
    request_params.FollowPerson,
    m.GoalStatus,
    "planner",
    (
        codes.NOBODY,
        codes.OUTSIDE_MAP,
        codes.KEEPOUT,
        codes.IN_OBSTACLE,
        codes.NO_PATH,
        codes.NOT_LOCALIZED,
        codes.WRONG_FRAME,
        codes.STOPPED,
    ),
)
GOAL_CANCEL = Request(
    "goal/cancel", request_params.WhichGoal, m.GoalStatus, "planner", (codes.NOT_CURRENT,)
)
GOAL_PAUSE = Request(
    "goal/pause", request_params.WhichGoal, m.GoalStatus, "planner", (codes.NOT_CURRENT,)
)
GOAL_RESUME = Request(
    "goal/resume",
    request_params.WhichGoal,
    m.GoalStatus,
    "planner",
    (codes.NOT_CURRENT, codes.STOPPED, codes.PERSON_LOST),
)
TOUR_START = Request("tour/start", request_params.StartTour, m.TourStatus, "tour")
TOUR_STOP = Request("tour/stop", request_params.Nothing, m.TourStatus, "tour", (codes.NOT_DRIVING,))
TOUR_PAUSE = Request(
    "tour/pause", request_params.Nothing, m.TourStatus, "tour", (codes.NOT_DRIVING,)
)
TOUR_RESUME = Request(
    "tour/resume", request_params.Nothing, m.TourStatus, "tour", (codes.NOT_DRIVING,)
)
TOUR_SKIP = Request("tour/skip", request_params.Nothing, m.TourStatus, "tour", (codes.NOT_DRIVING,))
TOUR_HISTORY = Request("tour/history", request_params.AskHistory, list[m.PastTrip], "tour")
TOUR_PHOTO = Request("tour/photo", request_params.WhichPhoto, m.Photo, "tour")
TOUR_OFFER = Request("tour/offer", request_params.AskOffer, m.Offer, "tour")
POSES_PUT = Request("poses/put", m.SavedPose, m.SavedPose, "tour", (codes.NOT_SAVED,))
POSES_DELETE = Request(
    "poses/delete", request_params.Named, m.SavedPose, "tour", (codes.NOT_SAVED,)
)
TOURS_PUT = Request("tours/put", m.Tour, m.Tour, "tour", (codes.NOT_SAVED,))
TOURS_DELETE = Request("tours/delete", request_params.Named, m.Tour, "tour", (codes.NOT_SAVED,))
ZONES_PUT = Request("zones/put", m.Zone, m.Zone, "localizer", (codes.NOT_SAVED,))
ZONES_DELETE = Request(
    "zones/delete", request_params.Named, m.Zone, "localizer", (codes.NOT_SAVED,)
)
CHANGES_DISMISS = Request(
    "changes/dismiss",
    request_params.WhichChange,
    m.MapChange,
    "localizer",
    (codes.NOT_SAVED, codes.MAPPING),
)
BASE_STOP = Request("base/stop", request_params.Nothing, m.BaseState, "base", always=True)
BASE_RESUME = Request("base/resume", request_params.Nothing, m.BaseState, "base")
PROPOSALS_DISMISS = Request(
    "proposals/dismiss", request_params.WhichProposal, m.Proposal, "base", (codes.NOT_SAVED,)
)
CONFIG_GET = Request("config/get", request_params.WhichConfig, m.Settings, "base")
CONFIG_SET = Request(
    "config/set",
    request_params.SetConfig,
    m.Settings,
    "base",
    (codes.ONLY_IN_FILE, codes.FILE_CHANGED, codes.NOT_SAVED, codes.BUSY),
)
SETUP_ANSWER = Request(
    "setup/answer", request_params.AnswerSetup, m.SetupState, "setup", (codes.NOT_CURRENT,)
)
MAP_LIST = Request("map/list", request_params.Nothing, list[str], "localizer")
MAP_LOAD = Request(
    "map/load",
    request_params.LoadMap,
    m.MapInfo,
    "localizer",
    (codes.OUTSIDE_MAP, codes.IN_OBSTACLE, codes.MAPPING),
)
LOCALIZER_YIELD = Request(
    "localizer/yield", request_params.Yield, m.PoseEstimate, "localizer", (codes.NOT_CURRENT,)
)
MAP_NEW = Request(
    "map/new", request_params.MapNamed, m.MappingStatus, "mapper", (codes.MAPPING, codes.EXISTS)
)
MAP_EXTEND = Request(
    "map/extend",
    request_params.MapNamed,
    m.MappingStatus,
    "mapper",
    (codes.MAPPING, codes.WRONG_MAP, codes.NOT_LOCALIZED),
)
MAP_SAVE = Request(
    "map/save",
    request_params.SaveMap,
    m.MappingStatus,
    "mapper",
    (codes.NOT_MAPPING, codes.EXISTS, codes.NOT_SAVED),
)
MAP_PAUSE = Request(
    "map/pause", request_params.PauseMap, m.MappingStatus, "mapper", (codes.NOT_MAPPING,)
)
MAP_EXPLORE = Request(
    "map/explore", request_params.ExploreMap, m.MappingStatus, "mapper", (codes.NOT_MAPPING,)
)
MAP_UNDO = Request(
    "map/undo", request_params.UndoMap, m.MappingStatus, "mapper", (codes.NOT_MAPPING,)
)
MAP_JOIN = Request(
    "map/join",
    request_params.JoinPart,
    m.MappingStatus,
    "mapper",
    (codes.NOT_MAPPING, codes.NOT_LOOSE, codes.OUTSIDE_MAP),
)
MAP_DROP = Request(
    "map/drop",
    request_params.Nothing,
    m.MappingStatus,
    "mapper",
    (codes.NOT_MAPPING, codes.NOT_LOOSE),
)
MAP_CANCEL = Request(
    "map/cancel", request_params.Nothing, m.MappingStatus, "mapper", (codes.NOT_MAPPING,)
)
MAP_ZONES_PUT = Request("map/zones/put", m.Zone, m.Zone, "mapper", (codes.NOT_MAPPING,))
MAP_ZONES_DELETE = Request(
    "map/zones/delete", request_params.Named, m.Zone, "mapper", (codes.NOT_MAPPING,)
)
MAP_EDIT = Request(
    "map/edit",
    m.EditMap,
    m.MapEdited,
    "mapper",
    (
        codes.MAPPING,
        codes.EXISTS,
        codes.OUTSIDE_MAP,
        codes.NO_MATCH,
        codes.AMBIGUOUS,
        codes.WRONG_MAP,
        codes.BUSY,
        codes.NOT_SAVED,
    ),
)

REQUESTS: tuple[Request[Any, Any], ...] = tuple(
    cast("Request[Any, Any]", row) for row in list(globals().values()) if isinstance(row, Request)
)
"""All rows, in the order above."""
