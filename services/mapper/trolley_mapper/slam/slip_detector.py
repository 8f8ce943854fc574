"""Whether the wheels turn in vain, to be said while it happens."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D

SLIPS = "the wheels slip: they turn farther than the robot moves"
# Of what was before each scan, so much still counts: about seven scans.
_FADING = 0.85
# The wheels must say so much before it is judged [m, rad], and less than that share be driven.
_LEAST_TOLD = (0.06, 0.2)
_DRIVEN_SHARE = 0.5


class Slipping:
    """Way and turn of the last scans, as the wheels say them and as scans show them."""

    def __init__(self) -> None:
        self._told = np.zeros(2)
        self._driven = np.zeros(2)

    def look(self, told: Pose2D, driven: NDArray[np.float64]) -> None:
        """Compare one step of the wheels with the step (3,) that was driven by the scans."""
        self._told = _FADING * self._told + _amounts(told.as_array())
        self._driven = _FADING * self._driven + _amounts(driven)

    @property
    def message(self) -> str:
        """What is the matter, in one sentence; empty when all is well."""
        in_vain = (self._told > _LEAST_TOLD) & (self._driven < _DRIVEN_SHARE * self._told)
        return SLIPS if in_vain.any() else ""


def _amounts(step: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return way [m] and turn [rad] of a step, both positive."""
    turn = abs(math.remainder(float(step[2]), 2.0 * math.pi))
    return np.array([math.hypot(float(step[0]), float(step[1])), turn])
