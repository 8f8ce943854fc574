"""Odometry steps and their noise."""

import math

import numpy as np
import pytest

from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D
from trolley_localizer.filter.motion_model import move_covariance, split_step, step_covariance

CONFIG = LocalizerConfig()


@pytest.mark.parametrize(
    "step",
    [
        Pose2D(0.3, 0.1, 0.4),
        Pose2D(-0.2, 0.02, -0.1),
        Pose2D(0.0, 0.0, 1.2),
        Pose2D(0.004, 0.0, 0.0),
    ],
)
def test_turn_drive_turn_gives_the_step_back(step: Pose2D) -> None:
    parts = split_step(step, CONFIG)
    joined = (
        Pose2D(0.0, 0.0, parts.turn) @ Pose2D(parts.drive, 0.0, 0.0) @ Pose2D(0.0, 0.0, parts.after)
    )
    assert joined.distance_to(step) < 1e-9
    assert joined.yaw == pytest.approx(step.yaw)


def test_reversing_is_a_negative_way_and_no_turn() -> None:
    parts = split_step(Pose2D(-0.5, 0.0, 0.0), CONFIG)
    assert parts.drive == pytest.approx(-0.5)
    assert parts.turn == pytest.approx(0.0, abs=1e-12)


def test_a_robot_that_stands_keeps_a_floor_of_noise() -> None:
    parts = split_step(Pose2D.identity(), CONFIG)
    assert parts.drive_dev == pytest.approx(CONFIG.slip_m)
    assert math.hypot(parts.turn_dev, parts.after_dev) == pytest.approx(CONFIG.slip_rad)


def test_covariance_follows_samples_of_the_same_step() -> None:
    rng = np.random.default_rng(0)
    before = Pose2D(1.0, 2.0, 0.7)
    step = Pose2D(0.5, 0.1, 0.3)
    spread = np.diag([0.02**2, 0.03**2, 0.05**2])
    samples = rng.multivariate_normal(before.as_array(), spread, 20_000)
    after = np.array([(Pose2D(*map(float, s)) @ step).as_array() for s in samples])
    assert move_covariance(spread, before, step) == pytest.approx(np.cov(after.T), abs=2e-4)


def test_noise_grows_with_the_way() -> None:
    near = step_covariance(Pose2D(0.1, 0.0, 0.0), 0.001, 0.001, CONFIG)
    far = step_covariance(Pose2D(1.0, 0.0, 0.0), 0.001, 0.001, CONFIG)
    assert (np.diag(far) > np.diag(near)).all()
