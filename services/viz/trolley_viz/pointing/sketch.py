"""A zone as it is drawn: its corners, what is wrong with them, and where they snap to a wall.

All points are x, y [m] in the frame that is drawn.
"""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trolley.geometry.polygon import (
    MAX_CORNERS,
    check_polygon,
    distance_to_segments,
    find_crossing,
    polygon_contains,
    signed_area,
)
from trolley.gridmap import OCCUPIED_FROM
from trolley.messages import OccupancyGrid, Zone
from trolley.messages.mapping import ZoneKind
from trolley.zones import LINE_KINDS

Point = tuple[float, float]

KIND_NAMES: dict[ZoneKind, str] = {
    "mirror": "mirror",
    "glass": "glass",
    "keepout": "no-go area",
    "speed": "slow area",
    "room": "room",
}
"""What people call each kind; a new zone is called so, with a number."""

SNAP_M = 0.15
"""A corner of a mirror or glass line snaps to a wall within this distance."""
MIN_LENGTH_M = 0.02
FAR_CELLS = 1e9
"""Far outside every map, and still a whole number of cells."""


@dataclass(frozen=True)
class Sketch:
    """The corners so far, in the order in which they were drawn."""

    kind: ZoneKind
    points: tuple[Point, ...] = ()

    @property
    def is_line(self) -> bool:
        """Whether it is a line, not an area."""
        return self.kind in LINE_KINDS

    def add(self, point: Point) -> "Sketch":
        """Add a corner; there is room for `MAX_CORNERS`."""
        return replace(self, points=(*self.points, point)[:MAX_CORNERS])

    def take_back(self) -> "Sketch":
        """Remove the corner that was added last."""
        return replace(self, points=self.points[:-1])

    def moved_corner(self, index: int, point: Point) -> "Sketch":
        """Put one corner elsewhere."""
        return replace(self, points=(*self.points[:index], point, *self.points[index + 1 :]))

    def moved(self, dx: float, dy: float) -> "Sketch":
        """Move the whole [m]."""
        return replace(self, points=tuple((x + dx, y + dy) for x, y in self.points))

    @property
    def middle(self) -> Point:
        """The mean of the corners."""
        x, y = np.mean(np.array(self.points), axis=0).tolist()
        return x, y

    def closes_at(self, point: Point, reach_m: float) -> bool:
        """Whether a corner there would end the drawing: at the last one, or at an area's first."""
        is_area = not self.is_line and len(self.points) >= 3
        ends = self.points[-1:] + (self.points[:1] if is_area else ())
        return any(math.dist(point, end) <= reach_m for end in ends)

    def crosses(self) -> bool:
        """Whether the outline of an area crosses itself."""
        if self.is_line or len(self.points) < 4:
            return False
        return find_crossing(np.array(self.points)) is not None

    def problem(self) -> str:
        """Say in a sentence why it is no zone yet; "" if it is one."""
        points = np.array(self.points, dtype=np.float64).reshape(-1, 2)
        if self.is_line:
            if len(points) < 2:
                return "A line needs at least two corners."
            length = float(np.hypot(*np.diff(points, axis=0).T).sum())
            return "" if length >= MIN_LENGTH_M else "This line is too short."
        if len(points) < 3:
            return "An area needs at least three corners."
        if self.crosses():
            return "The outline crosses itself."
        try:
            check_polygon(points)
        except ValueError:
            return "This area is too thin."
        return ""


def free_name(kind: ZoneKind, taken: Collection[str]) -> str:
    """Name a new zone after its kind, with the first free number."""
    number = 1
    while f"{KIND_NAMES[kind]} {number}" in taken:
        number += 1
    return f"{KIND_NAMES[kind]} {number}"


def zone_at(zones: Sequence[Zone], point: Point, reach_m: float) -> Zone | None:
    """The zone that a person means who points there: the nearest line, else the smallest area."""
    at = np.array([point], dtype=np.float64)
    near: list[tuple[float, int]] = []
    over: list[tuple[float, int]] = []
    for i, zone in enumerate(zones):
        corners = np.array(zone.points, dtype=np.float64)
        if zone.kind in LINE_KINDS:
            distance = float(distance_to_segments(at, corners[:-1], corners[1:])[0])
            if distance <= reach_m:
                near.append((distance, i))
        elif polygon_contains(corners, at)[0]:
            over.append((abs(signed_area(corners)), i))
    found = near or over
    return zones[min(found)[1]] if found else None


def snap_to_wall(grid: OccupancyGrid, point: Point, reach_m: float = SNAP_M) -> Point:
    """Move a point to the nearest face of a wall; it stays where none is within reach.

    Args:
        grid: the map.
        point: x, y [m] in the map's frame.
        reach_m: up to this distance it snaps to a wall [m].
    """
    if not (math.isfinite(point[0]) and math.isfinite(point[1])):
        return point
    at = grid.origin.inverse().transform_points(np.array([point]))[0] / grid.resolution
    at = np.clip(at, -FAR_CELLS, FAR_CELLS)
    faces = _wall_faces(grid, at, reach_m / grid.resolution)
    if not len(faces):
        return point
    # In cells: a face is one cell long and lies along a row or a column.
    nearest = np.clip(at, faces[:, 0], faces[:, 1])
    gaps = np.hypot(*(nearest - at).T)
    best = int(np.argmin(gaps))
    if gaps[best] * grid.resolution > reach_m:
        return point
    x, y = grid.origin.transform_points(nearest[best : best + 1] * grid.resolution)[0].tolist()
    return x, y


def _wall_faces(grid: OccupancyGrid, at: NDArray[np.float64], reach: float) -> NDArray[np.float64]:
    """The borders between a wall's cells and the others around a point (n, 2, 2), in cells."""
    cells = np.frombuffer(grid.cells, np.int8).reshape(grid.height, grid.width)
    col0, row0 = np.maximum(np.floor(at - reach).astype(np.int64) - 1, 0)
    col1, row1 = np.floor(at + reach).astype(np.int64) + 2
    walls = cells[row0 : max(row1, 0), col0 : max(col1, 0)] >= OCCUPIED_FROM
    faces: list[NDArray[np.float64]] = []
    for along, step in ((0, np.array([1.0, 0.0])), (1, np.array([0.0, 1.0]))):
        rows, cols = np.nonzero(np.diff(walls.astype(np.int8), axis=along))
        start = np.stack([cols + col0, rows + row0], axis=1) + (1.0 - step)
        faces.append(np.stack([start, start + step], axis=1))
    return np.concatenate(faces)
