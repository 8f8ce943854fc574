"""Optimal paths, computed slowly and exactly, to compare the planner's paths with."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley_planner.paths.heap import sift_up, take_first
from trolley_planner.paths.path import segment_cost

AWAY = 1e-4
"""Corners are placed this far outside their cell [cells]."""


@kernel
def grid_way(  # noqa: C901 - the textbook's algorithm in one piece
    weights: NDArray[np.uint8], start: int, goal: int
) -> tuple[float, NDArray[np.int64]]:
    """Cost and cells of the cheapest 8-connected path that cuts no corner, in weights times cells.

    Dijkstra (1959) in float64; a step costs its length times the mean of its two weights.
    """
    rows, cols = weights.shape
    flat = weights.reshape(-1)
    cost = np.full(rows * cols, np.inf)
    previous = np.full(rows * cols, -1)
    done = np.zeros(rows * cols, np.bool_)
    heap = np.empty((8 * rows * cols, 2))
    heap[0, 0], heap[0, 1] = 0.0, start
    cost[start], size = 0.0, 1
    while size > 0:
        cell = take_first(heap, size)
        size -= 1
        if cell == goal:
            break
        if done[cell]:
            continue
        done[cell] = True
        for row_step in (-cols, 0, cols):
            for col_step in (-1, 0, 1):
                other = cell + row_step + col_step
                if other == cell or flat[other] == 0:
                    continue
                if row_step and col_step and not (flat[cell + row_step] and flat[cell + col_step]):
                    continue
                length = math.sqrt(2.0) if row_step and col_step else 1.0
                through = cost[cell] + 0.5 * length * (float(flat[cell]) + float(flat[other]))
                if through < cost[other]:
                    cost[other], previous[other] = through, cell
                    sift_up(heap, size, through, other)
                    size += 1
    count, cell = 0, goal
    while cell >= 0:
        count, cell = count + 1, previous[cell]
    way, cell = np.empty(count, np.int64), goal
    for index in range(count - 1, -1, -1):
        way[index], cell = cell, previous[cell]
    return float(cost[goal]), way


def grid_cost(weights: NDArray[np.uint8], start: int, goal: int) -> float:
    """Cost of that path, +inf if there is none."""
    return grid_way(weights, start, goal)[0]


def corners(weights: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Points (n, 2) x, y [cells] just off every outward corner of the lethal cells."""
    lethal = weights == 0
    found: list[NDArray[np.float64]] = []
    for dr in (-1, 1):
        for dc in (-1, 1):
            here = lethal[1:-1, 1:-1]
            beside = np.roll(lethal, -dr, 0)[1:-1, 1:-1] | np.roll(lethal, -dc, 1)[1:-1, 1:-1]
            across = np.roll(lethal, (-dr, -dc), (0, 1))[1:-1, 1:-1]
            rows, cols = np.nonzero(here & ~beside & ~across)
            centres = np.stack([cols, rows], axis=1).astype(np.float64) + 1.5
            found.append(centres + np.array([dc, dr]) * (0.5 + AWAY))
    return np.concatenate(found)


@kernel
def shortest_length(nodes: NDArray[np.float64], weights: NDArray[np.uint8]) -> float:
    """Length of the shortest path from the first of the nodes (n, 2) to the last [cells].

    Dijkstra over all pairs of nodes that see each other.
    """
    count = nodes.shape[0]
    length = np.full(count, np.inf)
    done = np.zeros(count, np.bool_)
    length[0] = 0.0
    while True:
        best = -1
        for node in range(count):
            if not done[node] and (best < 0 or length[node] < length[best]):
                best = node
        if best < 0 or math.isinf(length[best]) or best == count - 1:
            return float(length[count - 1])
        done[best] = True
        x, y = nodes[best, 0], nodes[best, 1]
        for node in range(count):
            if done[node]:
                continue
            through = length[best] + math.hypot(nodes[node, 0] - x, nodes[node, 1] - y)
            if through < length[node] and not math.isinf(
                segment_cost(weights, x, y, nodes[node, 0], nodes[node, 1], math.inf)
            ):
                length[node] = through


def taut_length(
    weights: NDArray[np.uint8], start: tuple[float, float], goal: tuple[float, float]
) -> float:
    """Length of the shortest of all paths between two points that touch no lethal cell [cells].

    The visibility graph of Lozano-Perez and Wesley (1979) over the corners of the cells.
    """
    nodes = np.concatenate([[start], corners(weights), [goal]]).astype(np.float64)
    return shortest_length(nodes, (weights != 0).astype(np.uint8))
