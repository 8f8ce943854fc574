"""A device that sends to this computer over UDP: who is heard, and a board that is driven so."""

import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import pytest
from bench.base.lidars.ld19 import ld19_stream
from support.metal import make_hall
from support.processes import find_free_port
from support.waiting import wait_until

from trolley.config import ConfigError, RobotConfig
from trolley.config.hardware import ChassisConfig, LidarConfig
from trolley.geometry import Twist2D
from trolley.network_ports import AddressChangedError, explain_network
from trolley_base.drivers.boards import make_board
from trolley_base.drivers.boards.xrce_frames import FrameDecoder, MessageDatagrams
from trolley_base.drivers.interface import LidarScan
from trolley_base.drivers.lidars import make_lidar
from trolley_base.drivers.network_port import SILENT_S, ListeningPort
from trolley_base.drivers.real_device import RealDevice
from trolley_base.drivers.real_hardware import RealHardware
from trolley_base.emulators import EmulatedRobot, RobotInWorld
from trolley_base.world.world_file import load_world

pytestmark = pytest.mark.drives

PING = bytes.fromhex("80 00 00 00 02 01 08 00 00 0A FF FD 02 00 00 00")
"""Of a board that looks for its agent."""
RUBBISH = (b"", b"\x00", b"M-SEARCH * HTTP/1.1\r\n", bytes(1400), b"\xff" * 64, PING[:7], PING[4:])


@pytest.fixture
def number() -> int:
    return find_free_port()


@pytest.fixture
def caller() -> Iterator[Callable[[], socket.socket]]:
    made: list[socket.socket] = []

    def make() -> socket.socket:
        one = socket.socket(type=socket.SOCK_DGRAM)
        one.bind(("127.0.0.1", 0))
        one.settimeout(5.0)
        made.append(one)
        return one

    yield make
    for one in made:
        one.close()


def say(caller: socket.socket, number: int, *datagrams: bytes) -> None:
    for one in datagrams:
        caller.sendto(one, ("127.0.0.1", number))


def heard(port: ListeningPort) -> list[bytes]:
    """The messages that have come."""
    assert port.wait(5.0)
    return MessageDatagrams().cut(port.read())


def test_messages_go_both_ways_a_datagram_each(
    number: int, caller: Callable[[], socket.socket]
) -> None:
    port, board = ListeningPort(f"udp://:{number}", MessageDatagrams()), caller()
    assert not port.write(b"nobody has called")
    say(board, number, PING, PING)
    time.sleep(0.05)
    assert heard(port) == [PING, PING]
    framed = MessageDatagrams().join(PING)
    assert [one.message for one in FrameDecoder(lambda *_: None).feed(framed)] == [PING]
    assert port.write(framed + framed)
    assert [board.recv(2000), board.recv(2000)] == [PING, PING]
    port.close()
    port.close()


def test_what_is_no_message_is_left_out_and_makes_nobody_the_board(
    number: int, caller: Callable[[], socket.socket]
) -> None:
    port, board, other = ListeningPort(f"udp://:{number}", MessageDatagrams()), caller(), caller()
    say(other, number, *RUBBISH)
    time.sleep(0.05)
    assert heard(port) == []
    assert not port.write(MessageDatagrams().join(PING))
    say(board, number, *RUBBISH, PING)
    time.sleep(0.05)
    assert heard(port) == [PING]
    assert port.take_strangers() == 0
    port.close()


def test_another_sender_is_counted_and_not_heard_while_the_board_is_there(
    number: int, caller: Callable[[], socket.socket]
) -> None:
    port, board, other = ListeningPort(f"udp://:{number}", MessageDatagrams()), caller(), caller()
    say(board, number, PING)  # a moment before the other, however late they are read
    say(other, number, PING, PING)
    time.sleep(0.05)
    assert heard(port) == [PING]
    assert port.take_strangers() == 2
    assert port.write(MessageDatagrams().join(PING))
    assert board.recv(2000) == PING
    other.setblocking(False)
    with pytest.raises(BlockingIOError):
        other.recv(1)
    port.close()


def test_when_it_has_gone_the_next_caller_is_said(
    number: int, caller: Callable[[], socket.socket]
) -> None:
    name = f"udp://:{number}"
    port, board, other = ListeningPort(name, MessageDatagrams()), caller(), caller()
    say(board, number, PING)
    assert heard(port) == [PING]
    time.sleep(SILENT_S + 0.05)
    say(other, number, PING)
    assert port.wait(5.0)
    with pytest.raises(AddressChangedError) as caught:
        port.read()
    told = explain_network(name, caught.value)
    assert f"127.0.0.1:{board.getsockname()[1]} is silent" in told
    assert f"127.0.0.1:{other.getsockname()[1]} calls" in told
    port.close()


def test_a_port_in_use_is_said(number: int) -> None:
    name = f"udp://:{number}"
    port = ListeningPort(name, None)
    with pytest.raises(OSError, match="in use") as caught:
        ListeningPort(name, None)
    assert "another program listens there already" in explain_network(name, caught.value)
    port.close()


def test_a_board_that_calls_is_not_called() -> None:
    def device(port: str) -> RealDevice:
        chassis = {"board": "linorobot2", "port": port}
        base = {"driver": "hardware", "chassis": chassis, "lidar": {"model": "ld19", "port": "x"}}
        robot = {"name": "r", "footprint": {"radius_m": 0.2}}
        return RealDevice(msgspec.convert({"robot": robot, "base": base}, RobotConfig))

    device("udp://:8888")
    device("tcp://10.0.0.5:2000")  # its serial line, through an adapter
    with pytest.raises(ConfigError, match='write port = "udp://:8888"'):
        device("udp://10.0.0.5:8888")


def test_a_lidar_may_be_pushed_in_datagrams(
    number: int, caller: Callable[[], socket.socket]
) -> None:
    """As an ESP32 with linorobot2's firmware passes its LD19's bytes on."""
    name = f"udp://:{number}"
    lidar = make_lidar(LidarConfig(model="ld19", port=name))
    hardware = RealHardware(
        None, (lidar, name), time.monotonic_ns(), lambda ns: ns, lambda call: None, explain_network
    )
    end, esp32 = threading.Event(), caller()

    def push() -> None:
        begun_s = time.monotonic()
        for frame in ld19_stream():
            if end.wait(max(0.0, begun_s + frame.at_s - time.monotonic())):
                return
            say(esp32, number, frame.data[:20], frame.data[20:])

    thread = threading.Thread(target=push)
    thread.start()
    scans: list[LidarScan] = []

    def read() -> bool:
        hardware.advance(time.monotonic_ns())
        scans.extend(hardware.lidar.read().scans)
        return len(scans) >= 3

    try:
        wait_until(read, "scans come")
    finally:
        end.set()
        thread.join()
        hardware.close()
    ahead = scans[-1].ranges[round(-scans[-1].angle_min / scans[-1].angle_increment)]
    assert ahead == pytest.approx(3.0, abs=0.02)


class Host:
    """Base's hardware with a board on UDP, as base's thread uses it: every 10 ms, or when woken."""

    def __init__(self, number: int) -> None:
        self.number = number
        name = f"udp://:{number}"
        board = make_board(ChassisConfig(board="linorobot2", port=name), "differential")
        lidar = make_lidar(LidarConfig(model="ld19", port="/dev/null/none"))
        calls: deque[Callable[[], None]] = deque()
        woken = threading.Event()

        def call_soon(call: Callable[[], None]) -> None:
            calls.append(call)
            woken.set()

        def explain(port: str, error: OSError) -> str:
            return explain_network(port, error)

        now_ns = time.monotonic_ns()
        self.hardware = RealHardware(
            (board, name), (lidar, "/dev/null/none"), now_ns, lambda ns: ns, call_soon, explain
        )
        self.wanted = Twist2D.zero()
        self.counts: dict[str, int] = {}
        self.said: list[str] = []
        self._calls, self._woken = calls, woken
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._end.is_set():
            self._woken.wait(0.01)
            self._woken.clear()
            while self._calls:
                self._calls.popleft()()
            self.hardware.advance(time.monotonic_ns())
            self.hardware.chassis.drive(self.wanted)
            reading = self.hardware.chassis.read()
            for name, count in reading.counts.items():
                self.counts[name] = self.counts.get(name, 0) + count
            line = f"{reading.link.state}: {reading.link.message}"
            if not self.said or self.said[-1] != line:
                self.said.append(line)

    @property
    def is_up(self) -> bool:
        return self.said[-1:] == ["up: "]

    def close(self) -> None:
        self._end.set()
        self._thread.join()
        self.hardware.close()


@contextmanager
def driven(folder: Path, number: int) -> Iterator[tuple[EmulatedRobot, Host]]:
    body = RobotInWorld(load_world(make_hall(folder)), seed=3)
    network = {"linorobot2": f"udp:{number}"}
    with EmulatedRobot(["linorobot2"], body, folder / "ports", network=network) as robot:
        host = Host(number)
        try:
            wait_until(lambda: host.is_up, lambda: str(host.said))
            yield robot, host
        finally:
            host.close()


def drive_a_little(robot: EmulatedRobot, host: Host) -> None:
    host.wanted = Twist2D(0.15, 0.0, 0.0)
    wait_until(lambda: robot.truth().twist.vx > 0.1, lambda: str(host.said))
    host.wanted = Twist2D.zero()
    wait_until(lambda: robot.truth().twist.is_zero, lambda: str(host.said))


def test_a_board_is_driven_over_udp_whoever_else_sends(
    tmp_path: Path, number: int, caller: Callable[[], socket.socket]
) -> None:
    with driven(tmp_path, number) as (robot, host):
        assert robot.addresses["linorobot2"] == f"udp://:{number}"
        drive_a_little(robot, host)
        other = caller()
        end = threading.Event()

        def disturb() -> None:
            while not end.wait(0.01):
                say(other, number, PING, *RUBBISH)

        thread = threading.Thread(target=disturb)
        thread.start()
        try:
            drive_a_little(robot, host)
        finally:
            end.set()
            thread.join()
        assert host.counts["chassis/strangers"] > 0
        assert host.is_up


def test_a_board_that_comes_back_from_another_address_does_not_set_off(
    tmp_path: Path, number: int
) -> None:
    with driven(tmp_path, number) as (robot, host):
        host.wanted = Twist2D(0.15, 0.0, 0.0)
        wait_until(lambda: robot.truth().twist.vx > 0.1, lambda: str(host.said))
        robot.fault("linorobot2:unplug")
        wait_until(lambda: not host.is_up, lambda: str(host.said))
        host.wanted = Twist2D.zero()
        num_before = len(robot.commands())
        robot.fault("linorobot2:ok")
        wait_until(lambda: host.is_up, lambda: str(host.said))
        assert any("calls instead" in line for line in host.said)
        assert all(one.twist.is_zero for one in robot.commands()[num_before:])
        drive_a_little(robot, host)


def test_a_session_that_is_lost_is_opened_again(tmp_path: Path, number: int) -> None:
    with driven(tmp_path, number) as (robot, host):
        robot.fault("linorobot2:silence+1")
        wait_until(lambda: not host.is_up, lambda: str(host.said))
        wait_until(lambda: host.is_up, lambda: str(host.said))
        drive_a_little(robot, host)


def test_who_leaves_has_told_it_to_stand(tmp_path: Path, number: int) -> None:
    with driven(tmp_path, number) as (robot, host):
        host.wanted = Twist2D(0.15, 0.0, 0.0)
        wait_until(lambda: robot.truth().twist.vx > 0.1, lambda: str(host.said))
        host.close()
        assert robot.commands()[-1].twist.is_zero
        wait_until(lambda: robot.truth().twist.is_zero, "it stands")
