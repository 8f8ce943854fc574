"""What the robot is doing, or what keeps it from driving, as one plain sentence for anybody."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from trolley import codes, topics
from trolley.geometry.frames import MAP
from trolley.messages import (
    BaseState,
    GoalStatus,
    MappingStatus,
    PoseEstimate,
    SavedPose,
    SetupState,
    Tour,
    TourStatus,
)
from trolley.teleop import SOURCE as BY_HAND
from trolley.topics import Topic
from trolley.under_way import GOAL_GOES, GOAL_UNDER_WAY, TRIP_GOES, TRIP_UNDER_WAY, trip_of
from trolley_viz.robots.ages import Ages
from trolley_viz.words.plain_words import said
from trolley_viz.words.sentences import (
    EXPLORES_WELL,
    GOES_ON,
    NO_CONTACT,
    SPOT,
    STALE_S,
    UNCONFIRMED,
    StatusLine,
    age_text,
    aged,
    no_contact,
    remaining,
    where_to,
)

LOST = StatusLine(
    "The robot does not know where it is. Show it with “Set pose …”, or let it search.", "bad"
)
ASKING = StatusLine("Asking the robot what it is doing …", "busy")
READY = StatusLine("Ready.", "good")
LEFT_M = 1.0
"""Farther than that from where it arrived it is somewhere else [m]."""
STOPPED_REASONS = {
    codes.BUTTON: "Stopped",
    codes.BATTERY: "Stopped: the battery is too low",
    codes.BUMPER: "Stopped: it bumped into something",
    codes.COLLISION: "Stopped: it touched something",
    codes.CLIFF: "Stopped: there is no floor in front of it",
}
PAUSE_REASONS = {
    codes.TAKEN_OVER: "somebody drove it by hand",
    codes.STOPPED: "it was stopped",
    codes.RESTARTED: "the base was restarted",
    codes.OTHER_GOAL: "somebody sent it elsewhere",
    codes.CANCELED: "the drive was canceled",
    codes.LOW_BATTERY: "the battery was low; charge it first",
}


@dataclass(frozen=True)
class RobotState:
    """What is known of a robot; None where nothing has been received."""

    is_away: bool = False
    base: BaseState | None = None
    has_map: bool = True
    estimate: PoseEstimate | None = None
    estimate_age_s: float | None = None
    """Age of the estimate [s], None while unknown."""
    goal: GoalStatus | None = None
    lost_goal: GoalStatus | None = None
    """The goal that a restart of the planner has lost."""
    trip: TourStatus | None = None
    tour: Tour | None = None
    """The stored tour that is driven."""
    places: Sequence[SavedPose] = ()
    room: str | None = None
    """The room that it is in."""
    silent: frozenset[str] = frozenset()
    """Silent services, see `View.silent`."""
    ages: Ages = field(default_factory=dict[str, float])
    """How old what is said by topic is, where there should be something newer."""
    away_s: float | None = None
    """For how long nothing has been heard of it [s], None where that is not known."""
    mapping: MappingStatus | None = None
    setup: SetupState | None = None
    """Its setup, while there is one."""


def situation(known: RobotState) -> StatusLine:
    """Say the one thing that matters most: first what keeps it from driving, then what it does."""
    return next(words for say in RULES if (words := say(known)) is not None)


def _setup(known: RobotState) -> StatusLine | None:
    setup = known.setup
    if setup is None:
        return None
    match setup.outcome:
        case "done":
            return StatusLine("The robot is set up.", "good")
        case "interrupted":
            return StatusLine("The setup was interrupted.", "warn")
        case _:
            is_moving = setup.question is not None and setup.question.kind == "hold"
            now = "The wheels turn" if is_moving else "Setting up the robot"
            return StatusLine(f"{now}: step {setup.step} of {setup.steps}.", "busy")


def _away(known: RobotState) -> StatusLine | None:
    if not known.is_away:
        return None
    return StatusLine(NO_CONTACT if known.away_s is None else no_contact(known.away_s), "bad")


def _base(known: RobotState) -> StatusLine | None:
    base = known.base
    if base is None or base.mode in ("ok", "held"):
        return None
    if base.is_stop_unconfirmed:
        return StatusLine(said(base.message) or UNCONFIRMED, "bad")
    if base.mode == "stopped":
        why = STOPPED_REASONS.get(base.reason) or f"Stopped: {_reason_of(base)}"
        return StatusLine(f"{why}. Press “Drive on” to let it {_what_then(known)}.", "bad")
    if base.reason == codes.DOES_NOT_OBEY:
        return StatusLine(said(base.message, base.reason), "bad")
    return StatusLine(f"The robot cannot drive: {_reason_of(base)}.", "bad")


def _what_then(known: RobotState) -> str:
    """What a robot that is stopped will do once it may drive."""
    goal, trip = known.goal, known.trip
    if trip is not None and (trip.state, trip.reason) == ("paused", codes.STOPPED):
        return "continue the tour"
    if goal is not None and (goal.state, goal.reason) == ("paused", codes.STOPPED):
        to = where_to(goal, list(known.places))
        return "go on" if to == SPOT else f"go on to {to}"
    return "drive again"


def _by_hand(known: RobotState) -> StatusLine | None:
    base = known.base
    if base is None or base.source != BY_HAND:
        return None
    if base.mode == "ok" and base.reason:
        return StatusLine(f"Driven by hand: {_reason_of(base)}.", "warn")
    return StatusLine("Somebody is driving it by hand.", "busy")


def _held(known: RobotState) -> StatusLine | None:
    base = known.base
    if base is None or base.mode != "held":
        return None
    then = f" {GOES_ON}" if will_continue(known) else ""
    return StatusLine(f"Waiting: {_reason_of(base)}.{then}", "warn")


def _planner(known: RobotState) -> StatusLine | None:
    if "planner" in known.silent:
        return StatusLine("The robot cannot drive by itself: the planner is not running.", "bad")
    return ASKING if known.goal is None else None


def _mapping(known: RobotState) -> StatusLine | None:
    mapping = known.mapping
    if mapping is None or "mapper" in known.silent:
        return None
    match mapping.state:
        case "idle":
            if known.has_map or (known.estimate is not None and known.estimate.map is not None):
                return None
            return StatusLine("It has no map yet. Make one in the “Map” tab.", "warn")
        case "starting":
            return StatusLine("It is getting ready to make a map.", "busy")
        case "saving":
            return StatusLine("It is saving its new map.", "busy")
        case _:
            pass
    estimate = known.estimate
    if estimate is not None and estimate.state == "lost":
        return StatusLine(
            "It cannot find its place on the new map. Bring it back to where it has been.", "bad"
        )
    if mapping.message:
        goes_well = mapping.exploring in EXPLORES_WELL
        why = _reason_of(mapping)
        is_exploring = why.startswith("the robot is exploring")
        words = f"{why[:1].upper()}{why[1:]}." if is_exploring else f"Making a map: {why}."
        return StatusLine(words, "busy" if goes_well else "warn")
    if mapping.state == "paused":
        return StatusLine(f"The map “{mapping.name}” is paused. Press “Continue”.", "warn")
    if known.goal is not None and known.goal.state in GOAL_UNDER_WAY:
        return None
    return StatusLine(
        f"Making the map “{mapping.name}”. Drive the robot through every room.", "busy"
    )


def _position(known: RobotState) -> StatusLine | None:
    goal = known.goal
    if not known.has_map or (goal is not None and goal.frame != MAP):
        return None
    if "localizer" in known.silent:
        return StatusLine(
            "The robot does not know where it is: the localizer is not running.", "bad"
        )
    if known.estimate is None:
        return StatusLine("The robot does not know where it is yet.", "busy")
    if known.estimate_age_s is None or known.estimate_age_s > STALE_S:
        # Of a lidar that is silent base has told before this.
        age_s = known.ages.get(topics.POSE.name)
        since = "sends nothing new" if age_s is None else f"has sent nothing for {_age(age_s)}"
        return StatusLine(f"The robot does not know where it is: the localizer {since}.", "bad")
    match known.estimate.state:
        case "lost":
            return LOST
        case "searching":
            if known.estimate.wants_turn:
                return StatusLine(
                    "The robot is working out where it is, and needs to turn to see more.", "busy"
                )
            return StatusLine("The robot is working out where it is.", "busy")
        case _:
            return None


def _tour_service(known: RobotState) -> StatusLine | None:
    trip, goal = known.trip, known.goal
    if "tour" not in known.silent or trip is None or trip.state not in TRIP_UNDER_WAY:
        return None
    if goal is not None and goal.state in GOAL_GOES:
        return None  # it drives to the end of this goal
    return StatusLine("The tour does not go on: the tour service is not running.", "bad")


def _trip(known: RobotState) -> StatusLine | None:
    trip, goal = known.trip, known.goal
    if trip is None:
        return None
    is_over = trip.state not in TRIP_UNDER_WAY
    is_elsewhere = goal is not None and trip_of(goal.id) != trip.trip
    if is_elsewhere and (is_over or (goal is not None and goal.state in GOAL_UNDER_WAY)):
        return None  # something else was driven since
    if trip.reason == codes.LOW_BATTERY and trip.state in ("driving", "done"):
        return StatusLine(said(trip.message, trip.reason), "warn")
    match trip.state:
        case "paused":
            why = PAUSE_REASONS.get(trip.reason)
            because = f": {why}" if why else ""
            return StatusLine(f"The tour is paused{because}. Press “Continue”.", "warn")
        case "waiting":
            return StatusLine(f"The tour is waiting: {_reason_of(trip)}.", "warn")
        case "dwelling":
            return StatusLine(
                f"It is staying at {_stop_name(known)} for a while{_counted(known)}.", "busy"
            )
        case "failed":
            return StatusLine(f"The tour was given up: {_reason_of(trip)}.", "bad")
        case "done":
            missed = trip.num_missed
            if missed:
                count = trip.num_ended
                return StatusLine(
                    f"The tour is over: {count - missed} of {count} places reached.", "warn"
                )
            return StatusLine("The tour is done.", "good")
        case _:
            return None


def _goal(known: RobotState) -> StatusLine | None:
    goal = known.goal
    if goal is None or goal.state == "idle" or has_left(known):
        return None
    to = where_to(goal, list(known.places))
    why = _reason_of(goal)
    match goal.state:
        case "planning":
            return StatusLine(f"Looking for a path to {to}.", "busy")
        case "driving":
            slowly = ", slowly" if _is_unsure(known) else ""
            if goal.person is not None:
                return StatusLine(f"It is following the person{slowly}.", "busy")
            return StatusLine(
                f"It is on its way to {to}{slowly}{_left(goal)}{_counted(known)}.", "busy"
            )
        case "recovering":
            return StatusLine(f"On the way to {to}: {why}.", "warn")
        case "paused" if goal.reason == codes.OFF_MAP:
            return StatusLine(
                "The map ends here, so it waits. Send it to a place on the map, or bring it back.",
                "warn",
            )
        case "paused":
            because = PAUSE_REASONS.get(goal.reason)
            because = f": {because}" if because else ""
            return StatusLine(
                f"It is paused on its way to {to}{because}. Press “Continue”.", "warn"
            )
        case "arrived":
            return StatusLine(f"It has arrived at {to}.", "good")
        case "failed":
            return StatusLine(f"It did not reach {to}: {why}.", "bad")
        case _:
            return StatusLine("Canceled. Ready.", "good")


def _lost_drive(known: RobotState) -> StatusLine | None:
    if known.lost_goal is None:
        return None
    to = where_to(known.lost_goal, list(known.places))
    return StatusLine(f"The planner was restarted; the drive to {to} was lost.", "bad")


def _idle(known: RobotState) -> StatusLine | None:
    if known.trip is not None and known.trip.reason == codes.LOW_BATTERY:
        return StatusLine(said(known.trip.message, known.trip.reason), "warn")
    if known.estimate is not None and known.estimate.off_map is not None:
        return StatusLine("It has left its map. Send it to a place on the map.", "warn")
    if _is_unsure(known):
        return StatusLine("It is not quite sure where it is, so it drives slowly.", "warn")
    return READY if known.room is None else StatusLine(f"Ready. It is in “{known.room}”.", "good")


Rule = Callable[[RobotState], StatusLine | None]


def _of(topic: Topic[Any], rule: Rule) -> Rule:
    """A rule that repeats what a topic said, and how old that is."""

    def say(known: RobotState) -> StatusLine | None:
        words = rule(known)
        return None if words is None else aged(words, known.ages.get(topic.name))

    return say


RULES: Sequence[Rule] = (
    _setup,
    _away,
    _of(topics.BASE, _base),
    _of(topics.BASE, _by_hand),
    _of(topics.BASE, _held),
    _planner,
    _of(topics.MAPPING, _mapping),
    _position,
    _tour_service,
    _of(topics.TOUR, _trip),
    _of(topics.GOAL, _goal),
    _lost_drive,
    _idle,
)
"""The first that has something to say wins; the last one always has."""


_BY_PEOPLE = "|".join(
    re.escape(PAUSE_REASONS[code])
    for code in (codes.TAKEN_OVER, codes.STOPPED, codes.OTHER_GOAL, codes.CANCELED)
)
_ASKED_FOR = re.compile(
    rf"{STOPPED_REASONS[codes.BUTTON]}\. Press “Drive on” .+"
    rf"|(The tour|It|The map “.+”) is paused( on its way to [^:]+)?(: ({_BY_PEOPLE}))?"
    r"\. Press “Continue”\."
)


def is_asked_for(sentence: str) -> bool:
    """Whether a sentence tells of a stop or pause that somebody wanted: nothing went wrong."""
    return _ASKED_FOR.fullmatch(sentence) is not None


def will_continue(known: RobotState) -> bool:
    """Whether a robot that base holds is certain to drive on by itself once it may."""
    base, goal, trip = known.base, known.goal, known.trip
    if "planner" in known.silent or topics.GOAL.name in known.ages:
        return False
    if trip is not None and trip.state in TRIP_GOES:
        return "tour" not in known.silent
    # Without commands the planner may be gone, and a single goal with it.
    is_commanded = base is None or base.reason != codes.COMMAND_LOST
    is_going = goal is not None and goal.state in GOAL_GOES
    return is_commanded and is_going


def has_left(known: RobotState) -> bool:
    """Whether it is somewhere else than where it arrived, as when it was driven on by hand."""
    goal, estimate = known.goal, known.estimate
    if goal is None or goal.state != "arrived" or goal.pose is None or goal.person is not None:
        return False
    if goal.frame != MAP:
        return False
    here = None if estimate is None else estimate.pose
    return here is not None and here.distance_to(goal.pose) > LEFT_M


def _is_unsure(known: RobotState) -> bool:
    return known.estimate is not None and known.estimate.state == "unsure"


def _reason_of(status: BaseState | GoalStatus | TourStatus | MappingStatus) -> str:
    """The reason in words, to be put behind a colon."""
    reason = "" if isinstance(status, MappingStatus) else status.reason
    why = said(status.message, reason)
    return why[:1].lower() + why[1:].rstrip(".") if why else "no reason was given"


def _age(age_s: float) -> str:
    return age_text(age_s, 0.0)


def _left(goal: GoalStatus) -> str:
    words = remaining(goal)
    return words and f", {words}"


def _stop_name(known: RobotState) -> str:
    trip, tour = known.trip, known.tour
    if trip is None or trip.stop is None:
        return "its stop"
    name = tour.stops[trip.stop].name if tour is not None and trip.stop < len(tour.stops) else None
    return name or f"stop {trip.stop + 1}"


def _counted(known: RobotState) -> str:
    """Which stop of the tour this is."""
    trip, tour = known.trip, known.tour
    if trip is None or trip.stop is None or trip.state not in ("driving", "dwelling"):
        return ""
    of = f" of {len(tour.stops)}" if tour is not None and trip.stop < len(tour.stops) else ""
    return f" (stop {trip.stop + 1}{of})"
