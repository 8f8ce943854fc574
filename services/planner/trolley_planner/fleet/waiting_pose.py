"""A place to wait where no other robot wants to drive."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley_planner.costmap.costmap import Costmap
from trolley_planner.costmap.inflation import LETHAL
from trolley_planner.fleet.neighbours import Neighbour
from trolley_planner.fleet.right_of_way import Passages


@dataclass(frozen=True, slots=True)
class WaitingParams:
    """Where to wait; all by hand."""

    reach_m: float = 4.0
    """Distance from the robot within which places are compared."""
    step_m: float = 0.1
    """Distance between the places that are compared."""
    clear_m: float = 0.15
    """Distance left between the waiting robot and the one that passes."""
    wall_m: float = 0.05
    """Distance left between the waiting robot and walls."""
    spare_m: float = 0.05
    """A new place is better by this much than where the robot may stay."""
    short_price: float = 8.0
    """A metre too near to a path costs as much as driving this far."""
    narrow_price: float = 3.0
    """Waiting in a narrow place costs as much as driving this far."""
    stays_m: float = 0.15
    """A place this near is not worth driving to."""


WAITING = WaitingParams()


Floats = NDArray[np.float64]


def find_waiting_pose(
    costmap: Costmap,
    passages: Passages,
    here: Pose2D,
    radius_m: float,
    others: Sequence[Neighbour],
) -> tuple[float, float] | None:
    """Return the best place within reach to let others pass, x, y in `grid`; None: stay here.

    If no place is quite clear of their paths, the one that is least in the way is chosen.

    Args:
        costmap: what stands where.
        passages: narrow places.
        here: where the robot is.
        radius_m: of the robot.
        others: all robots; those that have a path and do not wait are let pass.
    """
    cells, lengths_m = _reachable(costmap, here, radius_m, others)
    if len(cells) == 0:
        return None
    step = max(1, round(WAITING.step_m / costmap.resolution_m))
    points = (cells.astype(np.float64) + 0.5) * (step * costmap.resolution_m)
    points[0] = here.x, here.y
    price = lengths_m + WAITING.narrow_price * passages.hold(points)
    inner = np.minimum(cells * step + step // 2, np.array(costmap.shape[::-1]) - 1)
    room_m = costmap.static.distance_m[inner[:, 1], inner[:, 0]]
    price += WAITING.short_price * np.maximum(0.0, radius_m + WAITING.wall_m - room_m)
    for other in others:
        apart_m = radius_m + other.radius_m + WAITING.clear_m + WAITING.spare_m
        if other.is_going and not other.is_waiting:
            price += WAITING.short_price * np.maximum(0.0, apart_m - _gaps(points, other.path))
        else:
            standing = np.array([[other.pose.x, other.pose.y]])
            price += WAITING.short_price * np.maximum(0.0, apart_m - _gaps(points, standing))
    best = int(price.argmin())
    if lengths_m[best] < WAITING.stays_m:
        return None
    return float(points[best, 0]), float(points[best, 1])


def is_clear(
    here: Pose2D, radius_m: float, passages: Passages, others: Sequence[Neighbour]
) -> bool:
    """Say whether the robot may wait where it is."""
    place = np.array([[here.x, here.y]])
    if passages.hold(place)[0]:
        return False
    return all(
        float(_gaps(place, other.path)[0]) > radius_m + other.radius_m + WAITING.clear_m
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
    """Return coarse cells (n, 2) col, row that can be reached, and how far they are; its own first.

    No path leads through another robot.
    """
    step = max(1, round(WAITING.step_m / costmap.resolution_m))
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
            if longer <= WAITING.reach_m:
                lengths[cell] = longer
                queue.append(cell)
    cells = np.array(list(lengths), dtype=np.int64).reshape(-1, 2)
    return cells, np.array(list(lengths.values()))
