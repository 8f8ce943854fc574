"""A driver that costs next to nothing: it knows the truth, and follows the shortest roomy path."""

import heapq
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from trolley import topics
from trolley.geometry import Pose2D, Twist2D, angle_difference
from trolley.gridmap import GridMap, distance_transform
from trolley.messages import VelocityCommand
from trolley.runtime.lockstep import Lockstep

PERIOD_S = 0.1
LEAST_M, ROOMY_M = 0.22, 0.45
"""Nearer to a wall it does not drive by choice; further away all places are as good [m]."""
OUT_OF_THERE = 100.0
"""Cost of a cell there, where it may find itself."""
AHEAD_CELLS = 9
FAST_MPS, TURN_RADPS = 0.45, 1.0
AT_M, AT_RAD = 0.1, 0.1
STUCK_S, FREE_ITSELF_S = 4.0, 1.5
FREE_ITSELF = tuple(Twist2D(vx, 0.0, wz) for vx, wz in ((-0.15, 0.0), (0.0, 1.0), (0.15, 0.0)))
"""One after the other where it does not get on; base lets it do what is possible."""
THINGS = ((4.25, 1.2), (5.0, -1.35), (-0.72, -0.68), (6.03, -3.47), (6.3, -2.04))
"""What stands in `worlds/real.toml` beside the map: bag, bucket, lamp, scales, drawer [m]."""
THING_M = 0.12
"""Radius of them, or a bit less, so that it can drive past [m]."""
STEPS = [(r, c) for r in (-1, 0, 1) for c in (-1, 0, 1) if r or c]


class Cruise:
    """Drives a robot in lock-step from goal to goal.

    Args:
        lockstep: in which base runs.
        grid: the map of the apartment; it goes around what stands there besides.
        meanwhile: called at each moment of the drive.
    """

    def __init__(self, lockstep: Lockstep, grid: GridMap, meanwhile: Callable[[], bool]) -> None:
        self._lockstep, self._grid, self._meanwhile = lockstep, grid, meanwhile
        self._truths = lockstep.record(topics.SIM_TRUTH)
        blocked = 1 - grid.free_mask()
        rows, cols = np.indices(blocked.shape)
        for x, y in THINGS:
            row, col = grid.world_to_cell(np.array([x, y])).tolist()
            blocked[np.hypot(rows - row, cols - col) * grid.resolution < THING_M] = 1
        room = distance_transform(blocked, grid.resolution)
        self._cost = 1.0 + 20.0 * np.maximum(0.0, ROOMY_M - room)
        self._cost[room < LEAST_M] = OUT_OF_THERE
        self._cost[grid.free_mask() == 0] = np.inf

    @property
    def pose(self) -> Pose2D:
        """Where the robot is."""
        del self._truths[:-1]
        return self._truths[-1].pose

    def go_to(self, goal: Pose2D) -> bool:
        """Drive there; free itself and return False where it does not get on."""
        path = self._plan(goal)
        far_m, stuck_s = math.inf, 0.0
        while path is not None and stuck_s < STUCK_S:
            twist = self._choose(path, goal)
            if twist is None:
                return True
            self._drive(twist)
            left_m = self.pose.distance_to(goal) + abs(angle_difference(goal.yaw, self.pose.yaw))
            stuck_s = 0.0 if abs(left_m - far_m) > 0.02 else stuck_s + PERIOD_S
            far_m = left_m if stuck_s == 0.0 else far_m
        for twist in FREE_ITSELF:
            for _ in range(round(FREE_ITSELF_S / PERIOD_S)):
                self._drive(twist)
        return False

    def _drive(self, twist: Twist2D) -> None:
        command = VelocityCommand(
            stamp_ns=self._lockstep.now_ns, twist=twist, valid_for=2.0 * PERIOD_S
        )
        self._lockstep.publish(topics.COMMAND, command, "teleop")
        self._lockstep.run_until(self._meanwhile, PERIOD_S)

    def _choose(self, path: NDArray[np.float64], goal: Pose2D) -> Twist2D | None:
        """Return what to drive; None: it is there."""
        pose = self.pose
        if pose.distance_to(goal) < AT_M:
            turn = angle_difference(goal.yaw, pose.yaw)
            if abs(turn) < AT_RAD:
                return None
            return Twist2D(0.0, 0.0, math.copysign(min(TURN_RADPS, 0.2 + abs(turn)), turn))
        nearest = int(np.argmin(np.hypot(path[:, 0] - pose.x, path[:, 1] - pose.y)))
        x, y = path[min(nearest + AHEAD_CELLS, len(path) - 1)].tolist()
        turn = angle_difference(math.atan2(y - pose.y, x - pose.x), pose.yaw)
        if abs(turn) > 1.0:
            return Twist2D(0.0, 0.0, math.copysign(TURN_RADPS, turn))
        return Twist2D(FAST_MPS * (1.0 - 0.8 * abs(turn)), 0.0, 1.6 * turn)

    def _plan(self, goal: Pose2D) -> NDArray[np.float64] | None:
        """Return the path (n, 2) [m] by Dijkstra's algorithm; None: there is none."""
        start, end = (
            tuple(self._grid.world_to_cell(np.array([[one.x, one.y]]))[0].tolist())
            for one in (self.pose, goal)
        )
        cost, best, towards = self._cost, {end: 0.0}, {end: end}
        queue = [(0.0, end)]
        while queue:
            so_far, cell = heapq.heappop(queue)
            if cell == start:
                break
            if so_far > best[cell]:
                continue
            for row, col in STEPS:
                to = cell[0] + row, cell[1] + col
                there = so_far + math.hypot(row, col) * float(cost[to])
                if there < best.get(to, math.inf):
                    best[to], towards[to] = there, cell
                    heapq.heappush(queue, (there, to))
        if start not in towards:
            return None
        cells = [start]
        while cells[-1] != end:
            cells.append(towards[cells[-1]])
        return self._grid.cell_to_world(np.array(cells))
