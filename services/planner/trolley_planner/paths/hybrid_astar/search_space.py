"""Where the footprint may be, and what a metre costs there."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.jit import lean_kernel
from trolley_planner.costmap.fine_grid import FineGrid
from trolley_planner.costmap.footprint import Footprint
from trolley_planner.paths.hybrid_astar.footprint_spans import (
    FootprintSpans,
    edge_distance,
    touched,
)
from trolley_planner.paths.hybrid_astar.motion_primitives import BACKWARDS, CELL_M, FORWARDS
from trolley_planner.sensing.beams import box_of, inside_polygon


class TraversalCosts(NamedTuple):
    """What a metre costs more than a metre in open floor; by hand."""

    near: float = 2.0
    """Extra cost of a metre where the footprint has less clearance than is wanted."""
    beside: float = 6.0
    """Extra cost of a metre where the footprint is nearer than `beside_m` to an obstacle."""
    beside_m: float = 0.026
    """Clearance below which the footprint is right beside an obstacle: two fine cells."""
    touching: float = 12.0
    """Extra cost of a metre where the footprint is nearer than `touching_m`, so that the robot
    keeps to the middle of a door, and straight."""
    touching_m: float = 0.016
    """Clearance below which the footprint all but touches: one fine cell."""
    reverse: float = 0.8
    """Extra cost of a metre backwards, which is driven at half the speed."""
    creep: float = 4.0
    """Extra cost of a metre backwards, or of a turn, over floor that is out of sight: `base` lets
    the robot creep there only, at a fifth of its speed."""
    arrived_m: float = 0.5
    """Distance from the robot beyond which it will have seen the floor that it turns over: it looks
    the way it drives."""


TRAVERSAL = TraversalCosts()
IN_SIGHT, OUT_OF_SIGHT, NEVER_SEEN = range(3)
"""How floor is known: what was seen free and is out of sight may be backed over, at a creep."""
BLOCKED, TOUCHING, BESIDE, NEAR = (np.uint64(0xFFFF << shift) for shift in (0, 16, 32, 48))
"""Bits of the counts of cells in which something stands, and of those next to it, right beside it,
and nearer to it than is wanted."""
UNSEEN, HIDDEN = BLOCKED, TOUCHING
"""Bits of the counts of cells that the robot must not back into, and of those into which it backs
and turns at a creep only."""
ONE = np.uint64(0x0001_0001_0001_0001)
"""One cell, of each kind."""


class SearchSpace(NamedTuple):
    """Where the footprint may be. Places are measured from the corner [m]."""

    obstacles: NDArray[np.uint64]
    """(rows, cols + 1) cells in each row, before each column, that are BLOCKED, TOUCHING, BESIDE
    and NEAR."""
    views: NDArray[np.uint64]
    """(rows, cols + 1) the same of cells that are UNSEEN and HIDDEN."""
    blocking: np.uint64
    """Bits of the kinds of cells that the footprint must not cover."""
    distance_m: NDArray[np.float32]
    """(rows, cols) to the nearest obstacle."""
    footprint: FootprintSpans
    """Of the robot, in these cells."""
    wanted_m: float
    """Clearance from which on nothing costs more."""
    state_cols: int
    """Cells of states in a row."""
    own: tuple[float, float]
    """Place of the robot."""


def make_search_space(
    grid: FineGrid,
    unseen: NDArray[np.uint8],
    own: Pose2D,
    footprint: Footprint,
    spans: FootprintSpans,
    wanted_m: float,
) -> SearchSpace:
    """Return what the footprint is looked up in.

    Args:
        grid: what stands around.
        unseen: (rows, cols) of `grid`: IN_SIGHT, OUT_OF_SIGHT or NEVER_SEEN.
        own: pose of the robot from the corner: nothing stands where it is.
        footprint: of the robot.
        spans: the same in cells of `grid`.
        wanted_m: clearance from which on nothing costs more.
    """
    rows, cols = grid.mask.shape
    obstacles, views = np.empty((2, rows, cols + 1), dtype=np.uint64)
    outline = own.transform_points(footprint.polygon) / grid.fine_m
    count_into((obstacles, views), (grid.mask, grid.distance_m, unseen), outline, wanted_m)
    return SearchSpace(
        obstacles=obstacles,
        views=views,
        blocking=BLOCKED,
        distance_m=grid.distance_m,
        footprint=spans,
        wanted_m=wanted_m,
        state_cols=math.ceil((cols + 1) * grid.fine_m / CELL_M),
        own=(own.x, own.y),
    )


@lean_kernel
def count_into(
    out_counts: tuple[NDArray[np.uint64], NDArray[np.uint64]],
    layers: tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.uint8]],
    outline: NDArray[np.float64],
    wanted_m: float,
) -> None:
    """Write how many cells of each row, before each column, are of each kind.

    Args:
        out_counts: (rows, cols + 1) each, overwritten; obstacles and views of `SearchSpace`.
        layers: (rows, cols) each: set where something stands; distance to the nearest of that; how
            it is known.
        outline: (n, 2) of the robot [cells]: nothing stands where it is.
        wanted_m: cells nearer than this are near.
    """
    out_obstacles, out_views = out_counts
    mask, distance_m, known = layers
    rows, cols = mask.shape
    for row in range(rows):
        obstacles, views = np.uint64(0), np.uint64(0)
        for col in range(cols):
            out_obstacles[row, col], out_views[row, col] = obstacles, views
            kinds = kinds_by_distance(distance_m[row, col], wanted_m)
            if mask[row, col] != 0:
                kinds |= BLOCKED
            obstacles += kinds & ONE
            if known[row, col] == NEVER_SEEN:
                views += UNSEEN & ONE
            if known[row, col] != IN_SIGHT and mask[row, col] == 0:
                views += HIDDEN & ONE
        out_obstacles[row, cols], out_views[row, cols] = obstacles, views
    low_x, low_y, high_x, high_y = box_of(outline)
    first_row, first_col = max(math.floor(low_y) - 1, 0), max(math.floor(low_x) - 1, 0)
    last_col = min(math.ceil(high_x) + 1, cols)
    for row in range(first_row, min(math.ceil(high_y) + 1, rows)):
        taken = np.uint64(0)
        for col in range(first_col, cols):
            is_occupied = mask[row, col] != 0 and col < last_col
            x, y = col + 0.5, row + 0.5
            if is_occupied and (
                inside_polygon(outline, x, y) or edge_distance(outline, x, y) < 1.0
            ):
                taken += BLOCKED & ONE
            out_obstacles[row, col + 1] -= taken


@lean_kernel
def kinds_by_distance(away_m: float, wanted_m: float) -> np.uint64:
    """Return the kinds of a cell so far from the nearest obstacle."""
    kinds = np.uint64(0)
    if away_m < wanted_m:
        kinds |= NEAR
    if away_m < TRAVERSAL.beside_m:
        kinds |= BESIDE
    if away_m < TRAVERSAL.touching_m:
        kinds |= TOUCHING
    return kinds


@lean_kernel
def can_turn(space: SearchSpace, place: tuple[float, float], more_m: float) -> bool:
    """Say whether there is room for a full turn at a place, with the wanted clearance and more."""
    fine_m = space.footprint.fine_m
    row, col = math.floor(place[1] / fine_m), math.floor(place[0] / fine_m)
    rows, cols = space.distance_m.shape
    if not (0 <= row < rows and 0 <= col < cols):
        return False
    least_m = space.footprint.circumscribed_m + space.wanted_m + fine_m + more_m
    return space.distance_m[row, col] > least_m


@lean_kernel
def fits(space: SearchSpace, place: tuple[float, float], angle: int, kinds: np.uint64) -> bool:
    """Say whether the footprint covers no cell of some kinds of obstacles, and none outside."""
    return touched(space.obstacles, space.footprint, place, angle, kinds) & kinds == 0


@lean_kernel
def has_arrived(space: SearchSpace, place: tuple[float, float]) -> bool:
    """Say whether the robot drives so far to a place that it will have seen the floor there."""
    return math.hypot(place[0] - space.own[0], place[1] - space.own[1]) > TRAVERSAL.arrived_m


@lean_kernel
def cost_per_metre(
    space: SearchSpace, place: tuple[float, float], angle: int, motion: int
) -> float:
    """Return what a metre to a pose costs, +inf if the footprint must not come there.

    Args:
        space: where it is.
        place: x, y from the corner [m].
        angle: index.
        motion: how the robot will drive there; TURNING: what a metre of its outline's way costs.
    """
    has_room = can_turn(space, place, 0.0)
    if has_room and motion == FORWARDS:
        return 1.0
    footprint, stands, views = space.footprint, np.uint64(0), np.uint64(0)
    if not has_room:
        stands = touched(space.obstacles, footprint, place, angle, space.blocking)
        if stands & space.blocking != 0:
            return math.inf
    price = 1.0
    if motion == BACKWARDS:
        views = touched(space.views, footprint, place, angle, UNSEEN)
        if views & UNSEEN != 0:
            return math.inf
        price += TRAVERSAL.reverse
    elif motion != FORWARDS and not has_arrived(space, place):
        views = touched(space.views, footprint, place, angle, HIDDEN)
    if views & HIDDEN != 0:
        price += TRAVERSAL.creep
    return price + surcharge(stands)


@lean_kernel
def surcharge(stands: np.uint64) -> float:
    """Return what a metre costs more where the footprint covers such cells."""
    price = 0.0
    if stands & NEAR != 0:
        price += TRAVERSAL.near
        if stands & BESIDE != 0:
            price += TRAVERSAL.beside
            if stands & TOUCHING != 0:
                price += TRAVERSAL.touching
    return price
