"""What the robot is doing, as an MQTT payload: a word for programs and a sentence for people."""

import dataclasses
import math
from collections.abc import Callable, Sequence

from msgspec import Struct

from trolley import codes
from trolley.geometry import Pose2D
from trolley.messages import BaseState, GoalStatus, PoseEstimate, SavedPose, TourStatus
from trolley.teleop import SOURCE as BY_HAND

ACTIVITIES = (
    "away",
    "fault",
    "stopped",
    "by_hand",
    "lost",
    "waiting",
    "paused",
    "driving",
    "dwelling",
    "failed",
    "ready",
)
POSITIONS = ("localized", "unsure", "searching", "lost", "mapping", "stale")
PROBLEMS = ("fault", "lost", "failed")
STALE_S = 1.0
AT_PLACE_M = 0.5
SAME_PLACE_M = 0.1
"""A goal this near to a saved pose is called by its name."""
MAX_TEXT = 255
"""Home Assistant takes no longer states."""

GOING = ("planning", "driving", "recovering")
WITH_A_TRIP = ("driving", "dwelling", "waiting", "paused", "failed")


class State(Struct, frozen=True, kw_only=True):
    """What is published; null where it is unknown or there is nothing to say."""

    activity: str
    message: str
    position: str | None
    place: str | None
    """The saved place where it stands."""
    destination: str | None
    tour: str | None
    battery: int | None
    """Percent."""
    charging: bool | None
    problem: bool
    answer: str | None
    """What became of the last command from here."""


@dataclasses.dataclass(frozen=True)
class Known:
    """What is known of the robot; None where nothing was heard."""

    is_away: bool = False
    base: BaseState | None = None
    estimate: PoseEstimate | None = None
    age_s: float | None = None
    """Of the estimate [s], None while it cannot be told."""
    goal: GoalStatus | None = None
    trip: TourStatus | None = None
    places: Sequence[SavedPose] = ()
    """On the robot's map."""


def tell(known: Known, answer: str | None = None) -> State:
    """All that is told of the robot."""
    activity, message = next(said for say in SAYINGS if (said := say(known)) is not None)
    battery = None if known.base is None else known.base.battery
    charge = None if battery is None else battery.fraction
    trip = known.trip if known.trip is not None and _has_trip(known) else None
    return State(
        activity=activity,
        message=message[:MAX_TEXT],
        position=_position(known),
        place=_place(known),
        destination=None if known.is_away else _destination(known),
        tour=None if trip is None or known.is_away or trip.state == "failed" else trip.name,
        battery=None if charge is None else round(100.0 * charge),
        charging=None if battery is None else battery.charging,
        problem=activity in PROBLEMS,
        answer=None if answer is None else answer[:MAX_TEXT],
    )


Said = tuple[str, str] | None


def _away(known: Known) -> Said:
    return ("away", "The robot is switched off or out of reach.") if known.is_away else None


def _base(known: Known) -> Said:
    base = known.base
    if base is None or base.mode in ("ok", "held"):
        return None
    return ("stopped" if base.mode == "stopped" else "fault", _told(base))


def _by_hand(known: Known) -> Said:
    if known.base is not None and known.base.source == BY_HAND:
        return ("by_hand", "Somebody drives the robot by hand.")
    return None


def _held(known: Known) -> Said:
    base = known.base
    return ("waiting", _told(base)) if base is not None and base.mode == "held" else None


def _lost(known: Known) -> Said:
    match _position(known):
        case "lost" | "stale":
            return ("lost", "The robot does not know where it is.")
        case "searching":
            return ("waiting", "The robot looks where it is.")
        case _:
            return None


def _trip(known: Known) -> Said:
    trip = known.trip
    return (trip.state, _told(trip)) if trip is not None and _has_trip(known) else None


def _goal(known: Known) -> Said:
    goal = known.goal
    if goal is None:
        return None
    to = _destination(known) or "the place that was pointed out"
    match goal.state:
        case "planning" | "driving":
            return ("driving", f"Driving to {to}.")
        case "recovering":
            return ("driving", f"On the way to {to}: {_told(goal)}")
        case "paused":
            return ("paused", f"Paused on the way to {to}: {_told(goal)}")
        case "failed":
            return ("failed", _told(goal))
        case _:
            return None


def _ready(known: Known) -> Said:
    trip = known.trip
    if trip is not None and trip.state == "idle" and trip.message:
        return ("ready", trip.message)
    return ("ready", "The robot is ready.")


SAYINGS: Sequence[Callable[[Known], Said]] = (
    _away,
    _base,
    _by_hand,
    _held,
    _lost,
    _trip,
    _goal,
    _ready,
)
"""Who has something to say says it; the last one always has."""


def _has_trip(known: Known) -> bool:
    """Whether a trip is what matters: it is not over, and nothing else is driven since."""
    trip, goal = known.trip, known.goal
    if trip is None or trip.state not in WITH_A_TRIP:
        return False
    own = goal is None or goal.id is None or goal.id.startswith(f"tour-{trip.trip}-")
    is_over = trip.state == "failed"
    return own or not (is_over or (goal is not None and goal.state in GOING))


def _position(known: Known) -> str | None:
    if known.is_away or known.estimate is None:
        return None
    if known.age_s is None or known.age_s > STALE_S:
        return "stale"
    return known.estimate.state


def _place(known: Known) -> str | None:
    """The nearest saved place, where the robot is at one and knows it."""
    estimate = known.estimate
    if estimate is None or _position(known) not in ("localized", "unsure"):
        return None
    return _nearest(estimate.pose, known.places, AT_PLACE_M)


def _destination(known: Known) -> str | None:
    """Where it goes by name, None where it goes nowhere or to a point without one."""
    trip, goal = known.trip, known.goal
    if trip is not None and _has_trip(known):
        stops = [] if trip.tour is None else trip.tour.stops
        index = len(stops) if trip.stop is None or trip.state == "failed" else trip.stop
        return stops[index].name if index < len(stops) else None
    if goal is None or goal.state not in (*GOING, "paused") or goal.frame != "map":
        return None
    return _nearest(goal.pose, known.places, SAME_PLACE_M)


def _nearest(pose: Pose2D | None, places: Sequence[SavedPose], within_m: float) -> str | None:
    if pose is None:
        return None
    found = [(math.hypot(one.pose.x - pose.x, one.pose.y - pose.y), one.name) for one in places]
    distance_m, name = min(found, default=(math.inf, ""))
    return name if distance_m <= within_m else None


def _told(status: BaseState | GoalStatus | TourStatus) -> str:
    return status.message or codes.SENTENCES.get(status.reason, "") or "No reason was given."
