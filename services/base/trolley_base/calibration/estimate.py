"""The correction that makes the odometry of all legs fit what was measured from outside.

Where the localizer measures, a lidar that sits otherwise than robot.toml says would look like
unequal wheels; so how it sits is estimated together with the wheels.

The linear formulas of UMBmark hold for small errors; five per cent on one wheel bend a square of
one metre out of all recognition. So the motions are integrated with the correction sought, by
nonlinear least squares.

Source:
    Triggs et al., Bundle Adjustment: A Modern Synthesis (2000), section 4 (Gauss-Newton);
    Huber, Robust Statistics (1981), for legs on which the wheels slipped or the pose was wrong.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley_base.upkeep.correction import Correction
from trolley_base.upkeep.legs import Leg

PRIOR_STD = np.array([0.3, 0.3, 0.5, 0.2, 0.05, 0.05])
"""What a robot's errors may be: without enough turning or straight parts the estimate hardly leaves
where it began. Linear, angular, bend [rad/m], lidar [rad, m, m]; by hand."""
LEAST, MOST = [0.5, 0.5, -3.0, -1.0, -0.5, -0.5], [2.0, 2.0, 3.0, 1.0, 0.5, 0.5]
"""No robot's errors are beyond these."""


@dataclass(frozen=True, slots=True)
class EstimateParams:
    """Of the Gauss-Newton fit."""

    huber: float = 1.345
    """Huber's k: beyond so many deviations a leg counts less (Huber 1981, 95 % efficiency)."""
    max_iterations: int = 30
    """At most this many steps."""
    difference: float = 1e-6
    """Step of the numeric derivatives."""
    convergence: float = 1e-9
    """The fit ends when no parameter changes by more."""


PARAMS = EstimateParams()


@dataclass(frozen=True, slots=True)
class Estimate:
    """A correction and how sure it is.

    Attributes:
        correction: the best fit.
        linear_std: standard error of `correction.linear`; inf where it was not estimated.
        angular_std: of `correction.angular`.
        bend_std: of `correction.bend` [rad/m].
        lidar: base_T_laser, true, @ base_T_laser^-1, as written.
        lidar_std: standard errors of its yaw, x and y [rad, m, m]; inf where not estimated.
        num_legs: how many legs it rests on.
        misfit: by how many of their deviations the corrected legs miss what was measured; about 1
            where nothing but scales and slip is wrong.
    """

    correction: Correction
    linear_std: float
    angular_std: float
    bend_std: float
    lidar: Pose2D
    lidar_std: tuple[float, float, float]
    num_legs: int
    misfit: float


def estimate(legs: Sequence[Leg], *, by_hand: bool = False) -> Estimate:
    """Fit a correction to legs.

    Args:
        legs: at least one.
        by_hand: whether a person measured the ends of closed paths: such an end says nothing
            about the linear scale, which then stays 1, nor about the lidar.

    Raises:
        ValueError: no legs.
    """
    if not legs:
        raise ValueError("there are no legs to estimate from")
    free = np.array([not by_hand, True, True, *3 * [not by_hand]])
    parameters = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    start = parameters.copy()
    for _ in range(PARAMS.max_iterations):
        residuals, jacobian = _linearize(legs, parameters)
        weights = _huber(residuals)
        normal = jacobian.T @ (weights[:, None] * jacobian) + np.diag(PRIOR_STD**-2)
        gradient = jacobian.T @ (weights * residuals) + (parameters - start) / PRIOR_STD**2
        change = np.zeros(len(free))
        change[free] = np.linalg.solve(normal[np.ix_(free, free)], -gradient[free])
        parameters = np.clip(parameters + change, LEAST, MOST)
        if float(np.max(np.abs(change))) < PARAMS.convergence:
            break
    residuals, jacobian = _linearize(legs, parameters)
    spare = max(1, len(residuals) - int(np.sum(free)))
    misfit = math.sqrt(float(np.sum(_huber(residuals) * residuals**2)) / spare)
    correction, lidar = _split(parameters)
    linear, angular, bend, yaw, x, y = _standard_errors(residuals, jacobian, free, misfit)
    return Estimate(correction, linear, angular, bend, lidar, (yaw, x, y), len(legs), misfit)


def _split(parameters: NDArray[np.float64]) -> tuple[Correction, Pose2D]:
    linear, angular, bend, yaw, x, y = parameters.tolist()
    return Correction(linear, angular, bend), Pose2D(x, y, yaw)


def _linearize(
    legs: Sequence[Leg], parameters: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    residuals = _residuals(legs, parameters)
    columns: list[NDArray[np.float64]] = []
    for index in range(len(parameters)):
        moved = parameters.copy()
        moved[index] += PARAMS.difference
        columns.append((_residuals(legs, moved) - residuals) / PARAMS.difference)
    return residuals, np.stack(columns, axis=1)


def _residuals(legs: Sequence[Leg], parameters: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (3 n,) how far each leg ends from where it was measured, in deviations."""
    correction, lidar = _split(parameters)
    rows: list[float] = []
    for leg in legs:
        along_m, across_m, heading_rad = leg.error_of(correction, lidar)
        along_std, across_std, heading_std = leg.deviations
        is_measured = math.isfinite(heading_std)
        rows += [along_m / along_std, across_m / across_std]
        rows.append(heading_rad / heading_std if is_measured else 0.0)
    return np.array(rows)


def _huber(residuals: NDArray[np.float64]) -> NDArray[np.float64]:
    # A leg whose position is off says little by its heading, too: one weight for its three rows.
    sizes = np.sqrt(np.mean(residuals.reshape(-1, 3) ** 2, axis=1))
    return np.repeat(PARAMS.huber / np.maximum(sizes, PARAMS.huber), 3)


def _standard_errors(
    residuals: NDArray[np.float64],
    jacobian: NDArray[np.float64],
    free: NDArray[np.bool_],
    misfit: float,
) -> list[float]:
    weights = _huber(residuals)
    normal = jacobian.T @ (weights[:, None] * jacobian) + np.diag(PRIOR_STD**-2)
    covariance = np.linalg.inv(normal[np.ix_(free, free)])
    deviations = np.full(len(free), math.inf)
    # Legs that fit worse than expected say that the noise is larger than expected.
    deviations[free] = max(1.0, misfit) * np.sqrt(np.diag(covariance))
    return deviations.tolist()
