"""The robot's outline on the floor: a polygon in `base_link`, and its two radii."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trolley.geometry.polygon import check_polygon, distance_to_outline, polygon_contains

# Smaller is a toy, larger does not fit through a door [m].
MIN_SIZE_M = 0.02
MAX_SIZE_M = 5.0
# Corners of the polygon that stands for a round robot: it is at most 2 % wider than the circle.
CIRCLE_CORNERS = 16


def footprint_from_box(length_m: float, width_m: float) -> NDArray[np.float64]:
    """Return a rectangle centred on `base_link`, (4, 2) x, y [m], counter-clockwise.

    Args:
        length_m: extent along x [m].
        width_m: extent along y [m].

    Raises:
        ValueError: with a sentence for people, if a size is not plausible.
    """
    for name, size in (("length_m", length_m), ("width_m", width_m)):
        _check_size(name, size)
    x, y = 0.5 * length_m, 0.5 * width_m
    return np.array([[x, -y], [x, y], [-x, y], [-x, -y]])


def footprint_from_radius(radius_m: float) -> NDArray[np.float64]:
    """Return a regular polygon that contains a circle about `base_link`, (16, 2) x, y [m].

    Raises:
        ValueError: with a sentence for people, if the size is not plausible.
    """
    _check_size("twice radius_m", 2.0 * radius_m)
    corner_radius = radius_m / math.cos(math.pi / CIRCLE_CORNERS)
    angles = (np.arange(CIRCLE_CORNERS) + 0.5) * (2.0 * math.pi / CIRCLE_CORNERS)
    return corner_radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def footprint_from_polygon(polygon_m: ArrayLike) -> NDArray[np.float64]:
    """Check an outline and return it counter-clockwise, (n, 2) x, y [m] in `base_link`.

    Raises:
        ValueError: with a sentence for people, if it is not a polygon that encloses
            `base_link`, or its size is not plausible.
    """
    corners = check_polygon(polygon_m)
    for name, size in zip("xy", np.ptp(corners, axis=0).tolist(), strict=True):
        _check_size(f"the extent along {name}", size)
    # The robot turns about base_link; outlines that leave it out are nearly always typed in
    # another frame or another unit.
    if inscribed_radius(corners) <= 0.0:
        raise ValueError(
            "the footprint does not enclose [0, 0], the point between the driven wheels that "
            "the robot turns about; give the corners relative to it"
        )
    return corners


def inscribed_radius(footprint: NDArray[np.float64]) -> float:
    """Return the radius of the largest circle about `base_link` inside the outline [m].

    It is 0 where the outline does not enclose `base_link`.
    """
    origin = np.zeros((1, 2))
    if not polygon_contains(footprint, origin)[0]:
        return 0.0
    return float(distance_to_outline(footprint, origin)[0])


def circumscribed_radius(footprint: NDArray[np.float64]) -> float:
    """Return the radius of the smallest circle about `base_link` that holds the outline [m]."""
    return float(np.max(np.hypot(footprint[:, 0], footprint[:, 1])))


def radius_of_gyration(footprint: NDArray[np.float64]) -> float:
    """Return how far from `base_link` the robot's mass resists a turn [m].

    Its mass is taken to be even over the footprint: turning at w, it has the energy that it has
    driving straight at w times this radius.
    """
    x, y = footprint.T
    next_x, next_y = np.roll(footprint, -1, axis=0).T
    doubled_areas = x * next_y - next_x * y
    squares = x * x + x * next_x + next_x * next_x + y * y + y * next_y + next_y * next_y
    return math.sqrt(float(np.sum(doubled_areas * squares) / (6.0 * np.sum(doubled_areas))))


def _check_size(name: str, size: float) -> None:
    # Written so that NaN is refused, too.
    if not MIN_SIZE_M <= size <= MAX_SIZE_M:
        raise ValueError(
            f"the footprint is not plausible: {name} is {size:g} m, allowed are {MIN_SIZE_M} "
            f"to {MAX_SIZE_M} m"
        )
