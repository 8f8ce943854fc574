"""Notices who is about to be where the robot will be, so that it stands before they meet."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, Twist2D
from trolley_planner.movers import Mover

HOLD_S = 0.4
"""The robot stands for so long since the last scan that shows it."""
MARGIN_M = 0.1
"""Who comes nearer than this is met."""
EARLIER_S = 0.6
"""It begins to brake so long before it would have to."""
SLACK_S = 0.3
"""Both may be this much earlier or later than thought."""
STEP_S = 0.1
LEAST_SPEED = 0.2
"""A robot that stands is about to drive on at least this fast [m/s]."""


class ClosingWatch:
    """Compares the way of what moves with the robot's own.

    A costmap takes everything for standing. Who walks into the robot's way needs it to brake
    before the distance alone would say so: whoever stands cannot run into anybody.

    Args:
        radius_m: of a circle about the robot's origin that holds its footprint.
    """

    def __init__(self, radius_m: float) -> None:
        self._radius_m = radius_m
        self._hold_until_ns = 0

    def note(
        self,
        now_ns: int,
        movers: list[Mover],
        pose: Pose2D,
        twist: Twist2D,
        deceleration: float,
    ) -> None:
        """Take what moves by a new scan.

        Args:
            now_ns: robot time.
            movers: what moves, in `grid`.
            pose: of the robot, in `grid`.
            twist: of the robot.
            deceleration: what it brakes with [m/s^2].
        """
        if not movers:
            return
        horizon_s = abs(twist.vx) / deceleration + EARLIER_S
        times = np.arange(0.0, horizon_s + STEP_S, STEP_S)
        way = _way(pose, twist, times)
        if any(self._meets(mover, way, times) for mover in movers):
            self._hold_until_ns = now_ns + round(HOLD_S * 1e9)

    def must_stand(self, now_ns: int) -> bool:
        """Say whether the robot had better stand."""
        return now_ns < self._hold_until_ns

    def _meets(self, mover: Mover, way: NDArray[np.float64], times: NDArray[np.float64]) -> bool:
        """Say whether a mover comes near to where the robot is about then."""
        towards = way[0] - mover.points.mean(axis=0)
        if float(towards @ mover.velocity) <= 0.0:
            return False  # It goes away: then it is no more than a thing that stands.
        points = mover.points[:: max(1, len(mover.points) // 8)]
        # (times of the mover, points, times of the robot)
        moved = points[None, :, None] + times[:, None, None, None] * mover.velocity
        gaps = np.hypot(*np.moveaxis(moved - way, -1, 0)) - self._radius_m
        near = (gaps < MARGIN_M).any(axis=1)
        together = np.abs(times[:, None] - times) <= SLACK_S + 1e-9
        return bool((near & together).any())


def _way(pose: Pose2D, twist: Twist2D, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return where the robot is (n, 2) at times (n,) [s] from now, if it drives on as it does."""
    speed = math.copysign(max(abs(twist.vx), LEAST_SPEED), twist.vx)
    yaws = pose.yaw + 0.5 * twist.wz * times
    steps = speed * times[:, None] * np.stack([np.cos(yaws), np.sin(yaws)], axis=1)
    return np.array([pose.x, pose.y]) + steps
