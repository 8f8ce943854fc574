"""Starts tours by their schedule: which are due in a minute of local time."""

import datetime
import time
from collections.abc import Iterable
from typing import get_args

from trolley import codes
from trolley.messages import Tour
from trolley.messages.touring import Day
from trolley.runtime.service import Service, every
from trolley.under_way import trip_of
from trolley_tour.charge_monitor import ChargeMonitor
from trolley_tour.problems import Problems
from trolley_tour.robot_state import RobotState
from trolley_tour.stored.checks import parse_utc
from trolley_tour.stored.tours import Tours
from trolley_tour.trips.runner import SKIPPED, TripRunner

LONGEST_PAUSE = datetime.timedelta(minutes=30)
"""A trip or goal that has been paused for longer gives way: nobody is about to go on with it."""
CLOCK = "clock"
UNKNOWN_TIME_NS = 600_000_000_000
"""The clock of a computer that has just started is synchronised by then [ns]."""
UNKNOWN_TIME = (
    "No tour starts at its time: the clock of the robot's computer is not synchronised. Let it "
    "reach the internet."
)
OCCUPATIONS = {
    codes.BUSY: "the robot was driving to a goal",
    codes.TAKEN_OVER: "somebody was driving the robot",
    codes.MAPPING: "a map was being made",
}
"""What the robot was doing when a tour was due."""
_DAYS: tuple[str, ...] = get_args(Day)


def tours_due(tours: Iterable[Tour], minute: datetime.datetime) -> list[Tour]:
    """Find the tours with an entry for this minute, in order.

    Args:
        tours: All that are stored.
        minute: Local time; seconds do not count. An hour that the clock skips or repeats in spring
            or autumn starts nothing, or starts it twice.
    """
    day, at = _DAYS[minute.weekday()], f"{minute:%H:%M}"
    return [
        tour
        for tour in tours
        if any(entry.at == at and (not entry.days or day in entry.days) for entry in tour.schedule)
    ]


class Minutes:
    """Each minute once; minutes in which nobody asked are not made up for."""

    def __init__(self) -> None:
        self._last: str | None = None

    def next(self, now: datetime.datetime) -> datetime.datetime | None:
        """The present minute, None where it was given before. The first one is not given.

        A service that is restarted must not start again what it started in this minute.
        """
        minute = now.replace(second=0, microsecond=0)
        last, self._last = self._last, minute.isoformat()
        return None if last is None or last == self._last else minute


class Scheduler:
    """Looks each second what is due, once the host's clock is synchronised."""

    def __init__(
        self,
        service: Service,
        tours: Tours,
        robot: RobotState,
        trips: TripRunner,
        charge: ChargeMonitor,
        problems: Problems,
    ) -> None:
        self._service = service
        self._tours = tours
        self._robot = robot
        self._trips = trips
        self._charge = charge
        self._problems = problems
        self._minutes = Minutes()
        self._time_known_ns: int | None = None
        """When the time was known last, or else when it was asked for first (local monotonic)."""
        self._goal_paused_at: datetime.datetime | None = None
        self._skipped: str | None = None

    @every(1.0, clock="local")
    def _start_due_tours(self) -> None:
        if self._skipped is not None and self._skipped not in self._tours.items:
            self._skipped = None
            self._problems.set(SKIPPED, None)
        now = self._service.utc_now()
        moment = None if now is None else parse_utc(now)
        self._tell_of_clock(is_known=moment is not None)
        if moment is None:
            return
        time.tzset()  # the time zone may have been set since this service began
        goal = self._robot.goal.latest
        if goal is None or goal.state != "paused" or trip_of(goal.id) is not None:
            self._goal_paused_at = None
        elif self._goal_paused_at is None:
            self._goal_paused_at = moment
        minute = self._minutes.next(moment.astimezone())
        for tour in [] if minute is None else tours_due(self._tours.items.values(), minute):
            self._start(tour, moment.astimezone())

    def _tell_of_clock(self, *, is_known: bool) -> None:
        """Say where tours would start if the time were known."""
        now_ns = self._service.monotonic_ns
        if is_known or self._time_known_ns is None:
            self._time_known_ns = now_ns
        is_missed = now_ns - self._time_known_ns >= UNKNOWN_TIME_NS and any(
            tour.schedule for tour in self._tours.items.values()
        )
        self._problems.set(CLOCK, UNKNOWN_TIME if is_missed else None)

    def _start(self, tour: Tour, now: datetime.datetime) -> None:
        """Start a tour, or say why not until another one is started, or this one deleted."""
        obstacle = self._obstacle(tour, now)
        if not obstacle:
            self._service.log.info("A tour is due", tour=tour.name)
            self._trips.begin(tour)
            return
        due = f"{now:%Y-%m-%d at %H:%M}"
        sentence = f"The tour “{tour.name}”, due on {due}, was skipped: {obstacle}."
        self._service.count("schedule/skipped")
        self._service.log.warning(sentence)
        self._problems.set(SKIPPED, sentence)
        self._skipped = tour.name

    def _obstacle(self, tour: Tour, now: datetime.datetime) -> str:
        """What keeps a tour from starting, in words, "" if nothing does."""
        if self._charge.is_low:
            return "the battery was low"
        base = self._robot.base.latest
        if base is not None and base.is_halted:
            return "the robot was stopped"
        if not tour.is_for(self._robot.map_name):
            return f"the robot was not on its map {tour.map}"
        trip, goal_paused_at = self._trips.record, self._goal_paused_at
        if trip is not None and trip.is_under_way:
            return "another tour was under way"
        if trip is not None and not trip.is_over:
            paused_at = parse_utc(trip.paused_at or "")
            if paused_at is None or now - paused_at <= LONGEST_PAUSE:
                return "another tour was paused"
        if goal_paused_at is not None and now - goal_paused_at <= LONGEST_PAUSE:
            return "a goal was paused"
        return OCCUPATIONS.get(self._robot.occupation, "")
