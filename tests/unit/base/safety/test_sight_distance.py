import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trolley import sight
from trolley.geometry import Twist2D, footprint_from_box
from trolley_base.safety.motion_limits import MotionLimits
from trolley_base.safety.observed_space import ALL_SEEN, Unseen
from trolley_base.safety.sight_distance import CLEAR, PARAMS, SightDistance

LIMITS = MotionLimits(
    speed=0.5, wz=1.5, acceleration=0.8, deceleration=1.0, angular_acceleration=4.0, sideways=True
)
FOOTPRINT = footprint_from_box(0.4, 0.2)
SIGHT = SightDistance(FOOTPRINT, LIMITS, 0.06)
FAST = Twist2D(0.5, 0.0, 0.0)


def cells(x: float, y: float, width: float = 0.4, *, may_creep: bool = False) -> Unseen:
    """Cells of a square whose middle is there."""
    along = np.arange(-0.5 * width, 0.5 * width + 0.01, 0.05)
    points = np.stack([axis.ravel() for axis in np.meshgrid(x + along, y + along)], axis=1)
    return Unseen(points, np.full(len(points), may_creep), np.full(len(points), False))


def test_where_all_was_seen_it_drives_as_it_likes() -> None:
    assert SIGHT.look(FAST, ALL_SEEN, by_hand=False) == CLEAR
    assert SIGHT.look(Twist2D.zero(), cells(0.3, 0.0), by_hand=False) == CLEAR


def test_what_lies_beyond_the_stopping_distance_or_beside_the_way_does_not_matter() -> None:
    assert SIGHT.look(FAST, cells(1.5, 0.0), by_hand=False) == CLEAR
    assert SIGHT.look(FAST, cells(0.3, 0.5), by_hand=False) == CLEAR
    assert SIGHT.look(FAST, cells(-0.5, 0.0), by_hand=False) == CLEAR


def test_before_what_was_not_seen_a_program_stops_and_a_hand_creeps() -> None:
    unseen = cells(0.45, 0.0)
    held = SIGHT.look(FAST, unseen, by_hand=False)
    assert held.where == "ahead"
    assert held.scale == pytest.approx(0.0, abs=1e-9)
    creeps = SIGHT.look(FAST, unseen, by_hand=True)
    assert FAST.speed * creeps.scale == pytest.approx(sight.SIGHT.creep_mps)
    assert SIGHT.is_creeping(FAST.scaled(creeps.scale))


def test_farther_away_it_drives_so_fast_that_it_can_stop_there() -> None:
    unseen = cells(0.6, 0.0)  # 0.2 m before the edge, less the margin
    look = SIGHT.look(FAST, unseen, by_hand=False)
    speed = FAST.speed * look.scale
    way = 0.06 * speed + 0.5 * speed * speed
    assert way == pytest.approx(0.2 - PARAMS.margin_m, abs=0.01)


@given(st.floats(0.1, 3.0), st.floats(0.0, 0.2), st.floats(0.0, 0.5), st.floats(0.06, 2.0))
def test_whatever_its_brakes_a_program_stops_just_before_what_was_not_seen(
    deceleration: float, slope: float, delay_s: float, gap_m: float
) -> None:
    limits = MotionLimits(0.5, 1.5, 0.8, deceleration, 4.0, slope=slope)
    never = np.array([False])
    unseen = Unseen(np.array([[0.2 + gap_m, 0.0]]), never, never)
    look = SightDistance(FOOTPRINT, limits, delay_s).look(FAST, unseen, by_hand=False)
    speed = FAST.speed * look.scale
    way = delay_s * speed + 0.5 * speed * speed / limits.downhill_deceleration
    assert way <= gap_m - PARAMS.margin_m + 1e-9
    assert look == CLEAR or way == pytest.approx(gap_m - PARAMS.margin_m)


@pytest.mark.parametrize(
    ("twist", "x", "y", "where"),
    [
        (Twist2D(-0.5, 0.0, 0.0), -0.45, 0.0, "behind"),
        (Twist2D(0.0, 0.4, 0.0), 0.0, 0.35, "to the left"),
        (Twist2D(0.0, -0.4, 0.0), 0.0, -0.35, "to the right"),
    ],
)
def test_it_says_where_it_did_not_see(twist: Twist2D, x: float, y: float, where: str) -> None:
    look = SIGHT.look(twist, cells(x, y), by_hand=False)
    assert look.where == where
    assert look.scale == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("by_hand", [True, False])
def test_what_was_free_a_while_ago_is_driven_into_at_a_creep_whoever_drives(by_hand: bool) -> None:
    unseen = cells(-0.45, 0.0, may_creep=True)
    backing = Twist2D(-0.5, 0.0, 0.0)
    look = SIGHT.look(backing, unseen, by_hand=by_hand)
    assert look.where == "behind"
    assert backing.speed * look.scale == pytest.approx(sight.SIGHT.creep_mps)
    turning = Twist2D(0.0, 0.0, 1.5)
    assert SIGHT.look(turning, cells(-0.1, 0.32, may_creep=True), by_hand=by_hand) == CLEAR


def test_what_was_never_seen_holds_a_program_though_what_lies_before_it_was_free() -> None:
    may_creep, never = cells(0.45, 0.0, may_creep=True), cells(0.45, 0.1)
    both = Unseen(
        np.concatenate([may_creep.points, never.points]),
        np.concatenate([may_creep.may_creep, never.may_creep]),
        np.concatenate([may_creep.was_echo, never.was_echo]),
    )
    assert SIGHT.look(FAST, both, by_hand=False).scale == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("by_hand", [True, False])
def test_corners_that_swing_out_creep_whoever_drives(by_hand: bool) -> None:
    unseen = cells(-0.1, 0.32)
    turn = SIGHT.look(Twist2D(0.0, 0.0, 1.5), unseen, by_hand=by_hand)
    assert turn.where == "beside the robot"
    # With the energy of a creep straight on: I w^2 = m v^2, where I = m (0.4^2 + 0.2^2) / 12.
    gyration_m = math.hypot(0.4, 0.2) / math.sqrt(12.0)
    assert 1.5 * turn.scale * gyration_m == pytest.approx(sight.SIGHT.creep_mps)
    arc = SIGHT.look(Twist2D(0.3, 0.0, -1.0), unseen, by_hand=by_hand)
    assert 0.0 < arc.scale < 1.0


def test_a_side_comes_softly_to_what_was_never_seen_while_a_program_drives_on() -> None:
    backing = Twist2D(-0.06, 0.0, -0.23)  # its left side swings out, behind what the lidar saw
    unseen = Unseen(np.array([[-0.14, 0.16]]), np.array([False]), np.array([False]))
    look = SIGHT.look(backing, unseen, by_hand=False)
    assert 0.14 * 0.23 * look.scale == pytest.approx(PARAMS.soft)
    assert look.where == "beside the robot"
    may_creep = unseen._replace(may_creep=np.array([True]))
    assert SIGHT.look(backing, may_creep, by_hand=False) == CLEAR
    in_place, all_but = Twist2D(0.0, 0.0, -0.23), Twist2D(0.001, 0.0, -0.23)
    for twist, by_hand in ((backing, True), (in_place, False), (all_but, False)):
        assert SIGHT.look(twist, unseen, by_hand=by_hand).scale > 2.0 * look.scale


def test_a_corner_comes_softly_to_where_something_stood_also_as_it_turns_in_place() -> None:
    turning = Twist2D(0.0, 0.0, 1.3)
    never = Unseen(np.array([[-0.1, -0.15]]), np.array([False]), np.array([False]))
    bucket = never._replace(was_echo=np.array([True]))
    assert SIGHT.look(turning, never, by_hand=True) == SIGHT.look(turning, bucket, by_hand=True)
    look = SIGHT.look(turning, bucket, by_hand=False)
    assert 0.1 * turning.wz * look.scale == pytest.approx(PARAMS.soft)
    assert look.scale < 0.3 * SIGHT.look(turning, never, by_hand=False).scale
    assert SIGHT.look(Twist2D(0.0, 0.0, -1.3), bucket, by_hand=False).scale > 3.0 * look.scale


def test_backing_in_a_curve_into_what_was_not_seen_is_held() -> None:
    look = SIGHT.look(Twist2D(-0.2, 0.0, 0.3), cells(-0.45, 0.0), by_hand=False)
    assert look.where == "behind"
    assert look.scale < 0.2
