"""The footprint at each angle, as spans of the cells that it covers.

With counts of what stands in each row before each column two look-ups say whether a span is free,
its inside included.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel, lean_kernel
from trolley_planner.costmap.footprint import Footprint
from trolley_planner.sensing.beams import inside_polygon

HEADINGS = 64
"""Headings of the states."""
TURN_RAD = 2.0 * math.pi / HEADINGS
"""Angle between two headings: 5.6 degrees."""
PHASES = 4
"""Number of angles at which the headings of a search may begin, so that one is nearly the goal's.
"""
ANGLES = PHASES * HEADINGS
"""Angles at which the footprint is checked: poses between two headings, as of curves and of direct
drives, would else be off by a centimetre at its corners."""
ANGLE_RAD = TURN_RAD / PHASES
"""Angle between two of the angles at which the footprint is checked: 1.4 degrees."""
SWING_M = 0.03
"""Farther its outermost point must not move between two poses at which a footprint is checked [m]:
the corner of a wall may lie in between."""
ALL_KINDS = np.uint64(2**64 - 1)
"""Bits of all kinds of cells."""


class FootprintSpans(NamedTuple):
    """The footprint at each angle."""

    spans: NDArray[np.int16]
    """(ANGLES, n, 3) row, first column and the one behind the last, from the origin's cell."""
    num_spans: NDArray[np.int64]
    """(ANGLES,) how many of them count."""
    phase: int
    """Angle of the first heading."""
    first_yaw: float
    """Angle of the first heading [rad]."""
    reach: int
    """Rows on either side of the origin [cells]."""
    inscribed_m: float
    circumscribed_m: float
    fine_m: float
    """Edge of a cell."""


def rasterized(footprint: Footprint, fine_m: float) -> FootprintSpans:
    """Return the footprint as spans of the cells that it touches.

    Args:
        footprint: of the robot.
        fine_m: edge of a cell.
    """
    reach = math.ceil(footprint.circumscribed_m / fine_m) + 1
    # A line meets a polygon of n corners in n / 2 spans at most.
    most = (2 * reach + 1) * (len(footprint.polygon) // 2)
    spans = np.zeros((ANGLES, most, 3), dtype=np.int16)
    num_spans = np.zeros(ANGLES, dtype=np.int64)
    rasterize_into(spans, num_spans, footprint.polygon / fine_m, reach)
    radii = footprint.inscribed_m, footprint.circumscribed_m
    return FootprintSpans(spans, num_spans, 0, 0.0, reach, *radii, fine_m)


@kernel
def rasterize_into(
    out_spans: NDArray[np.int16],
    out_num: NDArray[np.int64],
    polygon: NDArray[np.float64],
    reach: int,
) -> None:
    """Write the spans of cells that an outline covers or nearly touches, at each angle.

    A cell counts if its centre is inside, or within half a cell of an edge.

    Args:
        out_spans: (ANGLES, n, 3), overwritten; see `FootprintSpans`.
        out_num: (ANGLES,), overwritten.
        polygon: (m, 2) corners [cells].
        reach: rows on either side of the origin.
    """
    turned = np.empty_like(polygon)
    for angle in range(ANGLES):
        yaw = angle * ANGLE_RAD
        cos, sin = math.cos(yaw), math.sin(yaw)
        for corner in range(polygon.shape[0]):
            x, y = polygon[corner, 0], polygon[corner, 1]
            turned[corner, 0], turned[corner, 1] = cos * x - sin * y, sin * x + cos * y
        count = 0
        for row in range(-reach, reach + 1):
            first, col = reach + 1, -reach
            while col <= reach:
                off = edge_distance(turned, col, row)
                is_covered = off < 0.5 or inside_polygon(turned, col, row)
                if is_covered and first > reach:
                    first = col
                elif not is_covered and first <= reach:
                    out_spans[angle, count, 0] = row
                    out_spans[angle, count, 1] = first
                    out_spans[angle, count, 2] = col
                    count += 1
                    first = reach + 1
                col += max(math.floor(off + 0.5), 1)  # Up to there it is the same side.
        out_num[angle] = count


@lean_kernel
def edge_distance(polygon: NDArray[np.float64], x: float, y: float) -> float:
    """Return the distance of a point from the nearest edge of a polygon (n, 2)."""
    least = math.inf
    for index in range(polygon.shape[0]):
        ax, ay = polygon[index - 1, 0], polygon[index - 1, 1]
        dx, dy = polygon[index, 0] - ax, polygon[index, 1] - ay
        share = ((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy)
        share = min(max(share, 0.0), 1.0)
        off_x, off_y = ax + share * dx - x, ay + share * dy - y
        least = min(least, off_x * off_x + off_y * off_y)
    return math.sqrt(least)


@lean_kernel
def touched(
    counts: NDArray[np.uint64],
    footprint: FootprintSpans,
    place: tuple[float, float],
    angle: int,
    unwanted: np.uint64,
) -> np.uint64:
    """Return the bits of the kinds of cells that the footprint covers.

    Args:
        counts: (rows, cols + 1) of a few kinds side by side; see `SearchSpace`.
        footprint: as spans.
        place: x, y from the corner [m].
        angle: index.
        unwanted: bits of kinds of which one is enough to know; outside all are touched.
    """
    rows, cols = counts.shape[0], counts.shape[1] - 1
    row, col = math.floor(place[1] / footprint.fine_m), math.floor(place[0] / footprint.fine_m)
    reach = footprint.reach
    if row < reach or col < reach or row >= rows - reach or col >= cols - reach:
        return ALL_KINDS
    found = np.uint64(0)
    for index in range(footprint.num_spans[angle]):
        at = np.uint64(row + footprint.spans[angle, index, 0])
        first = np.uint64(col + footprint.spans[angle, index, 1])
        end = np.uint64(col + footprint.spans[angle, index, 2])
        found |= counts[at, end] - counts[at, first]
        if found & unwanted != 0:
            break
    return found


@lean_kernel
def heading_of(footprint: FootprintSpans, yaw: float) -> int:
    """Return the heading nearest to a direction [rad]."""
    return math.floor((yaw - footprint.first_yaw) / TURN_RAD + 0.5) % HEADINGS


@lean_kernel
def yaw_of(footprint: FootprintSpans, heading: int) -> float:
    """Return the direction of a heading [rad]."""
    return footprint.first_yaw + heading * TURN_RAD


@lean_kernel
def angle_of(footprint: FootprintSpans, heading: int) -> int:
    """Return the angle of a heading."""
    return heading * PHASES + footprint.phase


@lean_kernel
def nearest_angle(yaw: float) -> int:
    """Return the angle nearest to a direction [rad]."""
    return math.floor(yaw / ANGLE_RAD + 0.5) % ANGLES
