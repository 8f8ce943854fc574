"""By how much odometry errs: learnt where scans show the motion, used where they do not."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley_mapper.slam.motion_model import PARAMS as MOTION
from trolley_mapper.slam.motion_model import motion_covariance


@dataclass(frozen=True, slots=True)
class OdometryModelParams:
    """How the odometry's errors are estimated. Found with bench/mapper/."""

    scale_dev: float = 0.06
    """Standard deviation of the scales before the first metre."""
    errors: tuple[float, float] = (0.012, 0.012)
    """Error of a measured distance and turn [m, rad]."""
    fading: float = 0.995
    """Factor on a measurement's weight with each later one, so that some 200 count."""
    min_distance_m: float = 0.1
    """Distance below which a drive is no measurement [m]."""
    min_turn_rad: float = 0.1
    """Angle below which a turn is no measurement [rad]."""
    slip_share: float = 0.15
    """Disagreement above which the wheels slipped, rather than the scale being wrong."""
    max_bend_rad: float = 0.4
    """Bend above which paths are left out: their chord says little of their length [rad]."""
    share_weight: float = 3.0
    """Number of distances that the motion model counts as, before any was compared."""
    share_fading: float = 0.97
    """Factor on the weight of a distance's deviation with each later one, so that some 30 count:
    floors change."""
    min_share: float = 0.03
    """Least deviation of a distance, as a share of it: the scans that teach it err, too."""
    max_share: float = 0.36
    """Greatest deviation that a distance counts with, as a share of it: slip tells no more."""
    floor_dev: float = 0.01
    """Standard deviation of the scale from floor to floor: what is learnt later says no more of
    what was driven before."""
    min_information: tuple[float, float] = (2500.0, 2500.0)
    """Least information of the scan on distance and turn [1/m^2, 1/rad^2]."""


PARAMS = OdometryModelParams()


class OdometryModel:
    """Scales of distance and turn by which odometry is to be multiplied, and what is left to err.

    With a scan a metre the deviation of distances decides whether a corridor, where scans do not
    show the place along it, is mapped as long as it is: the motion model's has to be wide enough
    for any robot, and this one's is often a quarter of it.
    """

    def __init__(self) -> None:
        self.distance = 1.0
        self.turn = 1.0
        self._raw = Pose2D.identity()
        doubt = np.square(PARAMS.errors) / PARAMS.scale_dev**2
        self._products, self._squares = doubt.copy(), doubt.copy()
        # Number of distances that were compared, and the sum of their squared deviations a metre.
        self._weight = PARAMS.share_weight
        self._wander_m2 = PARAMS.share_weight * MOTION.distance_share**2

    def correct(self, step: Pose2D) -> Pose2D:
        """Return a step as it was probably driven."""
        self._raw = self._raw @ step
        return Pose2D(self.distance * step.x, self.distance * step.y, self.turn * step.yaw)

    def covariance(self, step: Pose2D) -> NDArray[np.float64]:
        """Return the covariance (3, 3) of a step that was corrected."""
        distance_m = math.hypot(step.x, step.y)
        share = self.distance_share(distance_m)
        return motion_covariance(distance_m, abs(step.yaw), share)

    def distance_share(self, distance_m: float) -> float:
        """Return the standard deviation of a corrected distance, as a share of it.

        It is a random walk's: the shorter the step, the larger the share.
        """
        if distance_m == 0.0:
            return MOTION.distance_share
        share = math.sqrt(self._wander_m2 / self._weight / distance_m)
        return min(max(share, PARAMS.min_share), MOTION.distance_share)

    @property
    def unlearnt(self) -> float:
        """Share of what will be learnt of the distance's scale that holds for the past, too."""
        variance = PARAMS.errors[0] ** 2 / float(self._squares[0])
        return variance / (variance + PARAMS.floor_dev**2)

    def restart(self) -> None:
        """Start measuring again, from a pose that is known."""
        self._raw = Pose2D.identity()

    def learn(self, moved: NDArray[np.float64], information: NDArray[np.float64]) -> None:
        """Compare what was driven since `restart` with what the wheels said.

        Args:
            moved: (3,) what was driven by the scans.
            information: (3, 3) how well the scan shows the place, in `base_link`.
        """
        raw = self._raw
        self.restart()
        reported, driven = math.hypot(raw.x, raw.y), math.hypot(moved[0], moved[1])
        if information[2, 2] >= PARAMS.min_information[1] and abs(raw.yaw) >= PARAMS.min_turn_rad:
            self._add(1, float(moved[2]), raw.yaw)
        is_straight = abs(moved[2]) < PARAMS.max_bend_rad and moved[0] * raw.x > 0.0
        if (
            information[0, 0] >= PARAMS.min_information[0]
            and reported >= PARAMS.min_distance_m
            and is_straight
        ):
            self._add_deviation(driven - self.distance * reported, reported)
            self._add(0, driven, reported)
        self.distance, self.turn = (self._products / self._squares).tolist()

    def _add(self, which: int, driven: float, reported: float) -> None:
        """Add a measurement of the distance (0) or the turn (1), unless the wheels slipped."""
        expected = (self.distance, self.turn)[which] * reported
        if abs(driven - expected) > PARAMS.slip_share * abs(reported):
            return
        self._products[which] = PARAMS.fading * self._products[which] + driven * reported
        self._squares[which] = PARAMS.fading * self._squares[which] + reported * reported

    def _add_deviation(self, deviation_m: float, distance_m: float) -> None:
        """Add by how much a corrected distance was off."""
        share = min(abs(deviation_m) / distance_m, PARAMS.max_share)
        self._weight = PARAMS.share_fading * self._weight + 1.0
        self._wander_m2 = PARAMS.share_fading * self._wander_m2 + share**2 * distance_m
