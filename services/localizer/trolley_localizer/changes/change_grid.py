"""The evidence for changes, cell by cell, kept in tiles where there is any."""

import numpy as np
from numpy.typing import NDArray

from trolley.gridmap import GridMap
from trolley_localizer.kernels import changes as kernels
from trolley_localizer.kernels.changes import COLUMNS, TILE, TILE_CELLS, ChangeEvidence

_MOST_TILES = 2048
"""Number of tiles that are kept; 13 numbers a cell are at most 27 MB, and far less in a flat."""
_SPARE_TILES = 64
"""Tiles that are free at the beginning of each scan."""


class ChangeGrid:
    """A table of cells that grows where there is something to say.

    Args:
        grid: the map.
    """

    def __init__(self, grid: GridMap) -> None:
        self._grid = grid
        tiles = np.full((-(-grid.rows // TILE), -(-grid.cols // TILE)), -1, np.int32)
        self.arrays = ChangeEvidence(tiles, _empty_table(_SPARE_TILES), np.zeros(1, np.int64))
        """As the kernels take it."""

    def make_room(self) -> None:
        """Have some tiles to spare; forget those that say nothing where there are too many."""
        tiles, table, used = self.arrays
        if (int(used[0]) + _SPARE_TILES) * TILE_CELLS <= table.shape[0]:
            return
        if used[0] >= _MOST_TILES:
            self.forget_empty()
        held = int(used[0])
        larger = _empty_table(min(2 * held, _MOST_TILES) + 2 * _SPARE_TILES)
        larger[: held * TILE_CELLS] = table[: held * TILE_CELLS]
        self.arrays = ChangeEvidence(tiles, larger, used)

    def forget_empty(self) -> None:
        """Forget the tiles without a cell that was found changed at any visit."""
        tiles, table, used = self.arrays
        parts = table[: int(used[0]) * TILE_CELLS].reshape(-1, TILE_CELLS, COLUMNS)
        keeps = (parts[:, :, kernels.VISITS] > 0).any(axis=1)
        kept = parts[keeps].reshape(-1, COLUMNS)
        number = np.append(np.where(keeps, np.cumsum(keeps) - 1, -1), -1).astype(np.int32)
        table[: len(kept)] = kept
        table[len(kept) :] = 0
        tiles[:] = number[tiles]
        used[0] = keeps.sum()

    def changed(self) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
        """Return row and column (n, 2) of the cells that speak for a change, and their rows.

        Returns:
            (n, 2) on the map, and (n, COLUMNS) of the table, copies.
        """
        tiles, table, used = self.arrays
        tile_rows, tile_cols = np.nonzero(tiles >= 0)
        corners = np.empty((int(used[0]), 2), np.int64)
        corners[tiles[tile_rows, tile_cols]] = np.column_stack([tile_rows, tile_cols]) * TILE
        index = np.flatnonzero(table[: int(used[0]) * TILE_CELLS, kernels.KIND] != kernels.NOTHING)
        inside = np.column_stack(np.divmod(index % TILE_CELLS, TILE))
        return corners[index // TILE_CELLS] + inside, table[index]

    def restore(self, where: NDArray[np.int64], rows: NDArray[np.int32]) -> None:
        """Take cells over as `changed` gave them, but for those that the map has taken up."""
        inside = self._grid.contains_cell(where)
        where, rows = where[inside], rows[inside]
        values = self._grid.cells[where[:, 0], where[:, 1]]
        is_wall = self._grid.occupied_mask()[where[:, 0], where[:, 1]] != 0
        is_floor = ~is_wall & (values >= 0)
        kind = rows[:, kernels.KIND]
        fits = ((kind == kernels.GONE) & is_wall) | ((kind == kernels.APPEARED) & is_floor)
        for (row, col), kept in zip(where[fits].tolist(), rows[fits], strict=True):
            self.make_room()
            at = kernels.claim_row(self.arrays, row, col)
            if at >= 0:
                self.arrays.table[at] = kept
                self.arrays.table[at, kernels.LOOK] = 0


def _empty_table(tiles: int) -> NDArray[np.int32]:
    return np.zeros((tiles * TILE_CELLS, COLUMNS), np.int32)
