"""What the sentences about a robot depend on, gathered from its streams."""

from typing import Any

from msgspec.structs import replace

from trolley import topics
from trolley.topics import Topic
from trolley.under_way import what_is_under_way
from trolley.zones import room_of
from trolley_viz.features.tours.layer import tour_of
from trolley_viz.robots.ages import WATCHED, Ages
from trolley_viz.robots.situation import RobotState, has_left, will_continue
from trolley_viz.robots.view import View
from trolley_viz.words.sentences import (
    STALE_S,
    StatusLine,
    aged,
    away_line,
    base_line,
    goal_line,
    position_line,
    trip_line,
)

NO_PLANNER = StatusLine("No planner", "bad", "The planner is not running.")


def robot_state(view: View) -> RobotState:
    """Gather what the sentence about the robot depends on."""
    streams = view.streams
    estimate, saved = streams.latest(topics.POSE), streams.latest(topics.POSES)
    trip = streams.latest(topics.TOUR)
    robot_ns, age_s = view.robot_ns, None
    if robot_ns is not None and estimate is not None:
        age_s = (robot_ns - estimate.stamp_ns) * 1e-9
    return RobotState(
        is_away=view.is_away,
        base=streams.latest(topics.BASE),
        has_map=view.map is not None,
        estimate=estimate,
        estimate_age_s=age_s,
        goal=streams.latest(topics.GOAL),
        lost_goal=view.lost_goal,
        trip=trip,
        tour=None if trip is None else tour_of(trip, view),
        places=[] if saved is None else saved.poses,
        room=room_of(estimate, streams.latest(topics.ZONES)),
        silent=view.silent,
        mapping=streams.latest(topics.MAPPING),
        ages=_ages(view, age_s),
        away_s=view.away_s,
        setup=view.setup,
    )


def _ages(view: View, pose_age_s: float | None) -> Ages:
    """How old what is known is, by topic, where there should be something newer."""
    ages = {topic.name: view.overdue_s(topic) for topic in WATCHED}
    if pose_age_s is not None and pose_age_s > STALE_S:
        ages[topics.POSE.name] = pose_age_s
    return {name: age_s for name, age_s in ages.items() if age_s is not None}


def under_way(known: RobotState) -> str | None:
    """The id of the trip that is under way, or else of the goal."""
    goal, trip = known.goal, known.trip
    match what_is_under_way(goal, trip):
        case "trip":
            return None if trip is None else trip.trip
        case "goal":
            return None if goal is None else goal.id
        case _:
            return None


def state_lines(known: RobotState, sent_by: str = "") -> list[StatusLine]:
    """The lines of the state: position, what holds it, where it is going, the trip, who sent it."""
    if known.setup is not None:
        return []
    if known.is_away:
        return [away_line(known.away_s)]
    goal = known.goal
    if goal is not None and has_left(known):
        goal = replace(goal, id=None, state="idle", pose=None)
    is_sent = goal is not None and goal.state != "idle"
    is_alone, places = "planner" in known.silent, list(known.places)

    def _aged(topic: Topic[Any], words: StatusLine | None) -> StatusLine | None:
        return None if words is None else aged(words, known.ages.get(topic.name))

    lines = [
        position_line(known.estimate, known.estimate_age_s),
        _aged(topics.BASE, base_line(known.base, goes_on=will_continue(known))),
        NO_PLANNER if is_alone else None,
        # Without a planner there is nothing to say of a robot that was not going anywhere.
        None if is_alone and not is_sent else _aged(topics.GOAL, goal_line(goal, places)),
        _aged(topics.TOUR, trip_line(known.trip, known.tour)),
        StatusLine(f"Sent {sent_by}", "idle") if sent_by else None,
    ]
    return [line for line in lines if line is not None]


def now_line(now: StatusLine) -> StatusLine:
    """Say what is, beside what was."""
    return StatusLine(f"Now: {now.headline}", now.tone, now.detail)
