"""Pieces of a drive: the odometry between two moments, and the true motion between them."""

import itertools
import math
from bisect import bisect_left
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, angle_difference, interpolate, log_pose
from trolley.messages import Odometry
from trolley_base.upkeep.correction import Correction

SLIP_M = 0.01
"""Standard deviation that slip adds to a position after a metre, a random walk [m]; by hand."""
SLIP_RAD = 0.015
"""Standard deviation that slip adds to a heading after a metre or a radian [rad]; by hand."""


@dataclass(frozen=True, slots=True, eq=False)
class Leg:
    """A piece of a drive.

    Attributes:
        steps: (n, 3) x, y [m], turn [rad] of the odometry's small arcs.
        start_T_end: the same motion as measured from outside.
        error_m: standard deviation of a measured position [m].
        error_rad: the same of a measured heading [rad]; inf if the end's was not measured.
    """

    steps: NDArray[np.float64]
    start_T_end: Pose2D
    error_m: float
    error_rad: float

    @property
    def distance_m(self) -> float:
        """Distance driven, forwards or backwards [m]."""
        return float(np.sum(np.hypot(self.steps[:, 0], self.steps[:, 1])))

    @property
    def turned_rad(self) -> float:
        """Angle turned, either way [rad]."""
        return float(np.sum(np.abs(self.steps[:, 2])))

    @property
    def deviations(self) -> tuple[float, float, float]:
        """Deviation of the measured motion from a perfectly calibrated one.

        Along the line from start to end and across it [m], and in the heading [rad].
        """
        slip_rad = SLIP_RAD * math.sqrt(self.distance_m + self.turned_rad)
        start_rad = self.error_rad if math.isfinite(self.error_rad) else 0.0
        # The heading at the start and slip on the way bring the end aside.
        aside_rad = math.hypot(start_rad, slip_rad / math.sqrt(3.0))
        reach_m = math.hypot(self.start_T_end.x, self.start_T_end.y)
        detour_m = 0.25 * max(0.0, self.distance_m - reach_m)
        noise_m = math.hypot(math.sqrt(2.0) * self.error_m, SLIP_M * math.sqrt(self.distance_m))
        return (
            math.hypot(noise_m, aside_rad * detour_m),
            math.hypot(noise_m, aside_rad * max(reach_m, detour_m)),
            math.hypot(math.sqrt(2.0) * self.error_rad, slip_rad),
        )

    def error_of(self, correction: Correction, lidar: Pose2D) -> tuple[float, float, float]:
        """Return by how much the corrected odometry misses the measured end, as `deviations`.

        Args:
            correction: of the odometry.
            lidar: base_T_laser, true, @ base_T_laser^-1, as written: the localizer sees the base
                move by what a lidar that was turned or moved sees.
        """
        fitted = lidar.inverse() @ correction.integrate(self.steps) @ lidar
        measured = self.start_T_end
        direction = math.atan2(measured.y, measured.x)
        cos, sin = math.cos(direction), math.sin(direction)
        x, y = fitted.x - measured.x, fitted.y - measured.y
        turn = angle_difference(fitted.yaw, measured.yaw)
        return cos * x + sin * y, cos * y - sin * x, turn


class OdometryLog:
    """The odometry of a drive, for cutting legs out of it."""

    def __init__(self) -> None:
        self._stamps_ns: list[int] = []
        self._poses: list[Pose2D] = []

    @property
    def latest_ns(self) -> int | None:
        """The newest stamp."""
        return self._stamps_ns[-1] if self._stamps_ns else None

    def add(self, odometry: Odometry) -> None:
        """Take a message; one that is not newer than the last is ignored."""
        if not self._stamps_ns or odometry.stamp_ns > self._stamps_ns[-1]:
            self._stamps_ns.append(odometry.stamp_ns)
            self._poses.append(odometry.pose)

    def forget_before(self, stamp_ns: int) -> None:
        """Forget what is older than the newest message before a moment."""
        first = max(0, bisect_left(self._stamps_ns, stamp_ns) - 1)
        del self._stamps_ns[:first], self._poses[:first]

    def __len__(self) -> int:
        return len(self._stamps_ns)

    def covers(self, stamp_ns: int) -> bool:
        """Whether there is odometry before and after a moment."""
        return bool(self._stamps_ns) and self._stamps_ns[0] <= stamp_ns <= self._stamps_ns[-1]

    def pose_at(self, stamp_ns: int) -> Pose2D:
        """Return odom_T_base, interpolated; the nearest outside what was heard.

        Raises:
            LookupError: nothing was heard yet.
        """
        if not self._stamps_ns:
            raise LookupError("no odometry yet")
        after = bisect_left(self._stamps_ns, stamp_ns)
        if after == 0 or after == len(self._stamps_ns):
            return self._poses[min(after, len(self._poses) - 1)]
        first_ns, last_ns = self._stamps_ns[after - 1], self._stamps_ns[after]
        part = (stamp_ns - first_ns) / (last_ns - first_ns)
        return interpolate(self._poses[after - 1], self._poses[after], part)

    def steps(self, start_ns: int, end_ns: int) -> NDArray[np.float64]:
        """Return the small arcs (n, 3) x, y [m], turn [rad] between two moments."""
        first = bisect_left(self._stamps_ns, start_ns + 1)
        last = bisect_left(self._stamps_ns, end_ns)
        poses = [self.pose_at(start_ns), *self._poses[first:last], self.pose_at(end_ns)]
        arcs = [log_pose(before.inverse() @ after) for before, after in itertools.pairwise(poses)]
        return np.array([(arc.vx, arc.vy, arc.wz) for arc in arcs])
