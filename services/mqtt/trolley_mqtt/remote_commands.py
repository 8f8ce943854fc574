"""What may be asked for over MQTT, and which request it becomes.

`<base topic>/do/go` and `…/do/tour` carry the name of a place or tour; the others ignore their
payload. `…/do/vacuum` carries the name of one of them: Home Assistant has one topic for all that a
vacuum cleaner can do.
"""

import dataclasses
from typing import Any

from trolley import codes, requests
from trolley.codes import Refused
from trolley.messages import GoalStatus, TourStatus
from trolley.messages.request_params import Nothing, SendGoal, StartTour, WhichGoal
from trolley.messages.touring import HOME
from trolley.names import canonical
from trolley.requests import Request
from trolley.under_way import what_is_under_way

GO, TOUR, STOP, PAUSE, RESUME, CANCEL = "go", "tour", "stop", "pause", "resume", "cancel"
START, RETURN, LOCATE = "start", "home", "locate"
VERBS = (GO, TOUR, STOP, PAUSE, RESUME, CANCEL, START, RETURN, LOCATE)
NAMED = (GO, TOUR)
VACUUM = "vacuum"
VACUUM_VERBS = (START, PAUSE, RETURN, LOCATE)
MAX_PAYLOAD = 512
"""A name has 64 characters of 4 bytes at most."""

TRIP_REQUESTS: dict[str, Request[Any, Any]] = {
    PAUSE: requests.TOUR_PAUSE,
    RESUME: requests.TOUR_RESUME,
    CANCEL: requests.TOUR_STOP,
}
GOAL_REQUESTS: dict[str, Request[Any, Any]] = {
    PAUSE: requests.GOAL_PAUSE,
    RESUME: requests.GOAL_RESUME,
    CANCEL: requests.GOAL_CANCEL,
}


@dataclasses.dataclass(frozen=True)
class Order:
    """A request to the robot, and how people call it."""

    title: str
    done: str
    """What is said when the robot has taken it."""
    request: Request[Any, Any]
    params: Any


def name_in(payload: bytes) -> str:
    """The name that a payload carries.

    Raises:
        Refused: It is not one.
    """
    if len(payload) > MAX_PAYLOAD:
        raise Refused(codes.TOO_LARGE, "That name is too long.")
    try:
        return canonical(payload.decode())
    except UnicodeDecodeError:
        raise Refused(codes.BAD_REQUEST, "That is not a name.") from None


def order_of(
    verb: str,
    name: str,
    known: tuple[GoalStatus | None, TourStatus | None],
    names: tuple[list[str], list[str]],
    new_id: str,
    start_tour: str,
) -> Order:
    """What a command other than stop asks the robot.

    Args:
        verb: One of `VERBS`.
        name: Of the place or tour.
        known: The present goal and trip.
        names: Of the places and tours that there are.
        new_id: For a new goal.
        start_tour: The tour that `START` begins; "": the only one.

    Raises:
        Refused: There is no such place or tour, nothing is under way, or for `START` something is.
    """
    places, tours = names
    goal, trip = known
    start_tour = canonical(start_tour)
    what = what_is_under_way(goal, trip)
    if verb == START:
        if not what:
            verb, name = TOUR, start_tour or _only(tours)
        elif _is_paused(trip if what == "trip" else goal):
            verb = RESUME
        else:
            raise Refused(codes.BUSY, "A tour or drive is under way already.")
    if verb in (GO, RETURN):
        return _go(HOME if verb == RETURN else name, places, new_id)
    if verb == TOUR:
        return _tour(name, tours)
    title = {PAUSE: "Pause", RESUME: "Continue", CANCEL: "Cancel"}[verb]
    if what == "trip":
        return Order(title, "done", TRIP_REQUESTS[verb], Nothing())
    if what == "goal" and goal is not None:
        return Order(title, "done", GOAL_REQUESTS[verb], WhichGoal(id=goal.id))
    raise Refused(codes.NOT_DRIVING, "The robot is not going anywhere.")


def _go(place: str, places: list[str], new_id: str) -> Order:
    if place not in places:
        raise Refused(codes.UNKNOWN_NAME, f"There is no place {place!r} on this map.")
    params = SendGoal(id=new_id, name=place)
    return Order(f"Go to {place}", "on its way", requests.GOAL_SEND, params)


def _tour(tour: str, tours: list[str]) -> Order:
    if tour not in tours:
        raise Refused(codes.UNKNOWN_NAME, f"There is no tour {tour!r}.")
    return Order(f"Tour {tour}", "on its way", requests.TOUR_START, StartTour(name=tour))


def _only(tours: list[str]) -> str:
    """The tour that is meant where none is named."""
    if not tours:
        raise Refused(codes.UNKNOWN_NAME, "There is no tour to start: make one in the viewer.")
    if len(tours) > 1:
        raise Refused(
            codes.UNKNOWN_NAME,
            "There are several tours: name the one to start in robot.toml, [mqtt] start_tour.",
        )
    return tours[0]


def _is_paused(status: GoalStatus | TourStatus | None) -> bool:
    return status is not None and status.state == "paused"
