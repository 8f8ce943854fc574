"""The demo as a user runs it, and other programs that speak to it."""

import itertools
import json
import subprocess
import sys
from collections.abc import Generator
from pathlib import Path

import pytest
from support.demo import Demo, Latest
from support.waiting import PATIENCE_S, wait_until

from trolley import drivers, topics
from trolley.client import Robot
from trolley.drivers import BUILT_IN
from trolley.runtime.zenoh_bus import open_bus

pytestmark = pytest.mark.slow

BOARDS, LIDARS = (
    [model for models in BUILT_IN[group].values() for model in models]
    for group in (drivers.BOARDS, drivers.LIDARS)
)
LATE = ("link_lost", "scan_lost")
"""Where a busy machine held the devices up, a board that nothing stops drives on meanwhile."""

DISOBEYED = "The motor board does not obey"


@pytest.mark.parametrize(("speed", "seed"), [(2, 2)])
def test_demo_reaches_all_stops(tmp_path: Path, speed: int, seed: int) -> None:
    demo = Demo(tmp_path, "--headless", "--tour", "--speed", str(speed), "--seed", str(seed))
    try:
        assert demo.process.wait(2 * PATIENCE_S) == 0, demo.process.log
    finally:
        demo.process.kill()
    for stop in ("corridor", "entrance", "kitchen"):
        assert f"{stop}: reached" in demo.process.log
    assert "0 collisions" in demo.process.log


@pytest.mark.again("a board whose emulator is held up does not obey")
@pytest.mark.parametrize(("board", "lidar"), [*zip(itertools.cycle(BOARDS), LIDARS, strict=False)])
def test_demo_reaches_all_stops_over_emulated_ports(tmp_path: Path, board: str, lidar: str) -> None:
    """Each lidar drives once, with the boards in turn."""
    demo = Demo(tmp_path, "--headless", "--tour", "--emulate", f"{board},{lidar}")
    try:
        wait_until(
            lambda: not demo.process.is_running or DISOBEYED in demo.process.log,
            lambda: f"it is over: {demo.process.log}",
            2 * PATIENCE_S,
        )
        assert DISOBEYED not in demo.process.log, demo.process.log  # waits for a person
        code = demo.process.wait()
    finally:
        demo.process.kill()
    log = demo.process.log
    is_late = any(word in log for word in LATE)
    assert "0 collisions" in log or is_late, log
    assert code == 0, log
    assert "3 of 3 stops reached" in log
    assert "is the device unplugged?" not in log


def is_localized(robot: Robot) -> bool:
    """Whether the newest pose says so."""
    pose = robot.latest(topics.POSE)
    return pose is not None and pose.state == "localized"


def has_kitchen(robot: Robot) -> bool:
    """Whether that place is stored."""
    poses = robot.latest(topics.POSES)
    return poses is not None and any(pose.name == "kitchen" for pose in poses.poses)


@pytest.fixture
def quiet_demo(tmp_path: Path) -> Generator[Demo]:
    """A demo that stands and waits, with its places saved."""
    demo = Demo(tmp_path, "--headless")
    try:
        with demo.client() as robot:
            wait_until(lambda: has_kitchen(robot), "the demo has saved its places")
            wait_until(lambda: is_localized(robot), "the robot is localized")
        yield demo
    finally:
        demo.end()


def zenoh_cli(demo: Demo, *arguments: str) -> str:
    """Run the PyPI client `zenoh-cli`."""
    program = Path(sys.executable).with_name("zenoh")
    command = [str(program), "--mode", "client", "--connect", demo.endpoint, *arguments]
    return subprocess.run(
        command, capture_output=True, text=True, timeout=PATIENCE_S, check=True
    ).stdout


def test_foreign_client_reads_and_stores(quiet_demo: Demo) -> None:
    name = quiet_demo.name
    kitchen = zenoh_cli(
        quiet_demo, "get", "--decoder", "json", "-s", f"trolley/{name}/poses/kitchen"
    )
    assert '"kitchen"' in kitchen.replace("'", '"')
    pose = zenoh_cli(quiet_demo, "get", "--decoder", "json", "-s", f"trolley/{name}/pose")
    assert "localized" in pose
    place = {"map": "apartment", "pose": {"x": 1.0, "y": 0.5, "yaw": 0.0}, "name": "sofa"}
    zenoh_cli(quiet_demo, "put", "-k", f"trolley/{name}/poses/sofa", "-v", json.dumps(place))
    with Robot(name, [quiet_demo.endpoint]) as robot:
        wait_until(lambda: robot.get(topics.SAVED_POSE, "sofa"), "the place is stored")


def test_reading_everything_moves_nothing(quiet_demo: Demo) -> None:
    with open_bus([quiet_demo.endpoint], PATIENCE_S) as bus:
        latest = Latest(bus, quiet_demo.name)
        wait_until(lambda: latest.truth, "the truth arrives")
        assert latest.truth is not None
        before = latest.truth.pose
        everything = zenoh_cli(quiet_demo, "get", "-s", f"trolley/{quiet_demo.name}/**")
        # The client prints one value a line, without keys: at least these topics answer.
        assert len(everything.splitlines()) >= 15
        latest.fastest_within(1.0)
        assert latest.truth.pose.distance_to(before) < 0.001
    assert set(quiet_demo.children()) == {"base", "localizer", "mapper", "planner", "tour"}


def test_recording_plays_as_real_processes(tmp_path: Path, recordings: Path) -> None:
    demo = Demo(
        tmp_path,
        "--headless",
        "--recording",
        str(recordings / "create3-rplidar-mac.npz"),
        "--map",
        str(recordings / "mac_1st_floor_final.yaml"),
    )
    try:
        with demo.client() as robot:
            wait_until(lambda: is_localized(robot), "localized on the recording")
    finally:
        demo.end()
