"""A queue of goals that one person makes before the robot drives to them."""

import math
from dataclasses import dataclass

from trolley.geometry import Pose2D
from trolley.messages import Stop, Tour, TourStatus
from trolley.under_way import TRIP_UNDER_WAY

MAX_STOPS = 50


@dataclass(frozen=True)
class QueuedGoal:
    """A goal in the queue: a saved place, or a pose on the map."""

    title: str
    pose: Pose2D
    """Where it is, in `map`."""
    name: str | None = None
    """Name of the saved place."""

    @property
    def stop(self) -> Stop:
        """Return the goal as a stop of a tour that is skipped if it cannot be reached."""
        if self.name is not None:
            return Stop(name=self.name, on_failure="skip")
        return Stop(pose=self.pose, on_failure="skip")


class GoalQueue:
    """The goals in the order in which they are driven to."""

    def __init__(self) -> None:
        self.items: tuple[QueuedGoal, ...] = ()
        self.is_collecting = False
        """Whether what is pressed is queued instead of driven to at once."""
        self._trip: TourStatus | None = None
        """The trip that drives to them."""

    @property
    def is_driven(self) -> bool:
        """Whether a trip drives to them."""
        return self._trip is not None

    def collect(self, *, is_on: bool) -> None:
        """Start or stop collecting; goals that are being driven to already are cleared first."""
        if is_on and self._trip is not None:
            self.clear()
        self.is_collecting = is_on

    def set_off(self, trip: TourStatus) -> None:
        """Note the trip that drives to them now."""
        self._trip, self.is_collecting = trip, False

    def follow(self, trip: TourStatus | None) -> None:
        """Clear the queue when its trip is over."""
        own = self._trip
        if own is None or trip is None or trip.stamp_ns < own.stamp_ns:
            return
        if trip.trip != own.trip or trip.state not in TRIP_UNDER_WAY:
            self.clear()

    def add_place(self, name: str, pose: Pose2D) -> bool:
        """Add a saved place at the end; False if there are too many already."""
        return self._add(QueuedGoal(name, pose, name))

    def add_point(self, x: float, y: float, yaw: float | None, start: Pose2D | None) -> bool:
        """Add a place that was pointed out [m, rad]; False if there are too many already.

        Without a heading the robot looks the way that it comes, from the last place or from where
        it stands (`start`).
        """
        came_from = self.items[-1].pose if self.items else start
        if yaw is None:
            yaw = 0.0 if came_from is None else math.atan2(y - came_from.y, x - came_from.x)
        return self._add(QueuedGoal(f"x {x:.1f} m, y {y:.1f} m", Pose2D(x, y, yaw)))

    def remove_last(self) -> None:
        """Take the last one off."""
        self.items = self.items[:-1]

    def clear(self) -> None:
        """Take all off."""
        self.items, self._trip = (), None

    def tour(self) -> Tour | None:
        """An unnamed tour of the queue, None while it is empty."""
        return Tour(stops=[one.stop for one in self.items]) if self.items else None

    def _add(self, queued: QueuedGoal) -> bool:
        if len(self.items) >= MAX_STOPS:
            return False
        self.items = (*self.items, queued)
        return True
