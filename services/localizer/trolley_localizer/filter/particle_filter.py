"""The particle filter: adaptive Monte Carlo localization.

Source:
    Thrun, Burgard, Fox, Probabilistic Robotics (2005), table 8.3; Fox, Adapting the Sample Size in
    Particle Filters Through KLD-Sampling (2003).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.config.localizer import LocalizerConfig
from trolley.scanning import Points
from trolley_localizer.filter.motion_model import OdometryStep
from trolley_localizer.kernels.layout import Cloud
from trolley_localizer.kernels.matching import score_particles
from trolley_localizer.kernels.particles import (
    count_bins,
    draw_systematic,
    gather,
    mean_near,
    move_particles,
    normalise,
    scatter_particles,
    variance_of_place,
    weigh,
)
from trolley_localizer.matching.likelihood_field import FULL_SCORE, LikelihoodField


@dataclass(frozen=True, slots=True)
class ParticleFilterParams:
    """What the configuration leaves open."""

    bin_m: float = 0.5
    bins_turn: int = 36
    """Bins of pose space for KLD sampling: edge [m], and bins in a full turn (AMCL's)."""
    wide_every: int = 8
    wide_factor: float = 4.0
    """One particle in so many gets this many times the noise: wheels slip on rugs, and encoders may
    miss a reversal (by hand)."""
    renewed_every: int = 20
    renewed_dev_m: float = 0.05
    renewed_dev_rad: float = 0.02
    """One particle in so many is drawn anew around the aligned estimate at each resampling, with
    these standard deviations [m, rad] (by hand)."""
    cluster_reach: tuple[tuple[float, float], ...] = ((1.0, 0.6), (0.7, 0.5), (0.7, 0.5))
    """How far around the heaviest place a cluster reaches, mean after mean [m, rad] (by hand)."""


PARAMS = ParticleFilterParams()


def kld_number(bins: int, error: float, quantile: float) -> int:
    """Return how many particles keep the Kullback-Leibler error below a bound.

    Args:
        bins: bins with at least one particle.
        error: largest error (epsilon).
        quantile: of the standard normal distribution, for the confidence (z).

    Source:
        Fox (2003), equation 7 (Wilson and Hilferty's approximation).
    """
    if bins <= 1:
        return 1
    a = 2.0 / (9.0 * (bins - 1))
    return math.ceil((bins - 1) / (2.0 * error) * (1.0 - a + math.sqrt(a) * quantile) ** 3)


def lower_root(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return L with L L^T = covariance (3, 3), for any symmetric matrix without large defects."""
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    # QR of the transpose makes the factor triangular; its signs do not matter for sampling.
    return np.ascontiguousarray(np.linalg.qr(root.T)[1].T)


class ParticleFilter:
    """A set of weighted poses on one map. All poses are in frame `grid`, in cells and radians."""

    def __init__(self, field: LikelihoodField, config: LocalizerConfig, seed: int) -> None:
        self._field = field
        self._config = config
        self._counter = (seed * 0x9E3779B97F4A7C15 + 0x2545F4914F6CDD1D) % 2**64
        most = max(config.max_particles, config.min_particles)
        self._cloud = self._empty(most)
        self._spare = self._empty(most)
        self._weights = np.empty(most, np.float32)
        self._score = np.empty(most, np.int32)
        self._index = np.empty(most, np.int32)
        self._bins = np.empty(2 ** math.ceil(math.log2(2 * most)), np.uint64)
        self._gain = 0.0
        self.count = 0

    @staticmethod
    def _empty(count: int) -> Cloud:
        return Cloud(*(np.zeros(count) for _ in range(3)))

    @property
    def cloud(self) -> Cloud:
        """The particles (views)."""
        return Cloud(*(part[: self.count] for part in self._cloud))

    @property
    def weights(self) -> NDArray[np.float32]:
        """Their weights, sum 1 (a view)."""
        return self._weights[: self.count]

    def _draw(self, numbers: int) -> np.uint64:
        """Take random numbers: return the first of a run of counters."""
        first = self._counter
        self._counter = (self._counter + numbers) % 2**64
        return np.uint64(first)

    def reset(self, mean: NDArray[np.float64], covariance: NDArray[np.float64]) -> None:
        """Draw all particles anew about a pose.

        Args:
            mean: (3,) x, y [cells], yaw [rad].
            covariance: (3, 3), same units.
        """
        self.count = self._weights.size
        first = self._draw(3 * self.count)
        scatter_particles(self.cloud, 0, 1, mean, lower_root(covariance), first)
        self._weights[:] = 1.0 / self.count

    def update(
        self,
        step: OdometryStep,
        points: Points,
        refine: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    ) -> None:
        """Run one cycle of the filter.

        Args:
            step: odometry since the last cycle.
            points: beam end points.
            refine: gets the mean pose of the heaviest cluster and returns the estimate (3,), around
                which a small share of the particles is drawn anew.
        """
        self.predict(step)
        self.weigh(points)
        self.normalise()
        estimate = refine(self.cluster())
        self.resample()
        self.renew(estimate)

    def predict(self, step: OdometryStep) -> None:
        """Move all particles by one noisy odometry step."""
        cells = 1.0 / self._field.resolution
        parts = np.array([step.turn, step.drive * cells, step.after])
        deviation = np.array(
            [step.turn_dev, step.drive_dev * cells, step.after_dev, step.slip_dev * cells]
        )
        first = self._draw(4 * self.count)
        move_particles(self.cloud, parts, deviation, PARAMS.wide_every, PARAMS.wide_factor, first)

    def weigh(self, points: Points) -> None:
        """Multiply the weights by the likelihood of beam end points, see `normalise`."""
        beams = max(points.x.size, 1)
        score_particles(self._score[: self.count], self.cloud, points, self._field.score)
        independent = min(float(beams), self._config.independent_beams)
        self._gain = self._field.log_range / FULL_SCORE * independent / beams
        weigh(self.weights, self._score[: self.count], self._gain)

    def normalise(self) -> None:
        """Make the sum of the weights 1 after `weigh`."""
        if not normalise(self.weights):
            # The old weights and the new evidence exclude each other: start from the evidence.
            self.weights[:] = 1.0
            weigh(self.weights, self._score[: self.count], self._gain)
            normalise(self.weights)

    def resample(self) -> None:
        """Draw equally weighted particles, as many as their spread asks for."""
        offset = float(self._draw(1) % np.uint64(1 << 20)) / (1 << 20)
        chosen = self._index[: self.count]
        draw_systematic(chosen, self.weights, offset)
        bins = count_bins(
            self._bins, self.cloud, chosen, PARAMS.bin_m / self._field.resolution, PARAMS.bins_turn
        )
        wanted = kld_number(bins, self._config.kld_error, self._config.kld_quantile)
        count = min(max(wanted, self._config.min_particles), self._weights.size)
        if count != self.count:
            chosen = self._index[:count]
            draw_systematic(chosen, self.weights, offset)
        gather(self._spare, self._cloud, chosen)
        self._cloud, self._spare = self._spare, self._cloud
        self.count = count
        self._weights[:count] = 1.0 / count

    def renew(self, about: NDArray[np.float64]) -> None:
        """Draw a small, evenly chosen share of the particles anew around a pose (3,)."""
        cells = PARAMS.renewed_dev_m / self._field.resolution
        root = np.diag([cells, cells, PARAMS.renewed_dev_rad])
        scatter_particles(
            self.cloud, 0, PARAMS.renewed_every, about, root, self._draw(3 * self.count)
        )

    def best_of(
        self, mean: NDArray[np.float64], root: NDArray[np.float64], points: Points, count: int
    ) -> NDArray[np.float64]:
        """Try random poses about a pose and return the one that scores best.

        Args:
            mean: (3,) x, y [cells], yaw [rad]; it is tried too.
            root: (3, 3) lower root of the covariance of the tries.
            points: beam end points.
            count: how many tries.
        """
        tries = self._empty(count)
        scatter_particles(tries, 1, 1, mean, root, self._draw(3 * count))
        for part, value in zip(tries, mean, strict=True):
            part[0] = value
        score = np.empty(count, np.int32)
        score_particles(score, tries, points, self._field.score)
        best = int(np.argmax(score))
        return np.array([float(part[best]) for part in tries])

    def cluster(self) -> NDArray[np.float64]:
        """Return the mean pose (3,) of the particles about the heaviest place.

        It begins at the heaviest particle and follows the mean three times.
        """
        best = int(np.argmax(self.weights))
        cloud, weights = self.cloud, self.weights
        mean = np.array([part[best] for part in cloud])
        for reach_m, reach_rad in PARAMS.cluster_reach:
            centre = mean.copy()
            reach = np.array([reach_m / self._field.resolution, reach_rad])
            mean_near(mean, cloud, weights, centre, reach)
        return mean

    def spread_m(self) -> float:
        """Return the root mean square distance of the particles from their mean [m]."""
        if self.count == 0:
            return 0.0
        return math.sqrt(variance_of_place(self.cloud, self.weights)) * self._field.resolution
