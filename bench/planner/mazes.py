"""Mazes and rooms of any size, drawn at random, in which every place can be reached."""

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.gridmap import FREE, OCCUPIED, GridMap

RESOLUTION = 0.05
WALL_CELLS = 2


def draw_maze(
    size_m: float,
    passage_m: float,
    seed: int,
    door_m: float | None = None,
    open_share: float = 0.05,
) -> GridMap:
    """A square maze with a few loops; with doors a building of rooms.

    Args:
        size_m: edge.
        passage_m: width of a passage or room, wall included.
        seed: of the random numbers.
        door_m: width of the doors; None: as wide as the passage.
        open_share: share of the walls that are opened besides those of the maze.
    """
    rng = np.random.default_rng(seed)
    pitch = round(passage_m / RESOLUTION)
    count = round(size_m / RESOLUTION) // pitch
    edge = count * pitch + WALL_CELLS
    size = max(round(size_m / RESOLUTION), edge)
    cells = np.full((size, size), OCCUPIED, np.int8)
    for row in range(count):
        for col in range(count):
            r, c = row * pitch + WALL_CELLS, col * pitch + WALL_CELLS
            cells[r : r + pitch - WALL_CELLS, c : c + pitch - WALL_CELLS] = FREE
    right, up = _spanning_tree(count, rng)
    right |= rng.random(right.shape) < open_share
    up |= rng.random(up.shape) < open_share
    inner = pitch - WALL_CELLS
    width = inner if door_m is None else min(inner, round(door_m / RESOLUTION))
    for row in range(count):
        for col in range(count):
            at = int(rng.integers(0, inner - width + 1))
            r, c = row * pitch + WALL_CELLS, col * pitch + WALL_CELLS
            if right[row, col]:
                cells[r + at : r + at + width, c + inner : c + pitch] = FREE
            if up[row, col]:
                cells[r + inner : r + pitch, c + at : c + at + width] = FREE
    return GridMap("maze", RESOLUTION, Pose2D.identity(), cells)


def furnish(grid: GridMap, per_m2: float, seed: int) -> GridMap:
    """The same with pieces of furniture that leave a metre around them."""
    rng = np.random.default_rng(seed)
    cells = grid.cells.copy()
    gap = round(0.8 / RESOLUTION)
    for _ in range(round(cells.size * RESOLUTION**2 * per_m2)):
        size = rng.integers(6, 24, 2)
        row, col = rng.integers(gap, np.array(cells.shape) - size - gap)
        around = cells[row - gap : row + size[0] + gap, col - gap : col + size[1] + gap]
        if np.all(around == FREE):
            cells[row : row + size[0], col : col + size[1]] = OCCUPIED
    return GridMap(grid.name, grid.resolution, grid.origin, cells)


def _spanning_tree(
    count: int, rng: np.random.Generator
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which walls to the right and above are open: depth first, so that paths are long."""
    right = np.zeros((count, count), np.bool_)
    up = np.zeros((count, count), np.bool_)
    seen = np.zeros((count, count), np.bool_)
    stack = [(0, 0)]
    seen[0, 0] = True
    while stack:
        row, col = stack[-1]
        sides = ((row, col + 1), (row, col - 1), (row + 1, col), (row - 1, col))
        fresh = [(r, c) for r, c in sides if 0 <= r < count and 0 <= c < count and not seen[r, c]]
        if not fresh:
            stack.pop()
            continue
        r, c = fresh[int(rng.integers(len(fresh)))]
        if r == row:
            right[row, min(c, col)] = True
        else:
            up[min(r, row), col] = True
        seen[r, c] = True
        stack.append((r, c))
    right[:, -1] = up[-1, :] = False
    return right, up
