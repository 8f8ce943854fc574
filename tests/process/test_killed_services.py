"""Any service may die at any moment: the robot stands where commands end, and the trip goes on."""

from collections.abc import Generator
from pathlib import Path

import pytest
from support.demo import Demo, Latest, speed_of
from support.waiting import PATIENCE_S, wait_until

from trolley import requests, topics
from trolley.messages import Truth, VelocityCommand
from trolley.runtime import codec
from trolley.runtime.zenoh_bus import open_bus

pytestmark = pytest.mark.slow


@pytest.fixture
def demo(tmp_path: Path) -> Generator[Demo]:
    running = Demo(tmp_path, "--headless", "--tour", "--seed", "3", "--speed", "2")
    yield running
    running.end()


def stands(truth: Truth) -> bool:
    return speed_of(truth) < 0.01


def test_robot_stands_within_half_a_second_of_a_killed_planner(demo: Demo) -> None:
    with open_bus([demo.endpoint], PATIENCE_S) as bus:
        latest = Latest(bus, demo.name)
        latest.wait_for_driving()
        commands: list[int] = []
        bus.subscribe(
            topics.COMMAND.key(demo.name, "planner"),
            lambda sample: commands.append(
                codec.decode(VelocityCommand, sample.payload, sample.encoding).stamp_ns
            ),
        )
        wait_until(lambda: commands, "a command is heard")
        demo.kill_service("planner")
        stood = wait_until(
            lambda: next(
                (one for one in latest.truths if one.stamp_ns > commands[-1] and stands(one)), None
            ),
            "the robot stands",
        )
        assert stood is not None
        # Commands are good for 0.5 s at most; then comes the way to brake from 0.5 m/s. The robot's
        # clock judges; the planner may have begun anew meanwhile.
        last_ns = max(at_ns for at_ns in commands if at_ns <= stood.stamp_ns)
        assert (stood.stamp_ns - last_ns) * 1e-9 < 0.5 + 0.6
        status = latest.wait_for_trip("done")
        assert [result.state for result in status.results] == ["reached"] * 3
        assert latest.truth is not None
        assert latest.truth.collisions == 0


@pytest.mark.parametrize("service", ["localizer", "tour"])
def test_trip_goes_on_after_a_restart(demo: Demo, service: str) -> None:
    with open_bus([demo.endpoint], PATIENCE_S) as bus:
        latest = Latest(bus, demo.name)
        latest.wait_for_driving()
        old = demo.children()[service]
        demo.kill_service(service)
        wait_until(lambda: demo.children().get(service, old) != old, lambda: f"{service} is back")
        status = latest.wait_for_trip("done")
        assert [result.state for result in status.results] == ["reached"] * 3
        assert latest.truth is not None
        assert latest.truth.collisions == 0


def test_trip_waits_for_a_person_after_base_died(demo: Demo) -> None:
    with open_bus([demo.endpoint], PATIENCE_S) as bus:
        latest = Latest(bus, demo.name)
        latest.wait_for_driving()
        stood = latest.truth
        assert stood is not None
        demo.kill_service("base")
        latest.wait_for_trip("paused")
        wait_until(
            lambda: latest.truth and latest.truth.stamp_ns > stood.stamp_ns + 10**9,
            "base is back",
        )
        # It goes on where it stood (saved each second at up to 0.5 m/s), and stays there.
        assert latest.truth is not None
        assert latest.truth.pose.distance_to(stood.pose) < 1.0
        assert latest.fastest_within(2.0) < 0.01
        with demo.client() as robot:
            robot.ask(requests.TOUR_RESUME)
        status = latest.wait_for_trip("done")
        assert [result.state for result in status.results] == ["reached"] * 3
