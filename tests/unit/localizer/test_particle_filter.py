"""The particle filter alone."""

import numpy as np
import pytest

from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley_localizer.filter.motion_model import split_step
from trolley_localizer.filter.particle_filter import ParticleFilter, lower_root
from trolley_localizer.kernels.particles import kld_number
from trolley_localizer.matching.likelihood_field import build_field
from trolley_localizer.matching.map_matcher import read_beams

from .conftest import at, make_scan

CONFIG = LocalizerConfig()


def test_kld_asks_for_more_particles_in_more_bins() -> None:
    numbers = [kld_number(bins, 0.05, 2.33) for bins in (1, 2, 10, 100)]
    assert numbers == sorted(numbers)
    # Fox (2003), equation 7, computed by hand for 100 bins.
    assert numbers[-1] == pytest.approx(1347, abs=3)


def test_a_root_times_its_transpose_is_the_covariance() -> None:
    covariance = np.array([[2.0, 0.5, 0.1], [0.5, 1.0, -0.2], [0.1, -0.2, 0.3]])
    root = lower_root(covariance)
    assert root @ root.T == pytest.approx(covariance)
    assert np.allclose(np.triu(root, 1), 0.0)


def test_particles_are_drawn_as_asked(flat: GridMap) -> None:
    particles = ParticleFilter(build_field(flat, CONFIG), CONFIG, 1)
    mean = np.array([80.0, 60.0, 1.0])
    covariance = np.array([[16.0, 4.0, 0.0], [4.0, 9.0, 0.1], [0.0, 0.1, 0.04]])
    particles.reset(mean, covariance)
    poses = np.stack(particles.cloud)
    assert particles.weights.sum() == pytest.approx(1.0, abs=1e-4)
    assert poses.mean(axis=1) == pytest.approx(mean, abs=0.3)
    assert np.cov(poses) == pytest.approx(covariance, abs=1.0)
    assert particles.spread_m() == pytest.approx(0.05 * 5.0, rel=0.05)


def test_scans_gather_the_particles_and_fewer_suffice(flat: GridMap) -> None:
    field = build_field(flat, CONFIG)
    particles = ParticleFilter(field, CONFIG, 1)
    pose = at(flat, 5.5, 3.0, 0.4)
    beams = read_beams(make_scan(flat, pose, Pose2D.identity()), field.resolution, 60.0)
    cells = np.diag([10.0, 10.0, 0.2]) ** 2
    particles.reset(field.to_cells(pose) + np.array([4.0, -3.0, 0.1]), cells)
    many, wide = particles.count, particles.spread_m()
    for _ in range(15):
        step = split_step(Pose2D(0.0, 0.0, 0.0), CONFIG)
        mean = particles.observe(step, beams.spread(CONFIG.num_beams))
        particles.redraw(mean)
    assert particles.count < many
    assert particles.spread_m() < 0.3 * wide
    assert field.to_map(mean).distance_to(pose) < 0.08


def test_a_cycle_draws_a_share_around_the_refined_estimate(flat: GridMap) -> None:
    field = build_field(flat, CONFIG)
    particles = ParticleFilter(field, CONFIG, 1)
    pose = at(flat, 5.5, 3.0, 0.4)
    beams = read_beams(make_scan(flat, pose, Pose2D.identity()), field.resolution, 60.0)
    particles.reset(field.to_cells(pose), np.diag([10.0, 10.0, 0.2]) ** 2)
    elsewhere = field.to_cells(at(flat, 1.5, 1.5, -2.0))
    clusters: list[np.ndarray] = []

    def refine(cluster: np.ndarray) -> np.ndarray:
        clusters.append(cluster)
        return elsewhere

    step = split_step(Pose2D.identity(), CONFIG)
    particles.update(step, beams.spread(CONFIG.num_beams), refine)
    assert field.to_map(clusters[0]).distance_to(pose) < 0.5
    away = np.hypot(particles.cloud.x - elsewhere[0], particles.cloud.y - elsewhere[1])
    assert (away < 5.0).mean() == pytest.approx(0.05, abs=0.01)
    assert particles.weights == pytest.approx(1.0 / particles.count)


def test_evidence_that_excludes_all_particles_replaces_their_weights(flat: GridMap) -> None:
    field = build_field(flat, CONFIG)
    particles = ParticleFilter(field, CONFIG, 1)
    pose = at(flat, 5.5, 3.0, 0.4)
    beams = read_beams(make_scan(flat, pose, Pose2D.identity()), field.resolution, 60.0)
    particles.reset(field.to_cells(pose), np.diag([10.0, 10.0, 0.2]) ** 2)
    particles.weights[:] = 0.0
    particles.weigh(beams.spread(CONFIG.num_beams))
    assert particles.weights.sum() == pytest.approx(1.0, abs=1e-4)


def test_trying_poses_finds_a_better_one_and_never_a_worse(flat: GridMap) -> None:
    field = build_field(flat, CONFIG)
    particles = ParticleFilter(field, CONFIG, 1)
    pose = at(flat, 5.5, 3.0, 0.4)
    points = read_beams(make_scan(flat, pose, Pose2D.identity()), 0.05, 60.0).spread(100)
    true = field.to_cells(pose)
    best = particles.best_of(
        true + np.array([4.0, 4.0, 0.1]), np.diag([4.0, 4.0, 0.1]), points, 3000
    )
    assert np.hypot(*(best - true)[:2]) < 2.5
    assert particles.best_of(true, np.diag([60.0, 60.0, 2.0]), points, 5)[:2] == pytest.approx(
        true[:2], abs=1e-3
    )
