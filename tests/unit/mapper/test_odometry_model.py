"""By how much the wheels err is learnt where scans show the motion."""

import math

import numpy as np
import pytest

from trolley.geometry import Pose2D
from trolley_mapper.slam.motion_model import PARAMS as MOTION
from trolley_mapper.slam.odometry_model import OdometryModel

SURE = np.diag([1e4, 1e4, 1e4])
CORRIDOR = np.diag([10.0, 1e4, 1e4])
"""Information of a scan that does not show the place along a corridor."""


def drive(
    model: OdometryModel,
    steps: int,
    dev_m: float,
    scale: float = 1.0,
    information: np.ndarray = SURE,
) -> None:
    """Drive steps of a metre; the wheels read `scale` of it and err by `dev_m` besides."""
    rng = np.random.default_rng(0)
    for _ in range(steps):
        model.correct(Pose2D(scale + dev_m * float(rng.standard_normal()), 0.0, 0.0))
        model.learn(np.array([1.0, 0.0, 0.0]), information)


def dev_m(model: OdometryModel) -> float:
    """The deviation along a metre."""
    return math.sqrt(float(model.covariance(Pose2D(1.0, 0.0, 0.0))[0, 0]))


@pytest.mark.parametrize("scale", [0.95, 1.0, 1.05])
def test_wheels_that_only_read_too_much_or_too_little_are_precise_once_it_is_known(
    scale: float,
) -> None:
    model = OdometryModel()
    before_m = dev_m(model)
    drive(model, 40, 0.01, scale)
    assert model.distance == pytest.approx(1.0 / scale, rel=0.01)
    assert dev_m(model) < 0.5 * before_m
    assert dev_m(model) > 0.03


def test_wheels_that_err_at_random_stay_as_vague_as_before() -> None:
    model = OdometryModel()
    before_m = dev_m(model)
    drive(model, 40, MOTION.distance_share)
    assert dev_m(model) > 0.8 * before_m


def test_wheels_that_begin_to_slip_are_vague_again() -> None:
    model = OdometryModel()
    drive(model, 40, 0.01)
    precise_m = dev_m(model)
    drive(model, 4, 0.01, scale=1.3)
    assert dev_m(model) > 2.0 * precise_m


def test_a_corridor_teaches_nothing_of_distances() -> None:
    model = OdometryModel()
    drive(model, 40, 0.01, scale=1.05, information=CORRIDOR)
    assert model.distance == 1.0
    assert model.distance_share(1.0) == MOTION.distance_share


def test_short_steps_err_by_a_larger_share() -> None:
    model = OdometryModel()
    drive(model, 40, 0.03)
    assert model.distance_share(0.25) == pytest.approx(2.0 * model.distance_share(1.0))
    assert model.distance_share(0.01) == MOTION.distance_share


def test_what_is_learnt_of_a_distance_holds_for_the_past_until_the_wheels_are_known() -> None:
    model = OdometryModel()
    assert model.unlearnt > 0.9
    drive(model, 40, 0.01, information=CORRIDOR)
    assert model.unlearnt > 0.9
    drive(model, 20, 0.01)
    assert model.unlearnt < 0.1
