"""Correlative scan matching by branch and bound.

Source:
    Olson, Real-Time Correlative Scan Matching (2009); Hess, Kohler, Rapp, Andor, Real-Time Loop
    Closure in 2D LIDAR SLAM (2016), section V-B.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley.scan_matching.layout import Cloud, Surfels
from trolley.slices import Slices

LAYERS = 4
"""Surfaces are drawn in layers by the side that they are seen from: the back of a wall must not be
laid over its front."""
SLICE_POINTS = 2_000_000
"""Points that are looked up in one slice of a search: some 5 to 10 ms of a PC's core, 20 to 40
of a small board's."""
ANY_SIDE = LAYERS
"""One layer more has all of them: for points of which it is not clear which side they show."""
IN_LAYER = 0.25
"""A layer takes what faces within 75 degrees of its middle (a cosine), so that points, which go to
the nearest middle, may err in their direction by 30."""


@kernel
def draw_likelihood(
    out_score: NDArray[np.uint8],
    surfels: Surfels,
    count: int,
    frame: NDArray[np.float64],
    sigma: float,
) -> None:
    """Write how well a point fits in each cell: 255 on a surface, less beside it.

    Args:
        out_score: (LAYERS + 1, rows, cols), overwritten; layer k has what faces k quarter turns,
            layer `ANY_SIDE` what is in any of the others.
        surfels: of the neighbourhood.
        count: how many there are.
        frame: (3,) x, y [m] of the outer corner of cell (0, 0), and cells per metre.
        sigma: standard deviation of a point [m].
    """
    out_score[:] = 0
    _, rows, cols = out_score.shape
    half = math.ceil(2.5 * sigma * frame[2])
    scale = -0.5 / (sigma * sigma * frame[2] * frame[2])
    for i in range(count):
        x = (surfels.place[i, 0] - frame[0]) * frame[2]
        y = (surfels.place[i, 1] - frame[1]) * frame[2]
        at_col = math.floor(x)
        at_row = math.floor(y)
        for layer in range(LAYERS):
            turn = layer * 0.5 * math.pi
            facing = surfels.normal[i, 0] * math.cos(turn) + surfels.normal[i, 1] * math.sin(turn)
            if facing < IN_LAYER:
                continue
            for row in range(max(at_row - half, 0), min(at_row + half + 1, rows)):
                for col in range(max(at_col - half, 0), min(at_col + half + 1, cols)):
                    dx = col + 0.5 - x
                    dy = row + 0.5 - y
                    value = np.uint8(255.0 * math.exp(scale * (dx * dx + dy * dy)))
                    if value > out_score[layer, row, col]:
                        out_score[layer, row, col] = value
                        out_score[ANY_SIDE, row, col] = max(out_score[ANY_SIDE, row, col], value)


@kernel
def fill_pyramid(levels: NDArray[np.uint8]) -> None:
    """Fill level h with the maxima over 2^h x 2^h cells up and right, from level 0.

    Args:
        levels: (heights, LAYERS + 1, rows, cols); level 0 is read, the others are overwritten.
    """
    heights, layers, rows, cols = levels.shape
    for at in range(layers, heights * layers):
        h = at // layers
        step = 1 << (h - 1)
        inside = max(cols - step, 0)
        below = levels[h - 1, at % layers]
        above = levels[h, at % layers]
        for row in range(rows):
            here, up = below[row], below[min(row + step, rows - 1)]
            fill_highest(above[row, :inside], here, up, here[step:], up[step:])
            fill_highest(above[row, inside:], here[inside:], up[inside:], here[-1:], up[-1:])


@kernel
def fill_highest(
    out: NDArray[np.uint8],
    here: NDArray[np.uint8],
    up: NDArray[np.uint8],
    right: NDArray[np.uint8],
    corner: NDArray[np.uint8],
) -> None:
    """Write the highest of four rows in each column; the last two may be one cell, for all."""
    if right.size < out.size:
        for col in range(out.size):
            out[col] = max(max(here[col], up[col]), max(right[0], corner[0]))
    else:  # plain enough for several columns to be done at once
        for col in range(out.size):
            out[col] = max(max(here[col], up[col]), max(right[col], corner[col]))


@kernel
def turn_cloud(
    out_cells: NDArray[np.int32],
    cloud: Cloud,
    yaws: NDArray[np.float64],
    frame: NDArray[np.float64],
    origin: NDArray[np.float64],
) -> None:
    """Write in which cell each point lies for each heading, with the base at `origin`.

    Args:
        out_cells: (yaws, points, 3), overwritten: row, col, and the layer of the side that the
            surface is seen from; `ANY_SIDE` where that is not clear.
        cloud: the points in `base_link`.
        yaws: (yaws,) [rad] in `map`.
        frame: (3,) of the grid, see `draw_likelihood`.
        origin: (2,) x, y [m] in `map`.
    """
    for a in range(yaws.size):
        cos = math.cos(yaws[a])
        sin = math.sin(yaws[a])
        for j in range(cloud.points.shape[0]):
            x = origin[0] + cos * cloud.points[j, 0] - sin * cloud.points[j, 1]
            y = origin[1] + sin * cloud.points[j, 0] + cos * cloud.points[j, 1]
            out_cells[a, j, 0] = math.floor((y - frame[1]) * frame[2])
            out_cells[a, j, 1] = math.floor((x - frame[0]) * frame[2])
            nx = cos * cloud.normals[j, 0] - sin * cloud.normals[j, 1]
            ny = sin * cloud.normals[j, 0] + cos * cloud.normals[j, 1]
            if nx == 0.0 and ny == 0.0:
                out_cells[a, j, 2] = ANY_SIDE
            elif abs(nx) > abs(ny):
                out_cells[a, j, 2] = 0 if nx > 0.0 else 2
            else:
                out_cells[a, j, 2] = 1 if ny > 0.0 else 3


class Placed(NamedTuple):
    """The points of a scan at one heading, as they are looked up."""

    inside: NDArray[np.uint32]
    """(points,) for those that no shift takes off the grid: the place of their cell in a level's
    memory, at the window's lower left corner."""
    edge: NDArray[np.int32]
    """(points, 3) of the others: row, col and layer without shift."""
    half: int
    """Half the window's edge [cells]."""


@kernel
def place(
    out_inside: NDArray[np.uint32],
    cells: NDArray[np.int32],
    shape: tuple[int, int, int],
    half: int,
    spare: int,
) -> Placed:
    """Tell which points no shift takes off the grid, and where in a level they are looked up.

    Args:
        out_inside: (points,), room for `Placed.inside`.
        cells: (points, 3) of one heading, from `turn_cloud`; put into another order.
        shape: of a level.
        half: half the window's edge [cells].
        spare: what a block reaches beyond the window [cells].
    """
    _, height, width = shape
    reach = 2 * half + spare
    count = 0
    for j in range(cells.shape[0]):
        row, col, layer = cells[j, 0], cells[j, 1], cells[j, 2]
        low, left = row - half, col - half
        if low < 0 or left < 0 or low + reach >= height or left + reach >= width:
            continue
        out_inside[count] = (layer * height + low) * width + left
        cells[j] = cells[count]
        cells[count, 0], cells[count, 1], cells[count, 2] = row, col, layer
        count += 1
    return Placed(out_inside[:count], cells[count:], half)


@kernel
def bound_at(level: NDArray[np.uint8], points: Placed, row: int, col: int, reach: int) -> float:
    """Return the highest mean score (0 to 1) of any shift in a block; exact where reach is 1.

    Args:
        level: (LAYERS + 1, rows, cols) maxima over `reach` cells up and right.
        points: at one heading.
        row: lowest shift of the block [cells]; `col` alike.
        col: see `row`.
        reach: shifts in the block along each axis.
    """
    total = np.int64(0)
    _, height, width = level.shape
    memory = level.reshape(-1)
    # Without a sign numba does not ask each time whether it counts from the end.
    offset = np.uint64((row + points.half) * width + col + points.half)
    for j in range(points.inside.size):
        total += memory[np.uint64(points.inside[j]) + offset]
    for j in range(points.edge.shape[0]):
        r = points.edge[j, 0] + row
        c = points.edge[j, 1] + col
        if -reach < r < height and -reach < c < width:
            # The first cell covers all that a block below the edge can reach.
            total += level[points.edge[j, 2], max(r, 0), max(c, 0)]
    count = points.inside.size + points.edge.shape[0]
    return float(total) / (255.0 * max(count, 1))


@kernel
def less_losses(
    score: float, row: int, col: int, reach: int, losses: tuple[float, float, int]
) -> float:
    """Return a score less what the shift in a block that loses least loses.

    Args:
        score: a bound of the block, or a shift's own where reach is 1.
        row: lowest shift of the block [cells]; `col` alike.
        col: see `row`.
        reach: shifts in the block along each axis.
        losses: twice the loss of score in the window's corner; that of the heading; half the
            window's edge [cells].
    """
    pull, turned, half = losses
    rows, cols = max(row, 1 - row - reach, 0), max(col, 1 - col - reach, 0)
    away = (rows * rows + cols * cols) / (2.0 * max(half * half, 1))
    return score - pull * 0.5 * away - turned


@kernel
def descend(
    out_best: NDArray[np.float64],
    levels: NDArray[np.uint8],
    points: Placed,
    block: tuple[int, int, float],
    window: tuple[float, float, int],
) -> int:
    """Search one block of the highest level, best parts first.

    Args:
        out_best: (5,) as in `new_best`; overwritten if a shift of the block is better.
        levels: (heights, LAYERS + 1, rows, cols) of `fill_pyramid`.
        points: at one heading.
        block: its lowest shift and its bound.
        window: loss of score at its border, loss for the heading, and the heading's index.

    Returns:
        The number of bounds that were computed.
    """
    pull, turned, heading = window
    half = points.half
    losses = (pull, turned, half)
    best = out_best[3]
    top = levels.shape[0] - 1
    stack = np.empty((4 * top + 8, 3), np.int64)
    bounds = np.empty(4 * top + 8)
    children, order = np.empty(4), np.empty(4, np.int64)
    stack[0, 0], stack[0, 1], stack[0, 2] = top, block[0], block[1]
    bounds[0] = block[2]
    depth = 1
    count = 0
    while depth > 0:
        depth -= 1
        h, row, col = stack[depth, 0], stack[depth, 1], stack[depth, 2]
        score = less_losses(bounds[depth], row, col, 1 << h, losses)
        if score < best:
            continue
        if h == 0:
            if abs(row) <= half and abs(col) <= half:
                best = score
                out_best[0], out_best[1], out_best[2] = bounds[depth], row, col
                out_best[3], out_best[4] = score, heading
            continue
        step = 1 << (h - 1)
        for k in range(4):
            r, c = row + step * (k // 2), col + step * (k % 2)
            children[k] = bound_at(levels[h - 1], points, r, c, step)
        count += 4
        for k in range(4):  # sorted by insertion, the highest last: it is searched first
            at = k
            while at > 0 and children[order[at - 1]] > children[k]:
                order[at] = order[at - 1]
                at -= 1
            order[at] = k
        for k in order:
            r, c = row + step * (k // 2), col + step * (k % 2)
            if less_losses(children[k], r, c, step, losses) >= best:
                stack[depth, 0], stack[depth, 1], stack[depth, 2] = h - 1, r, c
                bounds[depth] = children[k]
                depth += 1
    return count


class Blocks(NamedTuple):
    """What is left of a search once no part of it need be looked at that cannot be the best."""

    bounds: NDArray[np.float64]
    """(yaws * side * side,) the highest score in each block of the highest level."""
    inside: NDArray[np.uint32]
    """(yaws, points), room for `Placed.inside` at each heading."""
    counts: NDArray[np.int64]
    """(yaws,) how much of it is used."""
    half: int
    """Half the window's edge [cells]."""
    side: int
    """Number of blocks along the window's edge."""


@kernel
def bound_blocks(
    out: Blocks, levels: NDArray[np.uint8], cells: NDArray[np.int32], first: int, last: int
) -> None:
    """Compute the bounds of all blocks at some headings.

    Args:
        out: overwritten for these headings.
        levels: (heights, LAYERS + 1, rows, cols) of `fill_pyramid`.
        cells: (yaws, points, 3) of `turn_cloud`; put into another order.
        first: index of the first heading.
        last: index behind the last one.
    """
    top = levels.shape[0] - 1
    block = 1 << top
    half, side = out.half, out.side
    for a in range(first, last):
        points = place(out.inside[a], cells[a], levels.shape[1:], half, block)
        out.counts[a] = points.inside.size
        for at in range(side * side):
            row, col = at // side * block - half, at % side * block - half
            out.bounds[a * side * side + at] = bound_at(levels[top], points, row, col, block)


@kernel
def search_blocks(
    out_best: NDArray[np.float64],
    levels: NDArray[np.uint8],
    cells: NDArray[np.int32],
    blocks: Blocks,
    order: NDArray[np.int64],
    window: tuple[float, int, int],
) -> int:
    """Search blocks, the most promising first, until so many bounds have been computed.

    Args:
        out_best: (5,) as in `new_best`; overwritten if a shift is better.
        levels: (heights, LAYERS + 1, rows, cols) of `fill_pyramid`.
        cells: (yaws, points, 3) as `bound_blocks` has left them.
        blocks: with their bounds.
        order: of the blocks, the highest bound first.
        window: loss of score towards its corners, the place in `order` where to go on, and the
            number of bounds after which to stop.

    Returns:
        The place in `order` where to go on; its length when nothing is left that can be better.
    """
    pull, begin, most = window
    half, side = blocks.half, blocks.side
    block = 1 << (levels.shape[0] - 1)
    yaws = cells.shape[0]
    count = 0
    for k in range(begin, order.size):
        if count >= most:
            return k
        at = order[k]
        if blocks.bounds[at] < out_best[3]:
            return order.size
        a = at // (side * side)
        off = abs(2.0 * a / max(yaws - 1, 1) - 1.0)
        bound = float(blocks.bounds[at])
        at_block = ((at // side) % side * block - half, at % side * block - half, bound)
        losses = (pull, pull * 0.5 * off * off, half)
        if less_losses(bound, at_block[0], at_block[1], block, losses) < out_best[3]:
            continue
        points = Placed(blocks.inside[a, : blocks.counts[a]], cells[a, blocks.counts[a] :], half)
        count += descend(out_best, levels, points, at_block, (pull, pull * 0.5 * off * off, a))
    return order.size


def new_best(least: float) -> NDArray[np.float64]:
    """Return where the best is kept, (5,): score, rows, cols, score less its losses, heading.

    The heading is -1 as long as no score reaches `least`.
    """
    return np.array([-1.0, 0.0, 0.0, least, -1.0])


def find_best_shift(
    levels: NDArray[np.uint8], cells: NDArray[np.int32], half: int, least: float, pull: float
) -> Slices[NDArray[np.float64]]:
    """Find the shift and heading with the highest score in a square window.

    Args:
        levels: (heights, LAYERS + 1, rows, cols) of `fill_pyramid`.
        cells: (yaws, points, 3) of `turn_cloud`; put into another order.
        half: the window reaches from -half to half [cells].
        least: scores below this are not looked for.
        pull: loss of score towards the window's corners, for what cannot be told from the scan.

    Returns:
        What was found, as in `new_best`.
    """
    yaws, num_points = cells.shape[:2]
    block = 1 << (levels.shape[0] - 1)
    side = (2 * half + block) // block
    in_heading = side * side
    blocks = Blocks(
        np.empty(yaws * in_heading),
        np.empty((yaws, num_points), np.uint32),
        np.empty(yaws, np.int64),
        half,
        side,
    )
    most = max(SLICE_POINTS // max(num_points, 1), 1)
    headings = max(most // in_heading, 1)
    for first in range(0, yaws, headings):
        bound_blocks(blocks, levels, cells, first, min(first + headings, yaws))
        yield
    order = np.argsort(-blocks.bounds, kind="stable")
    best, at = new_best(least), 0
    while True:
        at = search_blocks(best, levels, cells, blocks, order, (pull, at, most))
        if at == len(order):
            return best
        yield
