"""Houses of any size, drawn at random, and what a lidar sees in them."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap, cast_rays, distance_transform

RESOLUTION = 0.05
ROOM_M = (2.5, 6.0)
WALL_CELLS = 2
DOOR_M = 0.9


Rect = tuple[int, int, int, int]
"""First row, row behind the last, first column, column behind the last [cells]."""


@dataclass(frozen=True)
class Plan:
    """What a house consists of.

    Attributes:
        walls: (rows, cols) a map's values, doors open, nothing in the rooms.
        doors: openings in the walls.
        furniture: the boxes of the pieces on the floor.
        shapes: the cells (rows, cols) that each piece takes of its box.
    """

    walls: NDArray[np.int8]
    doors: tuple[Rect, ...]
    furniture: tuple[Rect, ...]
    shapes: tuple[NDArray[np.bool_], ...]

    def built(self, closed: tuple[Rect, ...] = ()) -> GridMap:
        """The house with some of its doors closed."""
        cells = self.walls.copy()
        for (r0, r1, c0, c1), shape in zip(self.furniture, self.shapes, strict=True):
            cells[r0:r1, c0:c1][shape] = OCCUPIED
        for r0, r1, c0, c1 in closed:
            cells[r0:r1, c0:c1] = OCCUPIED
        return GridMap("house", RESOLUTION, Pose2D(0.0, 0.0, 0.0), cells)


def draw_house(size_m: float, seed: int) -> GridMap:
    """A square house of rooms with doors and furniture; its surroundings are unknown."""
    return plan_house(size_m, seed).built()


def plan_house(size_m: float, seed: int) -> Plan:
    """What `draw_house` draws, part by part."""
    rng = np.random.default_rng(seed)
    count = round(size_m / RESOLUTION)
    cells = np.full((count, count), UNKNOWN, np.int8)
    margin = 10
    cells[margin:-margin, margin:-margin] = OCCUPIED
    inner = margin + WALL_CELLS
    doors: list[Rect] = []
    _divide(cells, (inner, count - inner, inner, count - inner), doors, rng)
    pieces = tuple(_furnish(cells.copy(), rng))
    shapes = tuple(np.ones((r1 - r0, c1 - c0), bool) for r0, r1, c0, c1 in pieces)
    return Plan(cells, tuple(doors), pieces, shapes)


def _divide(
    cells: NDArray[np.int8], room: Rect, doors: list[Rect], rng: np.random.Generator
) -> None:
    """Cut a room in two until the pieces have the size of rooms, a door in each wall."""
    r0, r1, c0, c1 = room
    cells[r0:r1, c0:c1] = FREE
    height, width = r1 - r0, c1 - c0
    longest = max(height, width) * RESOLUTION
    if longest < rng.uniform(2.0 * ROOM_M[0], 2.0 * ROOM_M[1]):
        return
    least = round(ROOM_M[0] / RESOLUTION) // 2
    door = round(DOOR_M / RESOLUTION)
    if height >= width:
        cut = int(rng.integers(r0 + least, r1 - least))
        at = int(rng.integers(c0 + 2, c1 - door - 2))
        parts = ((r0, cut, c0, c1), (cut + WALL_CELLS, r1, c0, c1))
        wall, opening = (cut, cut + WALL_CELLS, c0, c1), (cut, cut + WALL_CELLS, at, at + door)
    else:
        cut = int(rng.integers(c0 + least, c1 - least))
        at = int(rng.integers(r0 + 2, r1 - door - 2))
        parts = ((r0, r1, c0, cut), (r0, r1, cut + WALL_CELLS, c1))
        wall, opening = (r0, r1, cut, cut + WALL_CELLS), (at, at + door, cut, cut + WALL_CELLS)
    for part in parts:
        _divide(cells, part, doors, rng)
    cells[wall[0] : wall[1], wall[2] : wall[3]] = OCCUPIED
    cells[opening[0] : opening[1], opening[2] : opening[3]] = FREE
    doors.append(opening)


def _furnish(cells: NDArray[np.int8], rng: np.random.Generator) -> list[Rect]:
    """Put about one piece of furniture on each 8 m^2; returns the pieces."""
    count = cells.shape[0]
    pieces: list[Rect] = []
    for _ in range(round((count * RESOLUTION) ** 2 / 8.0)):
        row, col = rng.integers(0, count - 20, 2)
        size = rng.integers(6, 30, 2)
        piece = cells[row : row + size[0], col : col + size[1]]
        if np.all(piece == FREE):
            piece[:] = OCCUPIED
            pieces.append((int(row), int(row + size[0]), int(col), int(col + size[1])))
    return pieces


def free_poses(
    grid: GridMap, clearance_m: float, count: int, rng: np.random.Generator
) -> list[Pose2D]:
    """Random poses on free floor at least so far from everything else."""
    blocked = 1 - grid.free_mask()
    rows, cols = np.nonzero(distance_transform(blocked, grid.resolution) >= clearance_m)
    chosen = rng.integers(0, len(rows), count)
    points = grid.cell_to_world(np.column_stack([rows[chosen], cols[chosen]]))
    return [Pose2D(float(x), float(y), float(rng.uniform(-math.pi, math.pi))) for x, y in points]


def seen_from(grid: GridMap, pose: Pose2D, beams: int, reach_m: float) -> NDArray[np.float32]:
    """Ranges (beams,) [m] of a lidar without errors at a pose, from -pi counter-clockwise."""
    at = grid.origin.inverse() @ pose
    angles = at.yaw - math.pi + np.arange(beams) * (2.0 * math.pi / beams)
    return cast_rays(grid.occupied_mask(), grid.resolution, (at.x, at.y), angles, reach_m)
