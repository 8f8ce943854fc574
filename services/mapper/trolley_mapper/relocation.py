"""Finding a robot that was carried elsewhere, on the map made so far."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley_mapper.atlas import Atlas
from trolley_mapper.local_map import LocalMap
from trolley_mapper.scan import Sweep
from trolley_mapper.tracking import judge

_LEAST_SCORE = 0.55
_GOOD_MATCH = 0.85
_GOOD_EXPLAINED = 0.75
_MARGIN_M = 2.0


@dataclass(eq=False)
class RelocationJob:
    """Search of all poses on the map for the one from which a scan fits.

    Attributes:
        atlas: a copy.
        sweep: the scan.
        odom_T_base: where the odometry was at it.
        found: map_T_base (3,), None where nothing fits.
    """

    atlas: Atlas
    sweep: Sweep
    odom_T_base: Pose2D
    found: NDArray[np.float64] | None = None

    def run(self) -> "RelocationJob":
        """Search; returns itself."""
        poses = self.atlas.poses
        places = [poses[[not one.is_prior for one in self.atlas.keyframes], :2]]
        places += [one.floor for one in self.atlas.keyframes if one.floor is not None]
        low = np.min([place.min(axis=0) for place in places if len(place)], axis=0)
        high = np.max([place.max(axis=0) for place in places if len(place)], axis=0)
        centre = np.array([*(0.5 * (low + high)), 0.0])
        half = 0.5 * float((high - low).max()) + _MARGIN_M
        local = LocalMap(self.atlas.keyframes, poses, centre[:2], half + 15.0)
        best = local.correlate(self.sweep.cloud, centre, (half, math.pi), _LEAST_SCORE, 0.0)
        if best is None:
            return self
        nothing = np.diag([1.0, 1.0, 1.0])
        pose, _ = local.align(best[0], self.sweep.cloud, best[0], nothing, 0.3)
        verdict = judge(local, pose, self.sweep, by_side=True)
        if verdict.match >= _GOOD_MATCH and verdict.explained >= _GOOD_EXPLAINED:
            self.found = pose
        return self
