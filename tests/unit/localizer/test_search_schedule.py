"""When the whole map is searched."""

import itertools
from dataclasses import replace

import pytest

from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.scanning import ScanInput
from trolley_localizer.tracking.search_schedule import PARAMS, SearchSchedule

from .conftest import at, make_scan

STEP_M = 0.05
AGAIN_S = 3.0


@pytest.fixture
def scan(flat: GridMap) -> ScanInput:
    return make_scan(flat, at(flat, 5.5, 3.0, 0.4), Pose2D.identity())


def drive(schedule: SearchSchedule, scan: ScanInput, metres: float) -> list[float]:
    """Search as often as it is due on a way of 0.5 m/s; return after which distances."""
    searched_m: list[float] = []
    for k in range(round(metres / STEP_M)):
        here = replace(scan, odom_T_base=Pose2D(k * STEP_M, 0.0, 0.0))
        schedule.since_s += 0.1
        schedule.predict(STEP_M)
        if schedule.is_due(here, AGAIN_S):
            schedule.begin(object(), here)
            searched_m.append((k + 1) * STEP_M)
    return searched_m


def test_searches_in_vain_come_after_a_share_of_what_was_driven_in_vain(scan: ScanInput) -> None:
    searched_m = drive(SearchSchedule(), scan, 200.0)
    slack_m = AGAIN_S * 0.5 + 2 * STEP_M
    for before, after in itertools.pairwise(searched_m):
        assert after - before <= max(slack_m, PARAMS.share * after + 2 * STEP_M)
        assert after - before <= PARAMS.most_m + 2 * STEP_M
    assert len(searched_m) < 35


def test_a_new_reason_lets_it_search_as_often_as_at_first(scan: ScanInput) -> None:
    schedule = SearchSchedule()
    at_first = drive(schedule, scan, 10.0)
    in_vain = drive(schedule, scan, 10.0)
    schedule.restart()
    anew = drive(schedule, scan, 10.0)
    assert len(in_vain) < len(at_first) <= len(anew) + 1


def test_what_shows_the_same_is_searched_again_only_after_long(scan: ScanInput) -> None:
    schedule = SearchSchedule()
    schedule.begin(object(), scan)
    schedule.since_s = AGAIN_S + 0.1
    assert not schedule.is_due(scan, AGAIN_S)
    nearer = replace(scan, ranges=0.5 * scan.ranges)
    assert schedule.is_due(nearer, AGAIN_S)
    schedule.since_s = PARAMS.same_s + 0.1
    assert schedule.is_due(scan, AGAIN_S)
