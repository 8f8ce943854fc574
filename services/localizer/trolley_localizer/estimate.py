"""What the localizer says after each scan."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.scanning import ScanInput
from trolley_localizer.tracking_state import TrackingState


@dataclass(frozen=True, slots=True)
class CandidatePose:
    """One place where the robot might be, in the map frame."""

    map_T_base: Pose2D
    match: float
    """Share of beams that the map explains from there, 0 ... 1."""


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Where the robot was at the stamp of a scan."""

    stamp_ns: int
    """Robot time of the scan's first beam, for which the pose holds [ns]."""
    map_T_base: Pose2D | None
    """The pose; None until one is known."""
    map_T_odom: Pose2D | None
    """`map_T_base` with the odometry taken off; held while searching or lost."""
    covariance: NDArray[np.float64] | None
    """(3, 3) over x, y [m], yaw [rad] in the map frame."""
    state: TrackingState
    match: float
    """Share of beams that the map explains, 0 ... 1."""
    spread: float
    """Root mean square distance of the hypotheses from their mean [m]."""
    beam_classes: NDArray[np.uint8]
    """(n,) 0 explained, 1 not on the map, 2 behind mirror or glass, 3 suspected, 4 unused."""
    candidates: list[CandidatePose] = field(default_factory=list[CandidatePose])
    """The places between which the scans cannot decide yet, best first."""
    wants_turn: bool = False
    """Whether a turn in place would help to tell the candidates apart."""
    message: str = ""
    """What is the matter, in one sentence; empty when all is well."""
    off_m: float | None = None
    """Distance driven since the map ended [m]; None on the map."""

    def held(self, scan: ScanInput) -> "Estimate":
        """Return the same at the stamp of a later scan, which told nothing new."""
        known = self.map_T_odom
        pose = None if known is None else (known @ scan.odom_T_base).wrapped()
        return replace(self, stamp_ns=scan.stamp_ns, map_T_base=pose)
