"""Any service may die at any moment: the robot stands where commands end, and the trip goes on."""

import time
from collections.abc import Generator
from pathlib import Path

import pytest
from support.demo import Demo, Latest
from support.waiting import PATIENCE_S, wait_until

from trolley import requests
from trolley.client import Robot
from trolley.runtime.zenoh_bus import open_bus

pytestmark = pytest.mark.slow


@pytest.fixture
def demo(tmp_path: Path) -> Generator[Demo]:
    running = Demo(tmp_path, "--headless", "--tour", "--seed", "3", "--speed", "2")
    yield running
    running.end()


def test_robot_stands_within_half_a_second_of_a_killed_planner(demo: Demo) -> None:
    with open_bus([demo.endpoint], PATIENCE_S) as bus:
        latest = Latest(bus, demo.name)
        latest.wait_for_driving()
        demo.kill_service("planner")
        # Commands are good for 0.5 s at most; then comes the way to brake from 0.5 m/s.
        wait_until(lambda: latest.speed < 0.01, "the robot stands", patience_s=0.5 + 0.6)
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
        time.sleep(2.0)
        assert latest.speed < 0.01
        with Robot(demo.name, [demo.endpoint]) as robot:
            robot.ask(requests.TOUR_RESUME)
        status = latest.wait_for_trip("done")
        assert [result.state for result in status.results] == ["reached"] * 3
