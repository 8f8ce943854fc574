"""How long a path takes: speeds along it, turns in between."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, wrap_angle, wrap_angles
from trolley_planner.control.rollout import Limits, caution_speed
from trolley_planner.costmap.costmap import Costmap
from trolley_planner.paths.path import PlannedPath


@dataclass(frozen=True, slots=True)
class TimingParams:
    """How paths are timed; by hand."""

    corner_rad: float = 0.6
    """The robot turns in place at corners sharper than this."""
    most_poses: int = 2000
    """A timed path has no more poses than this."""
    step_s: float = 0.25
    """Time between two poses of a timed path, unless it has too many."""


TIMING = TimingParams()


def seconds_along(
    points: NDArray[np.float64], start_yaw: float, costmap: Costmap, limits: Limits
) -> NDArray[np.float64]:
    """Return when the robot is at each point of a path.

    Args:
        points: (n, 2) in `grid` [m].
        start_yaw: heading at the beginning, in `grid` [rad].
        costmap: tells what is near, and the speed zones.
        limits: of the robot.

    Returns:
        (n,) seconds since the start; the first turn is over at index 0.
    """
    if len(points) < 2:
        return np.zeros(len(points))
    steps = np.diff(points, axis=0)
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    cells = np.floor(points[1:] / costmap.resolution_m).astype(np.int64)
    near = costmap.distance_m[cells[:, 1], cells[:, 0]] - costmap.footprint.inscribed_m
    speeds = np.array([caution_speed(limits, clearance) for clearance in near.tolist()])
    speeds = np.minimum(speeds, costmap.speed_limits[cells[:, 1], cells[:, 0]])
    bearings = np.arctan2(steps[:, 1], steps[:, 0])
    corners = np.abs(wrap_angles(np.diff(bearings)))
    turns = np.where(corners > TIMING.corner_rad, corners / limits.max_turn, 0.0)
    seconds = lengths / np.maximum(speeds, 0.01)
    seconds[1:] += turns
    first = abs(wrap_angle(float(bearings[0]) - start_yaw))
    begin = (first / limits.max_turn if first > TIMING.corner_rad else 0.0) + 0.5 * (
        limits.max_speed / limits.acceleration
    )
    return begin + np.insert(np.cumsum(seconds), 0, 0.0)


class PathTimer:
    """Remembers how long a path takes until the path or the speed changes."""

    def __init__(self) -> None:
        self._key: tuple[str, float] | None = None
        self._seconds = np.zeros(1)

    def eta_s(
        self,
        path_key: str,
        path: PlannedPath,
        index: int,
        pose: Pose2D,
        goal_yaw: float | None,
        costmap: Costmap,
        limits: Limits,
    ) -> float:
        """Return how long the rest of a path will take, with the turn at its end [s].

        Args:
            path_key: changes whenever the path does.
            path: in `grid`.
            index: of the point where the robot is.
            pose: of the robot in `grid`.
            goal_yaw: heading at the end, None if any will do.
            costmap: tells what is near, and the speed zones.
            limits: of the robot.
        """
        key = (path_key, limits.max_speed)
        if key != self._key:
            self._key = key
            self._seconds = seconds_along(path.points, pose.yaw, costmap, limits)
        turn = 0.0
        if goal_yaw is not None:
            end = path.points[-1] - path.points[path.ahead(0, max(path.length_m - 0.3, 0.0))]
            bearing = math.atan2(float(end[1]), float(end[0]))
            turn = abs(wrap_angle(goal_yaw - bearing)) / limits.max_turn
        return float(self._seconds[-1] - self._seconds[index]) + turn


def timed_poses(
    points: NDArray[np.float64], seconds: NDArray[np.float64], goal_yaw: float | None
) -> tuple[NDArray[np.float64], float]:
    """Return poses (m, 3) at even times, and the time between two of them [s].

    Args:
        points: (n, 2) [m].
        seconds: (n,) when the robot is there.
        goal_yaw: heading at the end; None: as it arrives.
    """
    steps = np.diff(points, axis=0)
    last = float(np.arctan2(steps[-1, 1], steps[-1, 0])) if len(steps) else 0.0
    end_yaw = last if goal_yaw is None else goal_yaw
    total = max(float(seconds[-1]), TIMING.step_s)
    count = min(math.ceil(total / TIMING.step_s) + 1, TIMING.most_poses)
    wanted = np.linspace(0.0, total, count)
    at = np.concatenate([[0.0], seconds]) if seconds[0] > 0.0 else seconds
    places = np.concatenate([points[:1], points]) if seconds[0] > 0.0 else points
    xs = np.interp(wanted, at, places[:, 0])
    ys = np.interp(wanted, at, places[:, 1])
    bearings = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0])) if len(steps) else np.zeros(1)
    yaws = np.interp(wanted, seconds[1:], bearings) if len(steps) else np.full(count, end_yaw)
    yaws[-1] = end_yaw
    return np.stack([xs, ys, wrap_angles(yaws)], axis=1), total / (count - 1)
