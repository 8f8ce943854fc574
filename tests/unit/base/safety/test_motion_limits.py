import pytest
from hypothesis import given
from hypothesis import strategies as st

from trolley.geometry import Twist2D
from trolley_base.safety.motion_limits import MotionLimits, ramp, within

LIMITS = MotionLimits(
    speed=0.5, wz=1.5, acceleration=0.8, deceleration=1.0, angular_acceleration=4.0
)
twists = st.builds(Twist2D, st.floats(-0.5, 0.5), st.just(0.0), st.floats(-1.5, 1.5))


def test_too_fast_is_driven_slower_on_the_same_arc() -> None:
    assert within(Twist2D(1.0, 0.0, 1.0), LIMITS) == Twist2D(0.5, 0.0, 0.5)
    assert within(Twist2D(0.2, 0.0, -3.0), LIMITS) == Twist2D(0.1, 0.0, -1.5)


def test_what_is_within_stays_as_it_is() -> None:
    assert within(Twist2D(-0.5, 0.0, 1.5), LIMITS) == Twist2D(-0.5, 0.0, 1.5)


def test_sideways_needs_wheels_for_it() -> None:
    assert within(Twist2D(0.1, 0.2, 0.0), LIMITS) == Twist2D(0.1, 0.0, 0.0)
    mecanum = MotionLimits(0.5, 1.5, 0.8, 1.0, 4.0, sideways=True)
    assert within(Twist2D(0.0, 1.0, 0.0), mecanum) == Twist2D(0.0, 0.5, 0.0)


@given(st.floats(-1e308, 1e308), st.floats(-1e308, 1e308), st.floats(-1e308, 1e308))
def test_any_finite_command_ends_within_the_limits(vx: float, vy: float, wz: float) -> None:
    limited = within(Twist2D(vx, vy, wz), LIMITS)
    assert limited.speed <= 0.5 * (1 + 1e-12)
    assert abs(limited.wz) <= 1.5 * (1 + 1e-12)


@pytest.mark.parametrize("slowest", [5e-324, 1e-310, 1e-9])
def test_what_moves_nothing_is_to_stand(slowest: float) -> None:
    assert within(Twist2D(slowest, 0.0, -slowest), LIMITS).is_zero
    assert within(Twist2D(0.0, 0.0, slowest), LIMITS).is_zero
    assert not within(Twist2D(1e-4, 0.0, 0.0), LIMITS).is_zero
    assert not within(Twist2D(0.0, 0.0, -1e-4), LIMITS).is_zero


def test_setting_off_braking_and_turning_have_their_own_rates() -> None:
    stand, ahead = Twist2D(0.0, 0.0, 0.0), Twist2D(0.5, 0.0, 0.0)
    assert ramp(stand, ahead, LIMITS, 0.1).vx == pytest.approx(0.08)
    assert ramp(ahead, stand, LIMITS, 0.1).vx == pytest.approx(0.4)
    assert ramp(stand, Twist2D(0.0, 0.0, 1.5), LIMITS, 0.1).wz == pytest.approx(0.4)


def test_setting_off_begins_on_the_wanted_arc() -> None:
    begun = ramp(Twist2D(0.0, 0.0, 0.0), Twist2D(0.4, 0.0, 0.6), LIMITS, 0.02)
    assert begun.wz / begun.vx == pytest.approx(1.5)


@given(twists, twists, st.floats(0.001, 0.1))
def test_no_part_changes_faster_than_allowed(now: Twist2D, wanted: Twist2D, dt: float) -> None:
    after = ramp(now, wanted, LIMITS, dt)
    assert abs(after.vx - now.vx) <= 1.0 * dt + 1e-12
    assert abs(after.wz - now.wz) <= 4.0 * dt + 1e-12
    assert min(now.vx, wanted.vx) - 1e-12 <= after.vx <= max(now.vx, wanted.vx) + 1e-12


@given(twists, twists)
def test_the_wanted_velocity_is_reached(now: Twist2D, wanted: Twist2D) -> None:
    for _ in range(200):
        now = ramp(now, wanted, LIMITS, 0.02)
    assert now == wanted
