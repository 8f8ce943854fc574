"""Compiled loops of the reference that `dwa.py` holds: search, distances along a plan, rollouts."""

import heapq
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel

BLOCKED = np.float32(np.inf)
"""Price of a cell that must not be entered."""
LETHAL, INSCRIBED = 254, 253
"""Costs of costmap_2d: an obstacle; the centre must not be there."""


@kernel
def navfn_into(
    out_costs: NDArray[np.float32], prices: NDArray[np.float32], goal: tuple[int, int]
) -> None:
    """Write each cell's cost-to-go, by Dijkstra's algorithm over 8 neighbours.

    Args:
        out_costs: (rows, cols), overwritten; infinite where there is no path.
        prices: (rows, cols) of a straight step into a cell; the outermost cells are not entered.
        goal: row and column.
    """
    rows, cols = prices.shape
    out_costs[:, :] = BLOCKED
    out_costs[goal] = 0.0
    heap = [(0.0, goal[0] * cols + goal[1])]
    while len(heap) > 0:
        cost, cell = heapq.heappop(heap)
        row, col = cell // cols, cell % cols
        if cost > out_costs[row, col]:
            continue
        for i in range(-1, 2):
            for j in range(-1, 2):
                r, c = row + i, col + j
                if (i == 0 and j == 0) or r < 1 or c < 1 or r >= rows - 1 or c >= cols - 1:
                    continue
                step = math.sqrt(i * i + j * j) * prices[r, c]
                if cost + step < out_costs[r, c]:
                    out_costs[r, c] = cost + step
                    heapq.heappush(heap, (np.float64(out_costs[r, c]), r * cols + c))


@kernel
def spread_into(
    out_cells: NDArray[np.float32], costs: NDArray[np.uint8], seeds: NDArray[np.int64]
) -> None:
    """Write how many cells it is to the nearest seed, through cells that are free (MapGrid).

    Args:
        out_cells: (rows, cols), overwritten; infinite where none leads to.
        costs: (rows, cols) of costmap_2d.
        seeds: (n, 2) row and column.
    """
    rows, cols = costs.shape
    out_cells[:, :] = np.inf
    queue = np.empty(rows * cols, dtype=np.int64)
    head, tail = 0, 0
    for index in range(seeds.shape[0]):
        row, col = seeds[index, 0], seeds[index, 1]
        if out_cells[row, col] != 0.0:
            out_cells[row, col] = 0.0
            queue[tail] = row * cols + col
            tail += 1
    while head < tail:
        row, col = queue[head] // cols, queue[head] % cols
        head += 1
        for i, j in ((0, 1), (1, 0), (0, -1), (-1, 0)):
            r, c = row + i, col + j
            if 0 <= r < rows and 0 <= c < cols and out_cells[r, c] == np.inf:
                if costs[r, c] >= INSCRIBED:
                    continue
                out_cells[r, c] = out_cells[row, col] + 1.0
                queue[tail] = r * cols + c
                tail += 1


@kernel
def take_scan(
    marks: NDArray[np.uint8],
    beams: NDArray[np.float64],
    cell_m: float,
    reaches: tuple[float, float],
) -> None:
    """Clear the cells that beams pass and mark where they end.

    Args:
        marks: (rows, cols) 1 for an obstacle, changed in place.
        beams: (n, 4) start x, y and end x, y [m] in the grid.
        cell_m: cell edge.
        reaches: echoes are marked up to the first, beams clear up to the second [m].
    """
    rows, cols = marks.shape
    for phase in range(2):
        for beam in range(beams.shape[0]):
            x, y = beams[beam, 0], beams[beam, 1]
            dx, dy = beams[beam, 2] - x, beams[beam, 3] - y
            length = math.hypot(dx, dy)
            if phase == 0:
                count = int(2.0 * min(length - cell_m, reaches[1]) / cell_m)
                for step in range(count):
                    share = 0.5 * step * cell_m / length
                    row, col = int((y + share * dy) / cell_m), int((x + share * dx) / cell_m)
                    if 0 <= row < rows and 0 <= col < cols:
                        marks[row, col] = 0
            elif length <= reaches[0]:
                row, col = int((y + dy) / cell_m), int((x + dx) / cell_m)
                if 0 <= row < rows and 0 <= col < cols:
                    marks[row, col] = 1


class Grids(NamedTuple):
    """What samples are scored by."""

    costs: NDArray[np.uint8]
    path: NDArray[np.float32]
    goal: NDArray[np.float32]
    goal_front: NDArray[np.float32]
    cell_m: float


class Scales(NamedTuple):
    """Weights of the critics, as dwa_local_planner multiplies them."""

    occupancy: float
    path: float
    goal: float
    alignment: float
    forward_m: float


@kernel
def outline_cost(
    costs: NDArray[np.uint8], outline: NDArray[np.float64], pose: tuple[float, float, float],
    cell_m: float,
) -> int:  # fmt: skip
    """Highest cost under points (n, 2) of the outline; -1 where they touch something."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    highest = 0
    for index in range(outline.shape[0]):
        px, py = outline[index, 0], outline[index, 1]
        col = int((pose[0] + cos * px - sin * py) / cell_m)
        row = int((pose[1] + sin * px + cos * py) / cell_m)
        if not (0 <= row < costs.shape[0] and 0 <= col < costs.shape[1]):
            return -1
        if costs[row, col] == LETHAL:
            return -1
        highest = max(highest, costs[row, col])
    return highest


@kernel
def sample_cost(
    start: tuple[float, float, float],
    velocity: tuple[float, float],
    seconds: tuple[float, float],
    outline: NDArray[np.float64],
    grids: Grids,
    scales: Scales,
) -> float:
    """Score a constant velocity; negative if it touches something or leads nowhere.

    Args:
        start: x, y, yaw in the grid.
        velocity: v [m/s] and w [rad/s].
        seconds: how long it is driven, and the step.
        outline: (n, 2) points on the footprint's edge.
        grids: what it is scored by.
        scales: weights.
    """
    x, y, yaw = start
    v, w = velocity
    count = max(1, math.ceil(seconds[0] / seconds[1]))
    dt = seconds[0] / count
    occupancy = 0
    for _ in range(count):
        cost = outline_cost(grids.costs, outline, (x, y, yaw), grids.cell_m)
        if cost < 0:
            return -1.0
        occupancy = max(occupancy, cost)
        x += v * math.cos(yaw) * dt
        y += v * math.sin(yaw) * dt
        yaw += w * dt
    row, col = int(y / grids.cell_m), int(x / grids.cell_m)
    front_row = int((y + scales.forward_m * math.sin(yaw)) / grids.cell_m)
    front_col = int((x + scales.forward_m * math.cos(yaw)) / grids.cell_m)
    rows, cols = grids.costs.shape
    if not (0 <= row < rows and 0 <= col < cols):
        return -1.0
    if not (0 <= front_row < rows and 0 <= front_col < cols):
        return -1.0
    path, goal = grids.path[row, col], grids.goal[row, col]
    if path == np.inf or goal == np.inf:
        return -1.0
    total = scales.occupancy * occupancy + scales.path * path + scales.goal * goal
    front, aligned = grids.goal_front[front_row, front_col], grids.path[front_row, front_col]
    # These two do not forbid: what lies ahead may be an obstacle.
    far = float(rows + cols)
    total += scales.goal * min(front, far)
    return total + scales.alignment * min(aligned, far)
