"""Where things are: the robot's frames, and its path over the last two seconds."""

import functools
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, interpolate_straight
from trolley.geometry.frames import BASE, MAP, ODOM, FrameTree, MissingLink
from trolley.messages import Odometry, Scan, Transform


class Placement:
    """The frame tree of one robot as its messages tell it.

    Everything is drawn in one frame, `world`: `map` where the robot has one, else `odom`.
    """

    def __init__(self) -> None:
        self.tree = FrameTree()
        self.world = MAP
        self._odometry: Sequence[Odometry] = ()
        self._found: dict[str, Pose2D | None] = {}
        """Where frames are in the world, as far as it was asked since the last message."""

    def update(
        self,
        transforms: Mapping[tuple[str, ...], Transform],
        odometry: Sequence[Odometry],
        *,
        has_map: bool,
    ) -> None:
        """Update from the newest messages.

        Args:
            transforms: the newest of each `tf/<child>`.
            odometry: the last two seconds, oldest first.
            has_map: whether a map is known, so that `map` is the world even before the robot
                has found itself on it.
        """
        self.tree.clear()
        self._found.clear()
        if odometry:
            last = odometry[-1]
            self.tree.set(ODOM, BASE, last.pose, last.stamp_ns)
        for (child,), transform in transforms.items():
            if child == BASE:
                continue
            try:
                self.tree.set(transform.parent, child, transform.pose, transform.stamp_ns)
            except ValueError:  # a loop or a nameless frame: somebody else's mistake, not drawn
                continue
        self.world = MAP if has_map or self.tree.link(ODOM) is not None else ODOM
        self._odometry = odometry

    def world_T(self, frame: str) -> Pose2D | None:  # noqa: N802 - the notation of the whole code
        """The pose of a frame in the world, None while it is not connected."""
        if frame not in self._found:  # nearly every layer asks for the map's
            try:
                self._found[frame] = self.tree.lookup(self.world, frame)
            except MissingLink:
                self._found[frame] = None
        return self._found[frame]

    def missing(self, frame: str) -> str:
        """Why a frame has no place in the world; empty if it has one."""
        try:
            self.tree.lookup(self.world, frame)
        except MissingLink as missing:
            return str(missing)
        return ""

    @property
    def world_T_base(self) -> Pose2D | None:
        """The robot's pose in the world."""
        return self.world_T(BASE)

    def scan_points(self, scan: Scan, ranges: NDArray[np.float32]) -> NDArray[np.float64] | None:
        """Place the echoes of a scan in the world, each where the robot was at its beam's time.

        Args:
            scan: the scan.
            ranges: (n,) [m], one per beam; those that are not finite come back not finite.

        Returns:
            (n, 2) x, y [m], or None while the laser has no place in the world.
        """
        world_T_odom, base_T_laser = self.world_T(ODOM), self._base_T_laser(scan.frame)
        if world_T_odom is None or base_T_laser is None or not self._odometry:
            return None
        num = ranges.shape[0]
        with np.errstate(invalid="ignore"):
            points_laser = ranges[:, None] * _directions(num, scan.angle_min, scan.angle_increment)
        around = self._odometry_around(scan.stamp_ns)
        still = around[0].pose
        if scan.time_increment == 0.0 or all(one.pose == still for one in around):
            odom_T_base = _pose_at(around, scan.stamp_ns)
            return (world_T_odom @ odom_T_base @ base_T_laser).transform_points(points_laser)
        odom_T_base = _poses_at(
            around, scan.stamp_ns, scan.time_increment * np.arange(num, dtype=np.float64)
        )
        points_odom = seen_from(odom_T_base, base_T_laser.transform_points(points_laser))
        return world_T_odom.transform_points(points_odom)

    def _base_T_laser(self, frame: str) -> Pose2D | None:
        try:
            return self.tree.lookup(BASE, frame)
        except MissingLink:
            return None

    def _odometry_around(self, stamp_ns: int) -> Sequence[Odometry]:
        """The odometry from the last that is not newer than a time [ns], else all there is."""
        odometry = self._odometry
        first = len(odometry) - 1
        while first > 0 and odometry[first].stamp_ns > stamp_ns:
            first -= 1
        return odometry[first:]


@functools.lru_cache(maxsize=4)
def _directions(num: int, angle_min: float, angle_increment: float) -> NDArray[np.float64]:
    """Where beams point, (num, 2) x, y: a lidar measures at the same angles again and again."""
    angles = angle_min + angle_increment * np.arange(num, dtype=np.float64)
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    directions.flags.writeable = False
    return directions


def _pose_at(odometry: Sequence[Odometry], stamp_ns: int) -> Pose2D:
    """The odometry at a time [ns] in its first interval; beyond the ends it stands still."""
    if len(odometry) == 1 or stamp_ns <= odometry[0].stamp_ns:
        return odometry[0].pose
    start, end = odometry[:2]
    fraction = (stamp_ns - start.stamp_ns) / (end.stamp_ns - start.stamp_ns)
    return interpolate_straight(start.pose, end.pose, fraction)


def _poses_at(
    odometry: Sequence[Odometry], stamp_ns: int, times_s: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The odometry at times after a stamp, (n, 3); beyond the ends it stands still."""
    known_s = np.array([(one.stamp_ns - stamp_ns) * 1e-9 for one in odometry])
    poses = np.array([[one.pose.x, one.pose.y, one.pose.yaw] for one in odometry])
    return poses_between(times_s, known_s, poses)


def poses_between(
    times_s: NDArray[np.float64], known_s: NDArray[np.float64], poses: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the poses (n, 3) at times (n,) between known ones (k, 3) at their times (k,)."""
    columns = poses[:, 0], poses[:, 1], np.unwrap(poses[:, 2])
    return np.stack([np.interp(times_s, known_s, column) for column in columns], axis=1)


def seen_from(poses: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points (n, 2), each as it is told from a pose of its own (n, 3), in their frame."""
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    placed = np.empty_like(points)
    with np.errstate(invalid="ignore"):
        ahead, left = points[:, 0], points[:, 1]
        placed[:, 0] = poses[:, 0] + cos * ahead - sin * left
        placed[:, 1] = poses[:, 1] + sin * ahead + cos * left
    return placed
