"""What the lidar saw near the robot, as points that stay in place while the robot moves on."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley_base.drivers import LidarScan
from trolley_base.odometry.track import OdometryTrack


@dataclass(frozen=True, slots=True)
class NearEchoesParams:
    """What is remembered and smoothed of the echoes near the robot; set by hand."""

    blind_margin_m: float = 0.03
    """Echoes this much beyond the shortest measurable distance are remembered when the robot comes
    nearer and the sensor goes blind for them [m]."""
    max_remembered: int = 512
    """At most this many points are remembered."""
    blind_width: float = 0.15
    """Something that near covers many beams; this many are judged together [rad]."""
    smoothing_width: float = 0.02
    """Beams this far to both sides are smoothed together [rad] ..."""
    max_smoothed: int = 3
    """... but at most so many to each side ..."""
    same_surface_m: float = 0.04
    """... where their ranges differ by less than this, as on one surface [m]."""


PARAMS = NearEchoesParams()

Floats = NDArray[np.float64]


class NearEchoes:
    """Points of the newest scan, each placed where the robot was when its beam was measured.

    Args:
        base_T_laser: where the lidar sits.
        reach: echoes farther than this from `base_link` are left out [m].
    """

    def __init__(self, base_T_laser: Pose2D, reach: float) -> None:
        self._base_T_laser = base_T_laser
        self._reach = reach
        self._points_odom: Floats = np.empty((0, 2))

    def update(self, scan: LidarScan, track: OdometryTrack) -> None:
        """Take a new scan, of at least one beam, in place of the last."""
        beams = np.arange(len(scan.ranges))
        odom_T_laser = laser_poses(scan, track, self._base_T_laser)
        seen = np.isfinite(scan.ranges) & (scan.ranges > 0.0)
        seen &= scan.ranges < self._reach + np.hypot(self._base_T_laser.x, self._base_T_laser.y)
        poses = odom_T_laser[seen]
        ranges = _smoothed(scan)[seen]
        angles = poses[:, 2] + scan.angle_min + beams[seen] * scan.angle_increment
        new = poses[:, :2] + ranges[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        hidden = self._hidden(scan, track.odom_T_base @ self._base_T_laser)
        self._points_odom = np.concatenate([new, hidden])

    def points(self, odom_T_base: Pose2D) -> Floats:
        """Return the echoes (n, 2) x, y [m] in `base_link` where it is now."""
        return odom_T_base.inverse().transform_points(self._points_odom)

    def _hidden(self, scan: LidarScan, odom_T_laser: Pose2D) -> Floats:
        """Return known points that are now too near to be measured and that no beam sees past."""
        points_laser = odom_T_laser.inverse().transform_points(self._points_odom)
        distances = np.hypot(points_laser[:, 0], points_laser[:, 1])
        near = distances < scan.range_min + PARAMS.blind_margin_m
        if not near.any():
            return self._points_odom[:0]
        angles = np.arctan2(points_laser[near, 1], points_laser[near, 0])
        turned = (angles - scan.angle_min + 0.5 * scan.angle_increment) % (2.0 * np.pi)
        beams = np.floor(turned / scan.angle_increment).astype(np.int64)
        blind = np.zeros(len(beams), dtype=np.bool_)
        inside = beams < len(scan.ranges)
        blind[inside] = _blind_beams(scan)[beams[inside]]
        return self._points_odom[near][blind][-PARAMS.max_remembered :]


def laser_poses(scan: LidarScan, track: OdometryTrack, base_T_laser: Pose2D) -> Floats:
    """Return odom_T_laser (beams, 3) x, y [m], yaw [rad] when each beam was measured."""
    beams = np.arange(len(scan.ranges))
    lags_ns = np.rint(beams * (scan.time_increment * 1e9)).astype(np.int64)
    poses, mount = track.poses_at(scan.stamp_ns + lags_ns), base_T_laser
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    return np.stack(
        [
            poses[:, 0] + cos * mount.x - sin * mount.y,
            poses[:, 1] + sin * mount.x + cos * mount.y,
            poses[:, 2] + mount.yaw,
        ],
        axis=1,
    )


def _smoothed(scan: LidarScan) -> Floats:
    """Return ranges (n,) [m], each the mean of itself and those beside it on the same surface.

    The nearest of hundreds of noisy echoes lies well before the wall; less noise lets the robot
    drive closer along it.
    """
    ranges = scan.ranges.astype(np.float64)
    width = min(PARAMS.max_smoothed, max(1, round(PARAMS.smoothing_width / scan.angle_increment)))
    total, count = ranges.copy(), np.ones(len(ranges))
    for shift in range(1, width + 1):
        for moved in (np.roll(ranges, shift), np.roll(ranges, -shift)):
            with np.errstate(invalid="ignore"):
                same = np.abs(moved - ranges) < PARAMS.same_surface_m
            total[same] += moved[same]
            count += same
    return total / count


def _blind_beams(scan: LidarScan) -> NDArray[np.bool_]:
    """Return the beams (n,) around which most are invalid.

    An invalid beam is 0: it measured neither the thing nor anything behind it. One that fails by
    itself among many must not make a wall forgotten.
    """
    width = max(1, round(PARAMS.blind_width / scan.angle_increment))
    invalid = (scan.ranges == 0.0).astype(np.float64)
    return np.convolve(invalid, np.ones(width) / width, mode="same") > 0.5
