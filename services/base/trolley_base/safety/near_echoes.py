"""What the lidar saw near the robot, as points that stay in place while the robot moves on."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.laser_scan import is_echo
from trolley.sight import SIGHT
from trolley_base.drivers import LidarScan
from trolley_base.odometry.track import OdometryTrack


@dataclass(frozen=True, slots=True)
class NearEchoesParams:
    """What is remembered and smoothed of the echoes near the robot; set by hand."""

    blind_margin_m: float = 0.03
    """Echoes up to this much beyond the shortest measurable range are remembered as the robot comes
    nearer, for as long as the sensor is blind to them [m]."""
    remembered_m: float = 0.02
    """Remembered points nearer together than about this count as one [m]."""
    max_remembered: int = 1024
    """At most this many points are remembered, the newest."""
    blind_width: float = 0.15
    """Something that near covers many beams; beams within this angle are judged together [rad]."""
    borne_out_m: float = 0.05
    """An echo among beams that fail is remembered for longer if another is this near to it [m]."""
    borne_out_s: float = 1.0
    """Time within which the other one must come: a leg that one scan in three shows comes again by
    then [s]."""
    smoothing_width: float = 0.02
    """Beams within this angle on both sides are smoothed together [rad]."""
    max_smoothed: int = 3
    """At most this many beams on each side are smoothed together."""
    same_surface_m: float = 0.04
    """Beams are smoothed together only if their ranges differ by less than this, as on one surface
    [m]."""


PARAMS = NearEchoesParams()

OUT_OF_VIEW = -1
"""Stands for the beam towards a point where the lidar does not look."""

Floats = NDArray[np.float64]


class NearEchoes:
    """Points of the newest scan, each placed where the robot was when its beam was measured.

    What was seen before stays, for a while, where the newest scan does not look. Where it cannot
    look, as into the sun, a lone echo may be light or dust, and no beam will ever see past it: only
    what other echoes bear out stays there.

    Args:
        base_T_laser: where the lidar sits.
        reach: echoes farther than this from `base_link` are left out [m].
    """

    def __init__(self, base_T_laser: Pose2D, reach: float) -> None:
        self._base_T_laser = base_T_laser
        self._reach = reach
        self._points_odom: Floats = np.empty((0, 2))
        self._seen_ns = np.empty(0, dtype=np.int64)
        self._is_borne_out = np.empty(0, dtype=np.bool_)
        self._num_new = 0

    def update(self, scan: LidarScan, track: OdometryTrack) -> None:
        """Take a new scan, of at least one beam, in place of what it looks at anew."""
        beams = np.arange(len(scan.ranges))
        odom_T_laser = laser_poses(scan, track, self._base_T_laser)
        seen = is_echo(scan.ranges)
        seen &= scan.ranges < self._reach + np.hypot(self._base_T_laser.x, self._base_T_laser.y)
        poses = odom_T_laser[seen]
        ranges = _smoothed(scan)[seen]
        angles = poses[:, 2] + scan.angle_min + beams[seen] * scan.angle_increment
        new = poses[:, :2] + ranges[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        failing = _failing_shares(scan)
        is_borne_out = self._are_borne_out(new, failing[seen], scan.stamp_ns)
        kept = self._remembered(scan, track.odom_T_base, failing > 0.5)
        self._num_new = len(new)
        self._is_borne_out = np.concatenate([is_borne_out, self._is_borne_out[kept]])
        self._points_odom = np.concatenate([new, self._points_odom[kept]])
        self._seen_ns = np.concatenate(
            [np.full(len(new), scan.stamp_ns, dtype=np.int64), self._seen_ns[kept]]
        )

    def points(self, odom_T_base: Pose2D) -> Floats:
        """Return the echoes (n, 2) x, y [m] in `base_link` where it is now."""
        counts = self._is_borne_out.copy()
        counts[: self._num_new] = True
        return odom_T_base.inverse().transform_points(self._points_odom[counts])

    def _are_borne_out(self, new: Floats, failing: Floats, stamp_ns: int) -> NDArray[np.bool_]:
        """Say which of the new echoes (n, 2) neither light nor dust makes.

        Args:
            new: in the order of the beams.
            failing: (n,) share of the beams around each that are invalid.
            stamp_ns: of the scan.
        """
        is_borne_out = failing == 0.0
        for shift in range(1, PARAMS.max_smoothed + 1):
            are_near = _are_near(new[shift:] - new[:-shift])
            is_borne_out[shift:] |= are_near
            is_borne_out[:-shift] |= are_near
        lone = new[~is_borne_out]
        is_before = self._is_borne_out | (stamp_ns - self._seen_ns < PARAMS.borne_out_s * 1e9)
        before = self._points_odom[is_before]
        is_borne_out[~is_borne_out] = _are_near(lone[:, None] - before).any(axis=1)
        return is_borne_out

    def _remembered(
        self, scan: LidarScan, odom_T_base: Pose2D, blind: NDArray[np.bool_]
    ) -> NDArray[np.int64]:
        """Return the indices of known points that no beam of a scan measures or sees past."""
        if is_round(scan) and not blind.any():
            return np.empty(0, dtype=np.int64)  # it looks everywhere, and sees
        base = odom_T_base.inverse().transform_points(self._points_odom)
        laser = self._base_T_laser.inverse().transform_points(base)
        beams = _beams_towards(scan, laser)
        fails = (beams != OUT_OF_VIEW) & blind[beams]
        age_s = (scan.stamp_ns - self._seen_ns) * 1e-9
        is_recent = age_s < SIGHT.memory_s
        is_near = np.hypot(laser[:, 0], laser[:, 1]) < scan.range_min + PARAMS.blind_margin_m
        is_kept = (is_recent & (fails | (beams == OUT_OF_VIEW))) | (is_near & fails)
        is_kept &= self._is_borne_out | (age_s < PARAMS.borne_out_s)
        is_kept &= np.hypot(base[:, 0], base[:, 1]) < self._reach
        kept = np.flatnonzero(is_kept)
        cells = np.floor(self._points_odom[kept] / PARAMS.remembered_m).astype(np.int64)
        _, first = np.unique(cells[:, 0] * 2**32 + cells[:, 1], return_index=True)
        return kept[np.sort(first)][: PARAMS.max_remembered]


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


def is_round(scan: LidarScan) -> bool:
    """Say whether a scan looks all around, but for a beam or two."""
    return (len(scan.ranges) + 2) * scan.angle_increment > 2.0 * np.pi


def _beams_towards(scan: LidarScan, points_laser: Floats) -> NDArray[np.int64]:
    """Return the beams (n,) that look at points (n, 2) [m] in the laser's frame."""
    angles = np.arctan2(points_laser[:, 1], points_laser[:, 0])
    turned = (angles - scan.angle_min + 0.5 * scan.angle_increment) % (2.0 * np.pi)
    beams = np.floor(turned / scan.angle_increment).astype(np.int64)
    if is_round(scan):
        return np.minimum(beams, len(scan.ranges) - 1)
    return np.where(beams < len(scan.ranges), beams, OUT_OF_VIEW)


def _failing_shares(scan: LidarScan) -> Floats:
    """Return which share of the beams around each (n,) is invalid.

    An invalid beam is 0: it measured neither the thing nor anything behind it. One that fails by
    itself among many must not make a wall forgotten.
    """
    width = max(1, round(PARAMS.blind_width / scan.angle_increment))
    width = min(width, len(scan.ranges))  # else there is a share for each of `width`
    invalid = (scan.ranges == 0.0).astype(np.float64)
    return np.convolve(invalid, np.ones(width) / width, mode="same")


def _are_near(apart: Floats) -> NDArray[np.bool_]:
    """Say which distances (..., 2) x, y [m] are so short that one echo bears out another."""
    are_near = np.abs(apart) < PARAMS.borne_out_m
    return are_near[..., 0] & are_near[..., 1]  # `max` takes three times as long
