"""What the lidar sees now: what is near, which floor is free, how much of it all is in view.

A covered lidar, or one that repeats one scan, sees nothing, however punctually it reports.
"""

import msgspec
import numpy as np

from trolley.geometry import Pose2D
from trolley.messages import Link
from trolley_base.drivers import LidarScan
from trolley_base.odometry.track import OdometryTrack
from trolley_base.safety.frozen_lidar import FrozenLidar
from trolley_base.safety.lidar_view import LidarView, without_cover
from trolley_base.safety.near_echoes import Floats, NearEchoes
from trolley_base.safety.observed_space import ObservedSpace, Unseen

COVERED_MESSAGE = "The lidar sees nothing at all; is something covering it?"
FROZEN_MESSAGE = (
    "The lidar repeats one and the same scan although the robot moves: it hangs; plug it in again."
)


class LidarSight:
    """Takes in each scan, and tells what is around the robot by all of them.

    Args:
        echoes: what the lidar saw near the robot.
        space: which floor it has seen to be free.
        view: how much of its surroundings it sees.
    """

    def __init__(self, echoes: NearEchoes, space: ObservedSpace, view: LidarView) -> None:
        self._echoes = echoes
        self._space = space
        self.view = view
        """How much of its surroundings the lidar sees."""
        self._frozen = FrozenLidar()
        self._is_covered = self._is_frozen = False
        self._seen_ns: int | None = None
        self._place: Pose2D | None = None
        self._around = echoes.points(Pose2D.identity()), space.unseen(Pose2D.identity())

    def begin(self, *, knows_motion: bool) -> None:
        """Begin a run with a lidar that has been opened.

        Args:
            knows_motion: something else than the lidar says how the robot moves.
        """
        self._frozen = FrozenLidar(knows_motion=knows_motion)

    def update(self, scan: LidarScan, track: OdometryTrack, now_ns: int) -> None:
        """Take in a scan of at least one beam."""
        self._place = None
        scan = without_cover(scan)
        self._is_frozen = self._frozen.update(scan, track.odom_T_base)
        if self._is_frozen:
            return
        seen = self.view.update(scan, track.odom_T_base)
        self._space.update(seen, track)
        # A covered lidar measures nothing valid, which is as good as silence.
        self._is_covered = not np.any(scan.ranges > 0.0)
        if not self._is_covered:
            # What stood near is not gone because of beams that prove nothing.
            self._echoes.update(seen if self.view.lacks_echoes else scan, track)
            self._seen_ns = now_ns

    def around(self, odom_T_base: Pose2D) -> tuple[Floats, Unseen]:
        """Return (n, 2) what it saw near the robot [m], and what it has not seen, in `base_link`.

        Base asks 50 times a second, and many a board reports a motion 20 times.
        """
        if self._place != odom_T_base:
            self._place = odom_T_base
            self._around = self._echoes.points(odom_T_base), self._space.unseen(odom_T_base)
        return self._around

    def age_ns(self, now_ns: int) -> int | None:
        """Return how long ago it saw something [ns], None if it never did."""
        return None if self._seen_ns is None else now_ns - self._seen_ns

    def judged(self, link: Link) -> Link:
        """Return the lidar's link with what its scans say about it."""
        if self._is_frozen and link.state == "up":
            return msgspec.structs.replace(link, state="down", message=FROZEN_MESSAGE)
        if self._is_covered and link.state == "up":
            return msgspec.structs.replace(link, message=COVERED_MESSAGE)
        return link
