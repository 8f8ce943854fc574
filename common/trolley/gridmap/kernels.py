"""Compiled loops over grids: distances and rays. Row-major cells, no I/O.

All lengths inside are in cells; x runs along the columns, y along the rows.
"""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel


@kernel
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
    none = rows + cols
    for col in range(cols):
        out_cells[0, col] = 0 if mask[0, col] else none
    for row in range(1, rows):
        for col in range(cols):
            out_cells[row, col] = 0 if mask[row, col] else min(out_cells[row - 1, col] + 1, none)
    for row in range(rows - 2, -1, -1):
        for col in range(cols):
            out_cells[row, col] = min(out_cells[row, col], out_cells[row + 1, col] + 1)


@kernel
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


@kernel
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


@kernel
def cast_ray(occupied: NDArray[np.uint8], x: float, y: float, angle: float, reach: float) -> float:
    """Return how far a ray runs before it enters an occupied cell [cells], or +inf.

    Args:
        occupied: (rows, cols), set where not 0.
        x: start along the columns [cells]; may lie outside the grid.
        y: start along the rows [cells].
        angle: direction [rad], counter-clockwise from +x.
        reach: farther hits do not count [cells].

    A ray whose start or direction is not finite hits nothing.

    Source:
        Amanatides, Woo, A Fast Voxel Traversal Algorithm for Ray Tracing (1987).
    """
    if not math.isfinite(x + y + angle):
        return math.inf
    rows, cols = occupied.shape
    dx, dy = math.cos(angle), math.sin(angle)
    travelled, leave = clip_to_grid(x, y, dx, dy, cols, rows)
    if not travelled <= min(leave, reach):
        return math.inf
    col = min(max(math.floor(x + travelled * dx), 0), cols - 1)
    row = min(max(math.floor(y + travelled * dy), 0), rows - 1)
    step_col, step_row = (1 if dx > 0.0 else -1), (1 if dy > 0.0 else -1)
    next_x = ((col + (dx > 0.0)) - x) / dx if dx != 0.0 else math.inf
    next_y = ((row + (dy > 0.0)) - y) / dy if dy != 0.0 else math.inf
    per_col = abs(1.0 / dx) if dx != 0.0 else math.inf
    per_row = abs(1.0 / dy) if dy != 0.0 else math.inf
    while travelled <= reach:
        if occupied[row, col]:
            return travelled
        if next_x < next_y:
            travelled, col = next_x, col + step_col
            next_x += per_col
        else:
            travelled, row = next_y, row + step_row
            next_y += per_row
        if col < 0 or col >= cols or row < 0 or row >= rows:
            break
    return math.inf


@kernel
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
