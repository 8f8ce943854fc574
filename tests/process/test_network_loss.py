"""A robot whose radio link breaks: its own services go on, and nothing old moves it afterwards."""

import itertools
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
import tomli_w
from support import wifi
from support.onlooker import Onlooker
from support.waiting import wait_until
from support.wifi import ADDRESSES, HOME, NETWORK, ROBOT, Wifi

from trolley.cli.demo_robot import Choices, settings
from trolley.geometry import Pose2D
from trolley.security.keyring import Keyring

pytestmark = pytest.mark.slow

NAME = "kiwi"
LOCAL = "tcp/127.0.0.1:7447"
PROGRAM = "from trolley.cli import main; main()"
BACK_S = 20.0
"""It takes about 1 s; this is for a busy machine."""
LARGE_PUTS = """
import os, time
from trolley import topics
from trolley.runtime.zenoh_bus import open_bus
with open_bus(["tcp/127.0.0.1:7447"], 30.0) as bus:
    while True:
        topic = topics.COSTMAP_GLOBAL
        bus.put(topic.key("kiwi"), os.urandom(300_000), "x", topic.qos)
        time.sleep(0.1)
"""


class House:
    """A home router and a simulated robot's base, each on a host of its own."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self._folder, self._stack = folder, stack
        self.wifi = stack.enter_context(Wifi())
        ring = Keyring(folder / "ring")
        now = datetime.now(UTC)
        ring.create(now)
        until = now + timedelta(days=1)
        home = ring.issue("router", "home", until, [ADDRESSES[HOME]], replace=False)
        robot = ring.issue("robot", NAME, until, replace=False)
        toml = settings(Choices(name=NAME))
        toml["zenoh"] = {
            "connect": [LOCAL],
            "uplink": [f"tls/{ADDRESSES[HOME]}:7448"],
            "keys": str(robot.folder),
        }
        path = folder / "robot.toml"
        path.write_text(tomli_w.dumps(toml), encoding="utf-8")
        self._home = ["-c", PROGRAM, "router", "--keys", str(home.folder)]
        self.router = self.start_router()
        self.start(ROBOT, "-c", PROGRAM, "router", "--config", str(path))
        self.start(ROBOT, "-m", "trolley_base", "--config", str(path))
        self.at_home = self._onlooker(HOME)
        self.on_robot = self._onlooker(ROBOT)
        self.wait_for_truth(0.0, 60.0)

    def start(self, host: str, *arguments: str) -> subprocess.Popen[bytes]:
        environment = {"TROLLEY_STATE": str(self._folder / "state"), "TROLLEY_CONFIG": ""}
        log = self._folder / f"{host}.log"
        process = self.wifi.start(host, arguments, log, environment)
        self._stack.callback(process.wait)
        self._stack.callback(process.kill)
        return process

    def start_router(self) -> subprocess.Popen[bytes]:
        return self.start(HOME, *self._home)

    def _onlooker(self, host: str) -> Onlooker:
        onlooker = Onlooker(self.wifi.namespace(host), LOCAL, NAME, hears_all=True)
        self._stack.callback(onlooker.close)
        return onlooker

    def wait_for_truth(self, since_s: float, seconds: float = BACK_S) -> None:
        logs = [path.read_text() for path in self._folder.glob("*.log")]
        wait_until(lambda: self.at_home.seen("truth", since_s), f"home hears the robot: {logs}")

    def local_gap_s(self, since_s: float) -> float:
        """The longest time that a program on the robot heard nothing of base."""
        times = [one.at_s for one in self.on_robot.seen("odom", since_s)]
        return max(b - a for a, b in itertools.pairwise(times))

    def speed_mps(self, since_s: float) -> float:
        return max((one.what for one in self.on_robot.seen("truth", since_s)), default=0.0)


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> Iterator[House]:
    reason = wifi.why_not()
    if reason is not None:
        pytest.skip(reason)
    with ExitStack() as stack:
        yield House(tmp_path_factory.mktemp("house"), stack)


def test_a_cut_leaves_the_robot_alone_and_nothing_old_moves_it(house: House) -> None:
    large = house.start(ROBOT, "-c", LARGE_PUTS)
    before = house.at_home.count_bytes()
    wait_until(lambda: house.at_home.count_bytes() > before + 1_000_000, "much is sent")
    began_s = time.monotonic()
    cut_s = 3.0
    house.at_home.drive(0.15, began_s + 1.0 + 0.9 * cut_s)
    wait_until(lambda: house.speed_mps(began_s) > 0.1, "the hand drives the robot")
    time.sleep(max(0.0, began_s + 1.0 - time.monotonic()))
    house.wifi.is_cut = True
    time.sleep(0.3)
    answer = house.at_home.stop()
    assert answer.code != "ok"
    assert answer.took_s < 2.0
    time.sleep(max(0.0, began_s + 1.0 + cut_s - time.monotonic()))
    stood_s = time.monotonic()
    house.wifi.is_cut = False
    house.wait_for_truth(stood_s)
    time.sleep(1.0)
    assert house.speed_mps(stood_s) < 0.005, "what was sent before or meanwhile moves nothing"
    assert house.on_robot.seen("teleop", stood_s) == []
    large.kill()
    assert house.local_gap_s(began_s) < 1.0, "the robot's own programs hear each other"


def test_a_long_cut_is_over_when_it_is_over(house: House) -> None:
    large = house.start(ROBOT, "-c", LARGE_PUTS)
    before = house.at_home.count_bytes()
    wait_until(lambda: house.at_home.count_bytes() > before + 1_000_000, "much is sent")
    house.wifi.is_cut = True
    # By now Linux would repeat what was on its way only every ten seconds and more.
    time.sleep(15.0)
    house.wifi.is_cut = False
    house.wait_for_truth(time.monotonic(), 7.0)
    large.kill()


def test_a_new_address_and_a_new_router_are_found(house: House) -> None:
    changed_s = time.monotonic()
    house.wifi.set_address(ROBOT, f"{NETWORK}.77")
    house.wait_for_truth(changed_s + 0.2)
    house.router.kill()
    house.router.wait()
    house.start_router()
    house.wait_for_truth(time.monotonic())
    sent_s = time.monotonic()
    house.at_home.drive(0.15, sent_s + 1.0)
    wait_until(lambda: house.speed_mps(sent_s) > 0.1, "the hand drives the robot again")
    assert house.at_home.stop().code == "ok"
    assert house.at_home.send_goal(Pose2D(1.0, 0.0, 0.0)).code == "not_ready"
