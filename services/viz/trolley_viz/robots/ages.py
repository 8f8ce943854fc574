"""How old what is shown is, where it should have been renewed by now."""

from collections.abc import Mapping, Set
from typing import Any

import msgspec

from trolley import topics
from trolley.messages import BaseState, GoalStatus, TourStatus
from trolley.topics import Topic
from trolley.under_way import TRIP_GOES

LIVE_S = 3.0
"""What comes once a second or more often is old after this [s]."""
WATCHED: tuple[Topic[Any], ...] = (
    topics.BASE,
    topics.GOAL,
    topics.TOUR,
    topics.MAPPING,
    topics.CHANGES,
)
"""What sentences and lines are made from. A pose says itself how old it is."""

Ages = Mapping[str, float]
"""By topic, how old the newest message is [s]; those that are as new as can be are left out."""


class LastHeard:
    """When a robot was last heard."""

    def __init__(self) -> None:
        self._heard_ns: int | None = None

    def update(self, robot_ns: int | None, now_ns: int) -> float | None:
        """Return how long nothing has been heard of a robot [s].

        Args:
            robot_ns: its time [ns], None while its clock is silent.
            now_ns: local monotonic time [ns].

        Returns:
            None while it is heard, or if it never was.
        """
        if robot_ns is not None:
            self._heard_ns = now_ns
            return None
        return None if self._heard_ns is None else (now_ns - self._heard_ns) * 1e-9


def overdue_s(
    topic: Topic[Any],
    message: msgspec.Struct | None,
    arrived_ns: int | None,
    now_ns: int,
    silent: Set[str] = frozenset(),
) -> float | None:
    """Return how old the newest message is [s], None if there need not be a newer one.

    Args:
        topic: of the message.
        message: the newest.
        arrived_ns: when it came (local monotonic [ns]).
        now_ns: now, by the same clock.
        silent: the services that are not running.
    """
    if message is None or arrived_ns is None:
        return None
    age_s = (now_ns - arrived_ns) * 1e-9
    is_overdue = age_s > LIVE_S and (topic.first_owner in silent or _goes_on(message))
    return age_s if is_overdue else None


def _goes_on(message: msgspec.Struct) -> bool:
    """Whether such a message is repeated at least once a second as long as it holds."""
    match message:
        case BaseState():
            return True
        case TourStatus():
            return message.state in TRIP_GOES
        case GoalStatus():
            return message.state in ("driving", "recovering")
        case _:
            return False
