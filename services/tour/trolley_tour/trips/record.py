"""What is known of a trip. All of it is saved, so that it can go on after a restart."""

import dataclasses
from typing import Any, ClassVar, Literal

from msgspec import Struct, structs

from trolley import codes
from trolley.geometry import Pose2D
from trolley.messages import PastTrip, Stop, StopResult, Tour, TourStatus
from trolley.messages.touring import TripState
from trolley.under_way import TRIP_GOES, TRIP_UNDER_WAY, trip_goal_id
from trolley_tour import sentences
from trolley_tour.stored.checks import MAX_ROUNDS, limited
from trolley_tour.trips.route import lap_stops

StopState = Literal["reached", "skipped", "failed"]
MIN_RESULTS = 200
"""Results that are kept at least, or those of two laps; the oldest are dropped."""
MAX_REPEATED_POINTS = 300
"""A tour of more stops and via points is not repeated in every status."""


@dataclasses.dataclass(frozen=True)
class Moment:
    """When and where: robot time [ns] and UTC where known, the local clock [ns], the place."""

    robot_ns: int | None
    monotonic_ns: int
    utc: str | None = None
    map: str | None = None
    pose: Pose2D | None = None
    """Where the robot believes it is on that map."""


class TripRecord(Struct, kw_only=True):
    """A trip: the tour as it was when it began, and how far it got."""

    trip: str
    tour: Tour
    state: TripState = "driving"
    reason: str = ""
    message: str = ""
    lap: int = 0
    position: int = 0
    """Which visit of the lap."""
    tries: list[int]
    """Per stop of the tour: goals sent so far, which keeps their ids apart."""
    failures: int = 0
    """Failed tries of this visit."""
    reached_here: bool = False
    """Whether this visit's stop was reached: what is left is to dwell."""
    goal: str | None = None
    """The id of the goal that this visit drives by, or did until it was paused."""
    goal_before: str | None = None
    """The goal that was the planner's when this one was sent."""
    epoch_ns: int | None = None
    """The run of `base` in which it drives."""
    results: list[StopResult] = []
    reached: int = 0
    missed: int = 0
    reached_in_lap: int = 0
    barren_laps: int = 0
    """Laps in a row in which nothing was reached."""
    started_at: str | None = None
    ended_at: str | None = None
    seconds: float = 0.0
    """Robot seconds since the start."""
    visit_started_at: str | None = None
    visit_seconds: float = 0.0
    """Robot seconds of driving on this visit."""
    map: str | None = None
    """The map on which it began."""
    visit_pose: Pose2D | None = None
    """Where the stop of this visit is, as far as its place was found."""
    battery: float | None = None
    """The charge because of which it drives home; null for a trip that somebody wanted."""
    interrupted: "TripRecord | None" = None
    """The trip that waits, paused, for the end of this one."""
    speed: float | None = None
    """It is driven at this speed at most [m/s]; null for as fast as the robot drives."""
    paused_at: str | None = None
    """Since when it has been paused, as UTC; null if it is not, or the time is not known yet."""

    SCHEMA: ClassVar[int] = 3

    @classmethod
    def bring_forward(cls, plain: dict[str, Any], schema: int) -> dict[str, Any]:
        """Return the content of an older file: 1 knew no `speed`, 2 no `paused_at` and limits."""
        del schema
        return limited(plain)

    def __post_init__(self) -> None:
        """Refuse a file whose parts do not fit together."""
        if len(self.tries) != len(self.tour.stops) or self.state == "idle":
            raise ValueError("TripRecord: tries or state do not fit the tour")
        if self.speed is not None and not self.speed > 0.0:
            raise ValueError("TripRecord: a speed is above 0")
        if self.lap < 0 or not 0 <= self.position < len(self.visits):
            raise ValueError("TripRecord: there is no such lap and position")

    @property
    def is_under_way(self) -> bool:
        """Whether it goes on by itself."""
        return self.state in TRIP_GOES

    @property
    def is_over(self) -> bool:
        """Whether it ended."""
        return self.state not in TRIP_UNDER_WAY

    @property
    def num_results(self) -> int:
        """How many visits ended, those included whose results were dropped."""
        return self.reached + self.missed

    @property
    def stop_index(self) -> int:
        """The stop of the tour that this visit is about."""
        return self.visits[self.position]

    @property
    def visits(self) -> list[int]:
        """The stops of this lap in order."""
        return lap_stops(len(self.tour.stops), self.tour.there_and_back, self.lap)

    @property
    def stop(self) -> Stop:
        """The stop itself."""
        return self.tour.stops[self.stop_index]

    @property
    def title(self) -> str:
        """The stop in words."""
        return sentences.stop_title(self.stop_index, self.stop)

    @property
    def driving_reason_and_message(self) -> tuple[str, str]:
        """What its status says while it drives."""
        if self.battery is not None:
            return codes.LOW_BATTERY, f"{sentences.battery_at(self.battery)}: driving home."
        return "", f"Driving to {self.title}."

    @property
    def done_reason_and_message(self) -> tuple[str, str]:
        """What its status says at its end."""
        if self.battery is not None:
            return codes.LOW_BATTERY, "Home, because the battery was low."
        return "", sentences.trip_done(self.reached, self.missed)

    @property
    def via(self) -> list[Pose2D]:
        """The points on the way to this stop; those of the way there, backwards, on a way back."""
        visits, position = self.visits, self.position
        if position and visits[position - 1] > visits[position]:
            return self.tour.stops[visits[position - 1]].via[::-1]
        return list(self.stop.via)

    def next_goal(self) -> str:
        """A fresh id for a goal to the present stop."""
        index = self.stop_index
        self.tries[index] += 1
        self.goal = trip_goal_id(self.trip, index, self.tries[index])
        return self.goal

    def note(self, state: StopState, code: str, message: str, at: Moment) -> None:
        """Add how the stop ended; a trip without end keeps the newest results."""
        result = StopResult(
            stop=self.stop_index,
            name=self.stop.name,
            state=state,
            code=code,
            message=message,
            started_at=self.visit_started_at,
            seconds=self.visit_seconds,
            pose=at.pose if at.map == self.map else None,
            goal=self.visit_pose,
        )
        keep = max(MIN_RESULTS, 2 * len(self.tour.stops))
        self.results = [*self.results, result][-keep:]
        if state == "reached":
            self.reached_here = True
            self.reached += 1
            self.reached_in_lap += 1
        else:
            self.missed += 1

    def advance(self) -> Literal["visit", "lap", "end"]:
        """Turn to the next visit; says whether it is one, a new lap or the end."""
        came: Literal["visit", "lap", "end"] = "visit"
        if self.position + 1 == len(self.visits):
            if self.tour.repeat and self.lap + 1 >= self.tour.repeat:
                return "end"
            came = "lap"
            self.barren_laps = 0 if self.reached_in_lap else self.barren_laps + 1
            self.lap, self.position, self.reached_in_lap = self.lap + 1, 0, 0
        else:
            self.position += 1
        self.goal, self.failures, self.reached_here = None, 0, False
        self.visit_started_at, self.visit_seconds, self.visit_pose = None, 0.0, None
        return came

    def copy(self) -> "TripRecord":
        """A copy that later changes do not affect."""
        return structs.replace(self, tries=list(self.tries), results=list(self.results))

    def status(self, stamp_ns: int) -> TourStatus:
        """What is published of it."""
        return TourStatus(
            stamp_ns=stamp_ns,
            name=self.tour.name or None,
            trip=self.trip,
            state=self.state,
            reason=self.reason,
            message=self.message,
            stop=None if self.state == "done" else self.stop_index,
            lap=self.lap,
            results=self.results,
            seconds=self.seconds,
            tour=self.tour if self._num_points <= MAX_REPEATED_POINTS else None,
            reached=self.reached,
            missed=self.missed,
        )

    def past(self) -> PastTrip:
        """What the history keeps of it."""
        return PastTrip(
            trip=self.trip,
            name=self.tour.name or None,
            state=self.state,
            reason=self.reason,
            message=self.message,
            started_at=self.started_at,
            ended_at=self.ended_at,
            seconds=self.seconds,
            results=list(self.results),
            map=self.map,
            planned=self._num_planned,
            reached=self.reached,
            missed=self.missed,
        )

    @property
    def _num_points(self) -> int:
        return sum(1 + len(stop.via) for stop in self.tour.stops)

    @property
    def _num_planned(self) -> int:
        """Visits of all laps, 0 where they never end."""
        tour = self.tour
        first, later = (len(lap_stops(len(tour.stops), tour.there_and_back, lap)) for lap in (0, 1))
        rounds = min(tour.repeat, MAX_ROUNDS)  # a file may say more
        return first + (rounds - 1) * later if rounds else 0
