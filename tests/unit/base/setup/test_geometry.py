"""Lidar and wheels from motions between stands, where the truth can be calculated."""

import itertools
import math
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest

from trolley.geometry import Pose2D, Twist2D, exp_twist
from trolley_base.drivers import MotionSample
from trolley_base.setup.geometry import Geometry, Stretch, cut, fit, mirrored
from trolley_base.setup.record import Record, SetupRefused, Stand, Waypoint

HALF_TRACK_M = 0.1
LEFT, RIGHT, TRACK, PLAY_M = 0.95, 1.04, 1.1, 0.004
COURSE = [
    *[Twist2D(0.0, 0.0, 1.7)] * 4,
    *[Twist2D(0.0, 0.0, -1.7)] * 4,
    *[Twist2D(0.3, 0.0, 0.0), Twist2D(0.4, 0.0, 0.1), Twist2D(-0.8, 0.0, 0.0)] * 8,
]
"""What the wheels count between each two stands [m, rad]."""
STEPS = 40


class Treads:
    """Wheels with play: what the robot does of what they count."""

    def __init__(self) -> None:
        self._at = [0.0, 0.0]

    def move(self, counted: Twist2D) -> Pose2D:
        outward = HALF_TRACK_M * counted.wz
        moved: list[float] = []
        for wheel, way in enumerate((counted.vx - outward, counted.vx + outward)):
            wanted = self._at[wheel] + way
            self._at[wheel] = min(PLAY_M, max(0.0, wanted))
            moved.append(wanted - self._at[wheel])
        left, right = LEFT * moved[0], RIGHT * moved[1]
        turn = (right - left) / (2.0 * HALF_TRACK_M * TRACK)
        return exp_twist(Twist2D(0.5 * (left + right), 0.0, turn))


def record_of(base_T_laser: Pose2D, *, is_mirrored: bool, disturbed: int = -1) -> Record:
    record, treads = Record(), Treads()
    start_T_base, now_ns = Pose2D.identity(), 0

    def stand() -> None:
        pose = base_T_laser.inverse() @ start_T_base @ base_T_laser
        seen = mirrored(pose) if is_mirrored else pose
        record.stands.append(Stand(now_ns + 1, now_ns + 3, seen, np.empty(0, np.float32)))

    stand()
    for number, way in enumerate(COURSE):
        for _ in range(STEPS):
            now_ns += 10_000_000
            step = way.scaled(1.0 / STEPS)
            record.motions.append(MotionSample(now_ns, exp_twist(step), step))
            start_T_base = start_T_base @ treads.move(step)
        if number == disturbed:
            start_T_base = start_T_base @ Pose2D(0.3, -0.3, 0.4)
        stand()
    return record


def measured(base_T_laser: Pose2D, *, is_mirrored: bool) -> Geometry:
    return fit(cut(record_of(base_T_laser, is_mirrored=is_mirrored), HALF_TRACK_M))


@pytest.mark.parametrize("is_mirrored", [False, True])
@pytest.mark.parametrize(
    "mount", [Pose2D(0.1, 0.03, 0.2), Pose2D(-0.12, 0.0, math.pi - 0.01), Pose2D(0.0, 0.0, -1.6)]
)
def test_exact_stands_give_lidar_and_wheels_exactly(mount: Pose2D, *, is_mirrored: bool) -> None:
    found = measured(mount, is_mirrored=is_mirrored)
    assert found.is_mirrored is is_mirrored
    assert found.base_T_laser.distance_to(mount) < 5e-4
    assert abs(math.remainder(found.yaw.value - mount.yaw, 2.0 * math.pi)) < 5e-4
    assert found.left.value == pytest.approx(LEFT, rel=2e-3)
    assert found.right.value == pytest.approx(RIGHT, rel=2e-3)
    assert found.track.value == pytest.approx(TRACK, rel=2e-3)
    assert found.play.value == pytest.approx(PLAY_M, abs=1.5e-3)
    assert found.linear.value == pytest.approx(0.5 * (LEFT + RIGHT), rel=2e-3)
    assert found.angular.value == pytest.approx(0.5 * (LEFT + RIGHT) / TRACK, rel=2e-3)
    assert found.wheel_ratio.value == pytest.approx(RIGHT / LEFT, rel=2e-3)


def test_even_an_exact_drive_is_not_said_to_be_exact() -> None:
    found = measured(Pose2D(0.1, 0.0, 0.0), is_mirrored=False)
    assert 1e-3 < found.left.std < 2e-2
    assert 1e-4 < found.x.std < 5e-3


def test_a_push_in_the_middle_is_refused() -> None:
    record = record_of(Pose2D(0.1, 0.0, 0.0), is_mirrored=False, disturbed=10)
    with pytest.raises(SetupRefused, match="slipped, or somebody moved"):
        fit(cut(record, HALF_TRACK_M))


def test_without_a_turn_nothing_is_said() -> None:
    record = record_of(Pose2D(0.1, 0.0, 0.0), is_mirrored=False)
    record.stands[:] = record.stands[8:10]
    with pytest.raises(SetupRefused, match="has not turned"):
        fit(cut(record, HALF_TRACK_M))


def test_a_stand_that_saw_one_wall_only_tells_nothing_of_where_the_robot_was() -> None:
    mount = Pose2D(0.1, 0.03, 0.2)
    record = record_of(mount, is_mirrored=False)
    turned = record.stands[2]
    seen = Pose2D(turned.start_T_laser.x + 0.3, turned.start_T_laser.y, turned.start_T_laser.yaw)
    record.stands[2] = replace(turned, start_T_laser=seen)
    with pytest.raises(SetupRefused, match="slipped, or somebody moved"):
        fit(cut(record, HALF_TRACK_M))
    record.stands[2] = replace(turned, start_T_laser=seen, is_plain=True)
    found = fit(cut(record, HALF_TRACK_M))
    assert found.base_T_laser.distance_to(mount) < 1e-3
    assert found.left.value == pytest.approx(LEFT, rel=2e-3)


def test_a_castor_swings_round_where_the_robot_sets_off_after_a_turn_or_goes_back() -> None:
    record = record_of(Pose2D(0.1, 0.0, 0.0), is_mirrored=False)
    strokes = cut(record, HALF_TRACK_M).stretches[8:14]
    assert [stroke.swings for stroke in strokes] == [True, False, True, True, False, True]


ROUNDS = (Twist2D(0.5, 0.0, 1.1), Twist2D(0.5, 0.0, -1.1))


def with_rounds(
    base_T_laser: Pose2D,
    *,
    arcs: Sequence[Twist2D] = ROUNDS,
    seconds: float = 17.0,
    late_ns: int = 0,
    slip_m: float = 0.0,
) -> Record:
    """The course, and then three rounds on a circle each way, or other arcs.

    The lidar scans ten times a second, by a clock that is late.
    """
    record = record_of(base_T_laser, is_mirrored=False)
    now_ns, treads = record.motions[-1].stamp_ns, Treads()
    start_T_base = base_T_laser @ record.stands[-1].start_T_laser @ base_T_laser.inverse()
    rng = np.random.default_rng(1)

    def go(twist: Twist2D, seconds: float) -> None:
        nonlocal now_ns, start_T_base
        for _ in range(round(seconds * 100)):
            now_ns += 10_000_000
            step = twist.scaled(0.01)
            record.motions.append(MotionSample(now_ns, exp_twist(step), twist))
            start_T_base = start_T_base @ treads.move(step)
            slipped = slip_m * math.sqrt(abs(step.vx)) * float(rng.standard_normal())
            start_T_base = start_T_base @ Pose2D(slipped, 0.0, 0.0)
            if now_ns % 100_000_000 == 0:
                record.waypoints.append(Waypoint(now_ns + late_ns, lidar()))

    def lidar() -> Pose2D:
        return base_T_laser.inverse() @ start_T_base @ base_T_laser

    def stand() -> None:
        start_ns = now_ns
        go(Twist2D.zero(), 1.0)
        stand = Stand(start_ns + 200_000_000, now_ns, lidar(), np.empty(0, np.float32))
        record.stands.append(stand)

    stand()
    for arc in arcs:
        go(arc, seconds)
        stand()
    return record


def test_rounds_on_a_circle_show_the_wheels_though_they_end_where_they_began() -> None:
    mount = Pose2D(-0.1, 0.03, 2.0)
    found = fit(cut(with_rounds(mount), HALF_TRACK_M))
    strokes_alone = measured(mount, is_mirrored=False)
    assert found.left.value == pytest.approx(LEFT, rel=1e-3)
    assert found.right.value == pytest.approx(RIGHT, rel=1e-3)
    assert found.track.value == pytest.approx(TRACK, rel=1e-3)
    assert found.left.std < 0.8 * strokes_alone.left.std


def test_a_lidar_whose_clock_is_late_sees_the_same_circles() -> None:
    late = fit(cut(with_rounds(Pose2D(0.1, 0.0, 0.0), late_ns=40_000_000), HALF_TRACK_M))
    assert late.left.value == pytest.approx(LEFT, rel=1e-3)
    assert late.right.value == pytest.approx(RIGHT, rel=1e-3)
    assert late.track.value == pytest.approx(TRACK, rel=2e-3)
    assert abs(late.yaw.value) < math.radians(0.3)


def test_wheels_that_slip_are_known_as_well_as_is_said() -> None:
    found = fit(cut(with_rounds(Pose2D(0.1, 0.0, 0.0), slip_m=0.02), HALF_TRACK_M))
    assert abs(found.linear.value - 0.5 * (LEFT + RIGHT)) < 3.0 * found.linear.std
    assert found.linear.std < 0.006


@pytest.mark.parametrize(("num_wrong", "is_fitted"), [(2, True), (3, False)])
def test_a_piece_of_a_way_that_the_lidar_was_followed_wrongly_on_is_left_out(
    num_wrong: int, is_fitted: bool
) -> None:
    drive = cut(with_rounds(Pose2D(0.1, 0.0, 0.0)), HALF_TRACK_M)
    pieces = [index for index, one in enumerate(drive.stretches) if one.is_piece]
    for index in pieces[5 : 5 + 4 * num_wrong : 4]:
        right = drive.stretches[index]
        drive.stretches[index] = replace(right, seen=right.seen @ Pose2D(0.0, 0.1, 0.0))
    with nullcontext() if is_fitted else pytest.raises(SetupRefused, match="On one stretch"):
        assert fit(drive).left.value == pytest.approx(LEFT, rel=1e-3)


def test_pieces_of_a_long_way_leave_nothing_of_it_out() -> None:
    drive = cut(with_rounds(Pose2D(0.1, 0.0, 0.0)), HALF_TRACK_M)
    pieces = [one for one in drive.stretches if one.is_piece]
    assert len(pieces) == 34
    assert all(before.end_ns <= after.start_ns for before, after in itertools.pairwise(pieces))
    assert sum(one.way for one in pieces) == pytest.approx(2 * 17.0 * 0.5)
    assert sum(one.turn for one in pieces) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("turn", [3.3, -3.3, 2.0, -0.4])
def test_a_turn_of_more_than_half_a_round_is_not_taken_for_one_the_other_way(turn: float) -> None:
    seen = Pose2D(0.0, 0.0, 1.02 * turn)
    stretch = Stretch(0, 1, slice(0, 0), seen, 0.0, turn, swings=False)
    assert stretch.seen_turn == pytest.approx(1.02 * turn)


def test_an_arc_of_more_than_half_a_round_does_not_make_the_lidar_turn_the_other_way() -> None:
    # The wheels count 2.6 rad where the robot turns 3.4, which looks like -2.9.
    record = with_rounds(Pose2D(0.1, 0.0, 0.0), arcs=[Twist2D(0.5, 0.0, 0.5)] * 6, seconds=5.2)
    assert not cut(record, HALF_TRACK_M).is_mirrored
