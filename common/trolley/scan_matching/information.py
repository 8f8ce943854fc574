"""What an alignment of a scan with surfaces is worth."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class InformationParams:
    """How much the points of a scan tell. Found with bench/mapper/ unless stated otherwise."""

    sigma_m: float = 0.03
    """Standard deviation of a point from its surface [m]."""
    independent_points: float = 60.0
    """Number of independent points that a scan counts as."""
    normal_noise: float = 0.01
    """Share of the information that is noise."""
    turn_m: float = 3.0
    """Distance that a turn by 1 rad counts as [m]."""


PARAMS = InformationParams()


def without_noise(information: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return information (3, 3) without what noise in the surfaces' directions feigns.

    A straight wall does not show the position along it; normals that err by some degrees seem to.
    """
    scale = np.array([1.0, 1.0, 1.0 / PARAMS.turn_m])
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    values = np.maximum(values - PARAMS.normal_noise * values.sum(), 0.0)
    return (vectors * values) @ vectors.T / np.outer(scale, scale)


def gain_of(points: int) -> float:
    """Return the information of one point of a scan [1/m^2]: neighbours err together."""
    return min(1.0, PARAMS.independent_points / max(points, 1)) / PARAMS.sigma_m**2
