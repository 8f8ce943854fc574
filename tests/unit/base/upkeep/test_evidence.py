"""What stretches of a drive tell about wheels and lidar."""

import math

import numpy as np
import pytest

from trolley.geometry import Pose2D
from trolley_base.odometry.wheel_scales import WheelScales
from trolley_base.upkeep.correction import Correction
from trolley_base.upkeep.evidence import ANGULAR, BEND, LINEAR, YAW, Errors, Upkeep, X, Y
from trolley_base.upkeep.findings import InForce, find_proposals
from trolley_base.upkeep.legs import Leg

pytestmark = pytest.mark.drives

MOUNT = Pose2D(0.08, -0.03, 0.4)
IN_FORCE = InForce(MOUNT, WheelScales(track_m=0.2), 0.1)
RIGHT = Correction()
ERROR_M, ERROR_RAD = 0.025, 0.015
ASKED = "Take it over?"
SMALLER_LEFT = "The left wheel is 3.0 % smaller than robot.toml says."


def drive(
    upkeep: Upkeep,
    count: int,
    seed: int,
    wheels: Correction = RIGHT,
    mount: Pose2D = MOUNT,
    loose: float = 0.0,
) -> None:
    """Drive stretches of a metre or a turn, with slip, as a localizer with noise sees them."""
    rng = np.random.default_rng(seed)
    moved = mount @ MOUNT.inverse()
    for _ in range(count):
        turn = rng.uniform(-1.5, 1.5)
        way = 1.0 if abs(turn) < 1.0 else rng.uniform(0.0, 0.5)
        steps = np.tile([way / 50, 0.0, turn / 50], (50, 1))
        true = steps.copy()
        true[:, 0] += 0.02 * math.sqrt(way / 50) * rng.standard_normal(50)
        true[:, 2] += 0.03 * math.sqrt((way + abs(turn)) / 50) * rng.standard_normal(50)
        true[:, 0] *= 1.0 + loose * rng.uniform(-1.0, 1.0)
        noise = [Pose2D(*rng.normal(0.0, (0.02, 0.02, 0.012))) for _ in range(2)]
        seen = moved.inverse() @ wheels.integrate(true) @ moved
        upkeep.update(Leg(steps, noise[0].inverse() @ seen @ noise[1], ERROR_M, ERROR_RAD))


def proposed(upkeep: Upkeep) -> dict[str, dict[str, float]]:
    errors = upkeep.errors()
    assert errors is not None
    return {one.id: one.settings for one in find_proposals(errors, IN_FORCE)}


def test_a_lidar_that_was_turned_is_proposed_within_ten_minutes() -> None:
    upkeep = Upkeep(MOUNT)
    drive(upkeep, 500, 1)
    assert proposed(upkeep) == {}
    drive(upkeep, 150, 2, mount=Pose2D(MOUNT.x, MOUNT.y, MOUNT.yaw + math.radians(3.0)))
    (settings,) = proposed(upkeep).values()
    turned = math.degrees(settings["base.lidar.pose.yaw"] - MOUNT.yaw)
    assert turned == pytest.approx(3.0, abs=0.8)


def test_a_worn_tyre_is_proposed_with_the_settings_that_make_up_for_it() -> None:
    upkeep = Upkeep(MOUNT)
    drive(upkeep, 300, 3)
    # The left wheel is 3 % smaller: half of that is missing ahead, and it bends to the left.
    drive(upkeep, 120, 4, wheels=Correction(0.985, 0.985, 0.03 / 0.2))
    (settings,) = proposed(upkeep).values()
    assert settings["base.odometry.linear_scale"] == pytest.approx(0.985, abs=0.012)
    assert settings["base.odometry.wheel_ratio"] == pytest.approx(1.03, abs=0.012)


def test_a_loose_encoder_is_no_correction_but_something_to_look_at() -> None:
    upkeep = Upkeep(MOUNT)
    drive(upkeep, 200, 5)
    drive(upkeep, 60, 6, loose=0.9)
    assert proposed(upkeep) == {"odometry": {}}


@pytest.mark.slow
def test_what_is_said_to_be_uncertain_is_as_uncertain_as_that() -> None:
    ratios: list[np.ndarray] = []
    for seed in range(12):
        upkeep = Upkeep(MOUNT)
        drive(upkeep, 150, 100 + seed)
        errors = upkeep.errors()
        assert errors is not None
        ratios.append(errors.values / np.sqrt(np.diag(errors.covariance)))
        assert find_proposals(errors, IN_FORCE) == []
    spread = np.sqrt(np.mean(np.square(ratios), axis=0))
    # Above 1 is overconfident, but for chance.
    assert np.all(spread[[LINEAR, ANGULAR, BEND, YAW, X, Y]] < 1.3)
    assert np.all(spread[[LINEAR, ANGULAR, BEND, YAW]] > 0.3)


def test_too_short_a_drive_says_nothing() -> None:
    upkeep = Upkeep(MOUNT)
    drive(upkeep, 20, 7)
    assert upkeep.errors() is None


def test_a_robot_that_scraped_along_something_is_not_measured_by_that() -> None:
    upkeep = Upkeep(MOUNT)
    drive(upkeep, 150, 8)
    before = upkeep.errors()
    steps = np.tile([0.0, 0.0, 0.04], (50, 1))
    for _ in range(6):  # the wheels turn it by 2 radians, and it comes round by 0.8
        upkeep.update(Leg(steps, Pose2D(0.0, 0.0, 0.8), ERROR_M, ERROR_RAD))
        errors = upkeep.errors()
        assert errors is not None
        assert before is not None
        assert find_proposals(errors, IN_FORCE) == []
        assert errors.values == pytest.approx(before.values)
    drive(upkeep, 30, 9)
    assert proposed(upkeep) == {}


def test_rugs_that_hold_both_wheels_back_are_no_worn_tyres() -> None:
    upkeep = Upkeep(MOUNT)
    for part in range(4):
        drive(upkeep, 60, 20 + part, wheels=Correction(0.965, 0.965))
        assert proposed(upkeep) == {}


def errors_of(
    linear: float, angular: float, bend: float, yaw: float = 0.0, yaw_std: float = 1e-3
) -> Errors:
    """What is wrong, as if it were known well."""
    stds = np.array([2e-3, 2e-3, 2e-3, yaw_std, 2e-3, 2e-3])
    values = np.array([linear, angular, bend, yaw, 0.0, 0.0])
    return Errors(values, np.diag(stds**2), 80.0, 1.0)


def test_a_worn_tyre_on_rugs_is_not_said_to_be_worn_by_what_the_rugs_take() -> None:
    # The left wheel is 3 % smaller, and rugs take 2.2 % of both.
    errors = errors_of(-0.037, -0.037, 0.15)
    # Proposed before or not: the right wheel is as robot.toml says.
    for before in ((), ("wheels",)):
        (proposal,) = find_proposals(errors, IN_FORCE, before)
        assert proposal.message == f"{SMALLER_LEFT} {ASKED}"
        assert proposal.settings == {
            "base.odometry.linear_scale": 0.985,
            "base.odometry.angular_scale": 0.985,
            "base.odometry.wheel_ratio": pytest.approx(1.031, abs=0.002),
        }


def test_a_thick_carpet_all_over_the_floor_is_not_said_to_be_worn_tyres() -> None:
    (proposal,) = find_proposals(errors_of(-0.06, -0.06, 0.002), IN_FORCE)
    told = "The wheels drive 6.0 % less far than robot.toml says: both are smaller, or rugs hold "
    assert proposal.message == f"{told}them back. {ASKED}"
    assert proposal.settings["base.odometry.linear_scale"] == 0.94
    # A worn tyre on it is told apart from it.
    (proposal,) = find_proposals(errors_of(-0.075, -0.075, 0.15), IN_FORCE)
    assert proposal.message == f"{told}them back. {SMALLER_LEFT} {ASKED}"
    assert proposal.settings["base.odometry.linear_scale"] == 0.925
    # What it takes may be worth no proposal, although both together would be.
    (proposal,) = find_proposals(errors_of(-0.055, -0.055, 0.15), IN_FORCE)
    assert proposal.message == f"{SMALLER_LEFT} {ASKED}"


def test_a_wider_track_is_proposed_without_what_rugs_take() -> None:
    (proposal,) = find_proposals(errors_of(-0.02, -0.06, 0.0), IN_FORCE)
    assert proposal.message == "The track is 4.0 % wider than robot.toml says. " + ASKED
    assert proposal.settings["base.odometry.linear_scale"] == 1.0
    assert proposal.settings["base.odometry.angular_scale"] == 0.96
    assert proposal.settings["base.odometry.wheel_ratio"] == 1.0


def test_a_turned_lidar_is_said_to_be_turned_while_it_stays_proposed() -> None:
    # It is less sure than it was when it was proposed.
    errors = errors_of(0.0, 0.0, 0.0, yaw=math.radians(2.0), yaw_std=math.radians(0.45))
    assert find_proposals(errors, IN_FORCE) == []
    (proposal,) = find_proposals(errors, IN_FORCE, ("lidar",))
    assert "turned by 2.0°" in proposal.message
    assert proposal.settings["base.lidar.pose.yaw"] == pytest.approx(0.4 + math.radians(2.0), 1e-3)


def test_wheels_of_quite_another_size_are_proposed_both() -> None:
    upkeep = Upkeep(MOUNT)
    drive(upkeep, 200, 50, wheels=Correction(0.92, 0.92))
    errors = upkeep.errors()
    assert errors is not None
    (proposal,) = find_proposals(errors, IN_FORCE)
    assert "% less far than robot.toml says: both are smaller, or rugs hold" in proposal.message
    assert proposal.settings["base.odometry.linear_scale"] == pytest.approx(0.92, abs=0.01)
