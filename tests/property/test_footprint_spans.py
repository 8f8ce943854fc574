"""The footprint in cells against a plain look at each cell."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from support.all_poses import FOOTPRINTS

from trolley_planner.costmap.footprint import Footprint
from trolley_planner.paths.hybrid_astar.footprint_spans import ANGLE_RAD, ANGLES, rasterized

FINE_M = 0.0125
ARM = [(0.175, 0.15), (-0.175, 0.15), (-0.175, -0.15), (0.175, -0.15), (0.2, -0.03), (0.475, -0.03),
       (0.475, 0.03), (0.2, 0.03)]  # fmt: skip
STAR = [
    (radius * math.cos(bearing), radius * math.sin(bearing))
    for radius, bearing in zip((0.3, 0.12) * 5, np.arange(10) * math.pi / 5.0, strict=True)
]


def covered(polygon: NDArray[np.float64], reach: int) -> NDArray[np.bool_]:
    """Which cells have their centre in a polygon [cells], or within half a cell of an edge."""
    ys, xs = np.mgrid[-reach : reach + 1, -reach : reach + 1].astype(float)
    off, is_inside = np.full(xs.shape, np.inf), np.zeros(xs.shape, dtype=np.bool_)
    for (ax, ay), (bx, by) in zip(np.roll(polygon, 1, axis=0), polygon, strict=True):
        dx, dy = bx - ax, by - ay
        share = np.clip(((xs - ax) * dx + (ys - ay) * dy) / (dx * dx + dy * dy), 0.0, 1.0)
        off = np.minimum(off, np.hypot(ax + share * dx - xs, ay + share * dy - ys))
        crosses = (ay > ys) != (by > ys)
        is_inside ^= crosses & (xs < ax + (ys - ay) * dx / np.where(dy == 0.0, 1.0, dy))
    return is_inside | (off < 0.5)


@pytest.mark.parametrize("corners", [*FOOTPRINTS, ARM, STAR])
def test_the_spans_are_the_cells_that_the_footprint_covers(
    corners: list[tuple[float, float]],
) -> None:
    footprint = Footprint.from_polygon(corners)
    spans = rasterized(footprint, FINE_M)
    for angle in range(0, ANGLES, 5):
        drawn = np.zeros((2 * spans.reach + 1, 2 * spans.reach + 1), dtype=np.int64)
        for row, first, end in spans.spans[angle, : spans.num_spans[angle]] + spans.reach:
            drawn[row, first:end] += 1
        cos, sin = math.cos(angle * ANGLE_RAD), math.sin(angle * ANGLE_RAD)
        turned = footprint.polygon @ np.array([[cos, sin], [-sin, cos]]) / FINE_M
        assert (drawn == covered(turned, spans.reach)).all()
