"""The mapper without wire, clock and files: scans and odometry in, poses and a map out.

Frames: `map` (fixed by the first keyframe), `odom`, `base_link`.
"""

import math
from typing import Self

import numpy as np

from trolley.config.mapper import MapperConfig
from trolley.geometry import Pose2D
from trolley.gridmap import UNKNOWN, GridMap
from trolley_mapper.estimate import Anchor, MapEstimate, Reject
from trolley_mapper.scan import ScanInput


class MapJob:
    """Heavy work (loop search and optimisation) that touches nothing of the mapper."""

    def run(self) -> "MapJob":
        """Do the work, in any thread; returns itself."""
        return self


class Mapper:
    """Makes a map from scans and odometry.

    Heavy work is handed out: after each call of `step` ask `take_job`, run the job anywhere (it
    touches nothing of the mapper), and give it back to `finish` from the thread that calls `step`.

    Args:
        config: settings.
        start: map_T_base at the first scan; None: the origin, or with a prior a search on it.
        prior: an existing map to extend.
    """

    def __init__(
        self, config: MapperConfig, start: Pose2D | None = None, prior: GridMap | None = None
    ) -> None:
        self._config = config
        self._pose = start or Pose2D.identity()
        self._last: ScanInput | None = None
        self._is_paused = False

    def step(self, scan: ScanInput) -> MapEstimate | Reject:
        """Take one scan and its odometry into account."""
        if self._last is not None:
            if scan.stamp_ns <= self._last.stamp_ns:
                return Reject.OLD_STAMP
            self._pose = self._pose @ self._last.odom_T_base.inverse() @ scan.odom_T_base
        self._last = scan
        return MapEstimate(
            stamp_ns=scan.stamp_ns,
            pose=self._pose,
            covariance=np.diag([0.01, 0.01, math.radians(3.0) ** 2]),
            match=1.0,
            state="mapping",
            message="",
            map_T_odom=self._pose @ scan.odom_T_base.inverse(),
            closed_loop=False,
        )

    def take_job(self) -> MapJob | None:
        """Return work to do now, or None. Give it back to `finish` when it is done."""
        return None

    def finish(self, job: MapJob) -> None:
        """Take the outcome of a job into account."""

    def grid(self) -> GridMap:
        """Return the map as it is now; cheap as long as `version` is the same."""
        cells = np.full((1, 1), UNKNOWN, np.int8)
        return GridMap("map", self._config.resolution_m, Pose2D.identity(), cells)

    @property
    def version(self) -> int:
        """A number that changes whenever `grid` would return something else."""
        return 0

    def anchor(self, map_T_pose: Pose2D) -> Anchor:
        """Tie a pose to the nearest keyframe."""
        return Anchor(-1, map_T_pose)

    def moved(self, anchor: Anchor) -> Pose2D:
        """Return where an anchored pose lies on the map now: map_T_pose."""
        return anchor.keyframe_T_pose

    def undo(self, seconds: float) -> Pose2D | None:
        """Forget what was mapped in the last seconds of robot time; tracking goes on.

        Returns:
            map_T_base of the newest keyframe that is left; None when there is none.
        """
        return None

    def pause(self) -> None:
        """Let the map be as it is; the pose is followed on it as long as the scans fit."""
        self._is_paused = True

    def resume(self, pose: Pose2D | None = None) -> None:
        """Go on mapping; with a pose where the robot was carried to, map_T_base."""
        self._is_paused = False
        if pose is not None:
            self._pose = pose

    @property
    def is_paused(self) -> bool:
        """Whether the map is let be as it is."""
        return self._is_paused

    @property
    def num_keyframes(self) -> int:
        """Number of scans that the map is made of."""
        return 0

    @property
    def memory_bytes(self) -> int:
        """Bytes of keyframes, graph and grids, about."""
        return 0

    def to_bytes(self) -> bytes:
        """Return all that is needed to go on after a restart, compactly."""
        return b""

    @classmethod
    def from_bytes(cls, config: MapperConfig, data: bytes) -> Self:
        """Make a mapper that goes on where `to_bytes` was called.

        The robot is taken to stand where it stood then; the first scan checks it.

        Raises:
            ValueError: the bytes are none of a mapper, or damaged.
        """
        return cls(config)
