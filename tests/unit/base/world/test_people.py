"""People on their paths."""

import math

import numpy as np
import pytest

from trolley_base.world.gaps import outline_to_point
from trolley_base.world.people import Walker
from trolley_base.world.spec import Person

FAR_AWAY = np.array([[90.0, 90.0], [91.0, 90.0], [91.0, 91.0], [90.0, 91.0]])


def track(person: Person, seconds: float, seed: int = 0) -> np.ndarray:
    walker = Walker(person, np.random.default_rng(seed))
    places = []
    for _ in range(round(seconds * 100)):
        walker.step(0.01, FAR_AWAY)
        places.append(walker.circles()[:, :2].mean(axis=0))
    return np.array(places)


def test_there_and_back() -> None:
    person = Person(path=[(0.0, 0.0), (2.0, 0.0)], speed_mps=1.0, starts_s=0.0)
    places = track(person, 8.0)
    assert places[:, 0].max() == pytest.approx(2.0, abs=0.02)
    assert places[399, 0] == pytest.approx(0.0, abs=0.03)
    assert np.abs(np.diff(places[:, 0])).max() <= 0.0101


def test_round_and_round_also_where_the_last_point_is_the_first() -> None:
    square = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.0, 0.0)]
    places = track(Person(path=square, speed_mps=1.0, loop=True, starts_s=0.0), 8.0)
    assert math.dist(places[399], (0.0, 0.0)) < 0.05
    assert math.dist(places[249], (0.5, 1.0)) < 0.05
    assert math.dist(places[649], (0.5, 1.0)) < 0.1


def test_dwell_and_start() -> None:
    person = Person(path=[(0.0, 0.0), (1.0, 0.0)], speed_mps=1.0, dwell_s=2.0, starts_s=1.0)
    places = track(person, 6.0)
    assert (places[:99] == 0.0).all()
    assert (np.abs(places[210:390, 0] - 1.0) < 0.02).all()


def test_seeds_begin_at_different_places() -> None:
    person = Person(path=[(0.0, 0.0), (4.0, 0.0)], speed_mps=1.0)
    first = [track(person, 0.01, seed)[0, 0] for seed in range(50)]
    assert min(first) < 0.7
    assert max(first) > 3.3


@pytest.mark.parametrize("path", [[(1.0, 2.0)], [(1.0, 2.0), (1.0, 2.0)]])
@pytest.mark.parametrize("loop", [False, True])
def test_a_path_without_length_is_somebody_who_stands(
    path: list[tuple[float, float]], loop: bool
) -> None:
    places = track(Person(path=path, loop=loop), 1.0)
    np.testing.assert_array_equal(places, [[1.0, 2.0]] * 100)


def test_legs_stay_within_reach_of_the_body() -> None:
    person = Person(path=[(0.0, 0.0), (2.0, 0.0)], legs=True, radius_m=0.2)
    walker = Walker(person, np.random.default_rng(0))
    for _ in range(500):
        walker.step(0.01, FAR_AWAY)
        legs = walker.circles()
        assert legs.shape == (2, 3)
        assert math.dist(legs[0, :2], legs[1, :2]) <= 2 * math.hypot(0.1, 0.15) + 1e-9


def test_legs_stay_in_place_when_somebody_turns_round() -> None:
    person = Person(
        path=[(0.0, 0.0), (2.0, 0.0)],
        starts_s=0.0,
        legs=True,
        stops_for_robot_m=0.0,
        patience_s=1.0,
    )
    # In the way where the legs are farthest apart.
    robot = np.array([[1.05, -0.2], [1.4, -0.2], [1.4, 0.2], [1.05, 0.2]])
    walker = Walker(person, np.random.default_rng(0))
    before = walker.circles()
    furthest = 0.0
    for _ in range(500):
        walker.step(0.01, robot)
        furthest = max(furthest, float(np.hypot(*(walker.circles() - before)[:, :2].T).max()))
        before = walker.circles()
    assert before[:, 0].max() < 1.0, "the person went back"
    # A leg that swings ahead is up to twice as fast as its owner.
    assert furthest < 2.0 * 0.01 * person.speed_mps


@pytest.mark.parametrize("seed", range(20))
def test_nobody_begins_on_the_robot(seed: int) -> None:
    person = Person(path=[(0.0, 0.0), (4.0, 0.0)], legs=True)
    rng = np.random.default_rng(seed)
    walker = Walker(person, rng)
    x = float(walker.circles()[:, 0].mean())
    robot = np.array([[0.2, 0.2], [-0.2, 0.2], [-0.2, -0.2], [0.2, -0.2]]) + np.array([x, 0.0])
    walker.keep_off(robot, rng)
    gaps = [outline_to_point(robot, float(x), float(y))[0] - r for x, y, r in walker.circles()]
    assert min(gaps) >= person.stops_for_robot_m
