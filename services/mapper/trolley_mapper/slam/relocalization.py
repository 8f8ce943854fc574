"""Finding a robot that was carried elsewhere, on the map made so far."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley_mapper.slam.keyframe_store import Atlas
from trolley_mapper.slam.local_map import LocalMap
from trolley_mapper.slam.scan_matcher import judge
from trolley_mapper.slam.sweep import Sweep

_LEAST_SCORE = 0.55
_GOOD_MATCH = 0.85
_GOOD_EXPLAINED = 0.75
_MARGIN_M = 2.0
# What lies so far from the best place is another one [m, rad]. Where that fits almost as well, by
# its score and in the end, nobody can tell which of the two it is.
_ELSEWHERE_M = 1.0
_ELSEWHERE_RAD = 0.5
_RIVAL_SCORE = 0.15
_RIVAL_MATCH = 0.1


@dataclass(eq=False)
class RelocationJob:
    """Search of all poses on the map for the one from which a scan fits, and no other.

    Attributes:
        atlas: a copy.
        sweep: the scan.
        odom_T_base: where the odometry was at it.
        found: map_T_base (3,), None where nothing fits, or several places do.
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
        pose, match = self._look_closely(local, best[0])
        if match >= _GOOD_MATCH and not self._has_rival(local, best, half, match):
            self.found = pose
        return self

    def _look_closely(
        self, local: LocalMap, start: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], float]:
        """Return the aligned pose and how well the scan fits there; 0 where it shows too little."""
        nothing = np.diag([1.0, 1.0, 1.0])
        pose, _ = local.align(start, self.sweep.cloud, start, nothing, 0.3)
        verdict = judge(local, pose, self.sweep, by_side=True)
        return pose, verdict.match if verdict.explained >= _GOOD_EXPLAINED else 0.0

    def _has_rival(
        self, local: LocalMap, best: tuple[NDArray[np.float64], float], half: float, match: float
    ) -> bool:
        """Say whether the scan fits elsewhere almost as well as at the best pose."""
        pose, score = best
        least = max(_LEAST_SCORE, score - _RIVAL_SCORE)
        far = 2.0 * half
        away = far + _ELSEWHERE_M
        # Elsewhere is: turned round anywhere, or alike on any of the four sides.
        windows = [(np.array([0.0, 0.0, math.pi]), far, math.pi - _ELSEWHERE_RAD)]
        windows += [
            (np.array([x, y, 0.0]), far, _ELSEWHERE_RAD)
            for x, y in ((away, 0.0), (-away, 0.0), (0.0, away), (0.0, -away))
        ]
        for shift, reach_m, reach_rad in windows:
            window = (reach_m, reach_rad)
            rival = local.correlate(self.sweep.cloud, pose + shift, window, least, 0.0)
            if rival is None:
                continue
            if self._look_closely(local, rival[0])[1] >= match - _RIVAL_MATCH:
                return True
        return False
