"""How well the lidar gives odometry on recorded drives: alone, and together with the wheels.

    TROLLEY_DATA=/path/to/recordings python -m bench.base.scan_odometry [--drives NAME ...]

Drift is how far the end of a stretch of 10 m (5 m for the short drive) is off, seen from its
beginning, in per cent of the stretch; the references themselves err by about 0.04 m, which is 0.4 %
of 10 m. A scan is lost where the last metre of the way is off by more than 0.2 m or 10 degrees.
Honest is the error over 2 m by the deviation that the covariances add up to, its root mean square:
1 is honest, below 1 cautious.

The second table has `[base.odometry] source = "both"`, beside the wheels alone. The raw odometry
of freiburg-079 runs ahead where the robot goes back, and its turns are 8 % short. Found is the
share of the scans with the robot going back in which the wheels are said to be wrong.
"""

import argparse
import math
import time
from dataclasses import dataclass

import numpy as np
from bench.harness.figures import Figure, at_most, recordings_folder, show, table
from bench.harness.recorded import Recording
from bench.mapper.recorded_drives import drives
from numpy.typing import NDArray

from trolley.geometry import Pose2D, Twist2D, angle_difference
from trolley.scan_matching.scan_odometry import ScanOdometry
from trolley_base.drivers import LidarScan, MotionSample
from trolley_base.odometry.lidar_odometry import LidarOdometry

LOST_M, LOST_RAD = 0.2, math.radians(10.0)
"""Error over the last metre beyond which a scan is lost."""
HEADS = [
    "drive", "scans", "way m", "drift %", "median", "95th", "deg/m", "end m", "lost %", "said %",
    "honest x", "y", "yaw", "ms", "99th",
]  # fmt: skip


@dataclass(frozen=True)
class Followed:
    """A drive as the lidar alone saw it."""

    recording: Recording
    poses: list[Pose2D]
    covariances: list[NDArray[np.float64]]
    is_lost: NDArray[np.bool_]
    seconds: NDArray[np.float64]


def follow(recording: Recording) -> Followed:
    """Follow a drive by its scans."""
    odometry = ScanOdometry()
    poses: list[Pose2D] = []
    covariances: list[NDArray[np.float64]] = []
    lost: list[bool] = []
    seconds: list[float] = []
    for index in range(len(recording.stamps)):
        scan = recording.scan(index)
        begin_s = time.process_time()
        motion = odometry.update(scan)
        seconds.append(time.process_time() - begin_s)
        poses.append(odometry.pose)
        covariances.append(motion.covariance)
        lost.append(motion.is_lost)
    return Followed(recording, poses, covariances, np.array(lost), np.array(seconds))


def stretches(way_m: NDArray[np.float64], length_m: float) -> list[tuple[int, int]]:
    """First and last scan of each stretch, one beginning at every scan."""
    ends = np.searchsorted(way_m, way_m + length_m)
    return [(k, int(end)) for k, end in enumerate(ends) if end < len(way_m)]


def errors(one: Followed, pairs: list[tuple[int, int]]) -> NDArray[np.float64]:
    """How far the ends of stretches are off (n, 3) x, y [m], yaw [rad], in the frame of the end."""
    found: list[list[float]] = []
    for a, b in pairs:
        moved = one.poses[a].inverse() @ one.poses[b]
        true = one.recording.reference_at(a).inverse() @ one.recording.reference_at(b)
        off = true.inverse() @ moved
        found.append([off.x, off.y, angle_difference(off.yaw, 0.0)])
    return np.array(found).reshape(-1, 3)


def summed(one: Followed, a: int, b: int) -> NDArray[np.float64]:
    """The covariance (3, 3) of the motion from scan a to scan b, in the frame of b."""
    total = np.zeros((3, 3))
    for k in range(a + 1, b + 1):
        rest = one.poses[k].inverse() @ one.poses[b]
        cos, sin = math.cos(rest.yaw), math.sin(rest.yaw)
        # What an error of the pose at k does to the pose at b, in the frame of b.
        back = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
        lever = back @ np.array([[1.0, 0.0, -rest.y], [0.0, 1.0, rest.x], [0.0, 0.0, 1.0]])
        total += lever @ one.covariances[k] @ lever.T
    return total


def follow_both(recording: Recording) -> tuple[list[Pose2D], NDArray[np.bool_]]:
    """Follow a drive by wheels and scans: poses, and whether the wheels are said to be wrong."""
    stamps_ns = np.round(recording.stamps * 1e9).astype(np.int64)
    odometry = LidarOdometry(recording.base_T_laser, 0, has_wheels=True, has_axle=True)
    poses = [Pose2D.identity()]
    troubled: list[bool] = []
    for index, stamp_ns in enumerate(stamps_ns.tolist()):
        step = recording.odom_at(max(index - 1, 0)).inverse() @ recording.odom_at(index)
        motion = MotionSample(stamp_ns, step, Twist2D.zero())
        pose = poses[-1] @ odometry.correct(motion, poses[-1]).previous_T_base
        odometry.update(lidar_scan(recording, index, stamp_ns), None)
        still = MotionSample(stamp_ns, Pose2D.identity(), Twist2D.zero())
        poses.append(pose @ odometry.correct(still, pose).previous_T_base)
        troubled.append(bool(odometry.trouble))
    return poses[1:], np.array(troubled)


def lidar_scan(recording: Recording, index: int, stamp_ns: int) -> LidarScan:
    """A scan as a driver gives it."""
    return LidarScan(
        stamp_ns,
        recording.angle_min,
        recording.angle_increment,
        0.0,
        0.05,
        recording.range_max,
        recording.ranges[index],
    )


def row_both(name: str, recording: Recording) -> tuple[list[str], list[Figure]]:
    """The line of a drive by wheels and scans, and its figures."""
    poses, troubled = follow_both(recording)
    count = len(poses)
    way_m = recording.way_m()
    length_m = 10.0 if way_m[-1] > 20.0 else 5.0
    pairs = stretches(way_m, length_m)
    nothing = np.zeros(count)
    wheels = [recording.odom_at(k) for k in range(count)]
    drifts: list[float] = []
    for found in (wheels, poses):
        off = errors(Followed(recording, found, [], nothing.astype(np.bool_), nothing), pairs)
        drifts.append(100.0 * float(np.hypot(off[:, 0], off[:, 1]).mean()) / length_m)
    steps = [
        recording.reference_at(k).inverse() @ recording.reference_at(k + 1)
        for k in range(count - 1)
    ]
    is_back = np.array([step.x < -0.03 for step in steps])
    cells = [name, f"{drifts[0]:.2f}", f"{drifts[1]:.2f}"]
    cells += [f"{100.0 * troubled[1:][is_back].mean():.0f}" if is_back.any() else ""]
    cells += [f"{100.0 * troubled[1:][~is_back].mean():.1f}"]
    return cells, [at_most(f"{name} with wheels: drift", drifts[1], 1.0, "%", 2)]


def row(name: str, one: Followed) -> tuple[list[str], list[Figure]]:
    """The line of a drive in the table, and its figures."""
    way_m = one.recording.way_m()
    length_m = 10.0 if way_m[-1] > 20.0 else 5.0
    off = errors(one, stretches(way_m, length_m))
    drift = 100.0 * np.hypot(off[:, 0], off[:, 1]) / length_m
    metre = stretches(way_m, 1.0)
    last = errors(one, metre)
    lost = (np.hypot(last[:, 0], last[:, 1]) > LOST_M) | (np.abs(last[:, 2]) > LOST_RAD)
    lost_percent = 100.0 * float(lost.mean())
    some = stretches(way_m, 2.0)[::10]
    deviations = np.sqrt([np.diag(summed(one, a, b)) for a, b in some])
    honest = np.sqrt(np.mean((errors(one, some) / deviations) ** 2, axis=0))
    end = errors(one, [(0, len(way_m) - 1)])[0]
    ms = 1e3 * one.seconds[5:]
    cells = [
        name,
        str(len(way_m)),
        f"{way_m[-1]:.0f}",
        f"{drift.mean():.2f}",
        f"{np.median(drift):.2f}",
        f"{np.quantile(drift, 0.95):.2f}",
        f"{math.degrees(float(np.abs(off[:, 2]).mean())) / length_m:.3f}",
        f"{math.hypot(end[0], end[1]):.2f}",
        f"{lost_percent:.2f}",
        f"{100.0 * one.is_lost.mean():.2f}",
        *(f"{value:.2f}" for value in honest),
        f"{np.median(ms):.2f}",
        f"{np.quantile(ms, 0.99):.2f}",
    ]
    return cells, [
        at_most(f"{name}: drift", float(drift.mean()), 1.0, "%", 2),
        at_most(f"{name}: lost", lost_percent, 2.0, "%", 2),
        at_most(f"{name}: a scan", float(np.median(ms)), 1.0, "ms CPU", 2),
    ]


def main() -> None:
    """Follow the drives and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drives", nargs="+", metavar="NAME")
    options = parser.parse_args()
    folder = recordings_folder()
    if folder is None:
        return
    lines: list[list[str]] = []
    figures: list[Figure] = []
    for name, recording in drives(folder).items():
        # Without the wheels these two are one drive.
        if name != "freiburg-raw" and name in (options.drives or [name]):
            cells, found = row(name, follow(recording))
            lines.append(cells)
            figures += found
    table(HEADS, lines)
    lines = []
    for name, recording in drives(folder).items():
        if name in (options.drives or [name]):
            cells, found = row_both(name, recording)
            lines.append(cells)
            figures += found
    table(["drive", "wheels %", "both %", "going back: found %", "else %"], lines)
    show(figures)


if __name__ == "__main__":
    main()
