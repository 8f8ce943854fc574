"""Compiled loops that put a scan into the costmap: where beams lie, what they clear and mark.

Everything is in frame `grid` [m]: x along the columns, y along the rows, the origin at the outer
corner of cell (0, 0).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley_planner.kernels.angles import wrapped

X, Y, DX, DY, CLEAR, ECHO = range(6)
"""Columns of a beam: start [m], direction, length that is free [m], distance of the echo [m]."""

TICK_S = 0.1
"""Unit of the times kept per cell [s]: coarse, so that 32 bits last for years."""

MAX_EVIDENCE = 12
"""Scans without an echo that a well-seen cell outlives."""
MARK_EVIDENCE = 3
"""Evidence that each scan with an echo adds; one that sees through takes away 1."""


class EchoLayer(NamedTuple):
    """What the lidar has seen, per cell: the arrays of `trolley_planner.echoes.Echoes`."""

    evidence: NDArray[np.uint8]
    """(rows, cols) 0 = no obstacle seen."""
    hits: NDArray[np.uint8]
    """(rows, cols) scans that confirmed it, saturating."""
    seen_ticks: NDArray[np.int32]
    """(rows, cols) robot time of the last echo, in `TICK_S`."""
    points: NDArray[np.float32]
    """(rows, cols, 2) where in the cell the last echo lay [m]."""
    observed: NDArray[np.uint8]
    """(rows, cols) 1 where some beam has passed."""
    touched: NDArray[np.int32]
    """(rows, cols, 2) number of the scan that last saw through, and that last marked."""
    dirty: NDArray[np.int64]
    """(4,) first and last row, first and last column of what changed since it was reset."""


class ScanShape(NamedTuple):
    """How the beams of a scan lie, in frame `laser`."""

    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float


@kernel
def touch(dirty: NDArray[np.int64], row: int, col: int) -> None:
    """Extend the box of changed cells by one cell."""
    dirty[0] = min(dirty[0], row)
    dirty[1] = max(dirty[1], row)
    dirty[2] = min(dirty[2], col)
    dirty[3] = max(dirty[3], col)


@kernel
def inside_polygon(polygon: NDArray[np.float64], x: float, y: float) -> bool:
    """Say whether a point lies in a polygon (n, 2), by counting crossings."""
    inside = False
    previous = polygon.shape[0] - 1
    for index in range(polygon.shape[0]):
        x1, y1 = polygon[index, 0], polygon[index, 1]
        x2, y2 = polygon[previous, 0], polygon[previous, 1]
        if (y1 > y) != (y2 > y) and x < (x2 - x1) * (y - y1) / (y2 - y1) + x1:
            inside = not inside
        previous = index
    return inside


@kernel
def place_beams_into(
    out_beams: NDArray[np.float64],
    ranges_m: NDArray[np.float32],
    shape: ScanShape,
    start_grid: NDArray[np.float64],
    end_grid: NDArray[np.float64],
    body_laser: NDArray[np.float64],
    clear_max_m: float,
) -> None:
    """Write where each beam starts and points, how far it is free, and where its echo lies.

    Beams that tell nothing (invalid, or hitting the robot's own body) get length 0.

    Args:
        out_beams: (n, 6), overwritten.
        ranges_m: (n,) +inf = no echo, 0 or NaN = invalid.
        shape: of the scan.
        start_grid: (3,) pose of the lidar at the first beam: x, y [m], yaw [rad].
        end_grid: (3,) pose of the lidar at the last beam; in between it moves evenly.
        body_laser: (m, 2) the robot's outline in frame `laser` [m].
        clear_max_m: beams count as free up to here at most [m].
    """
    count = ranges_m.shape[0]
    turn = wrapped(end_grid[2] - start_grid[2])
    reach = 0.0
    for corner in range(body_laser.shape[0]):
        reach = max(reach, math.hypot(body_laser[corner, 0], body_laser[corner, 1]))
    for beam in range(count):
        share = beam / (count - 1) if count > 1 else 0.0
        angle = shape.angle_min + beam * shape.angle_increment
        yaw = start_grid[2] + share * turn + angle
        out_beams[beam, X] = start_grid[0] + share * (end_grid[0] - start_grid[0])
        out_beams[beam, Y] = start_grid[1] + share * (end_grid[1] - start_grid[1])
        out_beams[beam, DX] = math.cos(yaw)
        out_beams[beam, DY] = math.sin(yaw)
        out_beams[beam, CLEAR] = 0.0
        out_beams[beam, ECHO] = 0.0
        measured = float(ranges_m[beam])
        if math.isnan(measured) or measured <= 0.0 or measured < shape.range_min:
            continue
        if measured > shape.range_max:  # +inf too
            out_beams[beam, CLEAR] = min(clear_max_m, shape.range_max)
            continue
        on_body = measured <= reach and inside_polygon(
            body_laser, measured * math.cos(angle), measured * math.sin(angle)
        )
        if not on_body:
            out_beams[beam, CLEAR] = min(measured, clear_max_m)
            out_beams[beam, ECHO] = measured


@kernel
def cut_at_lines(
    beams: NDArray[np.float64], segments: NDArray[np.float64], tolerance_m: float
) -> None:
    """End each beam at the first mirror or glass it crosses; its echo is then no obstacle.

    Args:
        beams: (n, 6), changed in place.
        segments: (m, 4) x1, y1, x2, y2 [m]: mirrors and glass.
        tolerance_m: how far beyond its ends a segment still counts, for the error of the pose;
            an echo that close in front of it is the mirror itself.
    """
    for beam in range(beams.shape[0]):
        if beams[beam, CLEAR] <= 0.0:
            continue
        x, y, dx, dy = beams[beam, X], beams[beam, Y], beams[beam, DX], beams[beam, DY]
        length = max(beams[beam, CLEAR], beams[beam, ECHO])
        for index in range(segments.shape[0]):
            ax, ay = segments[index, 0], segments[index, 1]
            sx, sy = segments[index, 2] - ax, segments[index, 3] - ay
            size = math.hypot(sx, sy)
            cross = dx * sy - dy * sx
            if size == 0.0 or abs(cross) < 1e-9 * size:
                continue
            along = ((ax - x) * sy - (ay - y) * sx) / cross
            share = ((ax - x) * dy - (ay - y) * dx) / cross
            margin = tolerance_m / size
            if along <= 0.0 or share < -margin or share > 1.0 + margin:
                continue
            if along <= length + tolerance_m:
                beams[beam, CLEAR] = min(beams[beam, CLEAR], along)
                if beams[beam, ECHO] > along - tolerance_m:
                    beams[beam, ECHO] = 0.0


@kernel
def see_through(layer: EchoLayer, row: int, col: int, scan_number: int) -> None:
    """Note that a beam passed a cell; evidence falls once a scan, however many beams pass."""
    if layer.observed[row, col] == 0:
        layer.observed[row, col] = 1
        touch(layer.dirty, row, col)
    if layer.evidence[row, col] == 0 or layer.touched[row, col, 0] == scan_number:
        return
    layer.touched[row, col, 0] = scan_number
    layer.evidence[row, col] -= 1
    if layer.evidence[row, col] == 0:
        layer.hits[row, col] = 0
        touch(layer.dirty, row, col)


@kernel
def trace_beams(
    layer: EchoLayer,
    walls: NDArray[np.uint8],
    beams: NDArray[np.float64],
    resolution_m: float,
    scan_number: int,
) -> None:
    """Clear the cells that beams pass, up to the first wall of the map.

    What a beam shows behind a wall of the map is a reflection or an error of the pose: its echo
    is dropped, and nothing behind the wall is cleared.

    Args:
        layer: changed in place.
        walls: (rows, cols), set where rays end.
        beams: (n, 6); echoes behind walls are set to 0.
        resolution_m: cell edge [m].
        scan_number: differs from that of every other scan.

    Source:
        Amanatides, Woo, A Fast Voxel Traversal Algorithm for Ray Tracing (1987).
    """
    rows, cols = walls.shape
    for beam in range(beams.shape[0]):
        # The cell of the echo and the one before it are the obstacle's.
        reach = beams[beam, CLEAR] / resolution_m
        if beams[beam, ECHO] > 0.0:
            reach = min(reach, beams[beam, ECHO] / resolution_m - 0.7)
        if reach <= 0.0:
            continue
        x, y = beams[beam, X] / resolution_m, beams[beam, Y] / resolution_m
        dx, dy = beams[beam, DX], beams[beam, DY]
        row, col = math.floor(y), math.floor(x)
        step_col, step_row = (1 if dx > 0.0 else -1), (1 if dy > 0.0 else -1)
        per_col = abs(1.0 / dx) if dx != 0.0 else math.inf
        per_row = abs(1.0 / dy) if dy != 0.0 else math.inf
        next_x = ((col + (dx > 0.0)) - x) / dx if dx != 0.0 else math.inf
        next_y = ((row + (dy > 0.0)) - y) / dy if dy != 0.0 else math.inf
        travelled = 0.0
        while travelled < reach and 0 <= row < rows and 0 <= col < cols:
            if walls[row, col]:
                beams[beam, ECHO] = 0.0
                beams[beam, CLEAR] = travelled * resolution_m
                break
            see_through(layer, row, col, scan_number)
            if next_x < next_y:
                travelled, col = next_x, col + step_col
                next_x += per_col
            else:
                travelled, row = next_y, row + step_row
                next_y += per_row


@kernel
def mark_echoes(
    layer: EchoLayer,
    wall_distance_m: NDArray[np.float32],
    beams: NDArray[np.float64],
    limits_m: tuple[float, float, float],
    scan_number: int,
    now_ticks: int,
) -> None:
    """Mark the cells of echoes that the map does not explain.

    Args:
        layer: changed in place.
        wall_distance_m: (rows, cols) distance of each cell to the nearest wall of the map.
        beams: (n, 6).
        limits_m: cell edge; echoes farther than the second are not marked; echoes nearer to a
            wall than the third are the wall.
        scan_number: of this scan, as in `trace_beams`, which comes first.
        now_ticks: robot time of the scan, in `TICK_S`.
    """
    rows, cols = wall_distance_m.shape
    resolution_m, mark_max_m, explained_m = limits_m
    for beam in range(beams.shape[0]):
        echo = beams[beam, ECHO]
        if echo <= 0.0 or echo > mark_max_m:
            continue
        x = beams[beam, X] + echo * beams[beam, DX]
        y = beams[beam, Y] + echo * beams[beam, DY]
        row, col = math.floor(y / resolution_m), math.floor(x / resolution_m)
        if not (0 <= row < rows and 0 <= col < cols) or wall_distance_m[row, col] < explained_m:
            continue
        layer.points[row, col, 0] = x
        layer.points[row, col, 1] = y
        if layer.touched[row, col, 1] == scan_number:
            continue
        layer.touched[row, col, 1] = scan_number
        layer.seen_ticks[row, col] = now_ticks
        # A beam beside the echo may have seen through the same cell in this scan.
        passed = 1 if layer.touched[row, col, 0] == scan_number else 0
        before = int(layer.evidence[row, col]) + passed
        if layer.evidence[row, col] == 0:
            touch(layer.dirty, row, col)
        layer.evidence[row, col] = min(before + MARK_EVIDENCE, MAX_EVIDENCE)
        layer.hits[row, col] = min(int(layer.hits[row, col]) + 1, 255)


@kernel
def fade(layer: EchoLayer, now_ticks: int, kept_ticks: tuple[int, int, int]) -> None:
    """Forget what has not been seen for long: the sooner, the less often it was confirmed.

    People leave few echoes in each cell, furniture many, so what moves is forgotten first.

    Args:
        layer: changed in place.
        now_ticks: robot time, in `TICK_S`.
        kept_ticks: how long a cell is kept at least, how much longer for each scan that
            confirmed it, and how long at most.
    """
    rows, cols = layer.evidence.shape
    least, per_hit, most = kept_ticks
    for row in range(rows):
        for col in range(cols):
            if layer.evidence[row, col] == 0:
                continue
            kept = min(least + per_hit * int(layer.hits[row, col]), most)
            if now_ticks - layer.seen_ticks[row, col] > kept:
                layer.evidence[row, col] = 0
                layer.hits[row, col] = 0
                touch(layer.dirty, row, col)


@kernel
def forget_near(layer: EchoLayer, x_cells: float, y_cells: float, radius_cells: float) -> None:
    """Forget every obstacle seen whose cell centre lies within a circle [cells]."""
    rows, cols = layer.evidence.shape
    for row in range(
        max(0, math.floor(y_cells - radius_cells)), min(rows, math.ceil(y_cells + radius_cells))
    ):
        for col in range(
            max(0, math.floor(x_cells - radius_cells)),
            min(cols, math.ceil(x_cells + radius_cells)),
        ):
            near = math.hypot(col + 0.5 - x_cells, row + 0.5 - y_cells) <= radius_cells
            if near and layer.evidence[row, col] > 0:
                layer.evidence[row, col] = 0
                layer.hits[row, col] = 0
                touch(layer.dirty, row, col)


@kernel
def forget_inside(layer: EchoLayer, polygon_cells: NDArray[np.float64], resolution_m: float) -> None:
    """Forget every obstacle whose last echo lay inside a polygon (n, 2) [cells].

    Where the robot is nothing else can be; a lidar that does not look all round would never see
    that what it once saw there is gone.
    """
    rows, cols = layer.evidence.shape
    for row in range(
        max(0, math.floor(polygon_cells[:, 1].min())),
        min(rows, math.ceil(polygon_cells[:, 1].max())),
    ):
        for col in range(
            max(0, math.floor(polygon_cells[:, 0].min())),
            min(cols, math.ceil(polygon_cells[:, 0].max())),
        ):
            if layer.evidence[row, col] == 0:
                continue
            x = layer.points[row, col, 0] / resolution_m
            y = layer.points[row, col, 1] / resolution_m
            if inside_polygon(polygon_cells, x, y):
                layer.evidence[row, col] = 0
                layer.hits[row, col] = 0
                touch(layer.dirty, row, col)


@kernel
def doubt(layer: EchoLayer, points: NDArray[np.float64], resolution_m: float) -> None:
    """Take the echoes of what moves for no more than a first sight: they are soon forgotten.

    Args:
        layer: changed in place.
        points: (n, 2) x, y of the echoes [m].
        resolution_m: cell edge [m].
    """
    rows, cols = layer.evidence.shape
    for index in range(points.shape[0]):
        row = math.floor(points[index, 1] / resolution_m)
        col = math.floor(points[index, 0] / resolution_m)
        if 0 <= row < rows and 0 <= col < cols and layer.evidence[row, col] > 0:
            layer.evidence[row, col] = min(int(layer.evidence[row, col]), MARK_EVIDENCE)
            layer.hits[row, col] = 1
