"""What the localizer says after each scan."""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D
from trolley.scanning import ScanInput
from trolley_localizer.filter.pose_estimator import PoseEstimator
from trolley_localizer.matching.likelihood_field import LikelihoodField
from trolley_localizer.matching.map_matcher import BeamSet, MatchScore
from trolley_localizer.tracking.states import Following, Searching
from trolley_localizer.tracking.tracking_state import TrackingState


class SeenScan(NamedTuple):
    """A scan, and its beams."""

    scan: ScanInput
    beams: BeamSet


@dataclass(frozen=True, slots=True)
class CandidatePose:
    """One place where the robot might be, in the map frame."""

    map_T_base: Pose2D
    match: float
    """Share of beams that the map explains from there, 0 ... 1."""


class Estimate(msgspec.Struct, frozen=True, eq=False):
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
    candidates: list[CandidatePose] = []
    """The places between which the scans cannot decide yet, best first."""
    wants_turn: bool = False
    """Whether a turn in place would help to tell the candidates apart."""
    message: str = ""
    """What is the matter, in one sentence; empty when all is well."""
    off_m: float | None = None
    """Distance driven since the map ended [m]; None on the map."""
    is_held: bool = False
    """Whether the scan told nothing new: `map_T_odom` is that of the estimate before."""

    def held(self, scan: ScanInput) -> "Estimate":
        """Return the same at the stamp of a later scan, which told nothing new."""
        known = self.map_T_odom
        pose = None if known is None else (known @ scan.odom_T_base).wrapped()
        classes, count = self.beam_classes, scan.ranges.size
        if classes.size != count:  # the lidar turned a little faster or slower
            classes = classes[np.arange(count) * classes.size // count]
        return msgspec.structs.replace(
            self, stamp_ns=scan.stamp_ns, map_T_base=pose, beam_classes=classes, is_held=True
        )


class EstimateReporter:
    """Puts what is known of the pose into an estimate, with a sentence on what is the matter."""

    def __init__(self, field: LikelihoodField, config: LocalizerConfig) -> None:
        self._field = field
        self._config = config
        self._map_T_odom: Pose2D | None = None
        self.said: Estimate | None = None
        """The newest estimate."""

    def set_config(self, config: LocalizerConfig) -> None:
        """Judge by other thresholds from the next scan on."""
        self._config = config

    def restart_odometry(self) -> None:
        """Take it that the odometry begins at zero where the robot was last."""
        if self.said is not None and self.said.map_T_base is not None:
            self._map_T_odom = self.said.map_T_base

    def following(
        self,
        following: Following,
        estimator: PoseEstimator,
        seen: SeenScan,
        score: MatchScore,
        classes: NDArray[np.uint8],
    ) -> Estimate:
        """Say where the robot is."""
        map_T_base = self._field.to_map(estimator.pose)
        self._map_T_odom = map_T_base @ seen.scan.odom_T_base.inverse()
        self.said = Estimate(
            stamp_ns=seen.scan.stamp_ns,
            map_T_base=map_T_base,
            map_T_odom=self._map_T_odom,
            covariance=self._field.covariance_to_map(estimator.covariance),
            state=following.monitor.state,
            match=score.match,
            spread=estimator.spread_m,
            beam_classes=classes,
            message=self._why_unsure(following, estimator.spread_m, seen.beams),
            off_m=following.off_m if following.is_off_map else None,
        )
        return self.said

    def searching(
        self, searching: Searching, seen: SeenScan, state: Literal["searching", "lost"]
    ) -> Estimate:
        """Say that the pose is not known; the last correction of the odometry is held."""
        places, held, beams = searching.places, self._map_T_odom, seen.beams
        items = places.items
        self.said = Estimate(
            stamp_ns=seen.scan.stamp_ns,
            map_T_base=None if held is None else held @ seen.scan.odom_T_base,
            map_T_odom=held,
            covariance=None if held is None else self._wide_covariance(searching),
            state=state,
            match=items[0].match if items else 0.0,
            spread=places.spread_m,
            beam_classes=beams.classes,
            candidates=[CandidatePose(self._field.to_map(i.pose), i.match) for i in items],
            wants_turn=searching.has_result and not beams.is_blind,
            message=_why_searching(searching, beams, state),
        )
        return self.said

    def _wide_covariance(self, searching: Searching) -> NDArray[np.float64]:
        """Return a covariance that says "anywhere among the places, or on the map"."""
        places = searching.places
        is_narrowed = len(places.items) > 1
        spread = places.spread_m if is_narrowed else 0.25 * max(self._field.grid.size_m)
        return np.diag([spread**2 + 1.0, spread**2 + 1.0, math.pi**2 / 3.0])

    def _why_unsure(self, following: Following, spread_m: float, beams: BeamSet) -> str:
        """Say in one sentence why the state is not `localized`."""
        monitor = following.monitor
        if beams.is_blind:
            return "the lidar sees too little to check the pose"
        if monitor.state == "localized":
            return ""
        if following.is_off_map:
            return f"off the map since {following.off_m:.0f} m"
        if following.proof is not None:
            return "driving on will show whether it is here"
        if spread_m > self._config.max_spread_m:
            return "the hypotheses lie far apart"
        if monitor.support < self._config.good_support:
            return "the scan does not fit the map well here"
        return "checking the pose against the scan"


def _why_searching(searching: Searching, beams: BeamSet, state: TrackingState) -> str:
    """Say in one sentence how the search stands."""
    if state == "lost":
        return "the scan does not fit the map here: lost"
    if beams.is_blind:
        return "the lidar sees too little to find the robot"
    if not searching.has_result:
        return "searching the whole map"
    if len(searching.places.items) > 1:
        return "several places look alike: a turn in place would help"
    return "no place on the map fits the scan"
