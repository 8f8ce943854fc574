"""Odometry: the wheels' motions joined from zero, and where the robot was a moment ago."""

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, Twist2D
from trolley_base.drivers import MotionSample


@dataclass(frozen=True, slots=True)
class TrackParams:
    """What is kept; set by hand."""

    max_poses: int = 64
    """Poses that are kept: 1.3 s at 50 Hz, several revolutions of any lidar."""


PARAMS = TrackParams()


class OdometryTrack:
    """Integrates measured motions; frame `odom` is where `base_link` lay at the beginning."""

    def __init__(self, stamp_ns: int) -> None:
        """Begin at zero, standing, at a robot time."""
        self.stamp_ns = stamp_ns
        self.odom_T_base = Pose2D.identity()
        self.twist = Twist2D.zero()
        self._track: deque[tuple[int, float, float, float]] = deque(maxlen=PARAMS.max_poses)
        self._yaw = 0.0
        self._keep()

    def add(self, motion: MotionSample) -> None:
        """Join a motion to those before."""
        self.odom_T_base = self.odom_T_base @ motion.previous_T_base
        # Beside the wrapped heading: between two poses it must not jump by a turn.
        self._yaw += motion.previous_T_base.yaw
        self.twist = motion.twist
        self.stamp_ns = motion.stamp_ns
        self._keep()

    @property
    def oldest_ns(self) -> int:
        """Robot time of the oldest pose that is kept [ns]."""
        return self._track[0][0]

    def poses_at(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return odom_T_base (n, 3) x, y [m], yaw [rad, not wrapped] at robot times (n,).

        Interpolated; outside what is kept the nearest pose that is.
        """
        track_ns, *coordinates = zip(*self._track, strict=True)
        # Relative to now: nanoseconds since 1970 do not fit a float.
        times = (np.array(track_ns, dtype=np.int64) - self.stamp_ns).astype(np.float64)
        wanted = (stamps_ns - self.stamp_ns).astype(np.float64)
        return np.stack([np.interp(wanted, times, one) for one in coordinates], axis=1)

    def _keep(self) -> None:
        pose = self.odom_T_base
        self._track.append((self.stamp_ns, pose.x, pose.y, self._yaw))
