"""ROS navigation's NavFn, as in navfn.cpp: the potential by expansion in priority blocks.

Port of `setNavArr`, `setCostmap`, `setupNavFn`, `updateCell` and `propNavFnDijkstra` of
https://github.com/ros-planning/navigation (navfn/src/navfn.cpp, BSD), with its float32 potential,
its three buffers of cells and its order of expansion. The path along the gradient is left out.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel

COST_OBS = 254
COST_OBS_ROS = 253
COST_UNKNOWN_ROS = 255
COST_NEUTRAL = 50
COST_FACTOR = np.float32(0.8)
POT_HIGH = np.float32(1.0e10)
INVSQRT2 = np.float32(0.707106781)
PRIORITY_BUFFER = 10_000


class NavFn(NamedTuple):
    """The arrays that NavFn makes once for a size of map."""

    cost: NDArray[np.uint8]
    potential: NDArray[np.float32]
    pending: NDArray[np.bool_]
    buffers: NDArray[np.int32]
    """(3, n) current, next, over; NavFn has room for 10,000, too few for a large map."""


def make_navfn(rows: int, cols: int) -> NavFn:
    """The arrays for a map."""
    cells = rows * cols
    return NavFn(
        np.empty(cells, np.uint8),
        np.empty(cells, np.float32),
        np.empty(cells, np.bool_),
        np.empty((3, max(PRIORITY_BUFFER, 8 * (rows + cols))), np.int32),
    )


@kernel
def set_costmap(nav: NavFn, costs: NDArray[np.uint8]) -> None:
    """Take ROS costs (0 free to 252, 253 inscribed, 254 lethal, 255 unknown)."""
    for cell in range(costs.shape[0]):
        value = costs[cell]
        nav.cost[cell] = COST_OBS
        if value < COST_OBS_ROS:
            scaled = int(COST_NEUTRAL + COST_FACTOR * np.float32(value))
            nav.cost[cell] = min(scaled, COST_OBS - 1)


@kernel
def propagate(  # noqa: C901, PLR0915 - in one piece as there
    nav: NavFn, rows: int, cols: int, goal: int, start: int
) -> bool:
    """Compute the potential from the goal until it reaches the start; False if it never does."""
    cost, pot, pending = nav.cost, nav.potential, nav.pending
    pot[:] = POT_HIGH
    pending[:] = False
    for col in range(cols):
        cost[col] = cost[(rows - 1) * cols + col] = COST_OBS
    for row in range(rows):
        cost[row * cols] = cost[row * cols + cols - 1] = COST_OBS
    current, following, over = 0, 1, 2
    num_current, num_next, num_over = 0, 0, 0
    threshold = np.float32(COST_OBS)
    room = nav.buffers.shape[1]
    pot[goal] = 0.0
    for other in (goal + 1, goal - 1, goal - cols, goal + cols):
        if not pending[other] and cost[other] < COST_OBS:
            nav.buffers[current, num_current] = other
            num_current += 1
            pending[other] = True
    for _ in range(max(rows * cols // 20, rows + cols)):
        if num_current == 0 and num_next == 0:
            break
        for index in range(num_current):
            pending[nav.buffers[current, index]] = False
        for index in range(num_current):
            n = nav.buffers[current, index]
            if cost[n] >= COST_OBS:
                continue
            left, right, up, down = pot[n - 1], pot[n + 1], pot[n - cols], pot[n + cols]
            tc, ta = min(left, right), min(up, down)
            hf = np.float32(cost[n])
            dc = tc - ta
            if dc < 0:
                dc, ta = -dc, tc
            if dc >= hf:
                new = ta + hf
            else:
                d = dc / hf
                v = np.float32(-0.2301) * d * d + np.float32(0.5307) * d + np.float32(0.7040)
                new = ta + hf * v
            if new >= pot[n]:
                continue
            pot[n] = new
            soon = new < threshold
            for other, its in ((n - 1, left), (n + 1, right), (n - cols, up), (n + cols, down)):
                if its <= new + INVSQRT2 * np.float32(cost[other]):
                    continue
                if pending[other] or cost[other] >= COST_OBS:
                    continue
                if soon and num_next < room:
                    nav.buffers[following, num_next] = other
                    num_next += 1
                    pending[other] = True
                elif not soon and num_over < room:
                    nav.buffers[over, num_over] = other
                    num_over += 1
                    pending[other] = True
        current, following = following, current
        num_current, num_next = num_next, 0
        if num_current == 0:
            threshold += np.float32(2 * COST_NEUTRAL)
            current, over = over, current
            num_current, num_over = num_over, 0
        if pot[start] < POT_HIGH:
            return True
    return False


def plan(nav: NavFn, costs: NDArray[np.uint8], goal: int, start: int) -> bool:
    """Take a costmap (rows, cols) and compute the potential from goal to start."""
    rows, cols = costs.shape
    set_costmap(nav, costs.reshape(-1))
    return propagate(nav, rows, cols, goal, start)
