"""`trolley tour`: trips through several places. `import` comes with the tour service."""

from itertools import repeat
from pathlib import Path

import click

from trolley import codes, requests, topics
from trolley.cli import PluggedGroup, exits
from trolley.cli.options import json_option, where_options
from trolley.cli.printing import say
from trolley.cli.robots import known, one_robot, reports_errors
from trolley.cli.show import Progress, pose_text, print_json, print_table, seconds_text
from trolley.client import TRIP_ENDS, Robot
from trolley.codes import Refused
from trolley.config import ConfigError
from trolley.files import why_not_written, write_atomically
from trolley.messages import PastTrip, Stop, StopResult, Tour, TourStatus, request_params
from trolley.names import canonical
from trolley.requests import Request


@click.group(
    name="tour",
    cls=PluggedGroup,
    sections={
        "A trip": ("start", "pause", "resume", "skip", "stop"),
        "Stored tours": ("list", "show", "import"),
        "Past trips": ("history", "photo"),
    },
)
def tour_command() -> None:
    """Drive through several places, one after another."""


@tour_command.command(name="start")
@click.argument("name")
@click.option("--no-wait", is_flag=True, help="Start the tour and return.")
@where_options
@json_option
@reports_errors
def start_tour(name: str, no_wait: bool, as_json: bool) -> None:
    """Start the tour NAME and follow it; Ctrl-C leaves it running.

    Exit code 1 unless every stop was reached.
    """
    with one_robot() as robot:
        status = robot.ask(requests.TOUR_START, request_params.StartTour(name=name))
        if not no_wait:
            try:
                status = follow_trip(robot, status.trip, quiet=as_json)
            except KeyboardInterrupt:
                say("The tour goes on; `trolley tour stop` ends it.", err=True)
                raise
    if as_json:
        print_json(status)
    else:
        say(_summary(status))
    if not no_wait and not all_reached(status):
        raise SystemExit(exits.FAILED)


def all_reached(status: TourStatus) -> bool:
    """Whether a trip is done and no stop of it was skipped or failed."""
    return status.state == "done" and status.num_missed == 0 and status.num_ended > 0


def follow_trip(robot: Robot, trip: str | None, *, quiet: bool = False) -> TourStatus:
    """Show how a trip goes, a line for each stop that is over; return how it ended."""
    progress = Progress()
    last: TourStatus | None = None
    shown = 0
    try:
        for status in robot.follow_tour(trip):
            last = status
            num_new, shown = status.num_ended - shown, status.num_ended
            if num_new > 0 and not quiet:
                progress.clear()
                for result in status.results[-num_new:]:
                    say(result_text(result))
            if status.state not in TRIP_ENDS:  # the caller says how it ended
                progress.show(_summary(status), f"{status.state} {status.reason} {status.stop}")
    finally:
        progress.clear()
    assert last is not None
    return last


def result_text(result: StopResult) -> str:
    """How a stop ended, for a person."""
    name = result.name or f"stop {result.stop + 1}"
    text = f"{name}: {result.state} after {seconds_text(result.seconds)}"
    return f"{text}: {result.message} ({result.code})" if result.code else text


def _summary(status: TourStatus) -> str:
    text = f"{status.name or 'trip'}: {status.state}"
    if status.stop is not None and status.state not in ("done", "failed", "stopped"):
        text += f", stop {status.stop + 1}"
    if status.lap:
        text += f", lap {status.lap + 1}"
    return f"{text}: {status.message} ({status.reason})" if status.reason else text


def _control(name: str, request: Request[request_params.Nothing, TourStatus], text: str) -> None:
    """Add a subcommand that asks a request without parameters."""

    @tour_command.command(name=name, help=text)
    @where_options
    @json_option
    @reports_errors
    def control(as_json: bool) -> None:
        with one_robot() as robot:
            status = robot.ask(request)
        if as_json:
            print_json(status)
        else:
            say(_summary(status))

    del control


_control("stop", requests.TOUR_STOP, "End the trip; the robot stops where it is.")
_control("pause", requests.TOUR_PAUSE, "Pause the trip.")
_control("resume", requests.TOUR_RESUME, "Resume a paused trip, to the same stop.")
_control("skip", requests.TOUR_SKIP, "Skip the current stop.")


def _stored(robot: Robot) -> list[Tour]:
    return known(robot, topics.TOURS, "The tour service is still starting.").tours


@tour_command.command(name="list")
@where_options
@json_option
@reports_errors
def list_tours(as_json: bool) -> None:
    """List the stored tours."""
    with one_robot() as robot:
        tours = _stored(robot)
    if as_json:
        print_json(tours)
    elif not tours:
        say("No tours are stored yet; use `trolley tour import` or the viewer.")
    else:
        rows = [
            (tour.name, tour.map or "-", str(len(tour.stops)), _laps(tour), _times(tour))
            for tour in tours
        ]
        print_table(("NAME", "MAP", "STOPS", "LAPS", "TIMES"), rows)


def _laps(tour: Tour) -> str:
    laps = "forever" if tour.repeat == 0 else str(tour.repeat)
    return f"{laps}, there and back" if tour.there_and_back else laps


def _times(tour: Tour) -> str:
    return "; ".join(f"{' '.join(entry.days) or 'daily'} {entry.at}" for entry in tour.schedule)


@tour_command.command(name="show")
@click.argument("name")
@where_options
@json_option
@reports_errors
def show_tour(name: str, as_json: bool) -> None:
    """Show the stops of the tour NAME."""
    with one_robot() as robot:
        tours = {tour.name: tour for tour in _stored(robot)}
    name = canonical(name)
    if name not in tours:
        there = ", ".join(tours) or "none"
        raise Refused(codes.UNKNOWN_NAME, f"There is no tour {name!r}; there are: {there}.")
    tour = tours[name]
    if as_json:
        print_json(tour)
        return
    starts = f"; starts {_times(tour)}" if tour.schedule else ""
    on_map = f" on {tour.map}" if tour.map else ""
    say(f"{tour.name}{on_map}, laps: {_laps(tour)}{starts}")
    rows = [_stop_row(index, stop) for index, stop in enumerate(tour.stops)]
    print_table(("STOP", "PLACE", "VIA", "STAY", "IF IT FAILS"), rows)


def _stop_row(index: int, stop: Stop) -> tuple[str, ...]:
    place = stop.name if stop.pose is None else pose_text(stop.pose)
    failing = f"{stop.on_failure} after {stop.retries} retries" if stop.retries else stop.on_failure
    return str(index + 1), place or "", str(len(stop.via) or ""), f"{stop.dwell:g} s", failing


@tour_command.command(name="history")
@click.option("--since", help="Only trips since this moment (ISO 8601).")
@click.option("--limit", type=click.IntRange(1, 1000), default=20, show_default=True)
@click.option("--stops", is_flag=True, help="Show how each stop ended, too.")
@where_options
@json_option
@reports_errors
def trip_history(since: str | None, limit: int, stops: bool, as_json: bool) -> None:
    """List past trips, the newest first."""
    with one_robot() as robot:
        trips = robot.ask(
            requests.TOUR_HISTORY, request_params.AskHistory(since=since, limit=limit)
        )
    if as_json:
        print_json(trips)
    elif not trips:
        say("There have been no trips yet.")
    elif stops:
        for trip in trips:
            say("  ".join(_row(trip)))
            for result, photo in zip(trip.results, trip.photos or repeat(""), strict=False):
                say(f"    {result_text(result)}" + (f", photo {photo}" if photo else ""))
    else:
        print_table(
            ("STARTED", "TOUR", "STATE", "TOOK", "STOPS REACHED", "REASON"), list(map(_row, trips))
        )


def _row(trip: PastTrip) -> tuple[str, ...]:
    reached = f"{trip.reached} of {trip.planned}" if trip.planned else str(trip.reached)
    took = seconds_text(trip.seconds)
    return trip.started_at or "?", trip.name or "-", trip.state, took, reached, trip.message


@tour_command.command(name="photo")
@click.argument("name")
@click.option(
    "-o",
    "--output",
    type=click.Path(dir_okay=False, path_type=Path),
    help="The file to write; else NAME.jpg.",
)
@where_options
@json_option
@reports_errors
def save_photo(name: str, output: Path | None, as_json: bool) -> None:
    """Save the photo NAME of a past trip's stop.

    `trolley tour history --stops` names them.
    """
    with one_robot() as robot:
        photo = robot.ask(requests.TOUR_PHOTO, request_params.WhichPhoto(name=name))
    path = output or Path(f"{photo.name}.jpg")
    try:
        write_atomically(path, photo.jpeg)
    except OSError as error:
        raise ConfigError(f"{path} cannot be written: {why_not_written(path, error)}") from error
    if as_json:
        print_json({"file": str(path), "bytes": len(photo.jpeg)})
    else:
        say(f"{path}: {len(photo.jpeg)} bytes")
