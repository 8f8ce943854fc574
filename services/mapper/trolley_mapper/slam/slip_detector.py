"""Whether the wheels slip, to be said while it happens."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley_mapper.slam import sentences


@dataclass(frozen=True, slots=True)
class SlipParams:
    """When wheels count as slipping. Set by hand."""

    fading: float = 0.85
    """Weight that earlier motion keeps with each scan: about seven scans count."""
    min_reported: tuple[float, float] = (0.06, 0.2)
    """Motion that the wheels must report before it is judged [m, rad]."""
    driven_share: float = 0.5
    """Share of the reported motion below which the wheels slip."""


PARAMS = SlipParams()


class SlipDetector:
    """Distance and turn over the last scans, as the wheels report and as scans show them."""

    def __init__(self) -> None:
        self._reported = np.zeros(2)
        self._driven = np.zeros(2)

    def update(self, reported: Pose2D, driven: NDArray[np.float64]) -> None:
        """Compare one step of the wheels with the step (3,) that was driven by the scans."""
        self._reported = PARAMS.fading * self._reported + _amounts(reported.as_array())
        self._driven = PARAMS.fading * self._driven + _amounts(driven)

    @property
    def message(self) -> str:
        """What is the matter, in one sentence; empty when all is well."""
        in_vain = (self._reported > PARAMS.min_reported) & (
            self._driven < PARAMS.driven_share * self._reported
        )
        return sentences.SLIPS if in_vain.any() else ""


def _amounts(step: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return distance [m] and turn [rad] of a step, both positive."""
    turn = abs(math.remainder(float(step[2]), 2.0 * math.pi))
    return np.array([math.hypot(float(step[0]), float(step[1])), turn])
