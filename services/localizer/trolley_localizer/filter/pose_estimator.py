"""The pose that is followed: particles for the alternatives, alignment for the centimetre."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D
from trolley.scanning.deskew import Points
from trolley_localizer.filter.motion_model import move_covariance, split_step, step_covariance
from trolley_localizer.filter.particle_filter import ParticleFilter, lower_root
from trolley_localizer.kernels.matching import refine_pose, score_pose
from trolley_localizer.matching.likelihood_field import LikelihoodField
from trolley_localizer.matching.map_matcher import BeamSet, MapMatcher

# Noise of odometry per scan even of a robot that stands [m, rad].
_FLOOR_M = 0.003
_FLOOR_RAD = 0.003
# Deviation of one beam's end from the wall [m], and as how many independent beams a scan counts.
_BEAM_DEV_M = 0.05
_INDEPENDENT = 60.0
# The estimate is never surer than this: the map itself is not more exact.
_SUREST_M = 0.01
_SUREST_RAD = 0.005
# Alignment begins wide and ends narrow [m].
_WIDTHS_M = (0.25, 0.1)
_STEPS = 8


class PoseTracker:
    """One pose and its covariance. Poses are x, y [cells], yaw [rad] in `grid`."""

    def __init__(self, field: LikelihoodField, config: LocalizerConfig) -> None:
        self._field = field
        self._config = config
        self.pose = np.zeros(3)
        self.covariance = np.eye(3)

    def reset(self, pose: NDArray[np.float64], covariance: NDArray[np.float64]) -> None:
        """Start anew at a pose."""
        self.pose = pose.copy()
        self.covariance = covariance.copy()

    def predict(self, step: Pose2D) -> None:
        """Carry the estimate through one odometry step [m, m, rad]."""
        resolution = self._field.resolution
        cells = Pose2D(step.x / resolution, step.y / resolution, step.yaw)
        before = Pose2D(float(self.pose[0]), float(self.pose[1]), float(self.pose[2]))
        after = before @ cells
        noise = step_covariance(step, _FLOOR_M, _FLOOR_RAD, self._config)
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
        return score_pose(
            self._field.distance, points, pose, _WIDTHS_M[-1] / self._field.resolution
        )

    def align(
        self, start: NDArray[np.float64], points: Points, *, free: bool
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return a pose moved to where the scan fits, and the scan's information there (3, 3).

        Args:
            start: where to begin.
            points: beam end points.
            free: the odometry does not hold the pose back (for a pose from elsewhere).
        """
        pose = start.copy()
        information = np.zeros((3, 3))
        cells = 1.0 / self._field.resolution
        prior_information = self._prior_information(free=free)
        beams = points.x.size
        gain = min(_INDEPENDENT, beams) / max(beams, 1) / (_BEAM_DEV_M * cells) ** 2
        for width_m in _WIDTHS_M:
            tuning = np.array([width_m * cells, gain])
            refine_pose(
                pose,
                information,
                self._field.distance,
                points,
                start if free else self.pose,
                prior_information,
                tuning,
                _STEPS,
            )
        return pose, information

    def _prior_information(self, *, free: bool) -> NDArray[np.float64]:
        """Return how firmly the odometry holds the pose (3, 3)."""
        if free:
            return np.diag([1e-4, 1e-4, 1e-2])
        return np.asarray(np.linalg.inv(self.covariance), np.float64)

    def accept(
        self, pose: NDArray[np.float64], information: NDArray[np.float64], *, free: bool
    ) -> None:
        """Take an aligned pose as the estimate and narrow the covariance by what the scan said."""
        resolution = self._field.resolution
        covariance = np.linalg.inv(self._prior_information(free=free) + information)
        floor = np.diag([(_SUREST_M / resolution) ** 2] * 2 + [_SUREST_RAD**2])
        self.pose = pose
        self.covariance = 0.5 * (covariance + covariance.T) + floor


# By how much a pose from elsewhere must be better supported to replace the aligned prediction.
_CLUSTER_LEAD = 0.03
_TRY_LEAD = 0.05
# The farther it is, the better: a jump across a room takes more than furniture that was moved.
_FAR_LEAD = 0.25
_FAR_M = 0.5
_FAR_RAD = 0.5
# A score this far below the usual one starts tries round about.
_SCORE_DROP = 0.1
_TRIES = 1500
_TRY_DEV_M = 0.25
_TRY_DEV_RAD = 0.15
# Alignment may lower the score by this: the odometry has a say, too.
_SCORE_SLACK = 0.01
_USUAL_SMOOTHING = 0.05
# The golden ratio moves the choice of beams evenly from scan to scan.
_PHASE_STEP = 0.6180339887


class PoseEstimator:
    """One estimate on one map, its particles and its covariance (cells and radians in `grid`)."""

    def __init__(
        self,
        field: LikelihoodField,
        matcher: MapMatcher,
        config: LocalizerConfig,
        seed: int,
    ) -> None:
        self._field = field
        self._matcher = matcher
        self._config = config
        self._filter = ParticleFilter(field, config, seed)
        self._tracker = PoseTracker(field, config)
        self._pending = Pose2D.identity()
        self._usual_score = 0.0
        self._fresh: NDArray[np.float64] | None = None
        self._phase = 0.5
        self._expected = (0.0, 0.0)
        self.spread_m = 0.0

    @property
    def pose(self) -> NDArray[np.float64]:
        """The estimate (3,)."""
        return self._tracker.pose

    @property
    def covariance(self) -> NDArray[np.float64]:
        """Its covariance (3, 3)."""
        return self._tracker.covariance

    def particles(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return poses (n, 3) x, y [m], yaw [rad] in the map frame, and weights (n,)."""
        x, y, yaw = (part.astype(np.float64) for part in self._filter.cloud)
        scale = self._field.resolution
        poses_grid = np.column_stack([x * scale, y * scale, yaw])
        poses = self._field.grid.origin.transform_poses(poses_grid)
        return poses.astype(np.float32), self._filter.weights.copy()

    def reset(self, pose: NDArray[np.float64], covariance: NDArray[np.float64]) -> None:
        """Start anew at a pose with a covariance."""
        self._tracker.reset(pose, covariance)
        self._filter.reset(pose, covariance)
        self._pending = Pose2D.identity()
        self._usual_score = 0.0
        self._fresh = lower_root(covariance)
        self.spread_m = self._filter.spread_m()

    def forget_motion(self) -> None:
        """Drop the odometry that the particles have not followed yet."""
        self._pending = Pose2D.identity()

    def predict(self, step: Pose2D) -> None:
        """Carry the estimate through one odometry step [m, m, rad]."""
        if self._filter.count == 0:
            return
        self._tracker.predict(step)
        self._pending = self._pending @ step

    def look(self, beams: BeamSet, *, is_trusted: bool) -> None:
        """Correct the estimate by one scan.

        Args:
            beams: of the scan.
            is_trusted: whether the estimate is believed so far.
        """
        seen = self._matcher.without_mirrored(self._tracker.pose, beams)
        points = seen.spread(self._config.refine_beams)
        if points.x.size == 0:
            return
        predicted = self._tracker.pose
        self._expected = self._expected_shift()
        pose, information = self._tracker.align(predicted, points, free=False)
        score = self._tracker.score(pose, points)
        before = self._tracker.score(predicted, points)
        if score < before - _SCORE_SLACK:
            pose, score = predicted, before
        self._tracker.accept(pose, information, free=False)
        moved = self._has_moved()
        if moved:
            score = self._filter_step(seen, points, score)
        if self._fresh is not None or score < self._usual_score - _SCORE_DROP or not is_trusted:
            score = self._try_around(beams, points, score)
        if moved:
            self._filter.resample(self._tracker.pose)
            self.spread_m = self._filter.spread_m()
        self._usual_score += _USUAL_SMOOTHING * (score - self._usual_score)

    def _has_moved(self) -> bool:
        """Say whether the robot has moved enough for another look by the particles."""
        way = math.hypot(self._pending.x, self._pending.y)
        return (
            self._fresh is not None
            or way >= self._config.update_distance_m
            or abs(self._pending.yaw) >= self._config.update_turn_rad
        )

    def _filter_step(self, seen: BeamSet, points: Points, score: float) -> float:
        """Move and weigh the particles; take their best place if it fits better."""
        self._filter.move(split_step(self._pending, self._config))
        self._pending = Pose2D.identity()
        self._phase = (self._phase + _PHASE_STEP) % 1.0
        self._filter.weigh(seen.spread(self._config.num_beams, self._phase))
        return self._offer(self._filter.cluster(), seen, points, score, _CLUSTER_LEAD)

    def _try_around(self, beams: BeamSet, points: Points, score: float) -> float:
        """Try poses at random about the estimate and take the best if it fits better."""
        cells = 1.0 / self._field.resolution
        root = np.diag([_TRY_DEV_M * cells, _TRY_DEV_M * cells, _TRY_DEV_RAD])
        if self._fresh is not None:
            root = self._fresh
            self._fresh = None
        few = beams.spread(self._config.num_beams, self._phase)
        best = self._filter.best_of(self._tracker.pose, root, few, _TRIES)
        return self._offer(best, beams, points, score, _TRY_LEAD)

    def _offer(
        self,
        start: NDArray[np.float64],
        beams: BeamSet,
        points: Points,
        score: float,
        lead: float,
    ) -> float:
        """Align another pose and take it if the scan supports it clearly better.

        Returns:
            The score of the estimate afterwards.
        """
        pose, information = self._tracker.align(start, points, free=True)
        other = self._tracker.score(pose, points)
        lead += _FAR_LEAD * self._farness(pose)
        if other <= score + lead or not self._matcher.may_stand(pose):
            return score
        rival = self._matcher.score(pose, beams).value
        if rival <= self._matcher.score(self._tracker.pose, beams).value + lead:
            return score
        self._tracker.accept(pose, information, free=True)
        return other

    def _expected_shift(self) -> tuple[float, float]:
        """Return how far off the odometry may have led the estimate [cells, rad]."""
        if self._fresh is not None:
            return 0.0, 0.0
        covariance = self._tracker.covariance
        across = math.sqrt(float(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
        return 2.0 * across, 2.0 * math.sqrt(float(covariance[2, 2]))

    def _farness(self, pose: NDArray[np.float64]) -> float:
        """Say how far a pose lies from the estimate: 0 is here, 1 too far for a small slip."""
        shift = pose - self._tracker.pose
        away = math.hypot(shift[0], shift[1]) - self._expected[0]
        turned = abs(math.remainder(float(shift[2]), 2.0 * math.pi)) - self._expected[1]
        share = max(away * self._field.resolution / _FAR_M, turned / _FAR_RAD)
        return min(max(share, 0.0), 1.0)
