"""What the bridge knows of the robot, and what follows from it: position, place, destination."""

import dataclasses
import math
from collections.abc import Sequence

from trolley.geometry import Pose2D
from trolley.messages import BaseState, GoalStatus, PoseEstimate, SavedPose, TourStatus, Zones
from trolley.under_way import GOAL_GOES, GOAL_UNDER_WAY, TRIP_UNDER_WAY, trip_of
from trolley.zones import room_of

POSITIONS = ("localized", "unsure", "searching", "lost", "mapping", "stale")
PLACED = ("localized", "unsure")
"""Those in which the robot knows, at least roughly, where it is."""
STALE_S = 1.0
"""An estimate older than this says nothing of where the robot is."""
AT_PLACE_M = 0.5
"""The robot is at a saved place that is this near."""
SAME_PLACE_M = 0.1
"""A goal this near to a saved pose is called by its name."""

ON_TRIP = (*TRIP_UNDER_WAY, "failed")
"""The states of a trip that is worth telling: it is not over, or it failed."""


@dataclasses.dataclass(frozen=True)
class RobotView:
    """The robot at one moment; None where nothing was heard."""

    is_away: bool = False
    base: BaseState | None = None
    estimate: PoseEstimate | None = None
    age_s: float | None = None
    """Of the estimate [s], None while unknown."""
    goal: GoalStatus | None = None
    trip: TourStatus | None = None
    places: Sequence[SavedPose] = ()
    """On the robot's map."""
    zones: Zones | None = None
    has_planner: bool = True
    """Whether the planner runs, or may just be starting."""

    @property
    def current_trip(self) -> TourStatus | None:
        """The trip, where it is what matters: nothing else has been driven since."""
        trip, goal = self.trip, self.goal
        if trip is None or trip.state not in ON_TRIP:
            return None
        if goal is None or goal.id is None or trip_of(goal.id) == trip.trip:
            return trip
        return None if trip.state == "failed" or goal.state in GOAL_GOES else trip

    @property
    def position(self) -> str | None:
        """How sure the robot is of its pose: one of `POSITIONS`."""
        if self.is_away or self.estimate is None or self.estimate.map is None:
            return None
        if self.age_s is None or self.age_s > STALE_S:
            return "stale"
        return self.estimate.state

    @property
    def place(self) -> str | None:
        """The nearest saved place, where the robot is at one and knows it."""
        if self.estimate is None or not self.is_placed:
            return None
        return _nearest(self.estimate.pose, self.places, AT_PLACE_M)

    @property
    def room(self) -> str | None:
        """The room that the robot is in and knows."""
        return room_of(self.estimate, self.zones) if self.is_placed else None

    @property
    def destination(self) -> str | None:
        """Where it goes by name, None where it goes nowhere or to a point without one."""
        trip, goal = self.current_trip, self.goal
        if trip is not None:
            stops = [] if trip.tour is None else trip.tour.stops
            index = len(stops) if trip.stop is None or trip.state == "failed" else trip.stop
            return stops[index].name if index < len(stops) else None
        if goal is None or goal.state not in GOAL_UNDER_WAY or goal.frame != "map":
            return None
        return _nearest(goal.pose, self.places, SAME_PLACE_M)

    @property
    def is_placed(self) -> bool:
        """Whether the robot knows, at least roughly, where it is."""
        return self.position in PLACED


def _nearest(pose: Pose2D | None, places: Sequence[SavedPose], within_m: float) -> str | None:
    if pose is None:
        return None
    found = [(math.hypot(one.pose.x - pose.x, one.pose.y - pose.y), one.name) for one in places]
    distance_m, name = min(found, default=(math.inf, ""))
    return name if distance_m <= within_m else None
