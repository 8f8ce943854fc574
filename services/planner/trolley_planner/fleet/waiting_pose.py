"""A place to wait where nobody wants to drive."""

from collections import deque
from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley_planner.costmap.costmap import Costmap
from trolley_planner.costmap.inflation import LETHAL
from trolley_planner.fleet.neighbours import Neighbour
from trolley_planner.fleet.right_of_way import Passages

REACH_M = 4.0
"""No place is looked for farther away than this."""
STEP_M = 0.1
"""How far apart the places lie that are looked at."""
CLEAR_M, WALL_M = 0.15, 0.05
"""Room that is left between who waits and who passes, and to walls."""
SPARE_M = 0.05
"""A new place is better by so much than where the robot may stay."""
SHORT_PRICE, NARROW_PRICE = 8.0, 3.0
"""What a metre too near to a way counts as a way to drive, and what waiting where it is narrow."""
STAYS_M = 0.15
"""A place this near is not worth driving to."""

Floats = NDArray[np.float64]


def place_aside(
    costmap: Costmap,
    passages: Passages,
    here: Pose2D,
    radius_m: float,
    others: Sequence[Neighbour],
) -> tuple[float, float] | None:
    """Return the best place within reach to let others pass, x, y in `grid`; None: stay here.

    Where none is quite clear of their ways the one is taken that is the least in the way.

    Args:
        costmap: what stands where.
        passages: narrow places.
        here: where the robot is.
        radius_m: of the robot.
        others: all robots; who has a way and does not wait is let pass.
    """
    cells, lengths_m = _reachable(costmap, here, radius_m, others)
    if len(cells) == 0:
        return None
    step = max(1, round(STEP_M / costmap.resolution_m))
    points = (cells.astype(np.float64) + 0.5) * (step * costmap.resolution_m)
    points[0] = here.x, here.y
    price = lengths_m + NARROW_PRICE * passages.hold(points)
    inner = np.minimum(cells * step + step // 2, np.array(costmap.shape[::-1]) - 1)
    room_m = costmap.static_distance_m[inner[:, 1], inner[:, 0]]
    price += SHORT_PRICE * np.maximum(0.0, radius_m + WALL_M - room_m)
    for other in others:
        apart_m = radius_m + other.radius_m + CLEAR_M + SPARE_M
        if other.is_going and not other.is_waiting:
            price += SHORT_PRICE * np.maximum(0.0, apart_m - _gaps(points, other.path))
        else:
            standing = np.array([[other.pose.x, other.pose.y]])
            price += SHORT_PRICE * np.maximum(0.0, apart_m - _gaps(points, standing))
    best = int(price.argmin())
    if lengths_m[best] < STAYS_M:
        return None
    return float(points[best, 0]), float(points[best, 1])


def is_clear(
    here: Pose2D, radius_m: float, passages: Passages, others: Sequence[Neighbour]
) -> bool:
    """Say whether a robot may wait where it is."""
    place = np.array([[here.x, here.y]])
    if passages.hold(place)[0]:
        return False
    return all(
        float(_gaps(place, other.path)[0]) > radius_m + other.radius_m + CLEAR_M
        for other in others
        if other.is_going and not other.is_waiting
    )


def _gaps(points: Floats, path: Floats) -> Floats:
    """Return how far each of some points (n, 2) is from a path (m, 2)."""
    few = path[::3]
    away = points[:, None, :] - few[None, :, :]
    return np.sqrt((away * away).sum(axis=2).min(axis=1))


def _reachable(
    costmap: Costmap, here: Pose2D, radius_m: float, others: Sequence[Neighbour]
) -> tuple[NDArray[np.int64], Floats]:
    """Return coarse cells (n, 2) col, row that a way leads to, and its length; the own one first.

    Nobody drives through another robot.
    """
    step = max(1, round(STEP_M / costmap.resolution_m))
    edge_m = step * costmap.resolution_m
    free = costmap.weights[step // 2 :: step, step // 2 :: step] != LETHAL
    rows, cols = free.shape[0], free.shape[1]
    columns = np.arange(cols, dtype=np.float64)[None, :]
    lines = np.arange(rows, dtype=np.float64)[:, None]
    for other in others:
        near = radius_m + other.radius_m
        away = np.hypot(
            (columns + 0.5) * edge_m - other.pose.x,
            (lines + 0.5) * edge_m - other.pose.y,
        )
        free &= away > 0.7 * near
    start = int(here.x / edge_m), int(here.y / edge_m)
    lengths = {start: 0.0}
    queue = deque([start])
    while queue:
        col, row = queue.popleft()
        length = lengths[col, row]
        for by_col, by_row in product((-1, 0, 1), repeat=2):
            cell = col + by_col, row + by_row
            inside = 0 <= cell[0] < cols and 0 <= cell[1] < rows
            if not inside or cell in lengths or not free[cell[1], cell[0]]:
                continue
            longer = length + edge_m * (1.0 if by_col == 0 or by_row == 0 else 1.414)
            if longer <= REACH_M:
                lengths[cell] = longer
                queue.append(cell)
    cells = np.array(list(lengths), dtype=np.int64).reshape(-1, 2)
    return cells, np.array(list(lengths.values()))
