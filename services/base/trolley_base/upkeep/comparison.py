"""Compares odometry with the localizer while somebody else drives."""

import math
from dataclasses import dataclass

import numpy as np

from trolley.geometry import Pose2D, angle_difference
from trolley.messages import Odometry, PoseEstimate
from trolley_base.upkeep.correction import Correction
from trolley_base.upkeep.legs import Leg, OdometryLog


@dataclass(frozen=True, slots=True)
class ComparisonParams:
    """How a drive by somebody else is cut into windows; set by hand."""

    window_m: float = 1.0
    """Distance after which a window ends, so that the pose's own error counts for little [m]."""
    window_rad: float = 2.0
    """Turn after which a window ends [rad]."""
    gap_ns: int = 1_000_000_000
    """A longer pause between sure poses may hide a leap of the pose [ns]."""
    max_std_m: float = 0.10
    """Standard deviation of the position above which a pose is not compared [m]."""
    max_std_rad: float = 0.10
    """Standard deviation of the heading above which a pose is not compared [rad]."""
    most_messages: int = 6000
    """A window of more messages of odometry is given up: the robot stands [messages]."""
    held_least: float = 0.5
    """A robot that the wheels bring less far, in metres and radians, may stand where it was."""
    held_share: float = 0.3
    """A robot that moves by less than this share of what its wheels count is held."""
    error_m: float = 0.025
    """Standard deviation of the position of a moving robot [m]."""
    error_rad: float = 0.015
    """Standard deviation of the heading of a moving robot [rad]."""


PARAMS = ComparisonParams()


class Comparison:
    """Cuts a drive into windows between two moments at which the robot knew where it was."""

    def __init__(self) -> None:
        self.legs: list[Leg] = []
        """The windows so far."""
        self._log = OdometryLog()
        self._waiting: list[PoseEstimate] = []
        self._begin: tuple[int, Pose2D] | None = None
        self._last_ns = 0
        self._distance_m = self._turned_rad = 0.0
        self._at: Pose2D | None = None

    def update_odometry(self, odometry: Odometry) -> None:
        """Take a message of `odom`."""
        if len(self._log) > PARAMS.most_messages:
            self._begin = None
            self._log.forget_before(odometry.stamp_ns)
        self._log.add(odometry)
        if self._at is not None:
            self._distance_m += self._at.distance_to(odometry.pose)
            self._turned_rad += abs(angle_difference(odometry.pose.yaw, self._at.yaw))
        self._at = odometry.pose
        ready = [one for one in self._waiting if self._log.covers(one.stamp_ns)]
        self._waiting = [one for one in self._waiting if one.stamp_ns > odometry.stamp_ns]
        for estimate in ready:
            self._compare(estimate)

    def update_pose(self, estimate: PoseEstimate) -> None:
        """Take a message of `pose`; it waits for the odometry of its moment."""
        self._waiting.append(estimate)
        del self._waiting[:-50]

    def _compare(self, estimate: PoseEstimate) -> None:
        pose = estimate.pose
        if pose is None or not _is_sure(estimate):
            return
        stamp_ns, is_gap = estimate.stamp_ns, estimate.stamp_ns - self._last_ns > PARAMS.gap_ns
        self._last_ns = stamp_ns
        if self._begin is None or is_gap:
            self._begin_at(stamp_ns, pose)
            return
        if self._distance_m < PARAMS.window_m and self._turned_rad < PARAMS.window_rad:
            return
        begin_ns, begin = self._begin
        steps = self._log.steps(begin_ns, stamp_ns)
        leg = Leg(steps, begin.inverse() @ pose, PARAMS.error_m, PARAMS.error_rad)
        if not _is_held(leg):
            self.legs.append(leg)
        self._begin_at(stamp_ns, pose)

    def _begin_at(self, stamp_ns: int, pose: Pose2D) -> None:
        self._begin, self._distance_m, self._turned_rad = (stamp_ns, pose), 0.0, 0.0
        self._log.forget_before(stamp_ns)


def _is_held(leg: Leg) -> bool:
    """Say whether the wheels turned on the spot: something holds the robot, or it is lifted."""
    counted, seen = Correction().integrate(leg.steps), leg.start_T_end
    turned = float(np.sum(leg.steps[:, 2]))  # more than half a turn is not seen as such
    reach = math.hypot(counted.x, counted.y) + abs(turned)
    moved = math.hypot(seen.x, seen.y) + abs(seen.yaw)
    return reach > PARAMS.held_least and moved < PARAMS.held_share * reach


def _is_sure(estimate: PoseEstimate) -> bool:
    if estimate.state != "localized" or estimate.covariance is None:
        return False
    x_var, y_var, yaw_var = estimate.covariance[0], estimate.covariance[4], estimate.covariance[8]
    return (
        math.sqrt(max(x_var, y_var, 0.0)) < PARAMS.max_std_m
        and math.sqrt(max(yaw_var, 0.0)) < PARAMS.max_std_rad
    )
