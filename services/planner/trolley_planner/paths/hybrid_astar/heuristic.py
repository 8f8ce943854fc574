"""What the rest of a maneuver costs at least.

It is known well where it is narrow: in cells of 5 cm the footprint is tried in all headings, so the
toll of a door counts from far away.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import lean_kernel
from trolley_planner.costmap.inflation import WEIGHT_UNIT
from trolley_planner.paths.hybrid_astar.footprint_spans import (
    HEADINGS,
    FootprintSpans,
    angle_of,
)
from trolley_planner.paths.hybrid_astar.motion_primitives import BACKWARDS, CELL_M, COSTS, PoseXYYaw
from trolley_planner.paths.hybrid_astar.search_space import (
    BESIDE,
    NEAR,
    TOUCHING,
    TRAVERSAL,
    SearchSpace,
    fits,
)
from trolley_planner.paths.search import STEP, UNREACHED, cost_to_go_into, make_queue
from trolley_planner.sensing.beams import wrapped


class HeuristicParams(NamedTuple):
    """How the rest is estimated; by hand where no source is given."""

    edge_m: float = 0.05
    """Approximate edge of the heuristic's cells."""
    octile: float = 0.9239
    """A straight line is at least this share of the shortest path along 8 directions: cosine of
    22.5 degrees."""
    greed: float = 2.5
    """Weight of the heuristic: the maneuver costs at most this many times the cheapest, and is
    found far sooner."""
    last_greed: float = 3.0
    """Weight of the heuristic where there is no clearance."""
    hasty_greed: float = 8.0
    """Weight of the heuristic where that takes too many states."""


HEURISTIC = HeuristicParams()


class Query(NamedTuple):
    """From where to where; poses are measured from the corner."""

    start: PoseXYYaw
    goal: PoseXYYaw
    any_heading: bool
    """Whether the goal's heading does not matter."""
    xy_m: float
    """How far the goal's place may be missed."""
    yaw_rad: float
    """How far its heading may be missed."""
    sense: int
    """BACKWARDS where the path is searched from its end, since the robot then drives the other way.
    """
    begin_m: float
    """Tolerance of the end of a path that is searched from its end."""


class Heuristic(NamedTuple):
    """Cost-to-go of the place alone, and how much it counts."""

    to_go_m: NDArray[np.float32]
    """(rows, cols) with a rim of one cell, +inf where the origin may not be."""
    edge_m: float
    """Edge of a cell."""
    greed: float


def cells_per_edge(footprint: FootprintSpans) -> int:
    """Return how many fine cells are in the edge of a cell of the heuristic."""
    return max(1, round(HEURISTIC.edge_m / footprint.fine_m))


def least_weights(space: SearchSpace, closed: NDArray[np.uint8], parity: int) -> NDArray[np.uint8]:
    """Return what a metre costs at least in each cell (rows, cols) of the heuristic.

    Args:
        space: where the footprint may be.
        closed: (fine rows, fine cols) set where the origin must not be.
        parity: the headings that are tried are even, 0, or odd, 1.
    """
    group = cells_per_edge(space.footprint)
    rows, cols = (-(-size // group) + 2 for size in space.distance_m.shape)
    weights = np.zeros((rows, cols), dtype=np.uint8)
    weigh_into(weights, space, closed, group, parity)
    return weights


def cell_of(space: SearchSpace, pose: PoseXYYaw) -> tuple[int, int]:
    """Return row and column of a place among the cells of the heuristic."""
    edge_m = cells_per_edge(space.footprint) * space.footprint.fine_m
    return math.floor(pose[1] / edge_m) + 1, math.floor(pose[0] / edge_m) + 1


def make_heuristic(
    space: SearchSpace, weights: NDArray[np.uint8], goal: tuple[int, int], greed: float
) -> Heuristic:
    """Return the cost-to-go of the place alone to a cell, row and column."""
    rows, cols = weights.shape
    edge_m = cells_per_edge(space.footprint) * space.footprint.fine_m
    costs = np.empty(rows * cols, dtype=np.int32)
    seeds = np.array([[goal[0] * cols + goal[1], 0]], dtype=np.int32)
    flat, queue = weights.reshape(-1), make_queue(rows * cols)
    cost_to_go_into(costs, flat, queue, seeds, cols, (-1, 0), 8)
    metres = HEURISTIC.octile * edge_m / (2 * STEP * WEIGHT_UNIT)
    to_go_m = np.where(costs == UNREACHED, np.inf, metres * costs).astype(np.float32)
    return Heuristic(to_go_m.reshape(rows, cols), edge_m, greed)


@lean_kernel
def weigh_into(
    out_weights: NDArray[np.uint8],
    space: SearchSpace,
    closed: NDArray[np.uint8],
    group: int,
    parity: int,
) -> None:
    """Write what a metre costs about at least in larger cells, whatever the heading.

    Args:
        out_weights: (rows, cols) with a rim of one cell, zero before: the origin must not be there.
        space: where the footprint may be.
        closed: (fine rows, fine cols) set where the origin must not be.
        group: fine cells in the edge of a larger one.
        parity: the headings that are tried are even, 0, or odd, 1.
    """
    footprint, distance_m = space.footprint, space.distance_m
    inscribed_m, circumscribed_m = footprint.inscribed_m, footprint.circumscribed_m
    rows, cols = distance_m.shape
    levels = (NEAR, BESIDE, TOUCHING)
    needed_m = (space.wanted_m, TRAVERSAL.beside_m, TRAVERSAL.touching_m)
    more = (TRAVERSAL.near, TRAVERSAL.beside, TRAVERSAL.touching)
    for row in range(out_weights.shape[0] - 2):
        for col in range(out_weights.shape[1] - 2):
            best_row, best_col, farthest = 0, 0, np.float32(-1.0)
            for fine_row in range(row * group, min((row + 1) * group, rows)):
                for fine_col in range(col * group, min((col + 1) * group, cols)):
                    away = distance_m[fine_row, fine_col]
                    if away > farthest and closed[fine_row, fine_col] == 0:
                        best_row, best_col, farthest = fine_row, fine_col, away
            # Between centres of cells: what stands, and the origin, may be half a cell nearer.
            if farthest < inscribed_m:
                continue
            place = (best_col + 0.5) * footprint.fine_m, (best_row + 0.5) * footprint.fine_m
            price = 1.0
            for level in range(len(levels)):
                if farthest > circumscribed_m + needed_m[level] or (
                    farthest >= inscribed_m + needed_m[level]
                    and fits_somehow(space, place, parity, levels[level])
                ):
                    break
                price += more[level]
            out_weights[row + 1, col + 1] = int(price * WEIGHT_UNIT)


@lean_kernel
def fits_somehow(
    space: SearchSpace, place: tuple[float, float], parity: int, kind: np.uint64
) -> bool:
    """Say whether the footprint covers no cell of a kind in one of every other heading."""
    for heading in range(parity, HEADINGS, 2):
        if fits(space, place, angle_of(space.footprint, heading), kind):
            return True
    return False


@lean_kernel
def place_to_go(heuristic: Heuristic, place: tuple[float, float]) -> float:
    """Return what the rest costs at least by its place alone [m], +inf where nothing may be."""
    row = math.floor(place[1] / heuristic.edge_m) + 1
    col = math.floor(place[0] / heuristic.edge_m) + 1
    return float(heuristic.to_go_m[row, col])


@lean_kernel
def to_go(heuristic: Heuristic, query: Query, place: tuple[float, float], yaw: float) -> float:
    """Return what the rest costs at least [m], +inf where the origin must not be.

    Somewhere on any path without a change of direction the robot looks along the line from its
    start to its end, or away from it: so much it turns at least.
    """
    rest_m = place_to_go(heuristic, place)
    if rest_m == math.inf:
        return math.inf
    dx, dy = query.goal[0] - place[0], query.goal[1] - place[1]
    length = math.hypot(dx, dy)
    # From within a cell of the goal its bearing says nothing.
    bearing = math.atan2(dy, dx) if length > CELL_M else yaw
    ahead, back = abs(wrapped(bearing - yaw)), abs(wrapped(bearing + math.pi - yaw))
    least = ahead if length > CELL_M else 0.0
    if not query.any_heading:
        ahead += abs(wrapped(query.goal[2] - bearing))
        back += abs(wrapped(query.goal[2] - bearing - math.pi))
        least = abs(wrapped(query.goal[2] - yaw))
    if query.sense == BACKWARDS:
        ahead, back = back, ahead
    turning = COSTS.arc_m * ahead
    if length > CELL_M:
        turning = min(turning, COSTS.arc_m * back + TRAVERSAL.reverse * length)
        turning = min(turning, COSTS.arc_m * least + COSTS.switch_m)
    return max(rest_m - heuristic.edge_m, length - query.xy_m, 0.0) + turning
