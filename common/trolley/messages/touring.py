"""Messages of `tour`: what people store (poses, tours) and the trip under way."""

from typing import Annotated, Literal

from msgspec import Meta, Struct

from trolley.geometry.pose import Pose2D
from trolley.messages.mapping import PoseState
from trolley.messages.types import Count, Covariance, NonNegative, Positive, Share, StampNs

Day = Literal["mon", "tue", "wed", "thu", "fri", "sat", "sun"]
TripState = Literal["idle", "driving", "dwelling", "waiting", "paused", "done", "failed", "stopped"]

HOME = "home"
"""The place that a robot returns to: when its battery is low, or when it is told to go home."""

TimeOfDay = Annotated[str, Meta(pattern=r"\A([01][0-9]|2[0-3]):[0-5][0-9]\Z")]


class SavedPose(Struct, frozen=True, kw_only=True):
    """A named place: map_T_base on the map called `map`. `saved_at` is UTC, ISO 8601, or null.

    A program that puts one may leave out `name`, which is in the key, and `map`, if it is the
    current one.
    """

    name: str = ""
    map: str = ""
    pose: Pose2D
    covariance: Covariance | None = None
    saved_at: str | None = None
    icon: str = ""
    note: str = ""


class SavedPoses(Struct, frozen=True, kw_only=True):
    """All named places. Owned by `tour`, on change."""

    stamp_ns: StampNs
    poses: list[SavedPose]


class CapturedPose(Struct, frozen=True, kw_only=True):
    """The answer to `pose/capture`: a SavedPose and how good it is.

    `name` is "" if nothing was saved; `age` [s] is that of the newest estimate.
    """

    name: str
    map: str
    pose: Pose2D
    covariance: Covariance | None = None
    saved_at: str | None = None
    icon: str = ""
    note: str = ""
    state: PoseState
    match: Share
    age: NonNegative


class Stop(Struct, frozen=True, kw_only=True):
    """One stop of a tour: `pose` (in `map`) or the `name` of a saved place, exactly one of the two.

    `via` are poses passed on the way; `dwell` [s] is the stay; `timeout` [s] bounds each drive
    (null: `[tour] stop_timeout_s`). After a failure the stop is tried `retries` more times, then
    `on_failure` applies: `skip` it or `abort` the trip. `retry` aborts after `retries`, too, but
    with `retries` 0 it tries until the stop is reached.
    """

    pose: Pose2D | None = None
    name: str | None = None
    via: list[Pose2D] = []
    dwell: NonNegative = 0.0
    timeout: Positive | None = None
    retries: Count = 0
    on_failure: Literal["retry", "skip", "abort"] = "abort"

    def __post_init__(self) -> None:
        """Refuse a stop that names two places or none."""
        if (self.pose is None) == (self.name is None):
            raise ValueError("Stop: give either pose or name")


class ScheduleEntry(Struct, frozen=True, kw_only=True):
    """Start at a local time of day, such as "08:30", on these days (empty: every day)."""

    days: list[Day] = []
    at: TimeOfDay


class Tour(Struct, frozen=True, kw_only=True):
    """A trip through several places. `repeat` 0 = forever; `resume`: continue after a reboot.

    More than 1000000 rounds are refused. `there_and_back`: after the last stop the others are
    visited in reverse order. `name` may be left out if it is in the key, and for a trip that is
    started without being saved. `map` is where poses and `via` of its stops lie, "" if there are
    none, or for any map. If it is left out, they lie on the map of the stored tour of this name if
    all are in it, else on the current one.
    """

    name: str = ""
    stops: Annotated[list[Stop], Meta(min_length=1, max_length=1000)]
    repeat: Count = 1
    there_and_back: bool = False
    schedule: list[ScheduleEntry] = []
    resume: bool = False
    map: str = ""

    @property
    def has_poses(self) -> bool:
        """Whether it has poses of its own, rather than names of places only."""
        return any(stop.pose is not None or stop.via for stop in self.stops)

    def is_for(self, map_name: str | None) -> bool:
        """Say whether it can be driven on this map, None for one that is not known."""
        return map_name is None or self.map in ("", map_name)


class Tours(Struct, frozen=True, kw_only=True):
    """All tours. Owned by `tour`, on change."""

    stamp_ns: StampNs
    tours: list[Tour]


class StopResult(Struct, frozen=True, kw_only=True):
    """The result of one stop. `stop` is its index in the tour; `code` says why it was not reached.

    `pose` is where the robot believed it was at that moment and `goal` where the stop is (both in
    `map`), null where unknown.
    """

    stop: Count
    name: str | None = None
    state: Literal["reached", "skipped", "failed"]
    code: str = ""
    message: str = ""
    started_at: str | None = None
    seconds: NonNegative = 0.0
    pose: Pose2D | None = None
    goal: Pose2D | None = None


class Photo(Struct, frozen=True, kw_only=True):
    """The answer to `tour/photo`: the bytes of a JPEG file."""

    name: str
    jpeg: bytes


class TourStatus(Struct, frozen=True, kw_only=True):
    """The trip under way or the last one.

    `trip` is its id, `stop` the index of the stop that it is at or drives to; `lap` counts from 0.
    The ids of its goals are `tour-<trip>-<stop>-<attempt>`.
    `seconds` is the robot time since it started, `tour` the tour as it was then (null if it has
    over 300 points, which is too much to repeat). `results` of a long trip holds only the newest;
    `reached` and `missed` count all stops that were reached or not.
    """

    stamp_ns: StampNs
    name: str | None
    trip: Annotated[str, Meta(pattern=r"\A[a-z0-9]{1,12}\Z")] | None
    state: TripState
    reason: str = ""
    message: str = ""
    stop: Count | None = None
    lap: Count = 0
    results: list[StopResult] = []
    seconds: NonNegative = 0.0
    tour: Tour | None = None
    reached: Count = 0
    missed: Count = 0

    @property
    def num_missed(self) -> int:
        """Stops that were not reached; a tour service that counts none tells its results."""
        return max(self.missed, sum(one.state != "reached" for one in self.results))

    @property
    def num_ended(self) -> int:
        """Stops that were reached or not."""
        return max(self.reached + self.missed, len(self.results))


class PastTrip(Struct, frozen=True, kw_only=True):
    """A trip of the history.

    `map` is the map that it was driven on, `planned` the number of stops to visit in all rounds (0:
    no end was set), `reached` and `missed` how many were reached or not. `results` of a long trip
    holds only the newest; `photos` has for each of them the name of the photo taken there, "" where
    there is none, or is empty.
    """

    trip: str
    name: str | None
    state: TripState
    reason: str = ""
    message: str = ""
    started_at: str | None = None
    ended_at: str | None = None
    seconds: NonNegative = 0.0
    results: list[StopResult] = []
    map: str | None = None
    planned: Count = 0
    reached: Count = 0
    missed: Count = 0
    photos: list[str] = []


class Offer(Struct, frozen=True, kw_only=True):
    """How soon this robot could be there.

    `seconds` is null if it cannot get there. `free` means that a goal would interrupt nothing and
    the robot is not charging. `reason` is the code of why it cannot, or is not free.
    """

    free: bool
    seconds: NonNegative | None = None
    reason: str = ""
