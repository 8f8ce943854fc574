"""Odometry at a moment between messages."""

import pytest

from trolley.geometry import Pose2D, Twist2D
from trolley.messages import Odometry
from trolley.odometry import is_covered, pose_at


def message(stamp_ms: int, x: float, vx: float = 1.0) -> Odometry:
    return Odometry(
        stamp_ns=stamp_ms * 1_000_000, pose=Pose2D(x, 0.0, 0.0), twist=Twist2D(vx, 0.0, 0.0)
    )


HISTORY = [message(100, 0.1), message(150, 0.15), message(200, 0.25)]


@pytest.mark.parametrize(
    ("stamp_ms", "x"), [(100, 0.1), (125, 0.125), (180, 0.21), (200, 0.25), (220, 0.27), (90, 0.09)]
)
def test_it_is_interpolated_or_carried_on(stamp_ms: int, x: float) -> None:
    pose = pose_at(HISTORY, stamp_ms * 1_000_000)
    assert pose is not None
    assert pose.x == pytest.approx(x)


def test_moments_too_far_away_have_none() -> None:
    assert pose_at([], 0) is None
    assert pose_at(HISTORY, 500_000_000) is None
    assert pose_at(HISTORY, -500_000_000) is None


def test_it_is_covered_by_a_message_from_then_or_later() -> None:
    assert is_covered(HISTORY, 200_000_000)
    assert not is_covered(HISTORY, 200_000_001)
    assert not is_covered([], 0)
