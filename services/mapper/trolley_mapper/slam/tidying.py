"""Free floor that beams saw through cracks: it is no part of what was mapped."""

import importlib
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trolley.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap, distance_transform
from trolley.slices import Slices
from trolley_mapper.kernels.frontiers import STRAIGHT, UNREACHED, spread_into

# SciPy ships no types.
_images: Any = importlib.import_module("scipy.ndimage")


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


def tidied(grid: GridMap, driven: NDArray[np.floating]) -> Slices[GridMap]:
    """Return a map without the floor that only beams through cracks have shown.

    What is seen through a door is connected with the floor that the robot drove on, and stays. So
    do walls behind cracks: the lidar will see them again.

    Args:
        grid: the map.
        driven: (n, 2) places that are known to be floor, x, y [m] in `map`.
    """
    free = grid.cells == FREE
    begin = grid.world_to_cell(driven)
    begin = begin[grid.contains_cell(begin)]
    room_m = distance_transform(grid.cells == OCCUPIED, grid.resolution)
    yield
    # Distances are between centres of cells: in a crack of four cells they are two at most.
    wide = free & (room_m > 0.5 * PARAMS.crack_m + 0.25 * grid.resolution)
    begin = np.ravel_multi_index((begin[:, 0], begin[:, 1]), free.shape)
    start = wide & _within(free, begin, PARAMS.beside_m / grid.resolution)
    yield
    if not start.any():
        return grid
    inside = _connected(wide, start)
    yield
    rim = np.flatnonzero(inside & _grown(free & ~inside))
    kept = inside | _within(free, rim, PARAMS.kept_m / grid.resolution)
    return replace(grid, cells=np.where(free & ~kept, np.int8(UNKNOWN), grid.cells))


def _within(
    members: NDArray[np.bool_], seeds: NDArray[np.int64], distance: float
) -> NDArray[np.bool_]:
    """Return (rows, cols) what is reached from seeds over members.

    Args:
        members: (rows, cols).
        seeds: (n,) numbers of cells.
        distance: of the way at most [cells].
    """
    cost, seed = np.empty(members.shape, np.int32), np.empty(members.shape, np.int32)
    passable = members.astype(np.uint8)
    spread_into(cost, seed, passable, seeds.astype(np.int32), int(STRAIGHT * distance))
    return np.asarray(cost != UNREACHED)


def _connected(members: NDArray[np.bool_], some: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the members that are connected with some of them, corners included."""
    pieces, count = _images.label(members, np.ones((3, 3)))
    is_reached = np.zeros(count + 1, bool)
    is_reached[pieces[some]] = True
    return np.asarray(is_reached[pieces])


def _grown(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask with all cells beside it, corners included."""
    grown = mask.copy()
    grown[1:] |= mask[:-1]
    grown[:-1] |= mask[1:]
    wider = grown.copy()
    wider[:, 1:] |= grown[:, :-1]
    wider[:, :-1] |= grown[:, 1:]
    return wider
