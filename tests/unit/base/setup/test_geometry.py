"""Lidar and wheels from motions between stands, where the truth can be calculated."""

import math
from dataclasses import replace

import numpy as np
import pytest

from trolley.geometry import Pose2D, Twist2D, exp_twist
from trolley_base.drivers import MotionSample
from trolley_base.setup.geometry import Geometry, cut, fit, mirrored
from trolley_base.setup.record import Record, SetupRefused, Stand

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
