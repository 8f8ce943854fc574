"""Shapes of groups of cells: boxes, convex outlines, and strokes that cover them."""

import numpy as np
from numpy.typing import NDArray

Box = tuple[int, int, int, int]
"""First row, first column, last row, last column."""

Cells = NDArray[np.int64]
"""(n, 2) row, column."""


def box_of(cells: Cells) -> Box:
    """Return the box of at least one cell."""
    low, high = cells.min(axis=0).tolist(), cells.max(axis=0).tolist()
    return low[0], low[1], high[0], high[1]


def shared(one: Box, other: Box) -> float:
    """Return which share of the smaller box lies in the other, 0 ... 1."""
    rows = min(one[2], other[2]) - max(one[0], other[0]) + 1
    cols = min(one[3], other[3]) - max(one[1], other[1]) + 1
    if rows <= 0 or cols <= 0:
        return 0.0
    return rows * cols / min(_area(one), _area(other))


def _area(box: Box) -> int:
    return (box[2] - box[0] + 1) * (box[3] - box[1] + 1)


def convex_hull(cells: Cells) -> NDArray[np.float64]:
    """Return the corners (n, 2) x, y [cells] of the convex hull of cells, counter-clockwise.

    Source:
        Andrew, Another efficient algorithm for convex hulls in two dimensions (1979).
    """
    rows, cols = cells.T
    corners = {
        (x, y)
        for dx in (0, 1)
        for dy in (0, 1)
        for x, y in zip((cols + dx).tolist(), (rows + dy).tolist(), strict=True)
    }
    points = sorted(corners)
    halves = _half(points)[:-1] + _half(points[::-1])[:-1]
    return np.array(halves, np.float64)


def _half(points: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return the hull below sorted points, as one goes along them."""
    hull: list[tuple[int, int]] = []
    for x, y in points:
        while len(hull) > 1:
            (ax, ay), (bx, by) = hull[-2:]
            if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0:
                break
            hull.pop()
        hull.append((x, y))
    return hull


def runs_of(cells: Cells) -> NDArray[np.float64]:
    """Return strokes (n, 2, 2) of x, y [cells], along rows or columns, whichever are fewer.

    Each goes from the middle of its first cell to that of its last: drawn one cell wide they cover
    the cells and nothing else.
    """
    along_rows = _runs(cells)
    along_cols = _runs(cells[:, ::-1])[:, :, ::-1]
    return along_rows if len(along_rows) <= len(along_cols) else along_cols


def _runs(cells: Cells) -> NDArray[np.float64]:
    """Return the strokes along the second number of the cells, as (second, first)."""
    ordered = cells[np.lexsort((cells[:, 1], cells[:, 0]))]
    breaks = (np.diff(ordered[:, 0]) != 0) | (np.diff(ordered[:, 1]) != 1)
    firsts = ordered[np.append(True, breaks)]
    lasts = ordered[np.append(breaks, True)]
    return np.stack([firsts[:, ::-1], lasts[:, ::-1]], axis=1).astype(np.float64) + 0.5
