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
    Evidence,
    Move,
    Number,
    Renewal,
    Store,
    observe,
    redraw,
    scatter_particles,
    variance_of_place,
    weigh_by_scan,
)
from trolley_localizer.matching.likelihood_field import FULL_SCORE, LikelihoodField


@dataclass(frozen=True, slots=True)
class ParticleFilterParams:
    """Parameters that the configuration does not offer."""

    bin_m: float = 0.5
    """Edge of the bins of pose space for KLD sampling [m] (AMCL's)."""
    bins_turn: int = 36
    """Number of bins in a full turn for KLD sampling (AMCL's)."""
    wide_every: int = 8
    """Number of particles per one that gets wider noise (by hand)."""
    wide_factor: float = 4.0
    """Factor on the noise of those: wheels slip on rugs, and encoders may miss a reversal (by
    hand)."""
    renewed_every: int = 20
    """Number of particles per one that each resampling draws anew around the aligned estimate (by
    hand)."""
    renewed_dev_m: float = 0.05
    """Standard deviation of the position of particles drawn anew [m] (by hand)."""
    renewed_dev_rad: float = 0.02
    """Standard deviation of the heading of particles drawn anew [rad] (by hand)."""
    cluster_reach: tuple[tuple[float, float], ...] = ((1.0, 0.6), (0.7, 0.5), (0.7, 0.5))
    """Reach of a cluster around the heaviest place, for each mean in turn [m, rad] (by hand)."""


PARAMS = ParticleFilterParams()


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
        self._mean = np.zeros(3)
        self._variance = 0.0
        cells = 1.0 / field.resolution
        self._reaches = np.array(PARAMS.cluster_reach) * [cells, 1.0]
        self._renewal_root = np.diag(
            [PARAMS.renewed_dev_m * cells, PARAMS.renewed_dev_m * cells, PARAMS.renewed_dev_rad]
        )
        self._number = Number(
            PARAMS.bin_m * cells,
            PARAMS.bins_turn,
            config.min_particles,
            config.kld_error,
            config.kld_quantile,
        )
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
        self._variance = variance_of_place(self.cloud, self.weights)

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
        self.redraw(refine(self.observe(step, points)))

    def observe(self, step: OdometryStep, points: Points) -> NDArray[np.float64]:
        """Move the particles by a noisy odometry step, and weigh them by a scan.

        Returns:
            The mean pose (3,) of the particles about the heaviest place: from the heaviest particle
            on, mean after mean.
        """
        cells = 1.0 / self._field.resolution
        move = Move(
            np.array([step.turn, step.drive * cells, step.after]),
            np.array(
                [step.turn_dev, step.drive_dev * cells, step.after_dev, step.slip_dev * cells]
            ),
            PARAMS.wide_every,
            PARAMS.wide_factor,
        )
        observe(
            self._mean,
            self.cloud,
            self.weights,
            self._score[: self.count],
            move,
            self._draw(4 * self.count),
            self._evidence(points),
            self._reaches,
        )
        return self._mean.copy()

    def weigh(self, points: Points) -> None:
        """Multiply the weights by the likelihood of beam end points; their sum is 1 again."""
        score = self._score[: self.count]
        weigh_by_scan(self.weights, score, self.cloud, self._evidence(points))

    def redraw(self, about: NDArray[np.float64]) -> None:
        """Draw equally weighted particles, as many as their spread asks for, some about a pose."""
        offset = float(self._draw(1) % np.uint64(1 << 20)) / (1 << 20)
        store = Store(self._cloud, self._spare, self._weights, self._index, self._bins)
        renewal = Renewal(about, self._renewal_root, PARAMS.renewed_every, self._draw(0))
        self.count, self._variance = redraw(store, self.count, offset, self._number, renewal)
        self._draw(3 * self.count)
        self._cloud, self._spare = self._spare, self._cloud

    def _evidence(self, points: Points) -> Evidence:
        beams = max(points.x.size, 1)
        independent = min(float(beams), self._config.independent_beams)
        gain = self._field.log_range / FULL_SCORE * independent / beams
        return Evidence(points, self._field.score, gain)

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

    def spread_m(self) -> float:
        """Return the root mean square distance of the particles from their mean [m]."""
        return math.sqrt(self._variance) * self._field.resolution
