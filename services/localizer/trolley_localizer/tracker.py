"""The estimate: one pose carried by odometry and aligned with the map by each scan.

The particle filter keeps the alternatives; here the best of them is followed to the centimetre.
Each scan is aligned by Gauss-Newton steps with the odometry as prior, so that along a bare
corridor, where the scan says nothing, the odometry decides.
"""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D
from trolley.scanning.deskew import Points
from trolley_localizer.field import LikelihoodField
from trolley_localizer.kernels.refine import refine_pose
from trolley_localizer.kernels.weights import score_pose
from trolley_localizer.motion import move_covariance, step_covariance

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
