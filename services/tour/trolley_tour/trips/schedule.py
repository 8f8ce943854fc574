"""Which tours are to start by themselves in a minute of local time."""

import datetime
from collections.abc import Iterable
from typing import get_args

from trolley.messages import Tour
from trolley.messages.touring import Day

_DAYS: tuple[str, ...] = get_args(Day)


def tours_due(tours: Iterable[Tour], minute: datetime.datetime) -> list[Tour]:
    """The tours with an entry for this minute, in order.

    Args:
        tours: All that are stored.
        minute: Local time; seconds do not count. An hour that the clock skips or repeats in spring
            or autumn starts nothing, or starts it twice.
    """
    day, at = _DAYS[minute.weekday()], f"{minute:%H:%M}"
    return [
        tour
        for tour in tours
        if any(entry.at == at and (not entry.days or day in entry.days) for entry in tour.schedule)
    ]


class Minutes:
    """Gives each minute once; minutes in which nobody asked are not made up for."""

    def __init__(self) -> None:
        self._last: str | None = None

    def next(self, now: datetime.datetime) -> datetime.datetime | None:
        """The present minute, None where it was given before. The first one is not given.

        A service that is restarted must not start again what it started in this minute.
        """
        minute = now.replace(second=0, microsecond=0)
        last, self._last = self._last, minute.isoformat()
        return None if last is None or last == self._last else minute
