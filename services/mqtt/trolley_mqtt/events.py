"""What has just happened, for automations and notifications: each once, with its reason."""

from collections.abc import Iterator

from msgspec import Struct

from trolley import codes
from trolley_mqtt.robot_view import RobotView
from trolley_mqtt.sentences import activity_of, where
from trolley_mqtt.state import MAX_TEXT

LOW, NO_LONGER_LOW = 0.2, 0.3
"""A battery is said to be low below the first share of its charge; again only after the second."""

ENDS = {"arrived": "arrived", "failed": "failed"}
TRIP_TURNS = {"done": "tour_done", "failed": "tour_failed", "waiting": "waiting"}
"""A trip that waits does so for a person."""
ALARMS = ("stopped", "lost", "fault")
BATTERY_LOW = "battery_low"
LOCATED = "located"
"""Somebody asked where the robot is."""
EVENT_TYPES = (*ENDS.values(), *TRIP_TURNS.values(), *ALARMS, BATTERY_LOW, LOCATED)


class Happened(Struct, frozen=True, kw_only=True):
    """One event."""

    event_type: str
    """One of `EVENT_TYPES`."""
    message: str
    """A sentence for people."""
    reason: str = ""
    """One of `trolley.codes`, "" where there is none."""
    place: str | None = None
    """The saved place that the robot is at."""
    tour: str | None = None


class Events:
    """Compares what is with what was.

    What is found at the beginning, or when the robot comes back, has not just happened.
    """

    def __init__(self) -> None:
        self._goal: tuple[str | None, str] | None = None
        self._trip: tuple[str | None, str] | None = None
        self._activity = ""
        self._is_low = False

    def update(self, view: RobotView) -> list[Happened]:
        """What has happened since the last time."""
        found = [*self._ends(view), *self._alarms(view), *self._battery(view)]
        return found if not view.is_away else []

    def _ends(self, view: RobotView) -> Iterator[Happened]:
        goal, trip = view.goal, view.trip
        if goal is not None:
            before, self._goal = self._goal, (goal.id, goal.state)
            is_new = before is not None and before != self._goal
            if is_new and goal.state in ENDS:
                words = goal.message or f"The robot has {goal.state}."
                yield _event(ENDS[goal.state], words, goal.reason, view)
        if trip is not None:
            before, self._trip = self._trip, (trip.trip, trip.state)
            is_new = before is not None and before != self._trip
            if is_new and trip.state in TRIP_TURNS:
                words = trip.message or f"The tour is {trip.state}."
                yield _event(TRIP_TURNS[trip.state], words, trip.reason, view, trip.name)

    def _alarms(self, view: RobotView) -> Iterator[Happened]:
        activity, message = activity_of(view)
        before, self._activity = self._activity, activity
        if activity in ALARMS and before not in ("", "away", activity):
            reason = codes.LOST if activity == "lost" or view.base is None else view.base.reason
            yield _event(activity, message, reason, view)

    def _battery(self, view: RobotView) -> Iterator[Happened]:
        battery = None if view.base is None else view.base.battery
        charge = None if battery is None else battery.fraction
        if charge is None:
            return
        was_low = self._is_low
        self._is_low = charge < LOW or (was_low and charge < NO_LONGER_LOW)
        if self._is_low and not was_low and not (battery and battery.charging):
            yield _event(BATTERY_LOW, f"The battery is at {round(100.0 * charge)} %.", "", view)


def located_of(view: RobotView) -> Happened:
    """Where the robot is."""
    return _event(LOCATED, where(view), "", view)


def _event(
    kind: str, message: str, reason: str, view: RobotView, tour: str | None = None
) -> Happened:
    return Happened(
        event_type=kind, message=message[:MAX_TEXT], reason=reason, place=view.place, tour=tour
    )
