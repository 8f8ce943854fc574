"""Cubic curves between two poses."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.jit import lean_kernel
from trolley_planner.paths.hybrid_astar.footprint_spans import nearest_angle
from trolley_planner.paths.hybrid_astar.motion_primitives import CELL_M, COSTS
from trolley_planner.paths.hybrid_astar.search_space import SearchSpace, cost_per_metre
from trolley_planner.sensing.beams import wrapped

LEAST_RADIUS_M = 0.3
"""Curves are no tighter than this (by hand)."""


@lean_kernel
def curve_count(first: NDArray[np.float64], last: NDArray[np.float64]) -> int:
    """Return into how many pieces a curve between two poses is divided."""
    return max(1, math.ceil(math.hypot(last[0] - first[0], last[1] - first[1]) / CELL_M))


@lean_kernel
def curve_into(
    out_poses: NDArray[np.float64],
    first: NDArray[np.float64],
    last: NDArray[np.float64],
    sense: int,
) -> bool:
    """Write poses (n, 3) along a cubic curve between two poses, without the first.

    Returns:
        Whether it is nowhere too tight, and has no cusp.
    """
    count = out_poses.shape[0]
    reach = math.hypot(last[0] - first[0], last[1] - first[1]) * sense
    ax, ay = reach * math.cos(first[2]), reach * math.sin(first[2])
    bx, by = reach * math.cos(last[2]), reach * math.sin(last[2])
    yaw, x, y, worst = first[2], first[0], first[1], 0.0
    for index in range(count):
        t = (index + 1) / count
        # Hermite's basis, and its derivative.
        h0, h1 = (1.0 + 2.0 * t) * (1.0 - t) ** 2, t * (1.0 - t) ** 2
        h2, h3 = t * t * (3.0 - 2.0 * t), t * t * (t - 1.0)
        to_x = h0 * first[0] + h1 * ax + h2 * last[0] + h3 * bx
        to_y = h0 * first[1] + h1 * ay + h2 * last[1] + h3 * by
        d0, d1, d3 = 6.0 * t * (t - 1.0), (1.0 - t) * (1.0 - 3.0 * t), t * (3.0 * t - 2.0)
        dx = d0 * (first[0] - last[0]) + d1 * ax + d3 * bx
        dy = d0 * (first[1] - last[1]) + d1 * ay + d3 * by
        turn = wrapped(math.atan2(sense * dy, sense * dx) - yaw)
        length = math.hypot(to_x - x, to_y - y)
        if length < 1e-6:
            return False
        worst = max(worst, abs(turn) / length)
        yaw, x, y = yaw + turn, to_x, to_y
        out_poses[index, 0], out_poses[index, 1], out_poses[index, 2] = x, y, yaw
    return abs(yaw - last[2]) < 0.01 and worst <= 1.0 / LEAST_RADIUS_M


@lean_kernel
def curve_cost(
    curve: NDArray[np.float64],
    first: NDArray[np.float64],
    space: SearchSpace,
    motion: int,
    most: float,
) -> float:
    """Return what a curve (n, 3) from a pose costs [m], +inf if that is not less than `most`.

    Args:
        curve: its poses.
        first: the pose before them.
        space: where it is.
        motion: how the robot will drive along it.
        most: [m].
    """
    total = 0.0
    x, y, yaw = first[0], first[1], first[2]
    for index in range(curve.shape[0]):
        place, angle = (curve[index, 0], curve[index, 1]), nearest_angle(curve[index, 2])
        length = math.hypot(place[0] - x, place[1] - y)
        turn = abs(curve[index, 2] - yaw)
        total += cost_per_metre(space, place, angle, motion) * (length + COSTS.arc_m * turn)
        x, y, yaw = curve[index, 0], curve[index, 1], curve[index, 2]
        if total >= most:
            return math.inf
    return total
