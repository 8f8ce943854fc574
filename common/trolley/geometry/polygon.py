"""Polygons in the plane: containment, crossings, distances, and what makes one usable.

A polygon is an array (n, 2) of corners x, y [m], closed implicitly: the last corner is joined to
the first. All functions are vectorised over points or edges.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

# More corners than anyone draws by hand; the check for crossings compares each pair of edges.
MAX_CORNERS = 500
# Corners closer than this are one corner [m].
SAME_CORNER_M = 1e-6
# A polygon of a smaller area is a line or a point [m^2].
MIN_AREA_M2 = 1e-6
# In place of the squared length of an edge that has none, so that nothing is divided by zero.
TINY = np.finfo(np.float64).tiny

Floats = NDArray[np.float64]


def check_polygon(points: ArrayLike) -> Floats:
    """Return a polygon counter-clockwise and without repeated corners.

    Args:
        points: (n, 2) x, y [m]; the first corner may be repeated at the end.

    Raises:
        ValueError: with a sentence for people, if it is not a polygon: too few or too many
            corners, numbers that are not finite, no area, or edges that cross or touch.
    """
    try:
        corners = np.array(points, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError("a polygon needs a list of corners [x, y]") from error
    if corners.ndim != 2 or corners.shape[1] != 2:
        raise ValueError(f"a polygon needs a list of corners [x, y], not shape {corners.shape}")
    if len(corners) > MAX_CORNERS:
        raise ValueError(f"a polygon may have {MAX_CORNERS} corners, not {len(corners)}")
    if not np.isfinite(corners).all():
        raise ValueError("a polygon needs finite numbers; one of these is NaN or infinite")
    if len(corners):
        gaps = np.hypot(*(corners - np.roll(corners, 1, axis=0)).T)
        corners = corners[gaps > SAME_CORNER_M]
    if len(corners) < 3:
        raise ValueError(f"a polygon needs at least 3 different corners, not {len(corners)}")
    crossing = find_crossing(corners)
    if crossing is not None:
        first, second = crossing
        raise ValueError(
            f"the polygon crosses or touches itself: the edge from corner {first + 1} meets "
            f"the edge from corner {second + 1}"
        )
    area = signed_area(corners)
    if abs(area) < MIN_AREA_M2:
        raise ValueError("the polygon has no area: its corners lie on one line")
    return corners if area > 0.0 else np.ascontiguousarray(corners[::-1])


def signed_area(polygon: Floats) -> float:
    """Return the enclosed area [m^2], positive if the corners run counter-clockwise."""
    # Relative to one corner: far from the origin the products would eat up the digits.
    x, y = (polygon - polygon[0]).T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def find_crossing(polygon: Floats) -> tuple[int, int] | None:
    """Return two edges (index of their first corner) that meet where they should not, or None.

    Neighbouring edges may share their corner and nothing else.
    """
    count = len(polygon)
    ends = np.roll(polygon, -1, axis=0)
    first, second = np.triu_indices(count, k=1)
    neighbours = (second - first == 1) | ((first == 0) & (second == count - 1))
    apart = ~neighbours
    meets = segments_meet(polygon[first], ends[first], polygon[second], ends[second]) & apart
    # Neighbours overlap where the second turns straight back over the first.
    back = ends - polygon
    before = np.roll(back, 1, axis=0)
    folded = (np.abs(_cross(before, back)) <= 1e-12) & (np.sum(before * back, axis=1) < 0.0)
    if meets.any():
        index = int(np.argmax(meets))
        return int(first[index]), int(second[index])
    if folded.any():
        index = int(np.argmax(folded))
        return (index - 1) % count, index
    return None


def segments_meet(
    starts_a: Floats, ends_a: Floats, starts_b: Floats, ends_b: Floats
) -> NDArray[np.bool_]:
    """Say for each pair of segments whether they have a point in common, ends included.

    Args:
        starts_a: (..., 2) x, y [m]; the four arrays are broadcast against each other.
        ends_a: (..., 2).
        starts_b: (..., 2).
        ends_b: (..., 2).

    Returns:
        (...) bool.

    Source:
        Cormen, Leiserson, Rivest, Stein, Introduction to Algorithms, section 33.1.
    """
    side_1 = np.sign(_cross(ends_b - starts_b, starts_a - starts_b))
    side_2 = np.sign(_cross(ends_b - starts_b, ends_a - starts_b))
    side_3 = np.sign(_cross(ends_a - starts_a, starts_b - starts_a))
    side_4 = np.sign(_cross(ends_a - starts_a, ends_b - starts_a))
    # Boxes that overlap decide between segments on one line, where all four sides are 0.
    low_a, high_a = np.minimum(starts_a, ends_a), np.maximum(starts_a, ends_a)
    low_b, high_b = np.minimum(starts_b, ends_b), np.maximum(starts_b, ends_b)
    boxes = np.all((low_a <= high_b) & (low_b <= high_a), axis=-1)
    return boxes & (side_1 * side_2 <= 0.0) & (side_3 * side_4 <= 0.0)


def polygon_contains(
    polygon: NDArray[np.floating[Any]], points: NDArray[np.floating[Any]]
) -> NDArray[np.bool_]:
    """Say for each point (n, 2) [m] whether it lies inside a polygon, (n,).

    Points exactly on an edge may count as either; a point that is not finite is outside.

    Source:
        Franklin, PNPOLY (1970): count the edges that a ray along +x crosses.
    """
    corners: list[tuple[float, float]] = np.asarray(polygon, dtype=np.float64).tolist()
    x, y = np.asarray(points, dtype=np.float64).T
    inside = np.zeros(len(x), dtype=np.bool_)
    for (x_0, y_0), (x_1, y_1) in zip(corners, corners[1:] + corners[:1], strict=True):
        if y_0 == y_1:
            continue
        straddles = (y_0 > y) != (y_1 > y)
        crossing_x = x_0 + (y - y_0) * ((x_1 - x_0) / (y_1 - y_0))
        inside ^= straddles & (x < crossing_x)
    return inside


def edges_of(polygon: Floats) -> Floats:
    """Return the edges (n, 2) [m] of a polygon (n, 2), each from its corner to the next."""
    edges = np.empty_like(polygon)
    np.subtract(polygon[1:], polygon[:-1], out=edges[:-1])
    np.subtract(polygon[0], polygon[-1], out=edges[-1])
    return edges


def distance_to_segments(points: Floats, starts: Floats, ends: Floats) -> Floats:
    """Return the distance from each point (n, 2) to the nearest of m segments (m, 2), (n,) [m]."""
    return _distance_to_edges(points, starts, ends - starts)


def distance_to_outline(polygon: Floats, points: Floats) -> Floats:
    """Return the distance from each point (n, 2) to a polygon's outline, (n,) [m]."""
    return _distance_to_edges(points, polygon, edges_of(polygon))


def _distance_to_edges(points: Floats, starts: Floats, edges: Floats) -> Floats:
    # One row a segment, x and y apart: sums and minima over short rows cost numpy the most.
    (x, y), (edge_x, edge_y) = points.T, edges.T[..., None]
    dx, dy = x - starts[:, :1], y - starts[:, 1:]
    squared = np.maximum(edge_x * edge_x + edge_y * edge_y, TINY)
    along = np.clip((dx * edge_x + dy * edge_y) / squared, 0.0, 1.0)
    return np.min(np.hypot(dx - along * edge_x, dy - along * edge_y), axis=0)


def _cross(a: Floats, b: Floats) -> Floats:
    """Return the z part of the cross product of vectors (..., 2)."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
