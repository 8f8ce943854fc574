"""Distances between the robot's outline and what is solid, against a slow and obvious twin."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley_base.world.gaps import Things, gaps_into, place_outline_into
from trolley_base.world.scene import build_walls, polyline

FOOTPRINT = np.array([[0.2, -0.12], [0.15, 0.12], [-0.15, 0.12], [-0.15, -0.12]])
AROUND = np.array([0.025, 0.0, 0.22])
NOTHING = Things(np.empty((0, 4)), np.empty(0, np.int64), np.empty((0, 3)), np.empty(0, np.int64))


def clearance(grid: GridMap, pose: Pose2D, things: Things = NOTHING, bodies: int = 1) -> float:
    outline = np.empty_like(FOOTPRINT)
    place_outline_into(outline, FOOTPRINT, pose.x, pose.y, pose.yaw)
    centre = pose.transform_points(AROUND[None, :2])[0]
    gaps, touches = np.empty(bodies), np.empty((bodies, 4))
    circle = np.array([*centre, AROUND[2]])
    return gaps_into(gaps, touches, outline, circle, build_walls(grid), things, 10.0)


def sampled(start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points every millimetre or closer along a segment."""
    count = max(2, math.ceil(float(np.hypot(*(end - start))) / 0.001))
    return start + np.linspace(0, 1, count)[:, None] * (end - start)


def naive_clearance(grid: GridMap, pose: Pose2D) -> float:
    """Distance from points on the outline to all occupied cells, as rectangles."""
    corners = pose.transform_points(FOOTPRINT)
    points = np.concatenate(
        [sampled(a, b) for a, b in zip(corners, np.roll(corners, -1, 0), strict=True)]
    )
    points = grid.world_to_grid(points)
    best = math.inf
    for row, col in np.argwhere(grid.cells == 100):
        low = np.array([col, row]) * grid.resolution
        away = np.maximum(0.0, np.maximum(low - points, points - low - grid.resolution))
        best = min(best, float(np.hypot(away[:, 0], away[:, 1]).min()))
    return best


@pytest.mark.parametrize("seed", range(25))
def test_clearance_to_the_map_is_exact(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cells = np.where(rng.random((40, 50)) < 0.02, 100, 0).astype(np.int8)
    grid = GridMap("g", 0.05, Pose2D.from_array(rng.uniform(-2, 2, 3)), cells)
    middle = grid.origin.transform_points(np.array([[1.25, 1.0]]))[0]
    pose = Pose2D.from_array([*(middle + rng.uniform(-1.5, 1.5, 2)), rng.uniform(-3, 3)])
    expected, found = naive_clearance(grid, pose), clearance(grid, pose)
    if found > 0.0:
        assert found == pytest.approx(expected, abs=0.001)
    else:
        assert expected < 0.001 or swallows(grid, pose)


def swallows(grid: GridMap, pose: Pose2D) -> bool:
    """Whether an occupied cell lies inside the outline without touching its border."""
    centres = grid.cell_to_world(np.argwhere(grid.cells == 100))
    local = pose.inverse().transform_points(centres)
    return bool(((np.abs(local[:, 0]) < 0.2) & (np.abs(local[:, 1]) < 0.12)).any())


def test_an_empty_map_is_far_away() -> None:
    grid = GridMap("g", 0.05, Pose2D(0, 0, 0), np.zeros((10, 10), np.int8))
    assert clearance(grid, Pose2D(0.2, 0.2, 0.0)) == 10.0


def test_deep_in_a_wall_is_no_clearance() -> None:
    grid = GridMap("g", 0.05, Pose2D(0, 0, 0), np.full((60, 60), 100, np.int8))
    assert clearance(grid, Pose2D(1.5, 1.5, 0.3)) < 0.0


@pytest.mark.parametrize(
    ("x", "expected"),
    [
        (1.0, math.hypot(0.6, 0.02)),
        (0.5, math.hypot(0.1, 0.02)),
        # Here the box's corner is nearest to the leaning front, not to the robot's corner.
        (0.401, (0.001 * 0.24 + 0.02 * 0.05) / math.hypot(0.05, 0.24)),
    ],
)
def test_clearance_to_a_box(x: float, expected: float) -> None:
    grid = GridMap("g", 0.05, Pose2D(0, 0, 0), np.zeros((10, 10), np.int8))
    corners = np.array([[x, -0.1], [x + 0.3, -0.1], [x + 0.3, 0.1], [x, 0.1]])
    pieces = polyline(corners, closed=True)
    things = Things(pieces, np.ones(4, np.int64), np.empty((0, 3)), np.empty(0, np.int64))
    assert clearance(grid, Pose2D(0.2, 0.0, 0.0), things, 2) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("gap", [1.0, 0.05, 0.0, -0.05])
def test_clearance_to_a_circle(gap: float) -> None:
    grid = GridMap("g", 0.05, Pose2D(0, 0, 0), np.zeros((10, 10), np.int8))
    circles = np.array([[0.2 + 0.2 + 0.3 + gap, -0.12, 0.3]])
    things = Things(np.empty((0, 4)), np.empty(0, np.int64), circles, np.ones(1, np.int64))
    assert clearance(grid, Pose2D(0.2, 0.0, 0.0), things, 2) == pytest.approx(gap, abs=1e-9)


def test_what_lies_inside_the_outline_overlaps() -> None:
    grid = GridMap("g", 0.05, Pose2D(0, 0, 0), np.zeros((10, 10), np.int8))
    stick = np.array([[-0.02, 0.0, 0.02, 0.0]])
    things = Things(stick, np.ones(1, np.int64), np.empty((0, 3)), np.empty(0, np.int64))
    assert clearance(grid, Pose2D(0.0, 0.0, 0.0), things, 2) < 0.0
