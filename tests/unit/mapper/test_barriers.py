"""Where the robot could not get on: the line that is taken for a wall."""

import numpy as np
import pytest

from trolley.geometry import Pose2D
from trolley.gridmap import FREE, OCCUPIED, GridMap
from trolley_mapper.explore.barriers import Barriers

AHEAD_M = 0.2
TOWARD = Pose2D(5.0, 0.0, 0.0)
NO_WALLS = GridMap("hall", 0.05, Pose2D(-2.0, -2.0, 0.0), np.full((200, 200), FREE, np.int8))


def test_a_stand_alone_is_no_barrier() -> None:
    barriers = Barriers()
    barriers.add(Pose2D(1.0, 0.0, 0.0), TOWARD, AHEAD_M, NO_WALLS)
    barriers.add(Pose2D(1.0, 4.0, 0.0), TOWARD, AHEAD_M, NO_WALLS)
    assert barriers.zones == []


def test_a_barrier_lies_across_the_way_beyond_where_the_robot_got_farthest() -> None:
    barriers = Barriers()
    for x in (0.5, 1.3, 1.0):
        barriers.update_position(Pose2D(x, 0.0, 0.0))
    barriers.update_position(Pose2D(4.0, 3.0, 0.0))  # elsewhere
    for _ in range(2):
        barriers.add(Pose2D(1.0, 0.0, 2.0), TOWARD, AHEAD_M, NO_WALLS)
    (zone,) = barriers.zones
    assert zone.kind == "mirror"
    assert [x for x, _ in zone.points] == pytest.approx([1.5, 1.5])
    assert zone.points[0][1] == -zone.points[1][1] != 0.0


def test_a_barrier_ends_at_a_wall_that_leaves_no_way_past_it() -> None:
    cells = NO_WALLS.cells.copy()
    cells[66] = OCCUPIED  # at y = 1.30 to 1.35, beyond the reach of half its width
    corridor = GridMap("corridor", 0.05, NO_WALLS.origin, cells)
    barriers = Barriers()
    for _ in range(2):
        barriers.add(Pose2D(1.0, 0.0, 0.0), TOWARD, AHEAD_M, corridor)
    (zone,) = barriers.zones
    right, left = (y for _, y in zone.points)
    assert left == pytest.approx(1.32, abs=0.03)
    assert right == pytest.approx(-0.8)
