"""Tours that start by themselves."""

import datetime

import pytest

from trolley.messages import ScheduleEntry, Stop, Tour
from trolley.messages.touring import Day
from trolley_tour.trips.schedule import Minutes, tours_due

MONDAY = datetime.datetime(2026, 11, 2, 8, 30, 12, tzinfo=datetime.UTC)


def tour(at: str, *days: Day) -> Tour:
    entries = [ScheduleEntry(days=list(days), at=at)]
    return Tour(name="t", stops=[Stop(name="a")], schedule=entries)


@pytest.mark.parametrize(
    ("entry", "is_due"),
    [
        (("08:30",), True),
        (("08:30", "mon"), True),
        (("08:30", "sat", "mon"), True),
        (("08:30", "tue"), False),
        (("08:31",), False),
        (("20:30",), False),
    ],
)
def test_entry_holds_for_its_minute(entry, is_due: bool):
    assert bool(tours_due([tour(*entry)], MONDAY)) == is_due


def test_each_minute_comes_once_and_the_first_not_at_all():
    minutes = Minutes()
    given = [minutes.next(MONDAY + datetime.timedelta(seconds=step)) for step in range(0, 180, 5)]
    assert [one.strftime("%H:%M") for one in given if one] == ["08:31", "08:32", "08:33"]
