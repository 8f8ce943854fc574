"""Branch and bound over all poses of the map.

Source:
    Hess, Kohler, Rapp, Andor, Real-Time Loop Closure in 2D LIDAR SLAM (2016), section V-B. The
    maxima are kept per block of cells instead of per cell (a looser bound, 1/3 more memory in all
    instead of a full table per level), and every pose within a margin of the best is found.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley.scanning import Points

_TWO_PI = 2.0 * math.pi


class Pyramid(NamedTuple):
    """All levels of the map in two flat arrays; level h has blocks of 2^h cells.

    Attributes:
        score: uint8, per block the best score of it and its three neighbours up and right; level 0
            holds the cells themselves.
        free: uint8, per block 1 where the robot may stand in some cell.
        offset: (levels,) int64, where each level begins.
        rows: (levels,) int64, blocks along y.
        cols: (levels,) int64, blocks along x.
    """

    score: NDArray[np.uint8]
    free: NDArray[np.uint8]
    offset: NDArray[np.int64]
    rows: NDArray[np.int64]
    cols: NDArray[np.int64]


class Found(NamedTuple):
    """The best poses so far, unordered.

    Attributes:
        score: (k,) float32, mean table value of the beams; negative where the slot is empty.
        row: (k,) int32, cell of the robot; `col` alike.
        col: see `row`.
        turn: (k,) int32, index of the heading.
    """

    score: NDArray[np.float32]
    row: NDArray[np.int32]
    col: NDArray[np.int32]
    turn: NDArray[np.int32]


@kernel
def reduce_level(pyramid: Pyramid, blocks: NDArray[np.uint8], level: int) -> None:
    """Fill level `level` >= 1 from the plain block maxima of the level below.

    Args:
        pyramid: its level is overwritten.
        blocks: flat scratch: block maxima of the level below, replaced by those of this level.
        level: see above.
    """
    rows, cols = pyramid.rows[level], pyramid.cols[level]
    below_rows, below_cols = pyramid.rows[level - 1], pyramid.cols[level - 1]
    below_free = pyramid.free[pyramid.offset[level - 1] :]
    free = pyramid.free[pyramid.offset[level] :]
    score = pyramid.score[pyramid.offset[level] :]
    for r in range(rows):
        for c in range(cols):
            best = np.uint8(0)
            is_free = np.uint8(0)
            for y in range(2 * r, min(2 * r + 2, below_rows)):
                for x in range(2 * c, min(2 * c + 2, below_cols)):
                    best = max(best, blocks[y * below_cols + x])
                    is_free |= below_free[y * below_cols + x]
            # Blocks are read at or beyond where they are written, row by row.
            blocks[r * cols + c] = best
            free[r * cols + c] = is_free
    for r in range(rows):
        for c in range(cols):
            best = np.uint8(0)
            for y in range(r, min(r + 2, rows)):
                for x in range(c, min(c + 2, cols)):
                    best = max(best, blocks[y * cols + x])
            score[r * cols + c] = best


@kernel
def turn_points(
    out_row: NDArray[np.int32], out_col: NDArray[np.int32], points: Points, turns: int
) -> None:
    """Round the end points to cells for each heading.

    Args:
        out_row: (turns, beams), overwritten: cells up from the robot's cell; `out_col` alike.
        out_col: see `out_row`.
        points: (beams,) in `base_link` [cells].
        turns: headings evenly over the circle.
    """
    for t in range(turns):
        yaw = _TWO_PI * t / turns
        cos = math.cos(yaw)
        sin = math.sin(yaw)
        for j in range(points.x.size):
            out_col[t, j] = math.floor(cos * points.x[j] - sin * points.y[j] + 0.5)
            out_row[t, j] = math.floor(sin * points.x[j] + cos * points.y[j] + 0.5)


@kernel
def bound_block(
    pyramid: Pyramid,
    level: int,
    row: int,
    col: int,
    beam_rows: NDArray[np.int32],
    beam_cols: NDArray[np.int32],
) -> float:
    """Return the highest mean score that any pose of a block can reach (exact at level 0).

    Args:
        pyramid: of the map.
        level: of the block.
        row: of the block; `col` alike.
        col: see `row`.
        beam_rows: (beams,) int32, see `turn_points`; `beam_cols` alike.
        beam_cols: see `beam_rows`.
    """
    rows, cols, offset = pyramid.rows[level], pyramid.cols[level], pyramid.offset[level]
    total = np.int64(0)
    beams = beam_rows.size
    for j in range(beams):
        r = row + (beam_rows[j] >> level)
        c = col + (beam_cols[j] >> level)
        # The first block outside still reaches into the map with its neighbours.
        if -1 <= r < rows and -1 <= c < cols:
            if level == 0:
                if r >= 0 and c >= 0:
                    total += pyramid.score[offset + r * cols + c]
            else:
                total += pyramid.score[offset + max(r, 0) * cols + max(c, 0)]
    return float(total) / max(beams, 1)


@kernel
def keep_best(
    found: Found, score: float, row: int, col: int, turn: int, apart: NDArray[np.int64]
) -> float:
    """Keep a pose if it is the best of its neighbourhood and among the best overall.

    Args:
        found: in place.
        score: of the pose.
        row: cell of the robot; `col` alike.
        col: see `row`.
        turn: index of the heading.
        apart: (3,) cells and headings within which poses are the same place, and headings in all.

    Returns:
        The best score of all.
    """
    lowest = 0
    best = score
    for k in range(found.score.size):
        if found.score[k] > best:
            best = found.score[k]
        if found.score[k] < found.score[lowest]:
            lowest = k
    for k in range(found.score.size):
        if found.score[k] < 0.0:
            continue
        turned = abs(found.turn[k] - turn)
        turned = min(turned, apart[2] - turned)
        if (
            abs(found.row[k] - row) <= apart[0]
            and abs(found.col[k] - col) <= apart[0]
            and turned <= apart[1]
        ):
            if score <= found.score[k]:
                return best
            lowest = k
            break
    if score > found.score[lowest]:
        found.score[lowest] = score
        found.row[lowest] = row
        found.col[lowest] = col
        found.turn[lowest] = turn
    return best


@kernel
def bound_top(
    out_bound: NDArray[np.float32],
    pyramid: Pyramid,
    level: int,
    beam_rows: NDArray[np.int32],
    beam_cols: NDArray[np.int32],
) -> None:
    """Bound every block of one level for every heading.

    Args:
        out_bound: (turns, rows, cols) of the level, overwritten; -1 where the robot cannot be.
        pyramid: of the map.
        level: see above.
        beam_rows: (turns, beams), see `turn_points`; `beam_cols` alike.
        beam_cols: see `beam_rows`.
    """
    rows, cols, offset = pyramid.rows[level], pyramid.cols[level], pyramid.offset[level]
    for t in range(beam_rows.shape[0]):
        for r in range(rows):
            for c in range(cols):
                if pyramid.free[offset + r * cols + c] == 0:
                    out_bound[t, r, c] = -1.0
                    continue
                out_bound[t, r, c] = bound_block(pyramid, level, r, c, beam_rows[t], beam_cols[t])


@kernel
def descend(
    found: Found,
    pyramid: Pyramid,
    node: NDArray[np.int64],
    leaf_level: int,
    beams: tuple[NDArray[np.int32], NDArray[np.int32]],
    apart: NDArray[np.int64],
    limits: NDArray[np.float64],
) -> int:
    """Search one block down to single poses, depth first, best child first.

    Args:
        found: in place.
        pyramid: of the map.
        node: (4,) level, row, col and heading of the block.
        leaf_level: blocks of this level count as one pose.
        beams: (turns, beams) rows and columns, see `turn_points`.
        apart: see `keep_best`.
        limits: (4,) best score so far, overwritten; how far below it a pose may lie; the lowest
            score worth keeping; and the number of bounds after which `search_blocks` pauses.

    Returns:
        The number of bounds that were computed.
    """
    turn = node[3]
    num_bounds = 0
    stack = np.empty((4 * 24, 3), np.int64)
    bounds = np.empty(4 * 24, np.float64)
    stack[0, 0], stack[0, 1], stack[0, 2] = node[0], node[1], node[2]
    bounds[0] = 1e9
    size = 1
    while size > 0:
        size -= 1
        level, row, col = stack[size, 0], stack[size, 1], stack[size, 2]
        if bounds[size] < max(limits[0] - limits[1], limits[2]):
            continue
        if level == leaf_level:
            half = (1 << level) >> 1
            limits[0] = max(
                limits[0],
                keep_best(
                    found, bounds[size], (row << level) + half, (col << level) + half, turn, apart
                ),
            )
            continue
        below = level - 1
        first = size
        for y in range(2 * row, min(2 * row + 2, pyramid.rows[below])):
            for x in range(2 * col, min(2 * col + 2, pyramid.cols[below])):
                if pyramid.free[pyramid.offset[below] + y * pyramid.cols[below] + x] == 0:
                    continue
                bound = bound_block(pyramid, below, y, x, beams[0][turn], beams[1][turn])
                num_bounds += 1
                if bound < max(limits[0] - limits[1], limits[2]):
                    continue
                at = size
                while at > first and bounds[at - 1] > bound:
                    bounds[at] = bounds[at - 1]
                    stack[at] = stack[at - 1]
                    at -= 1
                bounds[at] = bound
                stack[at, 0], stack[at, 1], stack[at, 2] = below, y, x
                size += 1
    return num_bounds


@kernel
def search_blocks(
    found: Found,
    pyramid: Pyramid,
    order: NDArray[np.int64],
    bounds: NDArray[np.float32],
    levels: NDArray[np.int64],
    beams: tuple[NDArray[np.int32], NDArray[np.int32]],
    apart: NDArray[np.int64],
    limits: NDArray[np.float64],
) -> int:
    """Descend into the top blocks, most promising first, until none can hold a good pose.

    Args:
        found: in place.
        pyramid: of the map.
        order: (n,) flat indices into `bounds`, best first, of those that are left.
        bounds: (turns, rows, cols) of the top level.
        levels: (2,) top and leaf level.
        beams: see `descend`.
        apart: see `keep_best`.
        limits: see `descend`.

    Returns:
        How many of `order` are done: all of them, or as many as were reached before a pause.
    """
    num_bounds = 0
    _, rows, cols = bounds.shape
    flat = bounds.ravel()
    node = np.empty(4, np.int64)
    for k in range(order.size):
        i = order[k]
        if flat[i] < max(limits[0] - limits[1], limits[2]):
            return order.size
        if num_bounds >= limits[3]:
            return k
        node[0] = levels[0]
        node[1] = (i // cols) % rows
        node[2] = i % cols
        node[3] = i // (rows * cols)
        num_bounds += descend(found, pyramid, node, levels[1], beams, apart, limits)
    return order.size
