"""Motion from boards: clocks behind late arrivals, wheels with encoders."""

import math
from itertools import pairwise

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from trolley.config.hardware import WheelsConfig
from trolley.geometry import Pose2D, Twist2D
from trolley_base.drivers.boards.arrival_clock import MOST_BEHIND_NS, ArrivalClock
from trolley_base.drivers.boards.velocities import VelocityIntegrator
from trolley_base.drivers.boards.wheel_ticks import (
    FRAME_S,
    MOST_SPEED,
    Counts,
    TickTargets,
    WheelOdometry,
    ticks_per_m,
    wrapped,
)

MS = 1_000_000
WHEELS = WheelsConfig(ticks_per_revolution=1200.0, diameter_m=0.065, track_m=0.2)
COUNT = st.integers(-(2**31), 2**31 - 1)
STEPS = st.lists(st.tuples(st.integers(-60, 60), st.integers(-60, 60)), min_size=1, max_size=40)
MIRRORED = st.booleans()


def ignore(name: str, number: int) -> None:
    """Count nothing."""


def arrivals(period_ns: int, delays_ms: list[int]) -> list[int]:
    """When frames arrive that are late by chance; none overtakes another."""
    late: list[int] = []
    for k, delay in enumerate(delays_ms):
        late.append(max([k * period_ns + delay * MS, *late[-1:]]))
    return late


@given(st.integers(10 * MS, 120 * MS), st.lists(st.integers(0, 300), min_size=2, max_size=80))
def test_stamps_never_go_back_nor_beyond_arrival(period_ns: int, delays: list[int]) -> None:
    clock = ArrivalClock(50 * MS)
    came = arrivals(period_ns, delays)
    stamps = [clock.stamp(arrived) for arrived in came]
    assert all(a <= b for a, b in pairwise(stamps))
    for arrived, stamp in zip(came, stamps, strict=True):
        assert arrived - MOST_BEHIND_NS <= stamp <= arrived


@given(
    st.integers(49 * MS, 52 * MS),
    st.lists(st.sampled_from([0, 0, 5, 20, 60, 120]), min_size=200, max_size=200),
)
def test_late_frames_get_the_time_at_which_they_were_sent(
    period_ns: int, delays: list[int]
) -> None:
    # Among as many frames as the clock looks at, some come at once; so do the two before them,
    # since none overtakes a late one.
    delays = [0 if k % 10 in (0, 8, 9) else delay for k, delay in enumerate(delays)]
    clock = ArrivalClock(50 * MS)
    stamps = [clock.stamp(arrived) for arrived in arrivals(period_ns, delays)]
    for k in range(20, 200):
        assert abs(stamps[k] - k * period_ns) < 35 * MS


@given(st.lists(st.integers(0, 400), min_size=2, max_size=60), st.floats(-2, 2), st.floats(-3, 3))
def test_no_time_is_lost_between_velocities(delays: list[int], vx: float, wz: float) -> None:
    wheels = VelocityIntegrator(50 * MS, ignore)
    came = arrivals(50 * MS, delays)
    # A longer silence begins anew, on purpose.
    assume(all(b - a <= 500 * MS for a, b in pairwise(came)))
    found = [wheels.add(Twist2D(vx, 0.0, wz), arrived) for arrived in came]
    motions = [motion for motion in found if motion is not None]
    turned = sum(motion.previous_T_base.yaw for motion in motions)
    last_ns = motions[-1].stamp_ns if motions else came[0]
    assert turned == pytest.approx(wz * (last_ns - came[0]) * 1e-9, abs=1e-6)


@given(COUNT, COUNT, STEPS, MIRRORED, MIRRORED)
def test_driving_back_undoes_whatever_the_counters_wrap(
    left: int, right: int, steps: list[tuple[int, int]], mirror_left: bool, mirror_right: bool
) -> None:
    wheels = WheelsConfig(
        ticks_per_revolution=1200.0,
        diameter_m=0.065,
        track_m=0.2,
        reverse_left=mirror_left,
        reverse_right=mirror_right,
    )
    odometry = WheelOdometry(wheels, ignore)
    assert odometry.add(Counts(left, right, 0)) is None
    pose, now_ns = Pose2D.identity(), 0
    for dl, dr in steps + [(-dl, -dr) for dl, dr in reversed(steps)]:
        left, right, now_ns = wrapped(left + dl), wrapped(right + dr), now_ns + 50 * MS
        motion = odometry.add(Counts(left, right, now_ns))
        assert motion is not None
        pose = pose @ motion.previous_T_base
    assert pose.distance_to(Pose2D.identity()) < 1e-9
    assert abs(pose.yaw) < 1e-9


@given(st.floats(-0.5, 0.5), st.floats(-2.0, 2.0), MIRRORED, MIRRORED)
def test_targets_reach_the_velocity_on_average_however_slow(
    vx: float, wz: float, mirror_left: bool, mirror_right: bool
) -> None:
    wheels = WheelsConfig(
        ticks_per_revolution=360.0,
        diameter_m=0.065,
        track_m=0.2,
        reverse_left=mirror_left,
        reverse_right=mirror_right,
    )
    targets = TickTargets(wheels)
    sums = [0, 0]
    for _ in range(100):
        left, right = targets.of(Twist2D(vx, 0.0, wz))
        sums[0] += -left if mirror_left else left
        sums[1] += -right if mirror_right else right
    scale = 100 * FRAME_S * ticks_per_m(wheels)
    assert sums[0] == pytest.approx((vx - 0.1 * wz) * scale, abs=0.6)
    assert sums[1] == pytest.approx((vx + 0.1 * wz) * scale, abs=0.6)
    assert targets.of(Twist2D.zero()) == (0, 0)


@given(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3))
def test_targets_fit_an_int_of_the_board_and_keep_the_arc(vx: float, wz: float) -> None:
    fine = WheelsConfig(ticks_per_revolution=1e6, diameter_m=0.01, track_m=3.0)
    left, right = TickTargets(fine).of(Twist2D(vx, 0.0, wz))
    assert max(abs(left), abs(right)) < 2**15
    if max(abs(left), abs(right)) > 1000:
        exact = (vx - 1.5 * wz) * (right / 32766), (vx + 1.5 * wz) * (left / 32766)
        largest = max(abs(vx - 1.5 * wz), abs(vx + 1.5 * wz))
        assert exact[0] == pytest.approx(exact[1], abs=1e-3 * largest)


@given(st.integers(-(10**6), 10**6), st.integers(-(10**6), 10**6), COUNT)
def test_one_misread_count_moves_nothing(left: int, right: int, wrong: int) -> None:
    most = MOST_SPEED * ticks_per_m(WHEELS) * 0.1 + 2
    assume(abs(wrapped(wrong - left)) > most)
    counts: list[str] = []
    odometry = WheelOdometry(WHEELS, lambda name, number: counts.append(name))
    odometry.add(Counts(left, right, 0))
    assert odometry.add(Counts(wrong, right, 50 * MS)) is None
    assert odometry.has_jumped
    motion = odometry.add(Counts(left + 10, right + 10, 100 * MS))
    assert motion is not None
    assert motion.previous_T_base.x == pytest.approx(10 / ticks_per_m(WHEELS))
    assert counts == ["encoder_jumps"]
    assert not odometry.has_jumped


def test_the_arc_is_exact() -> None:
    """A quarter turn about a point 1 m to the left."""
    odometry = WheelOdometry(WHEELS, ignore)
    per_m = ticks_per_m(WHEELS)
    inner, outer = round(0.9 * math.pi / 2 * per_m), round(1.1 * math.pi / 2 * per_m)
    odometry.add(Counts(0, 0, 0))
    motion = odometry.add(Counts(inner, outer, 1000 * MS))
    assert motion is not None
    pose = motion.previous_T_base
    assert (pose.x, pose.y, pose.yaw) == pytest.approx((1.0, 1.0, math.pi / 2), abs=2e-3)
    assert motion.twist.vx == pytest.approx(math.pi / 2, abs=1e-3)


@pytest.mark.parametrize("gap_ms", [50, 700])
def test_a_board_that_counts_from_zero_again_has_not_moved(gap_ms: int) -> None:
    odometry = WheelOdometry(WHEELS, ignore)
    odometry.add(Counts(50_000, 40_000, 0))
    found = [odometry.add(Counts(k, k, (gap_ms + 50 * k) * MS)) for k in range(3)]
    restarted = [k for k, motion in enumerate(found) if motion is None]
    assert restarted in ([0], [0, 1])
    last = found[-1]
    assert last is not None
    assert last.previous_T_base.x == pytest.approx(1 / ticks_per_m(WHEELS))
