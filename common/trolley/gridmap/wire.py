"""Grid maps as the messages of the contract, and back."""

import numpy as np

from trolley.gridmap.grid import GridMap
from trolley.messages import OccupancyGrid


def map_message(stamp_ns: int, grid: GridMap, name: str | None = None) -> OccupancyGrid:
    """Return a map as the contract's `map`, under another name where one is given."""
    return OccupancyGrid(
        stamp_ns=stamp_ns,
        name=grid.name if name is None else name,
        frame="map",
        resolution=grid.resolution,
        width=grid.cols,
        height=grid.rows,
        origin=grid.origin,
        cells=memoryview(grid.cells.tobytes()),
    )


def grid_of(message: OccupancyGrid) -> GridMap:
    """View a map's message as a grid, whose cells cannot be written to."""
    cells = np.frombuffer(message.cells, np.int8).reshape(message.height, message.width)
    return GridMap(message.name, message.resolution, message.origin, cells)
