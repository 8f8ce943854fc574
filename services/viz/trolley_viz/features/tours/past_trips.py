"""Past trips: when, which tour, how long, how far it got, and what came of each stop."""

import datetime
from collections.abc import Callable, Sequence

from trolley.messages import PastTrip, StopResult, TourStatus
from trolley_viz.controls.controls import Controls
from trolley_viz.controls.markup import details, lead, note, photo, row
from trolley_viz.robots.past_trips import PastTrips, has_failed
from trolley_viz.words.plain_words import said
from trolley_viz.words.sentences import StatusLine, Tone, duration, result_line, stops_text

SHOWN_AT_ONCE = 20
MAX_RESULTS = 50
ALL_TOURS = "all tours"
UNNAMED = "unnamed"
LOOK, MOMENT = "Look at it", "Show the moment"

HasRecord = Callable[[PastTrip], bool]


class PastTripsPanel:
    """The list of past trips, requested from `tour` when it is opened.

    Args:
        has_record: whether it is recorded what the robot did on a trip.
        look_at: shows that, or the moment of a stop that was not reached.
        time_zone: of the person at the page.
    """

    def __init__(
        self,
        gui: Controls,
        has_record: HasRecord,
        look_at: Callable[[PastTrip, StopResult | None], None],
        time_zone: Callable[[], datetime.tzinfo | None],
    ) -> None:
        self._has_record, self._look_at, self._time_zone = has_record, look_at, time_zone
        self._trips: dict[str, PastTrip] = {}
        """Those that are listed."""
        self._is_open = False
        self._num_shown = SHOWN_AT_ONCE
        self._toggle = gui.add_button("Past trips", icon="history")
        self._tour = gui.add_list("Tour", (ALL_TOURS,), words=(ALL_TOURS, UNNAMED), visible=False)
        self._list = gui.add_html("")
        self._more = gui.add_button("Show more", visible=False)
        self._toggle.on_press(self._switch)
        self._list.on_press(self._lead)
        self._more.on_press(self._show_more)

    def update(
        self,
        robot: str,
        past: PastTrips,
        trip: TourStatus | None,
        now_ns: int,
        *,
        is_shown: bool,
    ) -> None:
        """Show the trips, if they are open; `now_ns` [ns] is local monotonic time."""
        is_open = is_shown and self._is_open
        self._toggle.visible = is_shown
        self._toggle.label = "Close past trips" if is_open else "Past trips"
        self._tour.visible = is_open and bool(past.trips)
        if not is_open:
            self._more.visible, self._list.content = False, ""
            return
        past.refresh(trip, now_ns)
        trips = past.trips or ()
        self._tour.options = [ALL_TOURS, *sorted({one.name or UNNAMED for one in trips})]
        chosen = [one for one in trips if self._tour.value in (ALL_TOURS, one.name or UNNAMED)]
        self._more.visible = len(chosen) > self._num_shown
        shown = chosen[: self._num_shown]
        self._trips = {one.trip: one for one in shown}
        self._list.content = trips_html(past, shown, self._has_record, robot, self._time_zone())

    def _lead(self, press: str) -> None:
        """Show a trip, "t1", or what became of one of its stops, "t1 3"."""
        name, _, index = press.partition(" ")
        trip = self._trips.get(name)
        if trip is None or not self._has_record(trip):
            return
        results = trip.results
        is_stop = index.isdecimal() and int(index) < len(results)
        self._look_at(trip, results[int(index)] if is_stop else None)

    def _switch(self) -> None:
        self._is_open, self._num_shown = not self._is_open, SHOWN_AT_ONCE

    def _show_more(self) -> None:
        self._num_shown += SHOWN_AT_ONCE


def trips_html(
    past: PastTrips,
    trips: Sequence[PastTrip],
    has_record: HasRecord = lambda _: False,
    robot: str = "",
    time_zone: datetime.tzinfo | None = None,
) -> str:
    """The trips, each of which opens to what came of its stops, and leads to what was recorded.

    Args:
        past: what is known of them.
        trips: those to show.
        has_record: whether a trip was recorded.
        robot: whose they are: its photos are shown.
        time_zone: in which times are told; None: that of this computer.
    """
    problem = (
        row(StatusLine("Past trips are not available right now", "warn", past.problem))
        if past.problem
        else ""
    )
    if past.trips is None:
        return problem or note("Loading …")
    if not past.trips:
        return problem + note("No trips yet.")
    return problem + "".join(
        _trip(robot, trip, time_zone, is_recorded=has_record(trip)) for trip in trips
    )


def _trip(
    robot: str, trip: PastTrip, time_zone: datetime.tzinfo | None, *, is_recorded: bool
) -> str:
    shown = list(enumerate(trip.results))[-MAX_RESULTS:]
    left_out = trip.reached + trip.missed - len(shown)
    photos = dict(enumerate(trip.photos))
    results = "".join(
        row(result_line(result))
        + (lead(f"{trip.trip} {i}", MOMENT) if is_recorded and has_failed(result) else "")
        + (photo(f"photo/{robot}/{photos[i]}") if photos.get(i) else "")
        for i, result in shown
    )
    if left_out > 0:
        results = note(f"{left_out} earlier stops are not shown.") + results
    names = [trip.name] if trip.name else [one.name for one in trip.results if one.name]
    title = " · ".join(filter(None, [title_of(trip), when_text(trip.started_at, time_zone)]))
    words = StatusLine(title, tone_of(trip), summary(trip))
    look = lead(trip.trip, LOOK) if is_recorded else ""
    return details(words, look + (results or note("It had not reached a stop yet.")), names)


def title_of(trip: PastTrip) -> str:
    """The name of its tour, else the names of its stops, as of places that were driven in a row."""
    if trip.name:
        return trip.name
    stops = [one.name for one in trip.results]
    return stops_text(stops) if any(stops) else UNNAMED


def tone_of(trip: PastTrip) -> Tone:
    """The colour of how it went."""
    match trip.state:
        case "done":
            return "good" if trip.missed == 0 else "warn"
        case "failed":
            return "bad"
        case _:
            return "idle"


def summary(trip: PastTrip) -> str:
    """Say how far it got, how long it took, and why it ended if it did not come to its end."""
    of = f" of {trip.planned}" if trip.planned else ""
    why = said(trip.message, trip.reason)
    parts = [f"{trip.reached}{of} stops", duration(trip.seconds)]
    return " · ".join([*parts, why] if trip.state != "done" and why else parts)


def when_text(started_at: str | None, time_zone: datetime.tzinfo | None = None) -> str:
    """Write a moment (ISO 8601) as local time for people, "" where it is not known."""
    if started_at is None:
        return ""
    try:
        moment = datetime.datetime.fromisoformat(started_at)
    except ValueError:
        return ""
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=datetime.UTC)
    return f"{moment.astimezone(time_zone):%d %b %H:%M}".lstrip("0")
