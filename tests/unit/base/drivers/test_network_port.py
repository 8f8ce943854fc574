"""Devices of the network: what a connection does, and lidars that are read over one."""

import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.metal import make_hall
from support.waiting import PATIENCE_S, wait_until

from trolley.config.hardware import LidarConfig
from trolley.network_ports import explain_network, parse_address
from trolley_base.drivers.interface import LidarScan
from trolley_base.drivers.lidars import make_lidar
from trolley_base.drivers.network_port import NetworkPort
from trolley_base.drivers.real_hardware import RealHardware
from trolley_base.emulators import DeviceError, EmulatedRobot, RobotInWorld
from trolley_base.world.world_file import load_world

pytestmark = pytest.mark.drives


@pytest.fixture
def server() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server


def address_of(server: socket.socket) -> str:
    return f"tcp://127.0.0.1:{server.getsockname()[1]}"


def test_an_address_is_written_in_one_way() -> None:
    assert parse_address("tcp://192.168.0.10:10940") == ("tcp", "192.168.0.10", 10940)
    assert parse_address("udp://[fe80::1]:8089") == ("udp", "fe80::1", 8089)
    assert parse_address("tcp://lidar-2.home.local.:1").host == "lidar-2.home.local."
    assert parse_address("udp://:8888").host == ""
    for wrong in (
        "tcp://host",
        "tcp:/host:1",
        "tcp://:1",
        "udp://h:0",
        "udp://h:65536",
        "ftp://h:1",
        "tcp://192.168..10:1",
        "tcp://lidar..local:1",
        f"tcp://{64 * 'a'}.local:1",
    ):
        with pytest.raises(ValueError, match="write tcp://HOST:PORT"):
            parse_address(wrong)


def test_bytes_go_both_ways_and_the_end_is_an_error(server: socket.socket) -> None:
    port = NetworkPort(address_of(server))
    device, _ = server.accept()
    assert port.write(b"hello")
    assert device.recv(10) == b"hello"
    assert not port.wait(0.0)
    device.send(b"old")
    assert port.wait(5.0)
    port.discard_input()
    device.send(b"new")
    assert port.wait(5.0)
    assert port.read() == b"new"
    device.close()
    assert port.wait(5.0)
    with pytest.raises(ConnectionResetError) as caught:
        port.read()
    assert "has closed the connection" in explain_network(address_of(server), caught.value)
    port.close()
    port.close()


def test_what_nobody_takes_is_dropped_and_not_sent_late(server: socket.socket) -> None:
    server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
    port = NetworkPort(address_of(server))
    device, _ = server.accept()
    taken = 0
    while port.write(bytes(1000)):
        taken += 1000
        assert taken < 10_000_000
    assert not port.write(b"stop")
    held = 0
    device.settimeout(PATIENCE_S)
    while held < taken:
        data = device.recv(65536)
        assert b"stop" not in data
        held += len(data)
    device.settimeout(0.3)
    with pytest.raises(TimeoutError):
        device.recv(1)
    device.close()
    port.close()


def test_nobody_there_is_said(server: socket.socket) -> None:
    name = address_of(server)
    server.close()
    with pytest.raises(ConnectionRefusedError) as caught:
        NetworkPort(name)
    assert "refuses the connection" in explain_network(name, caught.value)
    unknown = socket.gaierror(-2, "Name or service not known")
    assert "nobody in this network is called lidar.lan" in explain_network(
        "tcp://lidar.lan:1", unknown
    )
    assert "does not answer" in explain_network(name, TimeoutError("timed out"))


@pytest.mark.parametrize(("model", "kind"), [("hokuyo_urg", "tcp"), ("rplidar_c1", "udp")])
def test_a_lidar_is_read_lost_and_found_again(tmp_path: Path, model: str, kind: str) -> None:
    body = RobotInWorld(load_world(make_hall(tmp_path)), seed=3)
    with EmulatedRobot([model], body, tmp_path / "ports", network={model: f"{kind}:0"}) as robot:
        name = robot.addresses[model]
        lidar = make_lidar(LidarConfig(model=model, port=name))
        start_ns = time.monotonic_ns()
        hardware = RealHardware(
            None, (lidar, name), start_ns, lambda ns: ns, lambda call: None, explain_network
        )
        said: list[str] = []

        def read() -> tuple[LidarScan, ...]:
            hardware.advance(time.monotonic_ns())
            reading = hardware.lidar.read()
            said.append(f"{reading.link.state}: {reading.link.message}")
            return reading.scans

        try:
            wait_until(read, lambda: said[-1])
            assert said[-1] == "up: "
            robot.fault(f"{model}:unplug")
            wait_until(lambda: read() == () and said[-1].startswith("down"), lambda: said[-1])
            assert name in said[-1]
            robot.fault(f"{model}:ok")
            wait_until(lambda: read() and said[-1] == "up: ", lambda: said[-1])
        finally:
            hardware.close()


def test_only_a_device_that_is_there_can_be_in_the_network(tmp_path: Path) -> None:
    body = RobotInWorld(load_world(make_hall(tmp_path)), seed=3)
    with pytest.raises(DeviceError, match="no ld19 to be in the network"):
        EmulatedRobot(["hokuyo_urg"], body, network={"ld19": "tcp:0"})
    with pytest.raises(DeviceError, match="write tcp:PORT"):
        EmulatedRobot(["hokuyo_urg"], body, network={"hokuyo_urg": "tcp:x"})
