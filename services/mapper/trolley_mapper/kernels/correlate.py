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

LAYERS = 4
"""Surfaces are drawn in layers by the side that they are seen from: the back of a wall must not be
laid over its front."""
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
def descend(
    out_best: NDArray[np.float64],
    levels: NDArray[np.uint8],
    points: Placed,
    block: tuple[int, int, float],
    window: tuple[float, float],
) -> float:
    """Search one block of the highest level, best parts first.

    Args:
        out_best: (4,) score, rows, cols, as in `find_best_shift`; overwritten if one is better.
        levels: (heights, LAYERS + 1, rows, cols) of `fill_pyramid`.
        points: at one heading.
        block: its lowest shift and its bound.
        window: loss of score at its border, loss for the heading.

    Returns:
        The best score so far, losses taken off.
    """
    pull, turned = window
    half = points.half
    best = out_best[3]
    top = levels.shape[0] - 1
    stack = np.empty((4 * top + 8, 3), np.int64)
    bounds = np.empty(4 * top + 8)
    children = np.empty(4)
    stack[0, 0], stack[0, 1], stack[0, 2] = top, block[0], block[1]
    bounds[0] = block[2]
    depth = 1
    while depth > 0:
        depth -= 1
        if bounds[depth] < best:
            continue
        h, row, col = stack[depth, 0], stack[depth, 1], stack[depth, 2]
        if h == 0:
            away = (row * row + col * col) / (2.0 * max(half * half, 1))
            score = bounds[depth] - pull * 0.5 * away - turned
            if score >= best and abs(row) <= half and abs(col) <= half:
                best = score
                out_best[0], out_best[1], out_best[2] = bounds[depth], row, col
                out_best[3] = score
            continue
        step = 1 << (h - 1)
        for k in range(4):
            r, c = row + step * (k // 2), col + step * (k % 2)
            children[k] = bound_at(levels[h - 1], points, r, c, step)
        for k in np.argsort(children):
            if children[k] >= best:
                stack[depth, 0] = h - 1
                stack[depth, 1] = row + step * (k // 2)
                stack[depth, 2] = col + step * (k % 2)
                bounds[depth] = children[k]
                depth += 1
    return best


@kernel
def find_best_shift(
    out_best: NDArray[np.float64],
    levels: NDArray[np.uint8],
    cells: NDArray[np.int32],
    half: int,
    least: float,
    pull: float,
) -> int:
    """Find the shift and heading with the highest score in a square window.

    Args:
        out_best: (4,) score, rows, cols, and score with the loss taken off, overwritten.
        levels: (heights, LAYERS + 1, rows, cols) of `fill_pyramid`.
        cells: (yaws, points, 3) of `turn_cloud`; put into another order.
        half: the window reaches from -half to half [cells].
        least: scores below this are not looked for.
        pull: loss of score towards the window's corners, for what cannot be told from the scan.

    Returns:
        The index of the heading; -1 where no score reaches `least`.
    """
    top = levels.shape[0] - 1
    yaws = cells.shape[0]
    block = 1 << top
    side = (2 * half + block) // block
    bounds = np.empty(yaws * side * side)
    inside = np.empty(cells.shape[:2], np.uint32)
    counts = np.empty(yaws, np.int64)
    for a in range(yaws):
        points = place(inside[a], cells[a], levels.shape[1:], half, block)
        counts[a] = points.inside.size
        for at in range(side * side):
            row, col = at // side * block - half, at % side * block - half
            bounds[a * side * side + at] = bound_at(levels[top], points, row, col, block)
    found = -1
    best = least
    kept = np.empty(4)
    out_best[3] = least
    for at in np.argsort(-bounds):
        if bounds[at] < best:
            break
        a = at // (side * side)
        off = abs(2.0 * a / max(yaws - 1, 1) - 1.0)
        bound = float(bounds[at])
        at_block = ((at // side) % side * block - half, at % side * block - half, bound)
        window = (pull, pull * 0.5 * off * off)
        out_best[0] = -1.0
        points = Placed(inside[a, : counts[a]], cells[a, counts[a] :], half)
        score = descend(out_best, levels, points, at_block, window)
        if out_best[0] >= 0.0:
            best = score
            found = a
            kept[:] = out_best
    out_best[:] = kept
    return found
