"""Groups of cells that changed together, and how far what is gone reaches."""

import numpy as np
from numpy.typing import NDArray

from trolley.gridmap import OCCUPIED_FROM
from trolley.jit import kernel
from trolley_localizer.kernels.changes import HIT, REACH, Ledger, find_row


@kernel
def spread_over(
    out_labels: NDArray[np.int32], seeds: NDArray[np.uint8], members: NDArray[np.uint8], gap: int
) -> int:
    """Number the groups of members that hold a seed.

    Args:
        out_labels: (rows, cols) overwritten: 0 outside all groups, else the group's number.
        seeds: (rows, cols) 1 where there is one; each is a member.
        members: (rows, cols) 1 where there is one.
        gap: members this near to each other, row by row and column by column, are of one group.

    Returns:
        How many groups there are.
    """
    rows, cols = members.shape
    out_labels[:] = 0
    waiting = np.empty(members.size, np.int64)
    count = 0
    for first in range(members.size):
        if not seeds[first // cols, first % cols] or out_labels[first // cols, first % cols]:
            continue
        count += 1
        out_labels[first // cols, first % cols] = count
        waiting[0] = first
        size = 1
        while size > 0:
            size -= 1
            row, col = waiting[size] // cols, waiting[size] % cols
            for r in range(max(row - gap, 0), min(row + gap + 1, rows)):
                for c in range(max(col - gap, 0), min(col + gap + 1, cols)):
                    if members[r, c] and out_labels[r, c] == 0:
                        out_labels[r, c] = count
                        waiting[size] = r * cols + c
                        size += 1
    return count


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
