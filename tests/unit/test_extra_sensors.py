"""Extra sensors: whose echoes count, where they stay, and how they go."""

import math
from typing import Any

import numpy as np
import pytest

from trolley.config.base import ExtraSensorConfig
from trolley.config.robot import PoseConfig
from trolley.extra_sensors import PARAMS, ExtraSensors
from trolley.geometry import Pose2D
from trolley.messages import Scan, floats_to_bytes

SECOND = 10**9
MOUNT = PoseConfig(x=0.2, y=0.0, yaw=0.0)


def scan(stamp_s: float, ranges: list[float] | np.ndarray, **changes: Any) -> Scan:
    """Nine beams over 80 degrees, looking ahead."""
    shape: dict[str, Any] = {
        "angle_min": -math.radians(40.0),
        "angle_increment": math.radians(10.0),
        "time_increment": 0.0,
        "range_min": 0.1,
        "range_max": 4.0,
    }
    return Scan(
        stamp_ns=round(stamp_s * SECOND),
        frame="front",
        ranges=floats_to_bytes(np.asarray(ranges, np.float32)),
        **(shape | changes),
    )


def ahead(distance: float) -> list[float]:
    """One echo straight ahead, nothing beside it."""
    return [math.inf] * 4 + [distance] + [math.inf] * 4


class Robot:
    """ExtraSensors on a robot that stands where `pose` says."""

    def __init__(self, **listed: ExtraSensorConfig) -> None:
        self.pose = Pose2D.identity()
        self.sensors = ExtraSensors(listed or {"front": ExtraSensorConfig(pose=MOUNT)}, "stop")

    def hear(self, message: Scan, name: str = "front", late_s: float = 0.05) -> str:
        now_ns = message.stamp_ns + round(late_s * SECOND)
        return self.sensors.update(name, message, now_ns, lambda _: self.pose)

    def points(self, at_s: float) -> list[tuple[float, float]]:
        found = self.sensors.points_odom(round(at_s * SECOND))
        return [(round(x, 3), round(y, 3)) for x, y in found.tolist()]


@pytest.fixture
def robot() -> Robot:
    return Robot()


def test_an_echo_stays_in_place_while_the_robot_moves_on(robot: Robot) -> None:
    assert robot.hear(scan(10.0, ahead(1.0))) == ""
    robot.pose = Pose2D(0.5, 0.0, math.pi / 2)  # and looks away
    assert robot.hear(scan(10.2, ahead(2.0))) == ""
    assert sorted(robot.points(10.3)) == [(0.5, 2.2), (1.2, 0.0)]


def test_it_goes_where_its_sensor_sees_past_it_and_in_time_where_it_does_not_look(
    robot: Robot,
) -> None:
    robot.hear(scan(10.0, ahead(1.0)))
    robot.hear(scan(10.1, ahead(3.0)))
    assert robot.points(10.2) == [(3.2, 0.0)]
    robot.pose = Pose2D(0.0, 0.0, math.pi)
    robot.hear(scan(10.2, [math.inf] * 9))
    assert robot.points(10.3) == [(3.2, 0.0)]
    assert robot.points(10.1 + ExtraSensorConfig().kept_s + 0.01) == []


@pytest.mark.parametrize("unseen", [[0.0] * 9, ahead(0.5), [math.nan] * 9])
def test_beams_that_do_not_reach_it_prove_nothing(robot: Robot, unseen: list[float]) -> None:
    robot.hear(scan(10.0, ahead(1.0)))
    robot.hear(scan(10.1, unseen))
    assert (1.2, 0.0) in robot.points(10.2)


def test_what_is_too_near_for_the_sensor_is_not_forgotten(robot: Robot) -> None:
    robot.hear(scan(10.0, ahead(0.3)))
    robot.pose = Pose2D(0.25, 0.0, 0.0)  # 5 cm before it, less than it can measure
    for number in range(50):
        robot.hear(scan(10.1 + 0.1 * number, [math.inf] * 9))
    assert robot.points(15.1) == [(0.5, 0.0)]
    robot.pose = Pose2D(0.0, 0.0, 0.0)  # backed off, it sees that nothing is there
    robot.hear(scan(15.2, [math.inf] * 9))
    assert robot.points(15.3) == []


@pytest.mark.parametrize(
    ("message", "name", "late_s", "why"),
    [
        (scan(10.0, ahead(1.0)), "back", 0.0, "unlisted"),
        (scan(10.0, []), "front", 0.0, "empty"),
        (scan(10.0, ahead(1.0)), "front", 0.6, "late"),
        (scan(10.0, ahead(1.0)), "front", -0.2, "early"),
    ],
)
def test_what_cannot_be_used_is_named(
    robot: Robot, message: Scan, name: str, late_s: float, why: str
) -> None:
    assert robot.hear(message, name, late_s) == why
    assert robot.points(10.1) == []


def test_a_scan_that_came_twice_counts_once(robot: Robot) -> None:
    assert robot.hear(scan(10.0, ahead(1.0))) == ""
    assert robot.hear(scan(10.0, ahead(1.0))) == "late"
    assert robot.hear(scan(9.9, ahead(2.0))) == "late"
    assert robot.points(10.1) == [(1.2, 0.0)]


def test_one_for_another_use_is_neither_used_nor_reported() -> None:
    robot = Robot(front=ExtraSensorConfig(pose=MOUNT, uses=["mark"]))
    assert robot.hear(scan(10.0, ahead(1.0))) == ""
    assert robot.points(10.1) == []
    assert robot.sensors.silent(99 * SECOND) == []


def test_silence_is_noticed_once_it_was_heard(robot: Robot) -> None:
    assert robot.sensors.silent(99 * SECOND) == []
    robot.hear(scan(10.0, ahead(1.0)))
    assert robot.sensors.silent(round(10.9 * SECOND)) == []
    assert robot.sensors.silent(round(11.1 * SECOND)) == ["front"]


@pytest.mark.parametrize(
    "shape", [{"time_increment": 1e300}, {"time_increment": -1e300}, {"angle_increment": 1e308}]
)
def test_a_scan_that_no_sensor_takes_is_left_out(robot: Robot, shape: dict[str, float]) -> None:
    for at_s in (10.0, 10.1):
        assert robot.hear(scan(at_s, ahead(1.0), **shape)) == "impossible"
    assert robot.hear(scan(10.2, ahead(1.0))) == ""
    assert robot.points(10.3) == [(1.2, 0.0)]


def test_memory_is_bounded(robot: Robot) -> None:
    rng = np.random.default_rng(1)
    for number in range(40):
        robot.pose = Pose2D(float(rng.uniform(-9, 9)), float(rng.uniform(-9, 9)), 0.0)
        robot.hear(scan(10.0 + 0.02 * number, rng.uniform(0.2, 4.0, 600), angle_increment=0.001))
    assert len(robot.points(10.8)) <= PARAMS.most_points


def test_beams_of_a_turning_sensor_are_placed_where_the_robot_was(robot: Robot) -> None:
    def pose(stamp_ns: int) -> Pose2D:
        return Pose2D(0.0, 0.0, (stamp_ns - 10 * SECOND) * 1e-9)  # turns by 1 rad/s

    message = scan(10.0, [1.0] * 9, time_increment=0.05)
    robot.sensors.update("front", message, round(10.41 * SECOND), pose)
    found = robot.sensors.points_odom(round(10.41 * SECOND))
    yaws = 0.05 * np.arange(9)
    angles = yaws + np.radians(-40.0 + 10.0 * np.arange(9))
    exact = np.stack(
        [0.2 * np.cos(yaws) + np.cos(angles), 0.2 * np.sin(yaws) + np.sin(angles)], axis=1
    )
    # The sensor itself goes along a chord of its way.
    np.testing.assert_allclose(found, exact, atol=0.005)
