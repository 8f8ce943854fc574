"""Compiled loops over grids: distances and rays. Row-major cells, no I/O.

All lengths inside are in cells; x runs along the columns, y along the rows.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel, lean_kernel


@lean_kernel
def column_distances_into(out_cells: NDArray[np.int32], mask: NDArray[np.uint8]) -> None:
    """Write for each cell how many rows away the nearest set cell of its column is.

    Args:
        out_cells: (rows, cols), overwritten; rows + cols where the column has none.
        mask: (rows, cols), set where not 0.

    Source:
        Meijster, Roerdink, Hesselink, A General Algorithm for Computing Distance Transforms in
        Linear Time (2000), phase 1: for a binary mask two sweeps replace the first envelope.
    """
    rows, cols = mask.shape
    none = np.int32(rows + cols)
    out_cells[0] = none
    step_down_into(out_cells[0], mask[0], out_cells[0], none)
    for row in range(1, rows):
        step_down_into(out_cells[row], mask[row], out_cells[row - 1], none)
    for row in range(rows - 2, -1, -1):
        step_up(out_cells[row], out_cells[row + 1])


@lean_kernel
def step_down_into(
    out_cells: NDArray[np.int32],
    mask: NDArray[np.uint8],
    above: NDArray[np.int32],
    none: np.int32,
) -> None:
    """Write the distances along columns (n,) of a row by those of the row before."""
    # Over whole rows and without branches, so that the processor does many at once.
    for col in range(out_cells.shape[0]):
        farther = min(np.int32(above[col] + np.int32(1)), none)
        out_cells[col] = np.int32(0) if mask[col] != 0 else farther


@lean_kernel
def step_up(cells: NDArray[np.int32], below: NDArray[np.int32]) -> None:
    """Lower the distances along columns (n,) of a row by those of the row after it."""
    for col in range(cells.shape[0]):
        cells[col] = min(cells[col], np.int32(below[col] + np.int32(1)))


@lean_kernel
def row_envelope(
    vertices: NDArray[np.int64],
    starts: NDArray[np.float64],
    heights: NDArray[np.float64],
    column_cells: NDArray[np.int32],
    reach: int,
) -> int:
    """Find the lower envelope of the parabolas (x - col)^2 + column_cells[col]^2 of one row.

    Args:
        vertices: (cols,) scratch: column of each parabola of the envelope, left to right.
        starts: (cols,) scratch: where each becomes the lowest [cells].
        heights: (cols,) scratch: the parabola's height at its column [cells^2].
        column_cells: (cols,) distance along each column [cells].
        reach: parabolas higher than this at their column are left out [cells].

    Returns:
        The number of parabolas in the envelope.

    Source:
        Felzenszwalb, Huttenlocher, Distance Transforms of Sampled Functions (2012), algorithm 1.
    """
    count = 0
    for col in range(column_cells.shape[0]):
        if column_cells[col] > reach:
            continue
        height = float(column_cells[col]) * float(column_cells[col])
        start = -math.inf
        while count > 0:
            vertex = vertices[count - 1]
            # Whole numbers below 2^53 throughout, so only the division rounds, and by less
            # than the 1 / (2 cols) by which a crossing can miss a cell.
            rise = (height + col * col) - (heights[count - 1] + vertex * vertex)
            start = rise / (2.0 * (col - vertex))
            if start > starts[count - 1]:
                break
            count -= 1
            start = -math.inf
        vertices[count] = col
        starts[count] = start
        heights[count] = height
        count += 1
    return count


@kernel
def distance_transform_into(
    out_m: NDArray[np.float32],
    column_cells: NDArray[np.int32],
    resolution_m: float,
    limit_m: float,
) -> None:
    """Write the distance between the centres of each cell and of the nearest set cell.

    Args:
        out_m: (rows, cols) [m], overwritten; at most `limit_m`.
        column_cells: (rows, cols) from `column_distances_into`.
        resolution_m: cell edge [m].
        limit_m: longer distances are cut off here [m]; may be infinite.
    """
    rows, cols = out_m.shape
    reach = rows + cols - 1
    if limit_m < reach * resolution_m:
        reach = math.ceil(limit_m / resolution_m)
    limit = np.float32(limit_m)
    scale = np.float32(resolution_m)
    vertices = np.empty(cols, np.int64)
    starts = np.empty(cols, np.float64)
    heights = np.empty(cols, np.float64)
    for row in range(rows):
        count = row_envelope(vertices, starts, heights, column_cells[row], reach)
        if count == 0:
            out_m[row, :] = limit
            continue
        first = 0
        for index in range(count):
            last = cols
            if index + 1 < count and starts[index + 1] < cols:
                last = max(math.floor(starts[index + 1]) + 1, 0)
            vertex = vertices[index]
            height = np.float32(heights[index])
            for col in range(first, last):
                offset = np.float32(col - vertex)
                out_m[row, col] = min(scale * np.sqrt(offset * offset + height), limit)
            first = max(first, last)


@lean_kernel
def clip_to_grid(
    x: float, y: float, dx: float, dy: float, cols: int, rows: int
) -> tuple[float, float]:
    """Return where along a ray it enters and leaves the grid; enter > leave if it misses.

    Args:
        x: start [cells].
        y: start [cells].
        dx: direction, unit length together with `dy`.
        dy: direction.
        cols: grid size [cells].
        rows: grid size [cells].

    Source:
        Kay, Kajiya, Ray Tracing Complex Scenes (1986), slab test.
    """
    enter, leave = 0.0, math.inf
    for start, step, size in ((x, dx, float(cols)), (y, dy, float(rows))):
        if step == 0.0:
            if not 0.0 <= start < size:
                return 1.0, 0.0
        else:
            near, far = -start / step, (size - start) / step
            if near > far:
                near, far = far, near
            enter, leave = max(enter, near), min(leave, far)
    return enter, leave


class March(NamedTuple):
    """A ray in one of the cells that it passes; all lengths along the ray in cells."""

    row: int
    col: int
    travelled: float
    """From the start of the ray to where it enters this cell."""
    next_col: float
    """From the start of the ray to the next border between columns; `next_row` alike."""
    next_row: float
    per_col: float
    """Between two borders between columns; `per_row` alike."""
    per_row: float
    step_col: int
    """The column after this border is so many further: 1 or -1; `step_row` alike."""
    step_row: int


@lean_kernel
def begin_march(
    start: tuple[float, float],
    direction: tuple[float, float],
    cell: tuple[int, int],
    travelled: float,
) -> March:
    """Begin to march along a ray from cell to cell.

    Args:
        start: x, y of the ray [cells].
        direction: x, y, a unit vector.
        cell: row and column in which the march begins.
        travelled: where along the ray that is [cells].

    Source:
        Amanatides, Woo, A Fast Voxel Traversal Algorithm for Ray Tracing (1987).
    """
    (x, y), (dx, dy), (row, col) = start, direction, cell
    return March(
        row,
        col,
        travelled,
        ((col + (dx > 0.0)) - x) / dx if dx != 0.0 else math.inf,
        ((row + (dy > 0.0)) - y) / dy if dy != 0.0 else math.inf,
        abs(1.0 / dx) if dx != 0.0 else math.inf,
        abs(1.0 / dy) if dy != 0.0 else math.inf,
        1 if dx > 0.0 else -1,
        1 if dy > 0.0 else -1,
    )


@lean_kernel
def next_cell(at: March) -> March:
    """Return the march in the next cell of its ray."""
    steps = at.per_col, at.per_row, at.step_col, at.step_row
    if at.next_col < at.next_row:
        col, travelled = at.col + at.step_col, at.next_col
        return March(at.row, col, travelled, at.next_col + at.per_col, at.next_row, *steps)
    row, travelled = at.row + at.step_row, at.next_row
    return March(row, at.col, travelled, at.next_col, at.next_row + at.per_row, *steps)


@lean_kernel
def first_occupied(
    occupied: NDArray[np.uint8], x: float, y: float, dx: float, dy: float, reach: float
) -> float:
    """Return how far a ray runs before it enters an occupied cell [cells], or +inf.

    Args:
        occupied: (rows, cols), set where not 0.
        x: start along the columns [cells]; may lie outside the grid.
        y: start along the rows [cells].
        dx: direction, unit length together with `dy`.
        dy: direction.
        reach: farther hits do not count [cells].
    """
    rows, cols = occupied.shape
    enter, leave = clip_to_grid(x, y, dx, dy, cols, rows)
    if not enter <= min(leave, reach):
        return math.inf
    col = min(max(math.floor(x + enter * dx), 0), cols - 1)
    row = min(max(math.floor(y + enter * dy), 0), rows - 1)
    at = begin_march((x, y), (dx, dy), (row, col), enter)
    while at.travelled <= reach and 0 <= at.row < rows and 0 <= at.col < cols:
        if occupied[at.row, at.col]:
            return at.travelled
        at = next_cell(at)
    return math.inf


@lean_kernel
def cast_ray(occupied: NDArray[np.uint8], x: float, y: float, angle: float, reach: float) -> float:
    """Return how far a ray runs before it enters an occupied cell [cells], or +inf.

    As `first_occupied`, by an angle [rad], counter-clockwise from +x. A ray whose start or
    direction is not finite hits nothing.
    """
    if not math.isfinite(x + y + angle):
        return math.inf
    return first_occupied(occupied, x, y, math.cos(angle), math.sin(angle), reach)


@lean_kernel
def cast_rays_into(
    out_m: NDArray[np.float32],
    occupied: NDArray[np.uint8],
    resolution_m: float,
    x_grid: float,
    y_grid: float,
    angles_grid: NDArray[np.float64],
    max_range_m: float,
) -> None:
    """Write how far each ray runs before it enters an occupied cell.

    Args:
        out_m: (n,) [m], overwritten; +inf where nothing is hit.
        occupied: (rows, cols), set where not 0.
        resolution_m: cell edge [m].
        x_grid: start in frame `grid` [m].
        y_grid: start in frame `grid` [m].
        angles_grid: (n,) directions in frame `grid` [rad].
        max_range_m: farther hits do not count [m]; may be infinite.
    """
    x, y, reach = x_grid / resolution_m, y_grid / resolution_m, max_range_m / resolution_m
    for ray in range(angles_grid.shape[0]):
        out_m[ray] = resolution_m * cast_ray(occupied, x, y, angles_grid[ray], reach)


@lean_kernel
def interpolate(values: NDArray[np.float32], x_cells: float, y_cells: float) -> float:
    """Return a grid's value between cell centres; outside, that of the nearest cell.

    Args:
        values: (rows, cols), at least two of each.
        x_cells: from the centre of the first column [cells].
        y_cells: from the centre of the first row [cells].
    """
    rows, cols = values.shape
    u = min(max(x_cells, 0.0), cols - 1.001)
    v = min(max(y_cells, 0.0), rows - 1.001)
    col, row = math.floor(u), math.floor(v)
    a, b = u - col, v - row
    low = values[row, col] + a * (values[row, col + 1] - values[row, col])
    high = values[row + 1, col] + a * (values[row + 1, col + 1] - values[row + 1, col])
    return low + b * (high - low)


@lean_kernel
def disc_box(
    x_cells: float, y_cells: float, radius_cells: float, rows: int, cols: int
) -> tuple[int, int, int, int]:
    """Return the cells about a disc: the first row and column, and those after the last."""
    return (
        max(0, math.floor(y_cells - radius_cells)),
        max(0, math.floor(x_cells - radius_cells)),
        min(rows, math.ceil(y_cells + radius_cells)),
        min(cols, math.ceil(x_cells + radius_cells)),
    )


@lean_kernel
def is_in_disc(row: int, col: int, x_cells: float, y_cells: float, radius_cells: float) -> bool:
    """Say whether a cell's centre lies within a disc."""
    return math.hypot(col + 0.5 - x_cells, row + 0.5 - y_cells) <= radius_cells


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
