"""What is under way: the states of goals and trips, and which of the two a person means."""

import re
from typing import Literal

from trolley.messages import GoalStatus, TourStatus

GOAL_GOES = ("planning", "driving", "recovering")
"""States of a goal that the robot is on its way to."""
GOAL_UNDER_WAY = (*GOAL_GOES, "paused")
"""Those of a goal that is not over."""
TRIP_GOES = ("driving", "dwelling", "waiting")
"""States of a trip that goes on by itself."""
TRIP_UNDER_WAY = (*TRIP_GOES, "paused")
"""Those of a trip that is not over."""
MAPPER_SILENT_NS = 3_000_000_000
"""A mapper that makes a map says so each second; after this long it is gone [ns]."""
EXPLORES = "map-"
"""How the ids of goals begin that belong to a robot that explores by itself."""
_TRIP_GOAL = re.compile(r"tour-([a-z0-9]{1,12})-\d+-\d+")


def trip_goal_id(trip: str, stop: int, attempt: int) -> str:
    """Return the id of a trip's goal at a stop."""
    return f"tour-{trip}-{stop}-{attempt}"


def trip_of(goal_id: str | None) -> str | None:
    """Return the id of the trip that a goal belongs to, None for all others."""
    found = _TRIP_GOAL.fullmatch(goal_id or "")
    return None if found is None else found[1]


def what_is_under_way(
    goal: GoalStatus | None, trip: TourStatus | None
) -> Literal["trip", "goal", ""]:
    """Say what "pause", "continue" and "cancel" act on: the trip under way, or else the goal."""
    is_going = goal is not None and goal.state in GOAL_UNDER_WAY
    is_of_trip = goal is not None and trip_of(goal.id) is not None
    if trip is not None and trip.state in TRIP_UNDER_WAY and (is_of_trip or not is_going):
        return "trip"
    return "goal" if is_going else ""
