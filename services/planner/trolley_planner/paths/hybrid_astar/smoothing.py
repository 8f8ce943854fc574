"""Curves in place of lines and turns, where they are free and cost less."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel, lean_kernel
from trolley_planner.paths.hybrid_astar.curves import curve_cost, curve_count, curve_into
from trolley_planner.paths.hybrid_astar.footprint_spans import nearest_angle
from trolley_planner.paths.hybrid_astar.motion_primitives import (
    BACKWARDS,
    COSTS,
    FORWARDS,
    TURNING,
    Motions,
    change_cost,
)
from trolley_planner.paths.hybrid_astar.search_space import TRAVERSAL, SearchSpace, cost_per_metre


class SmoothingParams(NamedTuple):
    """Which pieces are replaced; by hand."""

    states: int = 60
    """Number of states that a curve replaces at most."""
    every: int = 3
    """Number of states per one that is tried as the end of a curve."""


SMOOTHING = SmoothingParams()


def smoothed(poses: NDArray[np.float64], motions: NDArray[np.int8], space: SearchSpace) -> Motions:
    """Return a maneuver with curves in place of lines and turns."""
    costs = np.empty(len(poses))
    costs_into(costs, poses, motions, space)
    parts, kinds = [poses[:1]], [motions[:1]]
    at = 0
    while at < len(poses) - 1:
        end, sense = longest_curve(poses, costs, at, space)
        if end == at + 1:
            parts.append(poses[end : end + 1])
            kinds.append(motions[end : end + 1])
        else:
            count = curve_count(poses[at], poses[end])
            curve = np.empty((count, 3))
            curve_into(curve, poses[at], poses[end], sense)
            parts.append(curve)
            kinds.append(np.full(count, sense, dtype=np.int8))
        at = end
    return np.concatenate(parts), np.concatenate(kinds)


@lean_kernel
def costs_into(
    out_costs: NDArray[np.float64],
    poses: NDArray[np.float64],
    motions: NDArray[np.int8],
    space: SearchSpace,
) -> None:
    """Write what it costs to each of some poses (n, 3) [m], from the first on."""
    out_costs[0] = 0.0
    for index in range(1, poses.shape[0]):
        motion, before = int(motions[index]), int(motions[index - 1])
        turn = abs(poses[index, 2] - poses[index - 1, 2])
        dx, dy = poses[index, 0] - poses[index - 1, 0], poses[index, 1] - poses[index - 1, 1]
        length = COSTS.turn_m * turn
        if motion != TURNING:
            length = math.hypot(dx, dy) + COSTS.arc_m * turn
        place = poses[index, 0], poses[index, 1]
        price = cost_per_metre(space, place, nearest_angle(poses[index, 2]), motion)
        # The maneuver is free; beside the search's headings it may look otherwise.
        most = (
            1.0
            + TRAVERSAL.near
            + TRAVERSAL.beside
            + TRAVERSAL.touching
            + TRAVERSAL.reverse
            + TRAVERSAL.creep
        )
        price = min(price, most)
        change = 0.0 if index == 1 else change_cost(before, motion)
        out_costs[index] = out_costs[index - 1] + price * length + change


@kernel
def longest_curve(
    poses: NDArray[np.float64], costs: NDArray[np.float64], first: int, space: SearchSpace
) -> tuple[int, int]:
    """Return the farthest state to which a curve is free and costs no more, and its sense.

    The state after `first` and 0 where there is none.
    """
    curve = np.empty((int(SMOOTHING.states * 2), 3))
    farthest = min(first + SMOOTHING.states, poses.shape[0] - 1)
    for end in range(farthest, first + 1, -SMOOTHING.every):
        dx, dy = poses[end, 0] - poses[first, 0], poses[end, 1] - poses[first, 1]
        ahead = dx * math.cos(poses[first, 2]) + dy * math.sin(poses[first, 2])
        sense = FORWARDS if ahead > 0.0 else BACKWARDS
        count = curve_count(poses[first], poses[end])
        if count < 2 or count > curve.shape[0]:
            continue
        if not curve_into(curve[:count], poses[first], poses[end], sense):
            continue
        most = costs[end] - costs[first] + 1e-9
        if curve_cost(curve[:count], poses[first], space, sense, most) < most:
            return end, sense
    return first + 1, TURNING
