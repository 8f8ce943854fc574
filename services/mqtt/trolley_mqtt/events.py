"""What has just happened, for automations and notifications: each once, with its reason."""

import dataclasses
from collections.abc import Iterator
from typing import get_args

from msgspec import Struct

from trolley import codes
from trolley.config.webhook import EventType
from trolley_mqtt.robot_view import RobotView
from trolley_mqtt.sentences import NO_PLANNER, activity_of, reason_of, where
from trolley_mqtt.state import MAX_TEXT

LOW, NO_LONGER_LOW = 0.2, 0.3
"""A battery is said to be low below the first share of its charge; again only after the second."""

STUCK_S = 5.0
"""A robot that has tried to get on for so long is stuck: people walk out of its way sooner."""
STUCK = (codes.BLOCKED, codes.SLIP, codes.OSCILLATION, codes.BLIND)
"""Why it does not get on. Waiting for another robot is not among them."""

ENDS: dict[str, EventType] = {"arrived": "arrived", "failed": "failed"}
TRIP_TURNS: dict[str, EventType] = {
    "done": "tour_done",
    "failed": "tour_failed",
    "waiting": "waiting",
}
"""A trip that waits does so for a person."""
ALARMS: dict[str, EventType] = {"stopped": "stopped", "lost": "lost", "fault": "fault"}
EVENT_TYPES: tuple[EventType, ...] = get_args(EventType)


class Happened(Struct, frozen=True, kw_only=True):
    """One event, as it goes to the broker and to webhooks."""

    event_type: EventType
    message: str
    """A sentence for people."""
    reason: str = ""
    """One of `trolley.codes`, "" where there is none."""
    place: str | None = None
    """The saved place that the robot is at."""
    tour: str | None = None


class Events:
    """Finds events by comparing the robot's state with the one before.

    What is found at the beginning, or when the robot comes back, has not just happened.
    """

    def __init__(self) -> None:
        self._goal: tuple[str | None, str] | None = None
        self._trip: tuple[str | None, str] | None = None
        self._activity = ""
        self._had_planner = True
        self._is_low = False
        self._stuck_since_ns: int | None = None
        self._stuck_goal: str | None = None
        """The goal that was told to be stuck."""

    def update(self, view: RobotView) -> list[Happened]:
        """What has happened since the last time."""
        found = [
            *self._ends(view),
            *self._stuck(view),
            *self._planner(view),
            *self._alarms(dataclasses.replace(view, has_planner=True)),
            *self._battery(view),
        ]
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

    def _stuck(self, view: RobotView) -> Iterator[Happened]:
        goal = view.goal
        if goal is None or goal.state != "recovering" or goal.reason not in STUCK:
            self._stuck_since_ns = None
            return
        if self._stuck_since_ns is None:
            self._stuck_since_ns = goal.stamp_ns
        is_stuck = goal.stamp_ns - self._stuck_since_ns >= STUCK_S * 1e9
        if is_stuck and goal.id != self._stuck_goal:
            self._stuck_goal = goal.id
            yield _event("stuck", reason_of(goal), goal.reason, view)

    def _planner(self, view: RobotView) -> Iterator[Happened]:
        # It may be missing for good, as where the robot is only driven by hand: once is enough, and
        # no other fault is less worth telling for it.
        had, self._had_planner = self._had_planner, view.has_planner
        if had and not view.has_planner:
            yield _event("fault", NO_PLANNER, codes.NO_PLANNER, view)

    def _alarms(self, view: RobotView) -> Iterator[Happened]:
        activity, message = activity_of(view)
        before, self._activity = self._activity, activity
        if activity in ALARMS and before not in ("", "away", activity):
            reason = codes.LOST if activity == "lost" or view.base is None else view.base.reason
            yield _event(ALARMS[activity], message, reason, view)

    def _battery(self, view: RobotView) -> Iterator[Happened]:
        battery = None if view.base is None else view.base.battery
        charge = None if battery is None else battery.fraction
        if charge is None:
            return
        was_low = self._is_low
        self._is_low = charge < LOW or (was_low and charge < NO_LONGER_LOW)
        if self._is_low and not was_low and not (battery and battery.charging):
            yield _event("battery_low", f"The battery is at {round(100.0 * charge)} %.", "", view)


def located_of(view: RobotView) -> Happened:
    """Where the robot is."""
    return _event("located", where(view), "", view)


def _event(
    kind: EventType, message: str, reason: str, view: RobotView, tour: str | None = None
) -> Happened:
    return Happened(
        event_type=kind, message=message[:MAX_TEXT], reason=reason, place=view.place, tour=tour
    )
