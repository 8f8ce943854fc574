"""Where the robot could not get on: the line that is taken for a wall."""

import pytest

from trolley.geometry import Pose2D
from trolley_mapper.explore.barriers import Barriers

AHEAD_M = 0.2
TOWARD = Pose2D(5.0, 0.0, 0.0)


def test_a_stand_alone_is_no_barrier() -> None:
    barriers = Barriers()
    barriers.add(Pose2D(1.0, 0.0, 0.0), TOWARD, AHEAD_M)
    barriers.add(Pose2D(1.0, 4.0, 0.0), TOWARD, AHEAD_M)
    assert barriers.zones == []


def test_a_barrier_lies_across_the_way_beyond_where_the_robot_got_farthest() -> None:
    barriers = Barriers()
    for x in (0.5, 1.3, 1.0):
        barriers.update_position(Pose2D(x, 0.0, 0.0))
    barriers.update_position(Pose2D(4.0, 3.0, 0.0))  # elsewhere
    for _ in range(2):
        barriers.add(Pose2D(1.0, 0.0, 2.0), TOWARD, AHEAD_M)
    (zone,) = barriers.zones
    assert zone.kind == "mirror"
    assert [x for x, _ in zone.points] == pytest.approx([1.5, 1.5])
    assert zone.points[0][1] == -zone.points[1][1] != 0.0
