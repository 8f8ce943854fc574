"""Turns a world file and its map into the arrays that the kernels read."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.gridmap import GridMap, distance_transform
from trolley_base.world.gaps import Walls
from trolley_base.world.rays import DULL, GLASS, MIRROR, MIRROR_LEFT, OPAQUE, UNSEEN
from trolley_base.world.spec import Box, WorldSpec

# A bucket of wall edges: large enough that a room has few, small enough that one holds few edges.
BUCKET_M = 0.5
MAP = "map"


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """Straight pieces that belong to numbered bodies, in `map`.

    Attributes:
        points: (n, 4) x, y, x, y [m].
        kinds: (n,) uint8, the kinds of `rays`.
        echoes: (n, 2) share of beams that come back, incidence within which all do [rad].
        body: (n,) int64.
    """

    points: NDArray[np.float64]
    kinds: NDArray[np.uint8]
    echoes: NDArray[np.float64]
    body: NDArray[np.int64]

    def joined(self, other: "Segments") -> "Segments":
        """Return both sets of pieces together."""
        return Segments(
            np.concatenate([self.points, other.points]),
            np.concatenate([self.kinds, other.kinds]),
            np.concatenate([self.echoes, other.echoes]),
            np.concatenate([self.body, other.body]),
        )


def polyline(points: NDArray[np.float64], closed: bool) -> NDArray[np.float64]:
    """Return the pieces (n, 4) of a line through points (m, 2)."""
    following = np.roll(points, -1, axis=0)
    pieces = np.hstack([points, following])
    return np.ascontiguousarray(pieces if closed else pieces[:-1])


def pieces_of(
    points: NDArray[np.float64], body: int, kind: int = OPAQUE, echo: tuple[float, float] = (0, 0)
) -> Segments:
    """Return segments (n, 4) as pieces of one body of one kind."""
    count = len(points)
    return Segments(
        points,
        np.full(count, kind, dtype=np.uint8),
        np.tile(np.array(echo, dtype=np.float64), (count, 1)),
        np.full(count, body, dtype=np.int64),
    )


def no_segments() -> Segments:
    """Return an empty set of pieces."""
    return pieces_of(np.empty((0, 4)), 0)


def build_walls(grid: GridMap) -> Walls:
    """Prepare the map: which cells are solid, how far they are, and their outlines in buckets."""
    solid = grid.occupied_mask()
    per_bucket = max(1, round(BUCKET_M / grid.resolution))
    lines_grid, rows, cols = _cell_outlines(solid, per_bucket)
    bucket_rows = -(-grid.rows // per_bucket)
    bucket_cols = -(-grid.cols // per_bucket)
    bucket = rows * bucket_cols + cols
    order = np.argsort(bucket, kind="stable")
    bounds = np.searchsorted(bucket[order], np.arange(bucket_rows * bucket_cols + 1))
    buckets = np.stack([bounds[:-1], bounds[1:]], axis=1).reshape(bucket_rows, bucket_cols, 2)
    ends_grid = lines_grid[order].reshape(-1, 2) * grid.resolution
    origin = grid.origin
    return Walls(
        frame=np.array(
            [origin.x, origin.y, math.cos(origin.yaw), math.sin(origin.yaw), grid.resolution]
        ),
        solid=solid,
        distance=distance_transform(solid, grid.resolution),
        edges=np.ascontiguousarray(origin.transform_points(ends_grid).reshape(-1, 4)),
        buckets=np.ascontiguousarray(buckets.astype(np.int64)),
        bucket_edge=np.array([per_bucket * grid.resolution]),
    )


def _cell_outlines(
    solid: NDArray[np.uint8], per_bucket: int
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Return the borders between solid and free cells as long segments, cut at bucket borders.

    Returns:
        (n, 4) x, y, x, y in cells; (n,) row and (n,) col of each one's bucket.
    """
    rows, cols = solid.shape
    level = np.diff(np.pad(solid.astype(np.int8), ((1, 1), (0, 0))), axis=0) != 0
    upright = np.diff(np.pad(solid.astype(np.int8), ((0, 0), (1, 1))), axis=1) != 0
    at_row, from_col, to_col = _runs(level, per_bucket)
    at_col, from_row, to_row = _runs(np.ascontiguousarray(upright.T), per_bucket)
    lines = np.concatenate(
        [
            np.stack([from_col, at_row, to_col, at_row], axis=1),
            np.stack([at_col, from_row, at_col, to_row], axis=1),
        ]
    )
    bucket_row = np.concatenate([np.minimum(at_row, rows - 1), from_row]) // per_bucket
    bucket_col = np.concatenate([from_col, np.minimum(at_col, cols - 1)]) // per_bucket
    return lines.astype(np.float64), bucket_row, bucket_col


def _runs(
    marks: NDArray[np.bool_], cut: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return line, first and end of each run of marks along axis 1, cut at multiples of `cut`."""
    goes_on = np.zeros((marks.shape[0], marks.shape[1] + 1), dtype=np.bool_)
    goes_on[:, 1:-1] = marks[:, :-1] & marks[:, 1:]
    goes_on[:, ::cut] = False
    before, after = goes_on[:, :-1], goes_on[:, 1:]
    line, first = np.nonzero(marks & ~before)
    _, last = np.nonzero(marks & ~after)
    return line, first, last + 1


def build_segments(spec: WorldSpec) -> tuple[Segments, list[str]]:
    """Return the straight pieces of the world's things and the names of their bodies.

    Body 0 is the map and has no pieces here.
    """
    names, segments = [MAP], no_segments()
    for index, box in enumerate(spec.box):
        kind = OPAQUE if box.seen else UNSEEN
        outline = polyline(_corners(box), closed=True)
        segments = segments.joined(pieces_of(outline, len(names), kind))
        names.append(box.name or f"box {index}")
    for index, mirror in enumerate(spec.mirror):
        kind = MIRROR if mirror.side == "both" else MIRROR_LEFT
        line = polyline(np.array(mirror.points, dtype=np.float64), closed=False)
        segments = segments.joined(pieces_of(line, len(names), kind, (mirror.echo_share, 0.0)))
        names.append(mirror.name or f"mirror {index}")
    for index, pane in enumerate(spec.glass):
        line = polyline(np.array(pane.points, dtype=np.float64), closed=False)
        echo = (1.0 - pane.transmission, pane.echo_within)
        segments = segments.joined(pieces_of(line, len(names), GLASS, echo))
        names.append(pane.name or f"glass {index}")
    for index, surface in enumerate(spec.dull):
        line = polyline(np.array(surface.points, dtype=np.float64), closed=False)
        echo = (surface.echo_share, surface.echo_within)
        segments = segments.joined(pieces_of(line, len(names), DULL, echo))
        names.append(surface.name or f"dull {index}")
    return segments, names


def _corners(box: Box) -> NDArray[np.float64]:
    half_length, half_width = 0.5 * box.length_m, 0.5 * box.width_m
    corners = np.array(
        [
            [half_length, half_width],
            [-half_length, half_width],
            [-half_length, -half_width],
            [half_length, -half_width],
        ]
    )
    return Pose2D(box.x, box.y, box.yaw).transform_points(corners)
