"""`trolley detect` at addresses of the network that are named: who is there, and who calls."""

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from support.metal import make_hall
from support.processes import find_free_port

from trolley_base.detection import settings, udev_rules
from trolley_base.detection.detector import detect_devices
from trolley_base.detection.ports import find_ports
from trolley_base.detection.results import PortResult
from trolley_base.emulators import EmulatedRobot, RobotInWorld
from trolley_base.world.world_file import load_world

pytestmark = pytest.mark.drives


@pytest.fixture
def number() -> int:
    return find_free_port()


@contextmanager
def emulated(folder: Path, **network: str) -> Iterator[EmulatedRobot]:
    body = RobotInWorld(load_world(make_hall(folder)), seed=3)
    with EmulatedRobot(list(network), body, folder / "ports", network=network) as robot:
        yield robot


def detect(*names: str) -> list[PortResult]:
    return detect_devices(find_ports(names), lambda result, left: None)


def test_each_device_is_named_at_its_address(tmp_path: Path, number: int) -> None:
    network = {"hokuyo_urg": "tcp:0", "rplidar_c1": "udp:0", "linorobot2": f"udp:{number}"}
    with emulated(tmp_path, **network) as robot:
        names = [robot.addresses[one] for one in network]
        seen = detect(*names)
        found = {
            one.port.name: (one.found.kind, one.found.model)
            for one in seen
            if one.found is not None
        }
        assert found == {
            names[0]: ("lidar", "hokuyo_urg"),
            names[1]: ("lidar", "rplidar_c1"),
            names[2]: ("board", "linorobot2"),
        }
        assert robot.commands() == ()
    proposed = settings.propose([seen[0], seen[2]], {}).values
    assert proposed["base", "lidar", "port"] == names[0]
    assert proposed["base", "chassis", "port"] == f"udp://:{number}"
    assert ("base", "chassis", "baud") not in proposed
    assert "SUBSYSTEM" not in udev_rules.render(seen)


@pytest.mark.parametrize("lidar", ["ld19", "ydlidar_x4", "xv11"])
def test_a_lidar_behind_an_adapter_is_named(tmp_path: Path, lidar: str) -> None:
    with emulated(tmp_path, **{lidar: "tcp:0"}) as robot:
        [seen] = detect(robot.addresses[lidar])
    assert seen.found is not None, seen.problems
    assert seen.found.model == lidar


def test_one_that_only_its_speed_tells_from_another_is_said_to_be_either(tmp_path: Path) -> None:
    with emulated(tmp_path, stl27l="tcp:0") as robot:
        [seen] = detect(robot.addresses["stl27l"])
    assert seen.found is not None, seen.problems
    assert seen.found.model == "ld19"
    assert any("stl27l" in one for one in seen.found.details)


def test_a_board_that_calls_is_only_listened_to(tmp_path: Path, number: int) -> None:
    with emulated(tmp_path, linorobot2=f"udp:{number}") as robot:
        [seen] = detect(f"udp://:{number}")
        assert robot.writes("linorobot2") == ()
    assert seen.found is not None
    assert seen.found.details == ("looks for an agent",)


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("udp://:{free}", "Nobody answers or calls"),
        ("tcp://127.0.0.1:{free}", "refuses the connection"),
        ("udp://:{taken}", "another program listens there already"),
        ("udp://127.0.0.1", "is not an address"),
    ],
)
def test_where_nobody_is_it_is_said_why(name: str, told: str, number: int) -> None:
    with socket.socket(type=socket.SOCK_DGRAM) as taken:
        taken.bind(("", 0))
        [seen] = detect(name.format(free=number, taken=taken.getsockname()[1]))
    assert seen.found is None
    assert told in seen.problems[0]


def test_rubbish_is_nobody(number: int) -> None:
    end = threading.Event()

    def talk() -> None:
        with socket.socket(type=socket.SOCK_DGRAM) as caller:
            while not end.wait(0.01):
                caller.sendto(b"M-SEARCH * HTTP/1.1\r\n", ("127.0.0.1", number))

    thread = threading.Thread(target=talk)
    thread.start()
    try:
        [seen] = detect(f"udp://:{number}")
    finally:
        end.set()
        thread.join()
    assert seen.found is None
    assert "not those of a device that Trolley knows" in seen.problems[0]


def test_without_names_no_address_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> Callable[..., None]:
        raise AssertionError("a socket was opened")

    monkeypatch.setattr(socket, "socket", refuse)
    monkeypatch.setattr(socket, "create_connection", refuse)
    assert all(port.name.startswith("/dev/") for port in find_ports())
