"""The trip under way: what came of its stops, those to come, and how to steer it."""

from collections.abc import Callable

from trolley.messages import Stop, Tour, TourStatus
from trolley.under_way import TRIP_UNDER_WAY
from trolley_viz.controls.controls import Choice, Controls
from trolley_viz.controls.markup import note, row, title
from trolley_viz.words.sentences import StatusLine, duration, result_line, with_age

DRIVING_ACTIONS = ("Pause", "Skip", "End")
PAUSED_ACTIONS = ("Continue", "Skip", "End")
MAX_STOP_ROWS = 30


class TripPanel:
    """Shows the robot's present or last trip.

    Args:
        steer: does one of the actions; None where that is not the person's to do.
    """

    def __init__(self, gui: Controls, steer: Callable[[str], None] | None) -> None:
        self._progress = gui.add_html("")
        self._steers: list[Choice] = []
        if steer is not None:
            for actions in (DRIVING_ACTIONS, PAUSED_ACTIONS):
                choice = gui.add_choice("", actions, visible=False)
                choice.on_press(steer)
                self._steers.append(choice)

    def update(
        self,
        trip: TourStatus | None,
        tour: Tour | None,
        age_s: float | None = None,
        *,
        with_last: bool,
        is_halted: bool,
    ) -> None:
        """Show how a trip goes.

        Args:
            trip: the one under way or the last one.
            tour: what it drives, None where that is not known.
            age_s: how old that is [s], None where it holds now.
            with_last: whether to show one that has ended, too.
            is_halted: whether the robot is stopped: then it goes on by “Drive on” alone.
        """
        is_under_way = trip is not None and trip.state in TRIP_UNDER_WAY
        self._progress.content = progress(trip, tour, age_s) if is_under_way or with_last else ""
        is_paused = trip is not None and trip.state == "paused"
        for choice, is_for_paused in zip(self._steers, (False, True), strict=False):
            choice.visible = is_under_way and is_for_paused == is_paused
            choice.turn_off(*(["Continue"] if is_for_paused and is_halted else []))


def progress(trip: TourStatus | None, tour: Tour | None, age_s: float | None = None) -> str:
    """The trip and how old [s] that is, what came of its stops, and those to come, as HTML."""
    if trip is None:
        return note("The tour service is still starting.")
    if trip.state == "idle":
        return note("No tour is under way.")
    is_under_way = trip.state in TRIP_UNDER_WAY
    coming = visits_to_come(trip, tour) if is_under_way else []
    results = trip.results
    if is_under_way and tour is not None:
        made = visits_in_lap(tour, trip.lap) - len(coming) - (not is_there(trip, tour))
        results = results[-made:] if made > 0 else []
    lines = [result_line(one) for one in results[-MAX_STOP_ROWS:]]
    if tour is not None and trip.stop is not None and is_under_way:
        if not is_there(trip, tour) or trip.state == "paused":
            lines.append(_present(trip, tour))
        lines += [
            StatusLine(f"{_name(tour.stops, i)} to come", "idle") for i in coming[:MAX_STOP_ROWS]
        ]
        if len(coming) > MAX_STOP_ROWS:
            lines.append(StatusLine(f"and {len(coming) - MAX_STOP_ROWS} more", "idle"))
    heading = _heading(trip, tour)
    heading = heading if age_s is None else with_age(heading, age_s)
    return title(heading) + "".join(map(row, lines))


def _heading(trip: TourStatus, tour: Tour | None) -> str:
    if trip.state not in TRIP_UNDER_WAY:
        return f"Last tour: “{trip.name}”" if trip.name else "Last tour"
    parts = [f"“{trip.name}”" if trip.name else "Tour"]
    if tour is not None and tour.repeat != 1:
        of = f" of {tour.repeat}" if tour.repeat else ""
        parts.append(f"round {trip.lap + 1}{of}")
    if trip.seconds >= 1.0:
        parts.append(f"under way for {duration(trip.seconds // 1.0)}")
    return ", ".join(parts)


def _present(trip: TourStatus, tour: Tour) -> StatusLine:
    name = _name(tour.stops, trip.stop or 0)
    match trip.state:
        case "paused":
            is_next = "" if is_there(trip, tour) else " next"
            return StatusLine(f"{name}{is_next}, paused", "warn")
        case "waiting":
            return StatusLine(f"{name} next, waiting", "warn")
        case _:
            return StatusLine(f"{name} now", "busy")


def visits_in_lap(tour: Tour, lap: int) -> int:
    """How many stops a round visits; there and back, a later one begins where the first ended."""
    num = len(tour.stops)
    if not tour.there_and_back or num < 2:
        return num
    return 2 * num - 1 - (lap > 0)


def is_there(trip: TourStatus, tour: Tour) -> bool:
    """Whether the present stop has its result already: what is left is to stay, if anything."""
    if trip.state == "dwelling":
        return True
    # No tour of several stops visits one twice in a row.
    last = trip.results[-1].stop if trip.results and len(tour.stops) > 1 else None
    return last is not None and last == trip.stop


def visits_to_come(trip: TourStatus, tour: Tour | None) -> list[int]:
    """The stops that this round visits after the current one, in order."""
    if tour is None or trip.stop is None or trip.stop >= len(tour.stops):
        return []
    onward = list(range(trip.stop + 1, len(tour.stops)))
    back = list(range(trip.stop - 1, -1, -1))
    if not tour.there_and_back:
        return onward
    before = trip.results[-2:-1] if is_there(trip, tour) else trip.results[-1:]
    if not onward or (before and before[0].stop > trip.stop):
        return back
    return onward + list(range(len(tour.stops) - 2, -1, -1))


def _name(stops: list[Stop], index: int) -> str:
    return stops[index].name or f"stop {index + 1}" if index < len(stops) else "the stop"
