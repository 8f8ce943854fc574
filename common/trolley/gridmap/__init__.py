"""Occupancy grids: reading, writing, coordinates, distances and rays.

`distance_transform` and `cast_rays` are imported when first used, since they bring numba along.
"""

from typing import TYPE_CHECKING, Any

from trolley.gridmap.grid import FREE, OCCUPIED, OCCUPIED_FROM, UNKNOWN, GridMap
from trolley.gridmap.io import MAX_CELLS, MapError, load_map, save_map

if TYPE_CHECKING:
    from trolley.gridmap.distance import cast_rays, distance_transform

__all__ = [
    "FREE",
    "MAX_CELLS",
    "OCCUPIED",
    "OCCUPIED_FROM",
    "UNKNOWN",
    "GridMap",
    "MapError",
    "cast_rays",
    "distance_transform",
    "load_map",
    "save_map",
]

_COMPILED = {"cast_rays", "distance_transform"}


def __getattr__(name: str) -> Any:
    """Import the compiled functions when they are first asked for."""
    if name not in _COMPILED:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from trolley.gridmap import distance

    return getattr(distance, name)
