"""Groups of cells that changed together, and how far what is gone reaches."""

import numpy as np
from numpy.typing import NDArray

from trolley.gridmap import OCCUPIED_FROM
from trolley.jit import kernel
from trolley_localizer.kernels.changes import HIT, REACH, Ledger, find_row


@kernel
def is_at_edge(cells: NDArray[np.int8], row: int, col: int) -> bool:
    """Say whether floor is near to a cell of a wall: there nothing is seen through for certain."""
    for r in range(max(row - REACH, 0), min(row + REACH + 1, cells.shape[0])):
        for c in range(max(col - REACH, 0), min(col + REACH + 1, cells.shape[1])):
            if 0 <= cells[r, c] < OCCUPIED_FROM:
                return True
    return False


@kernel
def grow_gone(
    mask: NDArray[np.uint8],
    corner: tuple[int, int],
    ledger: Ledger,
    cells: NDArray[np.int8],
    since_s: int,
) -> None:
    """Grow what is gone over its edges, as far as they were not seen to stand.

    Args:
        mask: (rows, cols) of a window on the map: 1 where something is gone; grows.
        corner: row and column on the map where the window begins.
        ledger: what is known of the cells.
        cells: (rows, cols) of the map.
        since_s: walls where echoes ended later than this stand [s].
    """
    rows, cols = mask.shape
    for _ in range(REACH):
        before = mask.copy()
        for row in range(rows):
            for col in range(cols):
                if before[row, col] or cells[corner[0] + row, corner[1] + col] < OCCUPIED_FROM:
                    continue
                touches = (
                    (row > 0 and before[row - 1, col])
                    or (row + 1 < rows and before[row + 1, col])
                    or (col > 0 and before[row, col - 1])
                    or (col + 1 < cols and before[row, col + 1])
                )
                if not touches:
                    continue
                at = find_row(ledger, corner[0] + row, corner[1] + col)
                stands = at >= 0 and ledger.table[at, HIT] > since_s
                if not stands and is_at_edge(cells, corner[0] + row, corner[1] + col):
                    mask[row, col] = 1
