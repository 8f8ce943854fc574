"""Free floor that beams saw through cracks: it is no part of what was mapped."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trolley.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap, distance_transform
from trolley_mapper.kernels.frontiers import STRAIGHT, UNREACHED, spread_into


@dataclass(frozen=True, slots=True)
class TidyingParams:
    """Which floor belongs to what was driven on. Set by hand."""

    crack_m: float = 0.2
    """Width of a gap between walls below which it is a crack: beside window frames, under doors and
    between boards beams pass that nobody else can. Doors are wider, also those left ajar [m]."""
    kept_m: float = 0.3
    """Distance behind a crack up to which floor is kept: niches and what is behind chair legs [m].
    """
    beside_m: float = 0.3
    """Distance from where the robot drove at which floor counts as driven on [m]."""


PARAMS = TidyingParams()


def tidied(grid: GridMap, driven: NDArray[np.floating]) -> GridMap:
    """Return a map without the floor that only beams through cracks have shown.

    What is seen through a door is connected with the floor that the robot drove on, and stays. So
    do walls behind cracks: the lidar will see them again.

    Args:
        grid: the map.
        driven: (n, 2) places that are known to be floor, x, y [m] in `map`.
    """
    free = (grid.cells == FREE).astype(np.uint8)
    begin = grid.world_to_cell(driven)
    begin = begin[grid.contains_cell(begin)]
    room_m = distance_transform(grid.cells == OCCUPIED, grid.resolution)
    # Distances are between centres of cells: in a crack of four cells they are two at most.
    is_wide = room_m > 0.5 * PARAMS.crack_m + 0.25 * grid.resolution
    wide = free * is_wide.astype(np.uint8)
    begin = np.ravel_multi_index((begin[:, 0], begin[:, 1]), free.shape)
    start = _within(free, begin, PARAMS.beside_m / grid.resolution)
    inside = _within(wide, np.flatnonzero(start & (wide != 0)), np.inf)
    if not inside.any():
        return grid
    kept = _within(free, np.flatnonzero(inside), PARAMS.kept_m / grid.resolution)
    cells = np.where((free != 0) & ~kept, np.int8(UNKNOWN), grid.cells)
    return replace(grid, cells=cells)


def _within(
    members: NDArray[np.uint8], seeds: NDArray[np.int64], distance: float
) -> NDArray[np.bool_]:
    """Return (rows, cols) what is reached from seeds over members.

    Args:
        members: (rows, cols), set where not 0.
        seeds: (n,) numbers of cells.
        distance: of the way at most [cells].
    """
    cost, seed = np.empty(members.shape, np.int32), np.empty(members.shape, np.int32)
    limit = int(min(STRAIGHT * distance, UNREACHED // 2))
    spread_into(cost, seed, members, seeds.astype(np.int32), limit)
    return np.asarray(cost != UNREACHED)
