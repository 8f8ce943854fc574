"""What becomes of walls on the map that keyframes see at a grazing angle, or edge on."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from trolley.scan_matching.sweep import read_sweep
from trolley.scanning import ScanInput
from trolley_mapper.slam.keyframe import Keyframe
from trolley_mapper.slam.occupancy_grid import LogOddsGrid

EDGE_M = 0.05
BEAMS = 360
RANGE_MAX = 8.0
NOISE_M = 0.015
TURN_RAD = 0.23
"""Walls lie askew to the cells: along them a wall is seen in the better of two rows."""

Line = tuple[tuple[float, float], tuple[float, float]]

ROOM: list[Line] = [
    ((-2.0, -2.0), (6.0, -2.0)),
    ((6.0, -2.0), (6.0, 2.0)),
    ((6.0, 2.0), (-2.0, 2.0)),
    ((-2.0, 2.0), (-2.0, -2.0)),
]
"""8 m x 4 m."""
CHIMNEY: list[Line] = [*ROOM, ((-1.4, 0.0), (-0.6, 0.0)), ((-0.6, 0.0), (-0.6, 2.0))]
"""The room with something that fills a part of it, of which the robot sees two sides."""
FRONT = 4
"""The side of 0.8 m."""


def turned(walls: list[Line]) -> NDArray[np.float64]:
    """Segments (n, 2, 2) [m], turned by TURN_RAD."""
    cos, sin = math.cos(TURN_RAD), math.sin(TURN_RAD)
    return np.array(walls) @ np.array([[cos, sin], [-sin, cos]])


def on_map(x: float, y: float, yaw: float = 0.0) -> Pose2D:
    """A pose in the room, turned like it."""
    return Pose2D(0.0, 0.0, TURN_RAD) @ Pose2D(x, y, yaw)


def look(walls: NDArray[np.float64], pose: Pose2D, number: int, beams: int = BEAMS) -> Keyframe:
    """A keyframe by a lidar in the middle of the robot."""
    rng = np.random.default_rng(number)
    increment = 2.0 * math.pi / beams
    angles = pose.yaw - math.pi + increment * np.arange(beams)
    toward = np.column_stack([np.cos(angles), np.sin(angles)])
    start, along = walls[:, 0] - [pose.x, pose.y], walls[:, 1] - walls[:, 0]
    cross = toward[:, None, 0] * along[:, 1] - toward[:, None, 1] * along[:, 0]
    cross = np.where(np.abs(cross) < 1e-9, 1e-9, cross)
    away = (start[:, 0] * along[:, 1] - start[:, 1] * along[:, 0]) / cross
    share = (start[:, 0] * toward[:, None, 1] - start[:, 1] * toward[:, None, 0]) / cross
    hit = (away > 0.0) & (share >= 0.0) & (share <= 1.0)
    ranges = np.where(hit, away, np.inf).min(axis=1) + NOISE_M * rng.standard_normal(beams)
    ranges = np.where(ranges > RANGE_MAX, np.inf, ranges).astype(np.float32)
    scan = ScanInput(
        number, ranges, -math.pi, increment, 0.1, RANGE_MAX,
        Pose2D.identity(), Pose2D.identity(), Pose2D.identity(),
    )  # fmt: skip
    return Keyframe.of(number, number, read_sweep(scan, RANGE_MAX))


def draw(occupancy: LogOddsGrid, walls: NDArray[np.float64], poses: list[Pose2D]) -> None:
    """Add a keyframe at each pose."""
    for number, pose in enumerate(poses):
        occupancy.add(look(walls, pose, number), pose.as_array())


def gap_m(grid: GridMap, wall: NDArray[np.float64]) -> float:
    """The widest gap in a wall on the map, which may lie 1.5 cells off [m]."""
    length = float(np.hypot(*(wall[1] - wall[0])))
    along, across = (wall[1] - wall[0]) / length, np.array([[0.0, -1.0], [1.0, 0.0]])
    steps = np.arange(0.0, length, 0.2 * EDGE_M)
    is_closed = np.zeros(len(steps), bool)
    for off in np.arange(-1.5, 1.51, 0.25) * EDGE_M:
        line = wall[0] + steps[:, None] * along + off * (across @ along)
        is_closed |= grid.values_at(line) == OCCUPIED
    widest = run = 0
    for closed in is_closed:
        run = 0 if closed else run + 1
        widest = max(widest, run)
    return widest * 0.2 * EDGE_M


def along_front(y: float, count: int = 12) -> list[Pose2D]:
    """Poses from which the chimney's front is seen along itself, or not at all."""
    return [on_map(0.3 * k, y) for k in range(1, count + 1)]


@pytest.mark.parametrize("y", [0.0, -0.01, -0.1, -0.2])
def test_a_wall_seen_squarely_stays_where_many_keyframes_look_along_it(y: float) -> None:
    occupancy, walls = LogOddsGrid(EDGE_M), turned(CHIMNEY)
    draw(occupancy, walls, [on_map(-1.0, -1.0), on_map(-0.8, -1.2), *along_front(y)])
    assert gap_m(occupancy.grid(), walls[FRONT]) <= 0.1


def test_a_wall_seen_once_at_a_grazing_angle_is_closed_and_stays() -> None:
    occupancy, walls = LogOddsGrid(EDGE_M), turned(CHIMNEY)
    draw(occupancy, walls, [on_map(0.0, -0.25)])
    assert gap_m(occupancy.grid(), walls[FRONT]) <= 0.1
    draw(occupancy, walls, [on_map(0.2 * k, 0.0) for k in range(1, 15)])
    assert gap_m(occupancy.grid(), walls[FRONT]) <= 0.2


def test_what_was_taken_away_is_cleared() -> None:
    occupancy = LogOddsGrid(EDGE_M)
    draw(occupancy, turned(CHIMNEY), [on_map(0.3 * k, -0.6) for k in range(4)])
    draw(occupancy, turned(ROOM), [on_map(1.2 - 0.2 * k, -1.2 + 0.16 * k) for k in range(16)])
    x, y = np.meshgrid(np.arange(-1.8, 0.0, 0.04), np.arange(-0.2, 1.8, 0.04))
    inside = on_map(0.0, 0.0).transform_points(np.column_stack([x.ravel(), y.ravel()]))
    assert np.all(occupancy.grid().values_at(inside) == FREE)


def test_where_the_map_begins_floor_that_the_lidar_does_not_look_at_is_free_until_it_does() -> None:
    # It looks ahead; a thing stands behind it.
    walls = turned([*ROOM, ((-0.3, -0.5), (-0.3, 0.5))])
    here = on_map(0.0, 0.0)
    whole = look(walls, here, 0)
    half = replace(whole, points=whole.points[90:270], normals=whole.normals[90:270])
    occupancy = LogOddsGrid(EDGE_M)
    occupancy.add(half, here.as_array())
    near, far, thing = (
        on_map(0.0, 0.0).transform_points(np.array([[x, 0.02]])) for x in (-0.2, -0.6, -0.3)
    )
    assert occupancy.grid().values_at(near) == FREE
    assert occupancy.grid().values_at(far) == UNKNOWN
    occupancy.add(look(walls, here, 1), here.as_array())
    assert occupancy.grid().values_at(thing) == OCCUPIED


@pytest.mark.parametrize("number", [0, 1])
def test_only_where_a_map_begins_and_the_lidar_does_not_look_is_floor_free_by_itself(
    number: int,
) -> None:
    walls = turned([*ROOM, ((-0.3, -0.5), (-0.3, 0.5))])
    keyframe = look(walls, on_map(0.0, 0.0), number)
    if number == 1:
        keyframe = replace(
            keyframe, points=keyframe.points[90:270], normals=keyframe.normals[90:270]
        )
    occupancy = LogOddsGrid(EDGE_M)
    occupancy.add(keyframe, on_map(0.0, 0.0).as_array())
    hidden = on_map(-0.4 if number == 0 else -0.2, 0.02)
    grid = occupancy.grid()
    assert grid.values_at(hidden.as_array()[None, :2]) == UNKNOWN


@pytest.mark.parametrize("beyond", [[], [((-1.0, 4.0), (3.0, 4.0))]], ids=["far", "near"])
def test_a_door_seen_at_a_grazing_angle_is_not_walled_up(beyond: list[Line]) -> None:
    with_door = [*ROOM[:2], ((6.0, 2.0), (1.4, 2.0)), ((0.7, 2.0), (-2.0, 2.0)), ROOM[3], *beyond]
    occupancy = LogOddsGrid(EDGE_M)
    draw(occupancy, turned(with_door), [on_map(4.5 - 0.3 * k, 1.3) for k in range(10)])
    across = on_map(0.0, 0.0).transform_points(
        np.column_stack([np.arange(0.85, 1.25, 0.05), np.full(8, 2.0)])
    )
    assert not np.any(occupancy.grid().values_at(across) == OCCUPIED)


def test_nothing_is_drawn_that_is_seen_through_a_mirror() -> None:
    walls = turned([*ROOM[:2], ((6.0, 2.0), (1.4, 2.0)), ((0.7, 2.0), (-2.0, 2.0)), ROOM[3]])
    seen_in_it = np.concatenate([walls, turned([((-1.0, 4.0), (3.0, 4.0))])])
    ends = on_map(0.0, 0.0).transform_points(np.array([[0.7, 2.0], [1.4, 2.0]]))
    grids: list[GridMap] = []
    for mirrors in (np.empty((0, 4)), ends.reshape(1, 4)):
        occupancy = LogOddsGrid(EDGE_M, mirrors=mirrors)
        draw(occupancy, seen_in_it, [on_map(0.3 * k, -1.0) for k in range(6)])
        grids.append(occupancy.grid())
    x, y = np.meshgrid(np.arange(-2.0, 3.0, 0.05), np.arange(2.3, 4.2, 0.05))
    beyond = on_map(0.0, 0.0).transform_points(np.column_stack([x.ravel(), y.ravel()]))
    assert np.count_nonzero(grids[0].values_at(beyond) >= 0) > 500
    assert np.all(grids[1].values_at(beyond) < 0)
    assert gap_m(grids[1], walls[3]) <= 0.1
    x, y = np.meshgrid(np.arange(0.75, 1.35, 0.05), np.arange(1.0, 1.9, 0.05))
    ahead = on_map(0.0, 0.0).transform_points(np.column_stack([x.ravel(), y.ravel()]))
    assert np.all(grids[1].values_at(ahead) == FREE)


@pytest.mark.parametrize("edge_m", [0.01, 0.02, 0.03, 0.05, 0.1])
@pytest.mark.parametrize("yaw", [0.0, 0.3, 0.25 * math.pi])
@pytest.mark.parametrize("xy", [(0.0, 0.0), (0.013, -0.021)])
def test_a_map_that_is_extended_keeps_its_walls_whatever_its_cells(
    edge_m: float, yaw: float, xy: tuple[float, float]
) -> None:
    cells = np.full((round(2.0 / edge_m),) * 2, FREE, np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = OCCUPIED
    prior = GridMap("room", edge_m, Pose2D(*xy, yaw), cells)
    grid = LogOddsGrid(EDGE_M, prior).grid()
    corners = prior.cell_to_world(np.array([[0, 0], [0, -1], [-1, -1], [-1, 0]]) % len(cells))
    for side in np.stack([corners, np.roll(corners, -1, axis=0)], axis=1):
        assert gap_m(grid, side) < EDGE_M
    floor = prior.world_to_grid(grid.cell_to_world(np.argwhere(grid.cells == FREE)))
    clear_m = edge_m + EDGE_M
    inside = (floor > clear_m).all(axis=1) & (floor < prior.size_m[0] - clear_m).all(axis=1)
    assert inside.sum() == pytest.approx((2.0 - 2.0 * clear_m) ** 2 / EDGE_M**2, rel=0.06)


@pytest.mark.parametrize("shift_m", [0.0, 0.013, 0.04])
def test_a_map_with_cells_of_the_same_size_is_extended_as_it_is(shift_m: float) -> None:
    cells = np.random.default_rng(7).choice(np.array([UNKNOWN, FREE, OCCUPIED], np.int8), (40, 60))
    prior = GridMap("noise", EDGE_M, Pose2D(-1.0 + shift_m, 2.0 + shift_m, 0.0), cells)
    grid = LogOddsGrid(EDGE_M, prior).grid()
    assert np.array_equal(grid.cells, cells)
