"""A plain dynamic window approach over a plain Dijkstra, to compare the planner with.

Built like ROS 1's move_base with dwa_local_planner and costmap_2d, with their default parameters
but for what the robot is: the footprint, and 0.5 m/s. It is the planner of the lock-step: it takes
`scan` and `odom` and publishes velocities as `planner`.

Source:
    Fox, Burgard, Thrun, The Dynamic Window Approach to Collision Avoidance (1997), with the
    critics of dwa_local_planner; Marder-Eppstein et al., The Office Marathon (2010).
"""

import math
from typing import ClassVar

import numpy as np
from bench.planner.dwa_kernels import (
    BLOCKED,
    INSCRIBED,
    LETHAL,
    Grids,
    Scales,
    navfn_into,
    outline_cost,
    sample_cost,
    spread_into,
    take_scan,
)
from numpy.typing import NDArray

from trolley import topics
from trolley.geometry import Pose2D, Twist2D
from trolley.gridmap import distance_transform
from trolley.messages import Odometry, Scan, VelocityCommand
from trolley.messages.types import floats_from_bytes
from trolley.runtime.service import Service, every, on
from trolley_planner.costmap.footprint import Footprint

Floats = NDArray[np.float64]

CELL_M = 0.05
CORNER = (-6.0, -10.0)
SHAPE = (400, 480)
# costmap_2d: echoes are marked and cleared up to here, and cost around obstacles [m].
MARK_M, CLEAR_M, INFLATION_M, COST_SCALING, PADDING_M = 2.5, 3.0, 0.55, 10.0, 0.01
# navfn: price of a free cell, and of a unit of cost.
NEUTRAL, FACTOR = 50.0, 0.8
LOCAL_M = 2.5
COSTMAP_S, PLAN_S, CONTROL_S = 0.2, 1.0, 0.05
# dwa_local_planner.
MAX_SPEED, MIN_SPEED, MIN_TURN, MAX_TURN = 0.5, 0.1, 0.4, 1.0
ACC, TURN_ACC, ESCAPE_SPEED = 2.5, 3.2, 0.1
SIM_S, STEP_S, V_SAMPLES, W_SAMPLES = 1.7, 0.1, 3, 20
PATH_BIAS, GOAL_BIAS, OCC_SCALE, FORWARD_M = 32.0, 24.0, 0.01, 0.325
# move_base: without a velocity for this long, it clears the costmap and turns around.
PATIENCE_S, TURN_ROUND_S = 5.0, 7.0


class DwaService(Service):
    """The reference in place of the planner.

    Args:
        corners: of the robot's footprint in `base_link` [m].
        goal: in `odom`.
    """

    name: ClassVar[str] = "planner"

    def __init__(self, corners: list[tuple[float, float]], goal: tuple[float, float]) -> None:
        sign = np.sign(corners)
        footprint = Footprint.from_polygon((np.array(corners) + PADDING_M * sign).tolist())
        self._outline = footprint.edge_points
        self._inscribed_m = footprint.inscribed_m
        self._goal = goal
        self._marks = np.zeros(SHAPE, dtype=np.uint8)
        self._costs = np.zeros(SHAPE, dtype=np.uint8)
        self._odometry: Odometry | None = None
        self._scan: Scan | None = None
        self._path: NDArray[np.int64] = np.empty((0, 2), dtype=np.int64)
        self._stuck_s = 0.0
        self._turning_s = 0.0

    @on(topics.ODOM)
    def take_odometry(self, odometry: Odometry) -> None:
        """Keep the latest odometry."""
        self._odometry = odometry

    @on(topics.SCAN)
    def take_scan(self, scan: Scan) -> None:
        """Keep the latest scan."""
        self._scan = scan

    @every(COSTMAP_S)
    def look(self) -> None:
        """Put the newest scan into the costmap."""
        if self._scan is None or self._odometry is None:
            return
        take_scan(self._marks, self._beams(self._scan), CELL_M, (MARK_M, CLEAR_M))
        distance = distance_transform(self._marks, CELL_M, INFLATION_M + CELL_M)
        costs = 252.0 * np.exp(-COST_SCALING * (distance - self._inscribed_m))
        costs[distance > INFLATION_M] = 0.0
        costs[distance <= self._inscribed_m] = INSCRIBED
        costs[distance == 0.0] = LETHAL
        self._costs = costs.astype(np.uint8)

    @every(PLAN_S)
    def plan(self) -> None:
        """Search for the path to the goal."""
        if self._odometry is None:
            return
        prices = NEUTRAL + FACTOR * self._costs.astype(np.float32)
        prices[self._costs >= INSCRIBED] = BLOCKED
        costs = np.empty(SHAPE, dtype=np.float32)
        navfn_into(costs, prices, _cell(*self._goal))
        row, col = _cell(self._odometry.pose.x, self._odometry.pose.y)
        way = [(row, col)]
        while costs[row, col] > 0.0 and 0 < row < SHAPE[0] - 1 and 0 < col < SHAPE[1] - 1:
            around = costs[row - 1 : row + 2, col - 1 : col + 2]
            i, j = divmod(int(around.argmin()), 3)
            if (i, j) == (1, 1) or not math.isfinite(float(around[i, j])):
                break
            row, col = row + i - 1, col + j - 1
            way.append((row, col))
        if costs[row, col] == 0.0:
            self._path = np.array(way, dtype=np.int64)

    @every(CONTROL_S)
    def control(self) -> None:
        """Publish the best velocity."""
        if self._odometry is None or len(self._path) < 2:
            return
        wanted = self._turn_round() if self._turning_s > 0.0 else self._choose(self._odometry)
        self._stuck_s = self._stuck_s + CONTROL_S if wanted is None else 0.0
        if self._stuck_s > PATIENCE_S:
            self._stuck_s, self._turning_s = 0.0, TURN_ROUND_S
            self._marks[:] = 0
        twist = wanted or self._escape(self._odometry)
        command = VelocityCommand(stamp_ns=self.stamp_ns, twist=twist, valid_for=0.15, scan_ns=0)
        self.publish(topics.COMMAND, command, "planner")

    def _turn_round(self) -> Twist2D:
        self._turning_s -= CONTROL_S
        pose = _in_grid(self._odometry.pose if self._odometry else Pose2D.identity())
        ahead = (pose.x, pose.y, pose.yaw + 0.1)
        is_free = outline_cost(self._costs, self._outline, ahead, CELL_M) >= 0
        return Twist2D(0.0, 0.0, MAX_TURN if is_free else 0.0)

    def _escape(self, odometry: Odometry) -> Twist2D:
        """Back up where nothing else is possible, as base_local_planner does, if that is free."""
        pose = _in_grid(odometry.pose) @ Pose2D(-ESCAPE_SPEED, 0.0, 0.0)
        behind = (pose.x, pose.y, pose.yaw)
        is_free = outline_cost(self._costs, self._outline, behind, CELL_M) >= 0
        return Twist2D(-ESCAPE_SPEED if is_free else 0.0, 0.0, 0.0)

    def _choose(self, odometry: Odometry) -> Twist2D | None:
        """Best of the velocities that can be reached, None if all touch something."""
        pose, twist = _in_grid(odometry.pose), odometry.twist
        corner, grids = self._grids(pose)
        start = (pose.x - corner[1] * CELL_M, pose.y - corner[0] * CELL_M, pose.yaw)
        half = 0.5 * CELL_M
        left = math.dist((odometry.pose.x, odometry.pose.y), self._goal)
        alignment = half * PATH_BIAS if left > FORWARD_M else 0.0
        scales = Scales(
            CELL_M * OCC_SCALE, half * PATH_BIAS, half * GOAL_BIAS, alignment, FORWARD_M
        )
        low = max(0.0, twist.vx - ACC * CONTROL_S)
        high = min(MAX_SPEED, twist.vx + ACC * CONTROL_S)
        turn_low = max(-MAX_TURN, twist.wz - TURN_ACC * CONTROL_S)
        turn_high = min(MAX_TURN, twist.wz + TURN_ACC * CONTROL_S)
        best, chosen = math.inf, None
        for v in np.linspace(low, high, V_SAMPLES):
            for w in np.append(np.linspace(turn_low, turn_high, W_SAMPLES), 0.0):
                # Too slow to move at all; but from standing only the window's edges are reached.
                if v < MIN_SPEED and abs(w) < MIN_TURN and turn_low < w < turn_high:
                    continue
                cost = sample_cost(
                    start, (float(v), float(w)), (SIM_S, STEP_S), self._outline, grids, scales
                )
                if 0.0 <= cost < best:
                    best, chosen = cost, Twist2D(float(v), 0.0, float(w))
        return chosen

    def _grids(self, pose: Pose2D) -> tuple[tuple[int, int], Grids]:
        """Cut out the local costmap and spread the distances to path and local goal in it."""
        half = round(LOCAL_M / CELL_M)
        row, col = int(pose.y / CELL_M), int(pose.x / CELL_M)
        corner = max(0, row - half), max(0, col - half)
        costs = np.ascontiguousarray(
            self._costs[corner[0] : row + half + 1, corner[1] : col + half + 1]
        )
        is_in = (self._path >= corner) & (self._path < np.add(corner, costs.shape))
        inside = np.asarray(is_in.all(axis=1), np.bool_)
        nearest = int(np.abs(self._path - (row, col)).sum(axis=1).argmin())
        inside[:nearest] = False
        local = (self._path[inside] - corner) if inside.any() else np.array([[half, half]])
        path, goal, front = (np.empty(costs.shape, dtype=np.float32) for _ in range(3))
        spread_into(path, costs, local)
        spread_into(goal, costs, local[-1:])
        # The goal that the front aims at lies farther on by as much as the front lies ahead.
        towards = local[-1] - local[0]
        length = max(1.0, float(np.hypot(*towards)))
        beyond = np.round(local[-1] + towards * (FORWARD_M / CELL_M / length)).astype(np.int64)
        beyond = np.clip(beyond, 0, np.array(costs.shape) - 1)
        spread_into(front, costs, beyond[None])
        return corner, Grids(costs, path, goal, front, CELL_M)

    def _beams(self, scan: Scan) -> Floats:
        """Starts and ends (n, 4) of a scan's beams in the grid [m]."""
        ranges = floats_from_bytes(scan.ranges).astype(np.float64)
        used = ranges > 0.0
        angles = scan.angle_min + np.flatnonzero(used) * scan.angle_increment
        ranges = np.minimum(ranges[used], CLEAR_M + 1.0)
        pose = _in_grid(self._odometry.pose if self._odometry else Pose2D.identity())
        ends = ranges[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        starts = np.tile((pose.x, pose.y), (len(ends), 1))
        return np.hstack([starts, pose.transform_points(ends)])


def _in_grid(pose: Pose2D) -> Pose2D:
    return Pose2D(pose.x - CORNER[0], pose.y - CORNER[1], pose.yaw)


def _cell(x: float, y: float) -> tuple[int, int]:
    return int((y - CORNER[1]) / CELL_M), int((x - CORNER[0]) / CELL_M)
