"""The robot's outline as the planner uses it: radii for the path, points for exact checks."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.geometry.footprint import (
    circumscribed_radius,
    footprint_from_polygon,
    inscribed_radius,
)
from trolley.gridmap.kernels import interpolate
from trolley.jit import lean_kernel
from trolley_planner.people.moving_obstacles import NO_ROBOTS, NOBODY

EDGE_SPACING_M = 0.03
"""Spacing of the points on the edge; an obstacle between two of them seems 2 mm too far [m]."""
FEW_SPACING_M = 0.12
"""Spacing of the points for a first check; an obstacle at 0.15 m seems 12 mm too far [m]."""
NO_LIMITS = np.full((1, 1), np.inf, dtype=np.float32)
"""Stands for a costmap without speed zones."""


class Field(NamedTuple):
    """The grids of the local costmap, for look-ups at any point."""

    distance_m: NDArray[np.float32]
    """(rows, cols) fine cells: distance to the nearest obstacle."""
    cost_m: NDArray[np.float32]
    """(rows, cols) coarse cells: cost-to-go in metres of free floor."""
    speed_mps: NDArray[np.float32]
    """(rows, cols) of the whole costmap: limits of the speed zones; (1, 1) if there are none."""
    x: float
    """Corner of the local costmap [m]."""
    y: float
    fine_m: float
    """Edge of a fine cell."""
    coarse_m: float
    """Edge of a coarse cell."""
    cell_m: float
    """Edge of a cell of the costmap."""
    walkers: NDArray[np.float64] = NOBODY
    """(n, 7) people: x, y now [m], velocity [m/s], radius [m], its growth [m/s], time until they
    come upon somebody else [s]; they are not in the distances."""
    robots: NDArray[np.float64] = NO_ROBOTS
    """(n, steps, 3) discs of other robots that drive: x, y, radius [m], 0.1 s apart from now on."""


class Body(NamedTuple):
    """The robot's outline."""

    edge_points: NDArray[np.float64]
    """(n, 2) in `base_link`."""
    few_points: NDArray[np.float64]
    """(m, 2) the same, farther apart."""
    inscribed_m: float
    circumscribed_m: float

    def scaled(self, share: float) -> "Body":
        """Return one of the same shape and another size."""
        return Body(
            share * self.edge_points,
            share * self.few_points,
            share * self.inscribed_m,
            share * self.circumscribed_m,
        )


FEW_DO_M = 0.08
"""Clearance above which few points are exact enough, 2 cm too long at most [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Footprint:
    """The robot's outline in `base_link`.

    Attributes:
        polygon: (n, 2) corners, counter-clockwise [m].
        edge_points: (m, 2) points on the outline, at most `EDGE_SPACING_M` apart [m].
        few_points: (k, 2) the same, at most `FEW_SPACING_M` apart [m].
        inscribed_m: radius of the largest circle about the origin inside the outline.
        circumscribed_m: radius of the smallest circle about the origin around the outline.
    """

    polygon: NDArray[np.float64]
    edge_points: NDArray[np.float64]
    few_points: NDArray[np.float64]
    inscribed_m: float
    circumscribed_m: float

    @classmethod
    def from_polygon(cls, corners: Sequence[tuple[float, float]]) -> "Footprint":
        """Make a footprint of its corners [m], in either sense of rotation.

        Raises:
            ValueError: with a sentence for people, if it is no outline around `base_link`.
        """
        polygon = footprint_from_polygon(corners)
        return cls(
            polygon,
            _edge_points(polygon, EDGE_SPACING_M),
            _edge_points(polygon, FEW_SPACING_M),
            inscribed_radius(polygon),
            circumscribed_radius(polygon),
        )

    @property
    def body(self) -> Body:
        """The same as the kernels take it."""
        return Body(self.edge_points, self.few_points, self.inscribed_m, self.circumscribed_m)


def _edge_points(polygon: NDArray[np.float64], spacing_m: float) -> NDArray[np.float64]:
    """Return points along all edges, corners included."""
    parts: list[NDArray[np.float64]] = []
    for start, end in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        count = max(1, math.ceil(float(np.hypot(*(end - start))) / spacing_m))
        parts.append(start + (np.arange(count)[:, None] / count) * (end - start))
    return np.concatenate(parts)


@lean_kernel
def clearance_at(
    field: Field, body: Body, x: float, y: float, yaw: float, enough_m: float
) -> float:
    """Return the distance from the footprint to the nearest obstacle [m], at most `enough_m`.

    It is negative where an obstacle lies well inside.
    """
    return clearance_turned(field, body, (x, y), (math.cos(yaw), math.sin(yaw)), enough_m)


@lean_kernel
def clearance_turned(
    field: Field,
    body: Body,
    place: tuple[float, float],
    turned: tuple[float, float],
    enough_m: float,
) -> float:
    """Return the same as `clearance_at` for a heading given as its cosine and sine."""
    scale = 1.0 / field.fine_m
    u, v = (place[0] - field.x) * scale, (place[1] - field.y) * scale
    half = 0.5 * field.fine_m
    centre = interpolate(field.distance_m, u - 0.5, v - 0.5) - half
    if centre >= body.circumscribed_m + enough_m:
        return enough_m
    if centre < body.inscribed_m:
        # Less than what edge points in an obstacle give, so that clearance rises all the way out.
        return centre - body.inscribed_m - half
    outline = (body.few_points, body.edge_points)
    face = (turned[0] * scale, turned[1] * scale)
    return min(outline_clearance(field.distance_m, outline, (u, v), face, half), enough_m)


@lean_kernel
def outline_clearance(
    distance_m: NDArray[np.float32],
    outline: tuple[NDArray[np.float64], NDArray[np.float64]],
    place: tuple[float, float],
    turned: tuple[float, float],
    half_m: float,
) -> float:
    """Return the clearance of the outline's edge [m].

    Args:
        distance_m: (rows, cols) fine cells.
        outline: few points on the edge, and all.
        place: x, y in cells.
        turned: cosine and sine of the heading, in cells.
        half_m: half a cell.
    """
    nearest = nearest_of(distance_m, outline[0], place, turned) - half_m
    if nearest < FEW_DO_M:
        nearest = nearest_of(distance_m, outline[1], place, turned) - half_m
    return nearest


@lean_kernel
def nearest_of(
    distance_m: NDArray[np.float32],
    points: NDArray[np.float64],
    place: tuple[float, float],
    turned: tuple[float, float],
) -> float:
    """Return the least distance at points (n, 2) [m] of a body, at a place and turned [cells]."""
    u, v = place
    cos, sin = turned
    nearest = math.inf
    for index in range(points.shape[0]):
        px, py = points[index, 0], points[index, 1]
        x, y = u + cos * px - sin * py, v + sin * px + cos * py
        distance = interpolate(distance_m, x - 0.5, y - 0.5)
        nearest = min(nearest, distance)
    return nearest
