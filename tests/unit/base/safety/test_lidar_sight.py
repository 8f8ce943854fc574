"""What the lidar sees around the robot is put into its frame once a scan and place."""

import numpy as np

from trolley.geometry import Pose2D, Twist2D
from trolley_base.drivers import LidarScan, MotionSample
from trolley_base.odometry.track import OdometryTrack
from trolley_base.safety.lidar_sight import LidarSight
from trolley_base.safety.lidar_view import LidarView
from trolley_base.safety.near_echoes import NearEchoes
from trolley_base.safety.observed_space import ObservedSpace

FOOTPRINT = np.array([[0.15, -0.12], [0.15, 0.12], [-0.15, 0.12], [-0.15, -0.12]])
MOUNT = Pose2D(0.0, 0.0, 0.0)
BEAMS = 360


def wall_around(distance_m: float, stamp_ns: int) -> LidarScan:
    step = 2.0 * np.pi / BEAMS
    # Not all the same: a lidar that repeats a scan hangs.
    ranges = distance_m + 1e-3 * np.sin(np.arange(BEAMS) + 1e-9 * stamp_ns)
    return LidarScan(stamp_ns, -np.pi, step, 0.0, 0.1, 8.0, ranges.astype(np.float32))


def test_it_is_computed_anew_only_after_a_scan_or_a_motion() -> None:
    sight = LidarSight(
        NearEchoes(MOUNT, 2.0), ObservedSpace(FOOTPRINT, MOUNT, 2.0), LidarView(FOOTPRINT, MOUNT)
    )
    track = OdometryTrack(0)
    assert len(sight.around(track.odom_T_base)[0]) == 0
    sight.update(wall_around(1.0, 0), track, 0)
    first = sight.around(track.odom_T_base)
    assert len(first[0]) == BEAMS
    assert sight.around(Pose2D(0.0, 0.0, 0.0)) is first
    sight.update(wall_around(0.8, 10**8), track, 10**8)
    assert np.abs(sight.around(track.odom_T_base)[0][:, 0]).max() < 0.81
    track.add(MotionSample(2 * 10**8, Pose2D(0.1, 0.0, 0.0), Twist2D.zero()))
    assert np.abs(sight.around(track.odom_T_base)[0][:, 0]).max() > 0.89
