"""Where things are: the robot's frames, and its path over the last two seconds."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
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
        try:
            return self.tree.lookup(self.world, frame)
        except MissingLink:
            return None

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
        beams = np.arange(ranges.shape[0], dtype=np.float64)
        angles = scan.angle_min + scan.angle_increment * beams
        with np.errstate(invalid="ignore"):
            points_laser = ranges[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        points_base = base_T_laser.transform_points(points_laser)
        times_s = (scan.stamp_ns - self._odometry[-1].stamp_ns) * 1e-9 + scan.time_increment * beams
        odom_T_base = self._poses_at(times_s)
        return world_T_odom.transform_points(seen_from(odom_T_base, points_base))

    def _base_T_laser(self, frame: str) -> Pose2D | None:
        try:
            return self.tree.lookup(BASE, frame)
        except MissingLink:
            return None

    def _poses_at(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """The odometry at times relative to the newest, (n, 3); beyond the ends it stands still."""
        newest_ns = self._odometry[-1].stamp_ns
        known_s = np.array([(one.stamp_ns - newest_ns) * 1e-9 for one in self._odometry])
        poses = np.array([[one.pose.x, one.pose.y, one.pose.yaw] for one in self._odometry])
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
