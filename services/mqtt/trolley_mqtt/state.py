"""The robot's state as an MQTT payload."""

from msgspec import Struct

from trolley.messages.touring import HOME
from trolley.under_way import what_is_under_way
from trolley_mqtt.robot_view import RobotView
from trolley_mqtt.sentences import activity_of

PROBLEMS = ("fault", "lost", "failed")
"""Activities that somebody should look after."""
MAX_TEXT = 255
"""Home Assistant takes no longer states."""


class State(Struct, frozen=True, kw_only=True):
    """What is published; null where it is unknown or there is nothing to say."""

    activity: str
    message: str
    position: str | None
    place: str | None
    """The saved place that the robot is at."""
    room: str | None
    """The room that the robot is in."""
    destination: str | None
    tour: str | None
    battery: int | None
    """Percent."""
    charging: bool | None
    problem: bool
    answer: str | None
    """What became of the last command sent over MQTT."""


def state_of(view: RobotView, answer: str | None = None) -> State:
    """All that is published of the robot."""
    activity, message = activity_of(view)
    battery = None if view.base is None else view.base.battery
    charge = None if battery is None else battery.fraction
    trip = view.current_trip
    return State(
        activity=activity,
        message=message[:MAX_TEXT],
        position=view.position,
        place=view.place,
        room=view.room,
        destination=None if view.is_away else view.destination,
        tour=None if trip is None or view.is_away or trip.state == "failed" else trip.name,
        battery=None if charge is None else round(100.0 * charge),
        charging=None if battery is None else battery.charging,
        problem=activity in PROBLEMS,
        answer=None if answer is None else answer[:MAX_TEXT],
    )


def vacuum_of(view: RobotView, state: State) -> dict[str, str]:
    """The same in the words that Home Assistant has for vacuum cleaners."""
    match state.activity:
        case activity if activity in PROBLEMS:
            word = "error"
        case "paused":
            word = "paused"
        case "by_hand":
            word = "cleaning"
        case "driving" | "dwelling" | "waiting" if what_is_under_way(view.goal, view.trip):
            word = "returning" if state.destination == HOME else "cleaning"
        case _:
            word = "docked" if state.charging or state.place == HOME else "idle"
    return {"state": word}
