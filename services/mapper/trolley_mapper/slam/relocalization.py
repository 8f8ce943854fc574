"""Finding a robot that was carried elsewhere, on the map made so far."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley_mapper.slam.keyframe_store import KeyframeStore
from trolley_mapper.slam.local_map import LocalMap
from trolley_mapper.slam.scan_matcher import judge
from trolley_mapper.slam.sweep import Sweep


@dataclass(frozen=True, slots=True)
class RelocalizationParams:
    """When a lost robot counts as found. Set by hand."""

    min_score: float = 0.55
    """The search looks for no lower score, 0 ... 1."""
    min_match: float = 0.85
    """Share of the points in known space that must be explained."""
    min_explained: float = 0.75
    """Share of all points that must be explained."""
    margin_m: float = 2.0
    """The search reaches this far beyond what was driven and seen to be free [m]."""
    elsewhere_m: float = 1.0
    """A pose this far from the best one is another [m]."""
    elsewhere_rad: float = 0.5
    """The same for its heading [rad]."""
    rival_score: float = 0.15
    """Where another pose scores almost as well, by this, it is looked at closely."""
    rival_match: float = 0.1
    """Where its match is almost as good, by this, nobody can tell which is right."""


PARAMS = RelocalizationParams()


@dataclass(eq=False)
class RelocalizationJob:
    """Search of all poses on the map for the one from which a scan fits, and no other.

    Attributes:
        store: a copy.
        sweep: the scan.
        odom_T_base: where the odometry was at it.
        found: map_T_base (3,), None where nothing fits, or several places do.
    """

    store: KeyframeStore
    sweep: Sweep
    odom_T_base: Pose2D
    found: NDArray[np.float64] | None = None

    def run(self) -> "RelocalizationJob":
        """Search; returns itself."""
        poses = self.store.poses
        places = [poses[[not one.is_prior for one in self.store.keyframes], :2]]
        places += [one.floor for one in self.store.keyframes if one.floor is not None]
        low = np.min([place.min(axis=0) for place in places if len(place)], axis=0)
        high = np.max([place.max(axis=0) for place in places if len(place)], axis=0)
        centre = np.array([*(0.5 * (low + high)), 0.0])
        half = 0.5 * float((high - low).max()) + PARAMS.margin_m
        local = LocalMap(self.store.keyframes, poses, centre[:2], half + 15.0)
        best = local.correlate(self.sweep.cloud, centre, (half, math.pi), PARAMS.min_score, 0.0)
        if best is None:
            return self
        pose, match = self._align(local, best[0])
        if match >= PARAMS.min_match and not self._has_rival(local, best, half, match):
            self.found = pose
        return self

    def _align(
        self, local: LocalMap, start: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], float]:
        """Return the aligned pose and how well the scan fits there; 0 where it shows too little."""
        nothing = np.diag([1.0, 1.0, 1.0])
        pose, _ = local.align(start, self.sweep.cloud, start, nothing, 0.3)
        quality = judge(local, pose, self.sweep, by_side=True)
        return pose, quality.match if quality.explained >= PARAMS.min_explained else 0.0

    def _has_rival(
        self, local: LocalMap, best: tuple[NDArray[np.float64], float], half: float, match: float
    ) -> bool:
        """Say whether the scan fits elsewhere almost as well as at the best pose."""
        pose, score = best
        least = max(PARAMS.min_score, score - PARAMS.rival_score)
        far = 2.0 * half
        away = far + PARAMS.elsewhere_m
        # Elsewhere is: turned round anywhere, or alike on any of the four sides.
        windows = [(np.array([0.0, 0.0, math.pi]), far, math.pi - PARAMS.elsewhere_rad)]
        windows += [
            (np.array([x, y, 0.0]), far, PARAMS.elsewhere_rad)
            for x, y in ((away, 0.0), (-away, 0.0), (0.0, away), (0.0, -away))
        ]
        for shift, reach_m, reach_rad in windows:
            window = (reach_m, reach_rad)
            rival = local.correlate(self.sweep.cloud, pose + shift, window, least, 0.0)
            if rival is None:
                continue
            if self._align(local, rival[0])[1] >= match - PARAMS.rival_match:
                return True
        return False
