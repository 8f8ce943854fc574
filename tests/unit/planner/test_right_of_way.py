"""Who goes first, and where two robots do not fit side by side."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.flatland import empty_room, two_rooms, with_block

from trolley.geometry import Pose2D
from trolley.gridmap import GridMap, distance_transform
from trolley_planner.fleet.neighbours import NO_TRACK, Neighbour
from trolley_planner.fleet.right_of_way import Claim, OwnRobot, Passages, must_step_aside, must_wait

RADIUS_M = 0.2
claims = st.builds(
    Claim,
    st.booleans(),
    st.one_of(st.none(), st.floats(0.0, 60.0)),
    st.floats(0.0, 20.0),
    st.text("abc", min_size=1, max_size=2),
)


pytestmark = pytest.mark.drives


def passages_of(grid: GridMap) -> Passages:
    return Passages(distance_transform(grid.occupied_mask(), grid.resolution, 2.0), 0.05, 0.45)


def line(x1: float, y1: float, x2: float, y2: float) -> np.ndarray:
    count = round(float(np.hypot(x2 - x1, y2 - y1)) / 0.05) + 1
    return np.stack([np.linspace(x1, x2, count), np.linspace(y1, y2, count)], axis=1)


def own(
    path: np.ndarray, name: str = "b", *, waited_s: float | None = None, stood_s: float = 0.0
) -> OwnRobot:
    return OwnRobot(name, (float(path[0, 0]), float(path[0, 1])), RADIUS_M, path, waited_s, stood_s)


def other(path: np.ndarray, name: str = "a", *, waited_s: float | None = None) -> Neighbour:
    pose = Pose2D(float(path[0, 0]), float(path[0, 1]), 0.0)
    return Neighbour(name, pose, RADIUS_M, path, waited_s, NO_TRACK)


@given(claims, claims)
def test_of_two_robots_exactly_one_goes_first(one: Claim, two: Claim) -> None:
    if one.name != two.name:
        assert (one.rank < two.rank) != (two.rank < one.rank)


@given(st.lists(claims, min_size=3, max_size=6, unique_by=lambda claim: claim.name))
def test_no_ring_of_robots_waits_for_each_other(ring: list[Claim]) -> None:
    following = [*ring[1:], ring[0]]
    assert not all(one.rank < two.rank for one, two in zip(ring, following, strict=True))


def test_doors_and_narrow_corridors_are_narrow_and_walls_are_not() -> None:
    doors = passages_of(two_rooms(0.8))
    places = np.array([[4.0, 3.0], [2.0, 3.0], [2.0, 0.4], [0.4, 0.4], [3.0, 3.0]])
    assert doors.hold(places).tolist() == [True, False, False, False, False]
    walls = with_block(with_block(empty_room(), 2.5, 0.0, 3.0, 2.65), 2.5, 3.35, 3.0, 2.65)
    corridor = passages_of(walls)
    assert corridor.hold(np.array([[3.0, 3.0], [4.0, 3.0], [1.0, 3.0]])).tolist() == [
        True,
        True,
        False,
    ]
    assert len(corridor.on(line(1.0, 3.0, 7.0, 3.0))) == 1


def test_a_wide_way_is_no_passage() -> None:
    wide = passages_of(two_rooms(2.0))
    assert wide.on(line(2.0, 3.0, 6.0, 3.0)) == []
    assert must_wait(own(line(3.4, 3.0, 6.0, 3.0)), other(line(4.6, 3.0, 2.0, 3.0)), wide) is None


def test_at_a_door_the_nearer_one_goes_and_the_other_waits() -> None:
    doors = passages_of(two_rooms(0.8))
    near, far = line(3.2, 3.0, 6.0, 3.0), line(5.4, 3.0, 2.0, 3.0)
    assert must_wait(own(far), other(near), doors) == "at the door"
    assert must_wait(own(near), other(far), doors) is None
    # Names decide between two that are as near.
    as_near = line(4.8, 3.0, 2.0, 3.0)
    assert must_wait(own(as_near), other(near), doors) == "at the door"
    assert must_wait(own(near, "a"), other(as_near, "b"), doors) is None


def test_who_is_in_the_door_has_it_and_who_waits_goes_on_waiting() -> None:
    doors = passages_of(two_rooms(0.8))
    inside, before = line(4.0, 3.0, 6.0, 3.0), line(4.8, 3.0, 2.0, 3.0)
    assert must_wait(own(before, "a"), other(inside, "b"), doors) == "at the door"
    near, far = line(3.2, 3.0, 6.0, 3.0), line(5.3, 3.0, 2.0, 3.0)
    assert must_wait(own(near, "b", waited_s=5.0), other(far), doors) == "at the door"
    assert must_wait(own(far, "a"), other(near, "b", waited_s=5.0), doors) is None


def test_who_has_waited_for_long_goes_before_those_that_come_later() -> None:
    doors = passages_of(two_rooms(0.8))
    near, far = line(3.4, 3.0, 6.0, 3.0), line(4.7, 3.0, 2.0, 3.0)
    assert must_wait(own(far, "b", waited_s=30.0), other(near, "a"), doors) is None
    assert must_wait(own(near, "a"), other(far, "b", waited_s=30.0), doors) == "at the door"


def test_far_from_the_door_it_drives_on() -> None:
    doors = passages_of(two_rooms(0.8))
    far, nearer = line(1.0, 3.0, 6.0, 3.0), line(4.8, 3.0, 2.0, 3.0)
    assert must_wait(own(far), other(nearer), doors) is None


def test_a_robot_without_a_goal_claims_nothing() -> None:
    doors = passages_of(two_rooms(0.8))
    parked = Neighbour("a", Pose2D(4.0, 3.0, 0.0), RADIUS_M, np.empty((0, 2)), False, NO_TRACK)
    assert must_wait(own(line(3.2, 3.0, 6.0, 3.0)), parked, doors) is None


def test_face_to_face_one_of_the_two_steps_aside_after_a_while() -> None:
    mine, theirs = line(1.0, 1.0, 3.0, 1.0), line(1.8, 1.0, 0.0, 1.0)
    assert not must_step_aside(own(mine), other(theirs), 1.5)
    assert must_step_aside(own(mine, stood_s=2.0), other(theirs), 1.5)
    assert not must_step_aside(own(theirs, "a", stood_s=2.0), other(mine, "b"), 1.5)
