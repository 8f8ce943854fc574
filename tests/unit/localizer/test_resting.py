"""A robot that stands: little work, and nothing missed."""

from collections.abc import Callable

import numpy as np
import pytest

from trolley.geometry import Pose2D
from trolley_localizer.estimate import Estimate

from .conftest import BEAMS, INCREMENT, Drive, Turn, make_scan

SECOND = 10
"""Scans."""


@pytest.fixture(params=["a simulated lidar", "a real lidar"])
def standing(make_drive: Callable[..., Drive], request: pytest.FixtureRequest) -> Drive:
    """A robot that knows where it is and has stood for a while."""
    drive = make_drive()
    random = np.random.default_rng(3)
    drive.alter = noisy(random)
    if request.param == "a real lidar":
        drive.turn = unsteady(random)
    drive.localizer.set_pose(drive.pose)
    for _ in range(2 * SECOND):
        drive.scan(wz=0.3)
    for _ in range(3 * SECOND):
        drive.scan()
    return drive


def noisy(random: np.random.Generator) -> Callable[[np.ndarray], None]:
    """Errors of a budget lidar: 1 % of the range, and one beam in twenty misses."""

    def alter(ranges: np.ndarray) -> None:
        ranges *= 1.0 + 0.01 * random.standard_normal(ranges.size)
        ranges[random.random(ranges.size) < 0.05] = 0.0

    return alter


def unsteady(random: np.random.Generator) -> Callable[[], Turn]:
    """Turns of a motor that is 1 % faster or slower each time."""

    def turn() -> Turn:
        beams = BEAMS + int(random.integers(-4, 5))
        return Turn(beams, INCREMENT * random.uniform(0.0, 1.0) - np.pi)

    return turn


def shares_used(drive: Drive, scans: int) -> tuple[float, Estimate]:
    """Which share of scans was learnt from, and what was said last."""
    said = [drive.scan() for _ in range(scans)]
    return sum(not one.is_held for one in said) / scans, said[-1]


def test_standing_it_looks_once_a_second_and_goes_on_saying_where_it_is(standing: Drive) -> None:
    used, said = shares_used(standing, 5 * SECOND)
    assert used <= 0.12
    assert said.stamp_ns == standing.stamp_ns
    assert said.state == "localized"
    assert standing.error_m(said) < 0.03


def test_standing_it_classifies_as_many_beams_as_the_scan_has(standing: Drive) -> None:
    turn, counts = standing.turn, list[int]()

    def counted() -> Turn:
        counts.append(turn().beams)
        return Turn(counts[-1])

    standing.turn = counted
    assert [standing.scan().beam_classes.size for _ in range(SECOND)] == counts


def test_driving_on_it_learns_from_each_scan(standing: Drive) -> None:
    said = [standing.scan(vx=0.3) for _ in range(SECOND)]
    assert not any(one.is_held for one in said)
    assert standing.error_m(said[-1]) < 0.05


@pytest.mark.parametrize("push", [Pose2D(0.3, 0.0, 0.0), Pose2D(0.0, 0.0, 0.3)])
def test_a_push_that_the_wheels_do_not_see_is_noticed_at_once(
    standing: Drive, push: Pose2D
) -> None:
    standing.scan()
    standing.pose = standing.pose @ push
    said = standing.scan()
    assert not said.is_held
    for _ in range(3 * SECOND):
        said = standing.scan()
    assert said.state != "localized" or standing.error_m(said) < 0.1


def test_a_slow_push_that_the_wheels_do_not_see_is_followed(standing: Drive) -> None:
    said = standing.scan()
    for _ in range(10 * SECOND):
        standing.pose = standing.pose @ Pose2D(0.003, 0.0, 0.0)
        said = standing.scan()
        assert said.state != "localized" or standing.error_m(said) < 0.15


def test_whoever_walks_past_is_looked_at(standing: Drive) -> None:
    alter, first = standing.alter, [0]

    def somebody(ranges: np.ndarray) -> None:
        alter(ranges)
        first[0] += 12
        ranges[first[0] : first[0] + 60] = 0.6

    standing.alter = somebody
    used, _ = shares_used(standing, 2 * SECOND)
    assert used > 0.9


def test_a_covered_lidar_does_not_look_like_rest(standing: Drive) -> None:
    standing.alter = lambda ranges: ranges.fill(0.0)
    said = standing.scan()
    for _ in range(8 * SECOND):
        said = standing.scan()
    assert said.state != "localized"


def test_what_a_late_search_found_is_not_held_back_by_rest(standing: Drive) -> None:
    localizer = standing.localizer

    def step() -> Estimate:
        standing.stamp_ns += 100_000_000
        said = localizer.step(
            make_scan(standing.grid, standing.pose, standing.odom, standing.stamp_ns)
        )
        assert isinstance(said, Estimate)
        return said

    localizer.set_pose(standing.pose)
    step()
    job = localizer.take_job()
    assert job is not None
    said = [step() for _ in range(2 * SECOND + 5)]
    assert said[-1].state == "localized"
    localizer.finish(job.run())
    for _ in range(3):
        assert not step().is_held


def test_scans_without_beams_and_without_echoes_are_nothing_to_rest_on(standing: Drive) -> None:
    for beams in [0] * 15 + [BEAMS] * 3:
        standing.stamp_ns += 100_000_000
        scan = make_scan(standing.grid, standing.pose, standing.odom, standing.stamp_ns)
        object.__setattr__(scan, "ranges", np.full(beams, np.inf, np.float32))
        said = standing.localizer.step(scan)
        assert isinstance(said, Estimate)
        assert said.beam_classes.size == beams
