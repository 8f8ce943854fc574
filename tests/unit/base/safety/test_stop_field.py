import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from support.cases import cases

from trolley.geometry import (
    Twist2D,
    footprint_from_box,
    footprint_from_radius,
    polygon_contains,
)
from trolley_base.safety.braking import PARAMS as BRAKING
from trolley_base.safety.motion_limits import MotionLimits
from trolley_base.safety.stop_field import PARAMS, StopField
from trolley_base.safety.touching import closest_on_outline

pytestmark = pytest.mark.drives

LIMITS = MotionLimits(
    speed=0.5, wz=1.5, acceleration=0.8, deceleration=1.0, angular_acceleration=4.0
)
FOOTPRINT = footprint_from_box(0.4, 0.2)
FIELD = StopField(FOOTPRINT, LIMITS, 0.05)
"""One that is told of no commands, and so remembers nothing."""
GRAZE = 0.004
WIDER, NARROWER = (
    StopField(footprint_from_box(0.4 + 2.0 * more, 0.2 + 2.0 * more), LIMITS, 0.05)
    for more in (GRAZE, -GRAZE)
)
"""Ways to standing are sampled: what they pass within some millimetres they meet or not."""
AHEAD, BACK = Twist2D(0.4, 0.0, 0.0), Twist2D(-0.4, 0.0, 0.0)
LEFT, RIGHT = Twist2D(0.0, 0.0, 1.0), Twist2D(0.0, 0.0, -1.0)


@pytest.fixture
def field() -> StopField:
    """Of a robot of 0.4 x 0.2 m that stops 0.05 m short."""
    return StopField(footprint_from_box(0.4, 0.2), LIMITS, 0.05)


def wall_ahead(gap: float) -> NDArray[np.float64]:
    """A wall across, `gap` before the front."""
    y = np.linspace(-1.0, 1.0, 201)
    return np.stack([np.full(201, 0.2 + gap), y], axis=1)


def wall_left(gap: float) -> NDArray[np.float64]:
    x = np.linspace(-1.0, 1.0, 201)
    return np.stack([x, np.full(201, 0.1 + gap)], axis=1)


def test_nothing_near_leaves_everything_as_it_is(field: StopField) -> None:
    assert field.scale(AHEAD, np.empty((0, 2))) == 1.0
    assert field.scale(AHEAD, wall_ahead(3.0)) == 1.0


def way_of(speed: float) -> float:
    """One period of base, then even braking."""
    return speed * BRAKING.period_s + speed * speed / 2.0


STEP = 0.4 / 80.0
"""Two speeds that the field tells apart."""


def test_the_scaled_speed_brakes_to_the_margin(field: StopField) -> None:
    for gap in (0.06, 0.08, 0.1, 0.13):
        speed = 0.4 * field.scale(AHEAD, wall_ahead(gap))
        assert way_of(speed) <= gap - 0.05
        assert (1.0 + PARAMS.per_metre) * way_of(speed + STEP) > gap - 0.05


def test_what_is_under_way_is_driven_before_it_brakes() -> None:
    field = StopField(footprint_from_box(0.4, 0.2), LIMITS, 0.05, delay_s=0.3)
    for _ in range(30):
        field.follow(Twist2D(0.3, 0.0, 0.0), 0.02)
    under_way = 0.3 * (0.3 + PARAMS.lag_s)
    # Wheels that slow down as late and as little as they may still drive 0.3 m/s less 0.02 m/s.
    for gap in (0.1, 0.3, 1.0):
        is_free = way_of(0.3) + under_way < gap - 0.05
        assert (field.scale(Twist2D(0.3, 0.0, 0.0), wall_ahead(gap)) == 1.0) == is_free


def test_on_a_slope_it_brakes_earlier() -> None:
    level = StopField(footprint_from_box(0.4, 0.2), LIMITS, 0.05)
    slope = StopField(footprint_from_box(0.4, 0.2), replace(LIMITS, slope=0.05), 0.05)
    wall = wall_ahead(0.1)
    assert 0.6 < slope.scale(AHEAD, wall) / level.scale(AHEAD, wall) < 0.8


def test_a_turn_that_may_end_early_must_not_lead_straight_into_something() -> None:
    limits = replace(LIMITS, speed=1.5)
    field = StopField(footprint_from_box(0.4, 0.2), limits, 0.05)
    fast = Twist2D(1.5, 0.0, 1.5)
    beside_the_arc = np.array([[1.1, -0.05]])
    assert field.scale(fast, beside_the_arc) < 1.0
    assert field.scale(fast, np.array([[1.1, -0.5]])) == 1.0


def test_at_the_margin_only_what_does_not_lead_on_is_allowed(field: StopField) -> None:
    wall = wall_ahead(0.05)
    assert field.scale(AHEAD, wall) == 0.0
    assert field.scale(Twist2D(0.3, 0.0, 0.2), wall) < 0.05
    assert field.scale(BACK, wall) == 1.0
    assert field.scale(Twist2D(-0.3, 0.0, 0.5), wall) == 1.0


def test_a_drive_along_a_wall_is_allowed_at_any_distance(field: StopField) -> None:
    for gap in (0.05, 0.1):
        assert field.scale(AHEAD, wall_left(gap)) == 1.0
        assert field.scale(BACK, wall_left(gap)) == 1.0
    slower = [field.scale(AHEAD, wall_left(gap)) for gap in (0.001, 0.003, 0.01, 0.02)]
    assert slower == sorted(slower)
    assert slower[0] > 0.1


def test_a_turn_in_place_must_not_sweep_a_corner_into_an_echo(field: StopField) -> None:
    post = np.array([[0.205, -0.06]])  # before the front, within the corners' circle of 0.224
    assert field.scale(LEFT, post) == 0.0
    assert field.scale(RIGHT, post) == 1.0, "the far corner is a long way off"
    assert field.scale(LEFT, np.array([[0.25, -0.06]])) == 1.0
    assert field.scale(RIGHT, wall_left(0.02)) == 0.0


def test_after_a_stop_before_a_wall_it_may_turn_clear(field: StopField) -> None:
    # Its corners stick out 0.024 beyond its front, less than where it stopped.
    assert field.scale(LEFT, wall_ahead(0.05)) == 1.0
    assert field.scale(RIGHT, wall_ahead(0.05)) == 1.0


def test_a_round_robot_turns_anywhere() -> None:
    field = StopField(footprint_from_radius(0.2), LIMITS, 0.05)
    for gap in (0.02, 0.05):
        angles = np.linspace(-math.pi, math.pi, 90)
        ring = (0.204 + gap) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        assert field.scale(LEFT, ring) == 1.0


def test_the_farther_a_round_robot_drives_the_more_room_it_needs_beside_it() -> None:
    field = StopField(footprint_from_radius(0.2), replace(LIMITS, speed=1.5), 0.05)
    fast, beside_m = Twist2D(1.5, 0.0, 0.0), 0.2 + PARAMS.side_margin_m + 0.02
    assert field.scale(fast, np.array([[0.3, beside_m]])) == 1.0
    assert field.scale(fast, np.array([[0.9, beside_m]])) < 1.0


def test_the_own_body_is_not_an_obstacle_but_what_touches_is(field: StopField) -> None:
    mast = np.array([[0.2 - PARAMS.body_depth_m - 0.01, 0.0]])
    touching = np.array([[0.2 - 0.5 * PARAMS.body_depth_m, 0.0]])
    assert field.scale(AHEAD, mast) == 1.0
    assert field.scale(AHEAD, touching) == 0.0
    assert field.scale(BACK, touching) == 1.0


def test_without_a_margin_it_still_stops_before_the_echo() -> None:
    field = StopField(footprint_from_box(0.4, 0.2), LIMITS, 0.0)
    assert field.scale(AHEAD, wall_ahead(0.0)) == 0.0
    assert 0.0 < field.scale(AHEAD, wall_ahead(0.01)) < 0.5


clouds = st.lists(
    st.tuples(st.floats(-0.8, 0.8), st.floats(-0.8, 0.8)), min_size=1, max_size=30
).map(lambda rows: np.array(rows))
twists = st.builds(Twist2D, st.floats(-0.5, 0.5), st.just(0.0), st.floats(-1.5, 1.5))


@given(cloud=clouds, twist=twists)
def test_the_scale_is_a_share_and_more_echoes_never_raise_it(
    cloud: NDArray[np.float64], twist: Twist2D
) -> None:
    scale = FIELD.scale(twist, cloud)
    assert 0.0 <= scale <= 1.0
    # What stands beside the robot already makes its outline narrower for all echoes.
    outside = cloud[~polygon_contains(FOOTPRINT, cloud)]
    gaps = np.linalg.norm(outside - closest_on_outline(outside, FOOTPRINT), axis=1)
    assume(bool(np.all(gaps > 1.5 * PARAMS.side_margin_m)))
    assert scale <= FIELD.scale(twist, cloud[: len(cloud) // 2]) + 1e-12


@given(cloud=clouds, twist=twists)
@example(cloud=np.array([[0.0, 0.125]]), twist=Twist2D(0.0, 0.0, 2.2e-311))
@example(cloud=np.array([[0.125, 0.140625]]), twist=Twist2D(-0.375, 0.0, 1.5))
def test_a_slower_drive_of_the_same_arc_comes_as_far_as_the_faster(
    cloud: NDArray[np.float64], twist: Twist2D
) -> None:
    cloud = cloud[~polygon_contains(footprint_from_box(0.4 + 2 * GRAZE, 0.2 + 2 * GRAZE), cloud)]
    least, most = (min(0.5, field.scale(twist, cloud)) for field in (WIDER, NARROWER))
    slow = 0.5 * FIELD.scale(twist.scaled(0.5), cloud)
    # Two parts of a command that the field tells apart, of the whole and of the half.
    apart = 0.03
    assert least - apart <= slow <= most + apart


@pytest.mark.parametrize("turn", [0.0, -1.0])
def test_wheels_that_follow_sooner_than_the_longest_delay_are_reckoned_with(turn: float) -> None:
    field = StopField(footprint_from_box(0.4, 0.2), LIMITS, 0.05, delay_s=0.3)
    for _ in range(10):
        field.follow(Twist2D(0.4, 0.0, 0.0) if turn == 0.0 else Twist2D(0.0, 0.0, turn), 0.02)
    for _ in range(6):
        field.follow(Twist2D(-0.4, 0.0, turn), 0.02)
    # With the longest delay it first goes on as before, and does not come as far back.
    post = np.array([[-0.33, 0.0]])
    assert field.scale(Twist2D(-0.4, 0.0, turn), post) < 1.0


class LooksEverywhere(StopField):
    """One that leaves nothing out beforehand."""

    def _box(self, twist: Twist2D) -> tuple[float, float, float]:
        del twist
        return math.inf, math.inf, math.inf


@settings(max_examples=cases(40))
@given(seed=st.integers(0, 2**32 - 1), is_sideways=st.booleans())
def test_what_is_left_out_beforehand_could_not_matter(seed: int, is_sideways: bool) -> None:
    rng = np.random.default_rng(seed)
    fields = [kind(FOOTPRINT, LIMITS, 0.05, 0.15) for kind in (StopField, LooksEverywhere)]
    twist = Twist2D.zero()
    for _ in range(10):
        if rng.random() < 0.2:
            vy = float(rng.uniform(-0.3, 0.3)) if is_sideways else 0.0
            twist = Twist2D(float(rng.uniform(-0.4, 0.4)), vy, float(rng.uniform(-1.5, 1.5)))
            if rng.random() < 0.3:
                twist = Twist2D(twist.vx, twist.vy, 0.0)
        points = rng.uniform(-1.0, 1.0, (int(rng.integers(1, 60)), 2))
        ours, theirs = (field.scale(twist, points) for field in fields)
        assert ours == theirs
        for field in fields:
            field.follow(twist, 0.02)
