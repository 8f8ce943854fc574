"""All poses a robot can reach among boxes, and in what time: a slow and exhaustive judge.

Dijkstra over x, y and heading with the exact footprint: along one of 32 headings that lead from
grid point to grid point, either way, turning while it does or on the spot. At every move the robot
is at full speed, so the time is one that no planner undercuts by more than the grid's error (a few
per cent). It shares no code with the planner that it judges.
"""

import heapq
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.jit import kernel

Floats = NDArray[np.float64]
Box = tuple[float, float, float, float]
"""x, y of the centre, length along x, width along y [m]."""

STEP_M = 0.025
"""Between two points of the grid [m]."""
_QUARTER = ((1, 0), (3, 1), (2, 1), (3, 2), (1, 1), (2, 3), (1, 2), (1, 3))
HEADINGS = [
    (round(math.cos(k * math.pi / 2)) * x - round(math.sin(k * math.pi / 2)) * y,
     round(math.sin(k * math.pi / 2)) * x + round(math.cos(k * math.pi / 2)) * y)
    for k in range(4)
    for x, y in _QUARTER
]  # fmt: skip
"""Steps (x, y) of the grid along each heading, counter-clockwise."""


class Speeds(NamedTuple):
    """Full speed [m/s] and turn rate [rad/s]."""

    v: float
    wz: float


@dataclass(frozen=True)
class Target:
    """A goal, and how far it may be missed [m, rad]."""

    pose: Pose2D
    xy: float
    yaw: float


class Reach:
    """What a footprint can stand on among boxes.

    Args:
        footprint: (n, 2) corners of a convex footprint in `base_link` [m].
        boxes: what is solid.
        margin_m: kept from them.
    """

    def __init__(self, footprint: Floats, boxes: tuple[Box, ...], margin_m: float) -> None:
        rows = np.array(boxes, dtype=np.float64).reshape(-1, 4)
        self._low = (rows[:, :2] - 0.5 * rows[:, 2:]).min(axis=0)
        high = (rows[:, :2] + 0.5 * rows[:, 2:]).max(axis=0)
        cols, lines = np.ceil((high - self._low) / STEP_M).astype(int) + 1
        angles = [math.atan2(y, x) for x, y in HEADINGS]
        # Between two headings too, so that no corner is cut by turning.
        self._yaws = np.unwrap(angles)
        between = 0.5 * (self._yaws + np.append(self._yaws[1:], self._yaws[0] + 2.0 * math.pi))
        yaws = np.column_stack([self._yaws, between]).ravel()
        self._blocked = np.zeros((len(yaws), lines, cols), dtype=np.uint8)
        _block(self._blocked, footprint, yaws, rows, self._low, margin_m)

    def seconds(self, start: Pose2D, target: Target, speeds: Speeds) -> float:
        """Shortest time between two poses [s]; inf: the exhaustive search finds no way."""
        begin = self._near(start, STEP_M, math.radians(7.0))
        goals = self._near(target.pose, target.xy, target.yaw)
        return _least(self._costs(goals, begin, speeds), begin)

    def random_poses(
        self, start: Pose2D, count: int, speeds: Speeds, rng: np.random.Generator
    ) -> list[tuple[Pose2D, float]]:
        """Poses that can be reached from `start`, each place as likely, and in what time [s]."""
        begin = self._near(start, STEP_M, math.radians(7.0))
        costs = self._costs(begin, np.empty((0, 3), dtype=np.int64), speeds)
        places = np.argwhere(np.isfinite(costs).any(axis=0))
        found: list[tuple[Pose2D, float]] = []
        for row, col in places[rng.integers(0, len(places), count if len(places) else 0)].tolist():
            h = int(rng.choice(np.flatnonzero(np.isfinite(costs[:, row, col]))))
            x, y = (self._low + STEP_M * np.array([col, row])).tolist()
            pose = Pose2D(x, y, float(self._yaws[h])).wrapped()
            found.append((pose, float(costs[h, row, col])))
        return found

    def _costs(
        self, goals: NDArray[np.int64], ends: NDArray[np.int64], speeds: Speeds
    ) -> NDArray[np.float32]:
        """Time from each grid pose to the nearest of some [s], until one of `ends` is reached."""
        count, lines, cols = self._blocked.shape
        costs = np.full((count // 2, lines, cols), np.inf, dtype=np.float32)
        turns = np.diff(np.append(self._yaws, self._yaws[0] + 2.0 * math.pi))
        is_end = np.zeros(costs.shape, dtype=np.uint8)
        is_end[tuple(ends.T)] = 1
        moves = (np.array(HEADINGS, dtype=np.int64), turns)
        _spread(costs, (self._blocked, is_end), goals, moves, (speeds.v, speeds.wz))
        return costs

    def _near(self, pose: Pose2D, xy: float, yaw: float) -> NDArray[np.int64]:
        """Grid poses (n, 3) heading, row, col within tolerances of a pose, at least the nearest."""
        reach = math.ceil(xy / STEP_M) + 1
        at = np.round((np.array([pose.x, pose.y]) - self._low) / STEP_M).astype(int)
        found: list[tuple[int, int, int]] = []
        off = np.abs(np.angle(np.exp(1j * (self._yaws - pose.yaw))))
        headings = np.flatnonzero(off <= max(yaw, float(off.min()) + 1e-9))
        for row in range(at[1] - reach, at[1] + reach + 1):
            for col in range(at[0] - reach, at[0] + reach + 1):
                point = self._low + STEP_M * np.array([col, row])
                inside = 0 <= row < self._blocked.shape[1] and 0 <= col < self._blocked.shape[2]
                if inside and math.dist(point, (pose.x, pose.y)) <= xy + 0.5 * STEP_M:
                    found += [
                        (int(h), row, col) for h in headings if not self._blocked[2 * h, row, col]
                    ]
        return np.array(found, dtype=np.int64).reshape(-1, 3)


def _least(costs: NDArray[np.float32], poses: NDArray[np.int64]) -> float:
    return float(costs[tuple(poses.T)].min(initial=np.inf))


@kernel
def _meets(corners: Floats, x: float, y: float, boxes: Floats, margin: float) -> bool:
    """Whether a convex outline (n, 2) moved to x, y meets a box grown by the margin.

    By the separating axes of outline and box.
    """
    count = corners.shape[0]
    left, right = corners[:, 0].min(), corners[:, 0].max()
    down, up = corners[:, 1].min(), corners[:, 1].max()
    for b in range(boxes.shape[0]):
        dx, dy = boxes[b, 0] - x, boxes[b, 1] - y
        half_x, half_y = 0.5 * boxes[b, 2] + margin, 0.5 * boxes[b, 3] + margin
        if dx - half_x >= right or dx + half_x <= left:
            continue
        apart = dy - half_y >= up or dy + half_y <= down
        for i in range(count):
            j = (i + 1) % count
            nx, ny = corners[j, 1] - corners[i, 1], corners[i, 0] - corners[j, 0]
            nearest = nx * dx + ny * dy - abs(nx) * half_x - abs(ny) * half_y
            apart = apart or nearest >= nx * corners[i, 0] + ny * corners[i, 1]
        if not apart:
            return True
    return False


@kernel
def _block(
    out_blocked: NDArray[np.uint8],
    footprint: Floats,
    yaws: Floats,
    boxes: Floats,
    low: Floats,
    margin: float,
) -> None:
    """Mark the poses (headings, rows, cols) in which a convex footprint meets a box."""
    corners = np.empty_like(footprint)
    for h in range(yaws.shape[0]):
        cos, sin = math.cos(yaws[h]), math.sin(yaws[h])
        for i in range(footprint.shape[0]):
            corners[i, 0] = cos * footprint[i, 0] - sin * footprint[i, 1]
            corners[i, 1] = sin * footprint[i, 0] + cos * footprint[i, 1]
        for row in range(out_blocked.shape[1]):
            for col in range(out_blocked.shape[2]):
                x, y = low[0] + col * STEP_M, low[1] + row * STEP_M
                out_blocked[h, row, col] = _meets(corners, x, y, boxes, margin)


@kernel
def _move(
    blocked: NDArray[np.uint8],
    vectors: NDArray[np.int64],
    at: tuple[int, int, int],
    turn: int,
    way: int,
) -> tuple[int, int, int]:
    """Where a turn of -1...1 headings and a step of -1...1 lead; row -1: nowhere."""
    h, row, col = at
    headings = vectors.shape[0]
    to = (h + turn) % headings
    r, c = row + way * vectors[h, 1], col + way * vectors[h, 0]
    if r < 0 or r >= blocked.shape[1] or c < 0 or c >= blocked.shape[2]:
        return to, -1, c
    # A turn passes the heading between the two.
    if blocked[2 * to, r, c] or blocked[(2 * h + turn) % (2 * headings), row, col]:
        return to, -1, c
    return to, r, c


@kernel
def _spread(
    out_costs: NDArray[np.float32],
    places: tuple[NDArray[np.uint8], NDArray[np.uint8]],
    goals: NDArray[np.int64],
    moves: tuple[NDArray[np.int64], Floats],
    speeds: tuple[float, float],
) -> None:
    """Write the time from each pose to the nearest goal [s], inf where there is no way.

    `places` are the poses that are blocked, twice as many headings, and those at which it ends.
    """
    blocked, ends = places
    vectors, turns = moves
    rows, cols = out_costs.shape[1:]
    queue = [(np.float32(0.0), np.int64(0))]
    queue.pop()
    for i in range(goals.shape[0]):
        h, row, col = goals[i, 0], goals[i, 1], goals[i, 2]
        out_costs[h, row, col] = 0.0
        heapq.heappush(queue, (np.float32(0.0), (h * rows + row) * cols + col))
    while len(queue) > 0:
        cost, key = heapq.heappop(queue)
        at = (key // (rows * cols), (key // cols) % rows, key % cols)
        if cost > out_costs[at[0], at[1], at[2]]:
            continue
        if ends[at[0], at[1], at[2]]:
            return
        long = STEP_M * math.hypot(vectors[at[0], 0], vectors[at[0], 1]) / speeds[0]
        for move in range(9):
            turn, way = move // 3 - 1, move % 3 - 1
            h, row, col = _move(blocked, vectors, at, turn, way)
            if row < 0:
                continue
            # turns[k] leads from heading k to k + 1.
            turned = 0.0 if turn == 0 else turns[at[0] if turn > 0 else h] / speeds[1]
            after = np.float32(cost + max(abs(way) * long, turned))
            if after < out_costs[h, row, col]:
                out_costs[h, row, col] = after
                heapq.heappush(queue, (after, (h * rows + row) * cols + col))
