"""What a robot does, in one plain sentence."""

from trolley import codes
from trolley.cli.show import seconds_text
from trolley.messages import BaseState, GoalStatus, PoseEstimate, TourStatus
from trolley.under_way import TRIP_UNDER_WAY

CONTINUES = "`trolley ask goal/resume` continues it, `trolley cancel` ends it."
"""What there is to do about a paused goal."""
READY = "Ready."
LOST = {
    "searching": "The robot is working out where it is.",
    "lost": "The robot does not know where it is.",
}


def robot_sentence(
    base: BaseState | None,
    pose: PoseEstimate | None,
    goal: GoalStatus | None,
    trip: TourStatus | None,
    *,
    is_stale: bool = False,
) -> str:
    """Say what a robot does, or what keeps it from doing anything.

    Args:
        base: what its base says, None if it says nothing.
        pose: its newest pose; None for one that drives without a map.
        goal: where it was sent last.
        trip: its tour.
        is_stale: whether the pose is too old to be true.
    """
    if base is None:
        return "No contact with the robot."
    why = (base.message or codes.SENTENCES.get(base.reason, base.reason)).rstrip(".")
    if base.mode != "ok":
        if base.mode == "stopped":
            return base.message or "Stopped. `trolley resume` lets it drive."
        if base.reason == codes.DOES_NOT_OBEY:
            return f"{why}."
        return _sentence("Waiting" if base.mode == "held" else "It cannot drive", why)
    if pose is not None and is_stale:
        return "The pose is out of date."
    if pose is not None and pose.map is None:
        return "It has no map: make one (`trolley map new NAME`)."
    if pose is not None and pose.state in LOST:
        return LOST[pose.state]
    doing = _on_its_way(base, goal, trip)
    if doing == READY and pose is None and goal is not None and goal.frame == "map":
        return "It has no pose yet: there is no map, or its localizer is not running."
    if pose is not None and pose.state == "mapping":
        return f"Making the map {pose.map}. {doing}"
    return doing


def goal_message(goal: GoalStatus, base: BaseState | None = None) -> str:
    """Return what a goal says, or the commands that continue one that a stop has paused."""
    if (goal.state, goal.reason) != ("paused", codes.STOPPED):
        return goal.message
    is_resumed = base is not None and base.mode != "stopped"
    begin = "" if is_resumed else "Once the robot may drive again (`trolley resume`), "
    return begin + CONTINUES


def _on_its_way(base: BaseState, goal: GoalStatus | None, trip: TourStatus | None) -> str:
    left = "" if goal is None or goal.eta is None else f", {seconds_text(goal.eta)} left"
    if trip is not None and trip.state in TRIP_UNDER_WAY:
        doing = {"driving": f"driving{left}", "dwelling": "at a stop"}.get(
            trip.state, "waiting" if trip.state == "waiting" else "paused"
        )
        stop = "" if trip.stop is None else f", stop {trip.stop + 1}"
        name = f"tour {trip.name}" if trip.name else "a tour"
        return _sentence(f"On {name}{stop}, {doing}", trip.message.rstrip("."))
    if base.source not in (None, "planner"):
        return f"Driven by {base.source}."
    match goal.state if goal is not None else "idle":
        case "planning":
            return "Looking for a path."
        case "driving":
            return f"Driving to its goal{left}."
        case "recovering":
            return _sentence("Trying to get free", goal.message.rstrip(".") if goal else "")
        case "paused":
            return _sentence("Paused", goal_message(goal, base).rstrip(".") if goal else "")
        case "failed":
            return _sentence("The last goal failed", goal.message.rstrip(".") if goal else "")
        case "arrived":
            return "It has arrived."
        case _:
            return READY


def _sentence(begin: str, why: str) -> str:
    return f"{begin}: {why}." if why else f"{begin}."
