"""Compiled look-ups in the window: what a grid holds between its cells, and the clearance.

Everything is in frame `grid` [m].
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel

NOBODY = np.empty((0, 5))
"""Nobody walks."""
NO_ROBOTS = np.empty((0, 1, 3))
"""No other robot drives."""
NO_LIMITS = np.full((1, 1), np.inf, dtype=np.float32)
"""Stands for a costmap without speed zones."""


class Field(NamedTuple):
    """What the window holds, for look-ups at any point."""

    distance_m: NDArray[np.float32]
    """(rows, cols) fine cells: distance to the nearest obstacle."""
    cost_m: NDArray[np.float32]
    """(rows, cols) coarse cells: cost-to-go in metres of free floor."""
    speed_mps: NDArray[np.float32]
    """(rows, cols) of the whole costmap: limits of the speed zones; (1, 1) if there are none."""
    x: float
    """Corner of the window [m]."""
    y: float
    fine_m: float
    """Edge of a fine cell."""
    coarse_m: float
    """Edge of a coarse cell."""
    cell_m: float
    """Edge of a cell of the costmap."""
    walkers: NDArray[np.float64] = NOBODY
    """(n, 5) who walks: x, y now [m], velocity [m/s], radius [m]; they are not in the distances."""
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


FEW_DO_M = 0.08
"""Clearances larger than this need not be exact: few points find them, 2 cm too long at most."""


@kernel
def bilinear(values: NDArray[np.float32], x_cells: float, y_cells: float) -> float:
    """Return a grid's value between cell centres; outside, that of the nearest cell."""
    rows, cols = values.shape
    u = min(max(x_cells - 0.5, 0.0), cols - 1.001)
    v = min(max(y_cells - 0.5, 0.0), rows - 1.001)
    col, row = math.floor(u), math.floor(v)
    a, b = u - col, v - row
    low = values[row, col] + a * (values[row, col + 1] - values[row, col])
    high = values[row + 1, col] + a * (values[row + 1, col + 1] - values[row + 1, col])
    return low + b * (high - low)


@kernel
def clearance_at(
    field: Field, body: Body, x: float, y: float, yaw: float, enough_m: float
) -> float:
    """Return the distance from the footprint to the nearest obstacle [m], at most `enough_m`.

    It is negative where an obstacle lies well inside.
    """
    return clearance_turned(field, body, (x, y), (math.cos(yaw), math.sin(yaw)), enough_m)


@kernel
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
    centre = bilinear(field.distance_m, u, v) - half
    if centre >= body.circumscribed_m + enough_m:
        return enough_m
    if centre < body.inscribed_m:
        # Less than what edge points in an obstacle give, so that the way out only leads upwards.
        return centre - body.inscribed_m - half
    outline = (body.few_points, body.edge_points)
    face = (turned[0] * scale, turned[1] * scale)
    return min(outline_clearance(field.distance_m, outline, (u, v), face, half), enough_m)


@kernel
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


@kernel
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
        distance = bilinear(distance_m, u + cos * px - sin * py, v + sin * px + cos * py)
        nearest = min(nearest, distance)
    return nearest
