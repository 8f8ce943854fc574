"""Occupancy grids: cells, their place in the map frame, and conversions between the two.

Frame `grid` has its origin at the outer corner of cell (0, 0), x along the columns, y along the
rows [m]; `map_T_grid` is the grid's `origin`, which may be turned.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D

FREE = 0
OCCUPIED = 100
UNKNOWN = -1
# A cell counts as an obstacle from this value on: ROS's occupied_thresh of 0.65.
OCCUPIED_FROM = 65

# Cell indices are clipped to this, so that any coordinate has one; far outside every map.
_MAX_INDEX = float(2**31 - 1)


@dataclass(frozen=True, slots=True, eq=False)
class GridMap:
    """An occupancy grid and where it lies.

    Attributes:
        name: what people call the map.
        resolution: cell edge [m], > 0.
        origin: `map_T_grid`, the outer corner of cell (0, 0) in the map frame.
        cells: (rows, cols) int8: 0 free ... 100 occupied, -1 unknown; row 0 is at the bottom.
    """

    name: str
    resolution: float
    origin: Pose2D
    cells: NDArray[np.int8]

    def __post_init__(self) -> None:
        """Refuse what is not a grid.

        Raises:
            ValueError: wrong type or shape of the cells, a resolution that is not positive,
                or an origin that is not finite.
        """
        if self.cells.ndim != 2 or self.cells.dtype != np.int8 or self.cells.size == 0:
            raise ValueError(
                f"cells must be a non-empty int8 array of shape (rows, cols), "
                f"not {self.cells.dtype} {self.cells.shape}"
            )
        if not (math.isfinite(self.resolution) and self.resolution > 0.0):
            raise ValueError(f"the resolution must be a positive length, not {self.resolution}")
        if not self.origin.is_finite():
            raise ValueError(f"the origin must be finite, not {self.origin}")

    @property
    def rows(self) -> int:
        """Number of cells along the grid's y axis."""
        return int(self.cells.shape[0])

    @property
    def cols(self) -> int:
        """Number of cells along the grid's x axis."""
        return int(self.cells.shape[1])

    @property
    def size_m(self) -> tuple[float, float]:
        """Extent along the grid's x and y axes [m]."""
        return self.cols * self.resolution, self.rows * self.resolution

    def corners(self) -> NDArray[np.float64]:
        """Return the four outer corners, counter-clockwise, (4, 2) x, y [m] in `map`."""
        width, height = self.size_m
        corners_grid = np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]])
        return self.origin.transform_points(corners_grid)

    def world_to_grid(self, points_map: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """Return points (n, 2) of the map frame [m] in frame `grid` [m]."""
        return self.origin.inverse().transform_points(points_map)

    def world_to_cell(self, points_map: NDArray[np.floating[Any]]) -> NDArray[np.int64]:
        """Return the cell that each point lies in.

        Args:
            points_map: (n, 2) x, y [m] in `map`; may lie outside the grid.

        Returns:
            (n, 2) row, col; outside the grid they run on, negative or beyond the size. A
            point that is not finite gets an index outside every grid.
        """
        cells = np.floor(self.world_to_grid(points_map)[..., ::-1] / self.resolution)
        far = np.nan_to_num(cells, nan=-_MAX_INDEX, posinf=_MAX_INDEX, neginf=-_MAX_INDEX)
        return np.clip(far, -_MAX_INDEX, _MAX_INDEX).astype(np.int64)

    def cell_to_world(self, cells: NDArray[np.integer[Any]]) -> NDArray[np.float64]:
        """Return the centres of cells (n, 2) row, col as points (n, 2) x, y [m] in `map`."""
        centres_grid = (np.asarray(cells)[..., ::-1] + 0.5) * self.resolution
        return self.origin.transform_points(centres_grid)

    def contains_cell(self, cells: NDArray[np.integer[Any]]) -> NDArray[np.bool_]:
        """Say for each cell (n, 2) row, col whether the grid has it, (n,)."""
        rows, cols = cells[..., 0], cells[..., 1]
        return (rows >= 0) & (rows < self.rows) & (cols >= 0) & (cols < self.cols)

    def contains(self, points_map: NDArray[np.floating[Any]]) -> NDArray[np.bool_]:
        """Say for each point (n, 2) [m] in `map` whether it lies on the grid, (n,)."""
        return self.contains_cell(self.world_to_cell(points_map))

    def values_at(
        self, points_map: NDArray[np.floating[Any]], outside: int = UNKNOWN
    ) -> NDArray[np.int8]:
        """Return the cell values under points (n, 2) [m] in `map`, (n,).

        Args:
            points_map: (n, 2) x, y [m].
            outside: value for points that are not on the grid.
        """
        cells = self.world_to_cell(points_map)
        inside = self.contains_cell(cells)
        values = np.full(inside.shape, outside, dtype=np.int8)
        values[inside] = self.cells[cells[inside, 0], cells[inside, 1]]
        return values

    def occupied_mask(self, threshold: int = OCCUPIED_FROM) -> NDArray[np.uint8]:
        """Return (rows, cols) with 1 where a cell's value is at least `threshold`, else 0."""
        return (self.cells >= threshold).astype(np.uint8)

    def free_mask(self, below: int = OCCUPIED_FROM) -> NDArray[np.uint8]:
        """Return (rows, cols) with 1 where a cell is known and its value under `below`."""
        return ((self.cells >= 0) & (self.cells < below)).astype(np.uint8)
