"""How much the wheels exaggerate: learnt where scans show the way, used where they do not."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D

# What is believed before the first metre: scales of 1 with such a deviation, as if measured on ways
# and turns with an error of so much [m, rad].
_SCALE_DEV = 0.06
_ERRORS = (0.012, 0.012)
# A measurement counts by that factor after each later one, so that some 200 count.
_FADING = 0.995
# Ways and turns too short to tell [m, rad], and disagreement that is slip and no wrong scale.
_LEAST_WAY_M = 0.1
_LEAST_TURN_RAD = 0.1
_SLIP_SHARE = 0.15
# Ways that bend more than that are left out: their chord says little of their length [rad].
_STRAIGHT_RAD = 0.4
# The scan must show way and turn at least so well (1/m^2, 1/rad^2).
_LEAST_INFORMATION = (2500.0, 2500.0)


class OdometryScale:
    """Scales of way and turn by which odometry is to be multiplied."""

    def __init__(self) -> None:
        self.way = 1.0
        self.turn = 1.0
        self._raw = Pose2D.identity()
        doubt = np.square(_ERRORS) / _SCALE_DEV**2
        self._products, self._squares = doubt.copy(), doubt.copy()

    def correct(self, step: Pose2D) -> Pose2D:
        """Return a step as it was probably driven."""
        self._raw = self._raw @ step
        return Pose2D(self.way * step.x, self.way * step.y, self.turn * step.yaw)

    def restart(self) -> None:
        """Begin to measure anew, from a pose that is known."""
        self._raw = Pose2D.identity()

    def learn(self, moved: NDArray[np.float64], information: NDArray[np.float64]) -> None:
        """Compare what was driven since `restart` with what the wheels said.

        Args:
            moved: (3,) what was driven by the scans.
            information: (3, 3) how well the scan shows the place, in `base_link`.
        """
        raw = self._raw
        self.restart()
        told, way = math.hypot(raw.x, raw.y), math.hypot(moved[0], moved[1])
        if information[2, 2] >= _LEAST_INFORMATION[1] and abs(raw.yaw) >= _LEAST_TURN_RAD:
            self._add(1, float(moved[2]), raw.yaw)
        is_straight = abs(moved[2]) < _STRAIGHT_RAD and moved[0] * raw.x > 0.0
        if information[0, 0] >= _LEAST_INFORMATION[0] and told >= _LEAST_WAY_M and is_straight:
            self._add(0, way, told)
        self.way, self.turn = (self._products / self._squares).tolist()

    def _add(self, which: int, driven: float, told: float) -> None:
        """Add a measurement of the way (0) or the turn (1), unless the wheels slipped."""
        expected = (self.way, self.turn)[which] * told
        if abs(driven - expected) > _SLIP_SHARE * abs(told):
            return
        self._products[which] = _FADING * self._products[which] + driven * told
        self._squares[which] = _FADING * self._squares[which] + told * told
