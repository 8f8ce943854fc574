"""What the robot is doing: a word for programs and a sentence for people."""

from collections.abc import Callable, Sequence

from trolley import codes
from trolley.messages import BaseState, GoalStatus, TourStatus
from trolley.teleop import SOURCE as BY_HAND
from trolley_mqtt.robot_view import RobotView

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

AWAY = "The robot is switched off or out of reach."
LOST = "The robot does not know where it is."
NO_POSE = "The robot has no map yet, or its localizer is not running."

NO_PLANNER = "The robot cannot drive by itself: the planner is not running."

Activity = tuple[str, str]
"""One of `ACTIVITIES`, and the sentence."""


def activity_of(view: RobotView) -> Activity:
    """The most pressing thing there is to say."""
    return next(found for find in _BY_URGENCY if (found := find(view)) is not None)


def where(view: RobotView) -> str:
    """Where the robot is, as a sentence."""
    if view.is_away:
        return AWAY
    pose = None if view.estimate is None else view.estimate.pose
    if not view.is_placed or pose is None:
        return LOST
    if view.place is not None:
        return f"The robot is at {view.place}."
    if view.room is not None:
        return f"The robot is in {view.room}."
    return f"The robot is at x {pose.x:.1f} m, y {pose.y:.1f} m on the map."


def _away(view: RobotView) -> Activity | None:
    return ("away", AWAY) if view.is_away else None


def _base(view: RobotView) -> Activity | None:
    base = view.base
    if base is None or base.mode in ("ok", "held"):
        return None
    return ("stopped" if base.mode == "stopped" else "fault", reason_of(base))


def _by_hand(view: RobotView) -> Activity | None:
    if view.base is not None and view.base.source == BY_HAND:
        return ("by_hand", "Someone is driving the robot by hand.")
    return None


def _held(view: RobotView) -> Activity | None:
    base = view.base
    return ("waiting", reason_of(base)) if base is not None and base.mode == "held" else None


def _planner(view: RobotView) -> Activity | None:
    return None if view.has_planner else ("fault", NO_PLANNER)


def _lost(view: RobotView) -> Activity | None:
    match view.position:
        case "lost" | "stale":
            return ("lost", LOST)
        case "searching":
            return ("waiting", "The robot is working out where it is.")
        case _:
            return None


def _trip(view: RobotView) -> Activity | None:
    trip = view.current_trip
    return None if trip is None else (trip.state, reason_of(trip))


def _goal(view: RobotView) -> Activity | None:
    goal = view.goal
    if goal is None:
        return None
    to = view.destination or "the place that was pointed out"
    match goal.state:
        case "planning" | "driving":
            return ("driving", f"Driving to {to}.")
        case "recovering":
            return ("driving", f"On the way to {to}: {reason_of(goal)}")
        case "paused":
            return ("paused", f"Paused on the way to {to}: {reason_of(goal)}")
        case "failed":
            return ("failed", reason_of(goal))
        case _:
            return None


def _ready(view: RobotView) -> Activity:
    if view.position is None:
        return ("waiting", NO_POSE)
    trip = view.trip
    if trip is not None and trip.state == "idle" and trip.message:
        return ("ready", trip.message)
    return ("ready", "The robot is ready.")


_BY_URGENCY: Sequence[Callable[[RobotView], Activity | None]] = (
    _away,
    _base,
    _by_hand,
    _held,
    _planner,
    _lost,
    _trip,
    _goal,
    _ready,
)
"""The first that has something to say is heard; the last one always has."""


def reason_of(status: BaseState | GoalStatus | TourStatus) -> str:
    """Why it is so, as a sentence."""
    return status.message or codes.SENTENCES.get(status.reason, "") or "No reason was given."
