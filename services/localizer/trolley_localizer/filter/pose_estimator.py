"""The pose that is followed: particles for the alternatives, alignment for the centimetre.

One pose and its covariance are carried by the odometry and aligned with the map by each scan, with
the odometry as prior: along a bare corridor, where the scan says nothing, the odometry decides. The
particle filter keeps the alternatives; the pose changes over to one that fits clearly better.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D
from trolley.scanning import Points
from trolley_localizer.filter.motion_model import move_covariance, split_step, step_covariance
from trolley_localizer.filter.particle_filter import ParticleFilter, lower_root
from trolley_localizer.filter.wall_depth import WallDepth, lengthened
from trolley_localizer.kernels.matching import refine_pose, score_pose
from trolley_localizer.matching.likelihood_field import LikelihoodField
from trolley_localizer.matching.map_matcher import FREE_INFORMATION, BeamSet, MapMatcher


@dataclass(frozen=True, slots=True)
class ScanMatcherParams:
    """How a scan is aligned with the map. All values were found by hand."""

    floor_m: float = 0.003
    """Least deviation of the odometry's position per scan, even at rest [m]."""
    floor_rad: float = 0.003
    """Least deviation of the odometry's heading per scan, even at rest [rad]."""
    beam_dev_m: float = 0.05
    """Standard deviation of a beam's end from the wall [m]."""
    independent_beams: float = 60.0
    """Number of independent beams that a scan counts as: neighbours share their errors."""
    least_dev_m: float = 0.01
    """Least standard deviation of the estimated position: the map is not more exact [m]."""
    least_dev_rad: float = 0.005
    """Least standard deviation of the estimated heading: the map is not more exact [rad]."""
    widths_m: tuple[float, ...] = (0.25, 0.1)
    """Widths of Welsch's function: alignment begins wide and ends narrow [m]."""
    max_steps: int = 8
    """Gauss-Newton steps at each width."""


@dataclass(frozen=True, slots=True)
class PoseEstimatorParams:
    """When a pose from elsewhere replaces the aligned one. Found by hand."""

    cluster_lead: float = 0.03
    """Lead by which the heaviest cluster of particles replaces the estimate."""
    try_lead: float = 0.05
    """Lead by which a pose that was tried at random replaces the estimate."""
    far_lead: float = 0.25
    """Extra lead that a far pose needs: a jump takes more than furniture that was moved."""
    far_m: float = 0.5
    """Distance beyond the odometry's error from which on a pose is far [m]."""
    far_rad: float = 0.5
    """Turn beyond the odometry's error from which on a pose is far [rad]."""
    score_drop: float = 0.1
    """Drop below the usual score at which poses around the estimate are tried."""
    num_tries: int = 1500
    """Number of poses that are tried."""
    try_dev_m: float = 0.25
    """Standard deviation of the positions that are tried [m]."""
    try_dev_rad: float = 0.15
    """Standard deviation of the headings that are tried [rad]."""
    back_support: float = 0.65
    """Support from which on a robot off the map takes a pose close by: what speaks for a place more
    than against it (`ProofParams.between`)."""
    back_farness: float = 0.5
    """Share of what is far within which such a pose must lie."""
    score_slack: float = 0.01
    """Most by which alignment may lower the score: the odometry has a say, too."""
    usual_smoothing: float = 0.05
    """Weight of each scan in the usual score."""
    phase_step: float = 0.6180339887
    """The golden ratio moves the choice of beams evenly from scan to scan."""


MATCHER = ScanMatcherParams()
PARAMS = PoseEstimatorParams()


class AlignedPose:
    """One pose and its covariance. Poses are x, y [cells], yaw [rad] in `grid`."""

    def __init__(self, field: LikelihoodField, config: LocalizerConfig) -> None:
        self._field = field
        self._config = config
        self.walls = field.distance
        """(rows + 2, cols + 2) distance to where beams may end [cells]."""
        self.pose = np.zeros(3)
        self.covariance = np.eye(3)
        self._inverted = self._inverse = np.eye(3)

    def reset(self, pose: NDArray[np.float64], covariance: NDArray[np.float64]) -> None:
        """Start anew at a pose."""
        self.pose = pose.copy()
        self.covariance = covariance.copy()

    def predict(self, step: Pose2D) -> None:
        """Carry the pose through one odometry step [m, m, rad]."""
        resolution = self._field.resolution
        cells = Pose2D(step.x / resolution, step.y / resolution, step.yaw)
        before = Pose2D(float(self.pose[0]), float(self.pose[1]), float(self.pose[2]))
        after = before @ cells
        noise = step_covariance(step, MATCHER.floor_m, MATCHER.floor_rad, self._config)
        cos, sin = math.cos(after.yaw), math.sin(after.yaw)
        turn = np.array(
            [
                [cos / resolution, -sin / resolution, 0.0],
                [sin / resolution, cos / resolution, 0.0],
                [0.0, 0.0, 1.0],
            ]
        )
        self.covariance = move_covariance(self.covariance, before, cells) + turn @ noise @ turn.T
        self.pose = after.as_array()

    def score(self, pose: NDArray[np.float64], points: Points) -> float:
        """Return the mean robust score of a pose, 0 ... 1."""
        width = MATCHER.widths_m[-1] / self._field.resolution
        return score_pose(self.walls, points, pose, width)

    def align(
        self, start: NDArray[np.float64], points: Points, *, is_free: bool
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return a pose moved to where the scan fits, and the scan's information there (3, 3).

        Args:
            start: where to begin.
            points: beam end points.
            is_free: the odometry does not hold the pose back (for a pose from elsewhere).
        """
        pose = start.copy()
        information = np.zeros((3, 3))
        cells = 1.0 / self._field.resolution
        prior_information = self._prior_information(is_free=is_free)
        gain = self.information_of_beam(points)
        for width_m in MATCHER.widths_m:
            refine_pose(
                pose,
                information,
                self.walls,
                points,
                start if is_free else self.pose,
                prior_information,
                np.array([width_m * cells, gain]),
                MATCHER.max_steps,
            )
        return pose, information

    def information_of_beam(self, points: Points) -> float:
        """Return the information of one of so many beams [1/cells^2]."""
        beams = points.x.size
        share = min(MATCHER.independent_beams, beams) / max(beams, 1)
        return share / (MATCHER.beam_dev_m / self._field.resolution) ** 2

    def _prior_information(self, *, is_free: bool) -> NDArray[np.float64]:
        """Return how firmly the odometry holds the pose (3, 3)."""
        if is_free:
            return FREE_INFORMATION
        if self._inverted is not self.covariance:
            self._inverted = self.covariance
            self._inverse = np.asarray(np.linalg.inv(self.covariance), np.float64)
        return self._inverse

    def accept(
        self, pose: NDArray[np.float64], information: NDArray[np.float64], *, is_free: bool
    ) -> None:
        """Take an aligned pose and narrow the covariance by what the scan said."""
        resolution = self._field.resolution
        covariance = np.linalg.inv(self._prior_information(is_free=is_free) + information)
        least_m2 = (MATCHER.least_dev_m / resolution) ** 2
        floor = np.diag([least_m2, least_m2, MATCHER.least_dev_rad**2])
        self.pose = pose
        self.covariance = 0.5 * (covariance + covariance.T) + floor


@dataclass(slots=True, eq=False)
class ScanView:
    """What one correction works with: the scan, and how well the estimate fits it so far."""

    beams: BeamSet
    points: Points
    """The end points that poses are aligned with."""
    score: float
    """Mean robust score of the estimate, 0 ... 1."""
    drift: tuple[float, float]
    """Most that the odometry may have led the estimate astray [cells, rad]."""
    is_trusted: bool
    """Whether the estimate is believed so far."""


class PoseEstimator:
    """One estimate on one map, its particles and its covariance (cells and radians in `grid`)."""

    def __init__(
        self, field: LikelihoodField, matcher: MapMatcher, config: LocalizerConfig, seed: int
    ) -> None:
        self._field = field
        self._matcher = matcher
        self._config = config
        self._filter = ParticleFilter(field, config, seed)
        self._aligned = AlignedPose(field, config)
        self._depth = WallDepth(field)
        self._pending = Pose2D.identity()
        self._usual_score = 0.0
        self._given_root: NDArray[np.float64] | None = None
        self._phase = 0.5
        self.spread_m = 0.0

    def set_config(self, config: LocalizerConfig) -> None:
        """Update the particles by other thresholds; their number and noise stay."""
        self._config = config

    @property
    def pose(self) -> NDArray[np.float64]:
        """The estimate (3,)."""
        return self._aligned.pose

    @property
    def covariance(self) -> NDArray[np.float64]:
        """Its covariance (3, 3)."""
        return self._aligned.covariance

    def particles(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return poses (n, 3) x, y [m], yaw [rad] in the map frame, and weights (n,)."""
        x, y, yaw = (part.astype(np.float64) for part in self._filter.cloud)
        scale = self._field.resolution
        poses_grid = np.column_stack([x * scale, y * scale, yaw])
        poses = self._field.grid.origin.transform_poses(poses_grid)
        return poses.astype(np.float32), self._filter.weights.copy()

    def reset(self, pose: NDArray[np.float64], covariance: NDArray[np.float64]) -> None:
        """Start anew at a pose with a covariance."""
        self._aligned.reset(pose, covariance)
        self._filter.reset(pose, covariance)
        self._pending = Pose2D.identity()
        self._usual_score = 0.0
        self._given_root = lower_root(covariance)
        self.spread_m = self._filter.spread_m()

    def forget_motion(self) -> None:
        """Drop the odometry that the particles have not followed yet."""
        self._pending = Pose2D.identity()

    def predict(self, step: Pose2D) -> None:
        """Carry the estimate through one odometry step [m, m, rad]."""
        if self._filter.count == 0:
            return
        self._aligned.predict(step)
        self._pending = self._pending @ step

    def lead(
        self, pose: NDArray[np.float64], covariance: NDArray[np.float64], beams: BeamSet
    ) -> None:
        """Go on from where the scans have led without the map, with the covariance that they left.

        Args:
            pose: (3,) near the prediction.
            covariance: (3, 3) of the pose.
            beams: of the scan; if the map explains it from close by, the robot is there.
        """
        self._aligned.reset(pose, covariance)
        if self._has_moved():
            few = beams.spread(self._config.num_beams, self._phase)
            best = self._filter.best_of(pose, self._root_of_tries(), few, PARAMS.num_tries)
            found, information = self._aligned.align(
                best, beams.spread(self._config.refine_beams), is_free=True
            )
            is_back = self._matcher.score(found, beams).value >= PARAMS.back_support
            is_near = self._farness(found, self._possible_drift()) <= PARAMS.back_farness
            if is_back and is_near and self._matcher.may_stand(found):
                self._aligned.accept(found, information, is_free=True)
                pose, covariance = self.pose, self.covariance
            self._filter.reset(pose, covariance)
            self._pending = Pose2D.identity()
            self._given_root = None
            self.spread_m = self._filter.spread_m()

    def correct(self, beams: BeamSet, *, is_trusted: bool) -> None:
        """Correct the estimate by one scan.

        Args:
            beams: of the scan.
            is_trusted: whether the estimate is believed so far.
        """
        beams = self._matcher.on_known(self.pose, beams)
        seen = self._matcher.without_mirrored(self.pose, beams)
        points = seen.spread(self._config.refine_beams)
        if points.x.size == 0:
            return
        if beams.looks_all_round:
            self._aligned.walls = self._field.distance
        else:
            points = self._as_deep_as_walls(points, beams.laser, is_trusted=is_trusted)
        view = ScanView(seen, points, 0.0, self._possible_drift(), is_trusted)
        self._align(view)
        if self._has_moved():
            self._update_filter(view, beams)
        elif self._is_doubtful(view):
            self._try_around(view, beams)
        self._usual_score += PARAMS.usual_smoothing * (view.score - self._usual_score)

    def _as_deep_as_walls(
        self, points: Points, laser: tuple[float, float], *, is_trusted: bool
    ) -> Points:
        """Return end points as deep in walls as they have to be, and learn how deep that is."""
        self._aligned.walls = self._depth.walls
        if is_trusted:
            gain = self._aligned.information_of_beam(points)
            self._depth.update(points, laser, self.pose, gain)
        return lengthened(points, laser, self._depth.cells)

    def _align(self, view: ScanView) -> None:
        """Align the prediction with the scan, unless that makes it worse."""
        predicted = self.pose
        pose, information = self._aligned.align(predicted, view.points, is_free=False)
        score = self._aligned.score(pose, view.points)
        before = self._aligned.score(predicted, view.points)
        if score < before - PARAMS.score_slack:
            pose, score = predicted, before
        self._aligned.accept(pose, information, is_free=False)
        view.score = score

    def _has_moved(self) -> bool:
        """Say whether the robot has moved far enough for another cycle of the particle filter."""
        return (
            self._given_root is not None
            or math.hypot(self._pending.x, self._pending.y) >= self._config.update_distance_m
            or abs(self._pending.yaw) >= self._config.update_turn_rad
        )

    def _update_filter(self, view: ScanView, beams: BeamSet) -> None:
        """Run a cycle of the particle filter; change over to its best place if that fits better."""

        def refine(cluster: NDArray[np.float64]) -> NDArray[np.float64]:
            self._offer(cluster, view, view.beams, PARAMS.cluster_lead)
            if self._is_doubtful(view):
                self._try_around(view, beams)
            return self.pose

        step, self._pending = split_step(self._pending, self._config), Pose2D.identity()
        self._phase = (self._phase + PARAMS.phase_step) % 1.0
        points = view.beams.spread(self._config.num_beams, self._phase)
        self._filter.update(step, points, refine)
        self.spread_m = self._filter.spread_m()

    def _is_doubtful(self, view: ScanView) -> bool:
        """Say whether the scan may well fit better close by."""
        has_dropped = view.score < self._usual_score - PARAMS.score_drop
        return self._given_root is not None or has_dropped or not view.is_trusted

    def _try_around(self, view: ScanView, beams: BeamSet) -> None:
        """Try poses at random around the estimate and take the best if it fits better."""
        root = self._root_of_tries() if self._given_root is None else self._given_root
        self._given_root = None
        few = beams.spread(self._config.num_beams, self._phase)
        best = self._filter.best_of(self.pose, root, few, PARAMS.num_tries)
        self._offer(best, view, beams, PARAMS.try_lead)

    def _root_of_tries(self) -> NDArray[np.float64]:
        """Return how far around poses are tried: as far as the estimate may be off, or a slip."""
        cells = 1.0 / self._field.resolution
        least = [PARAMS.try_dev_m * cells, PARAMS.try_dev_m * cells, PARAMS.try_dev_rad]
        return np.diag(np.maximum(np.sqrt(np.diag(self.covariance)), least))

    def _offer(
        self, start: NDArray[np.float64], view: ScanView, beams: BeamSet, lead: float
    ) -> None:
        """Align another pose and take it if the scan supports it clearly better."""
        pose, information = self._aligned.align(start, view.points, is_free=True)
        score = self._aligned.score(pose, view.points)
        farness = self._farness(pose, view.drift)
        if view.is_trusted and farness >= 1.0:
            return  # A jump needs a reason.
        lead += PARAMS.far_lead * farness
        if score <= view.score + lead or not self._matcher.may_stand(pose):
            return
        rival = self._matcher.score(pose, beams).value
        if rival <= self._matcher.score(self.pose, beams).value + lead:
            return
        self._aligned.accept(pose, information, is_free=True)
        view.score = score

    def _possible_drift(self) -> tuple[float, float]:
        """Return how far off the odometry may have led the estimate [cells, rad]."""
        if self._given_root is not None:
            return 0.0, 0.0
        xx, xy, yy = (float(self.covariance[at]) for at in ((0, 0), (1, 0), (1, 1)))
        longest = 0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), xy)  # the larger eigenvalue
        return 2.0 * math.sqrt(longest), 2.0 * math.sqrt(float(self.covariance[2, 2]))

    def _farness(self, pose: NDArray[np.float64], drift: tuple[float, float]) -> float:
        """Say how far a pose lies from the estimate: 0 is here, 1 too far for a small slip."""
        shift = pose - self.pose
        away = math.hypot(shift[0], shift[1]) - drift[0]
        turned = abs(math.remainder(float(shift[2]), 2.0 * math.pi)) - drift[1]
        share = max(away * self._field.resolution / PARAMS.far_m, turned / PARAMS.far_rad)
        return min(max(share, 0.0), 1.0)
