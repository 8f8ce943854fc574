"""Devices on real pseudo terminals, their world moved by the clock."""

import math
import os
import struct
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest
import serial
from support.waiting import PATIENCE_S, wait_until

from trolley.geometry import Twist2D
from trolley_base.emulators import DeviceError, EmulatedRobot, FaultError, RobotInWorld
from trolley_base.world.world_file import load_world

from .test_linorobot import TOPICS_PLEASE, twist

pytestmark = pytest.mark.drives

TIME_PLEASE = bytes.fromhex("fffe0800f70a")
"""How a linorobot's answer begins."""
HELD_BACK_S = 1.0
"""What may have waited in buffers, or comes at once after a pause of this machine."""
Make = Callable[..., EmulatedRobot]


@pytest.fixture
def make(worlds: Path) -> Make:
    """Make a robot in the plain room."""
    body = RobotInWorld(load_world(worlds / "room.toml"), seed=7)

    def make(*devices: str, **more) -> EmulatedRobot:
        return EmulatedRobot(devices, body, **more)

    return make


def collect(port: serial.Serial, seconds: float) -> bytes:
    end_s, data = time.monotonic() + seconds, b""
    while time.monotonic() < end_s:
        data += port.read(4096)
    return data


def good_packets(data: bytes) -> int:
    """LD19 packets with the header at both ends, so that none is counted by chance."""
    return sum(
        data[at : at + 2] == b"\x54\x2c" and data[at + 47 : at + 49] == b"\x54\x2c"
        for at in range(len(data))
    )


def test_bytes_come_at_the_devices_pace(make: Make):
    with (
        make("ld19") as robot,
        serial.Serial(str(robot.ports["ld19"]), 230400, timeout=0.02) as port,
    ):
        collect(port, 0.2)
        began_s = time.monotonic()
        data = collect(port, 2.0)
        assert len(data) < 375 * 47 * (time.monotonic() - began_s + HELD_BACK_S)
        # What is not read in time does not fit in the port's buffer, and is counted.
        assert good_packets(data) >= len(data) // 47 - 3 or robot.dropped("ld19") > 0


def test_a_flood_is_no_faster_than_the_line(make: Make):
    with (
        make("xv11") as robot,
        serial.Serial(str(robot.ports["xv11"]), 115200, timeout=0.02) as port,
    ):
        robot.fault("xv11:flood")
        wait_until(lambda: robot.dropped("xv11") > 0, "the line is full")
        began_s = time.monotonic()
        data = collect(port, 1.0)
        assert len(data) < 11520 * (time.monotonic() - began_s + HELD_BACK_S)


def test_the_board_moves_the_robot_and_commands_are_kept(make: Make):
    with (
        make("linorobot") as robot,
        serial.Serial(str(robot.ports["linorobot"]), 57600, timeout=0.02) as port,
    ):
        port.write(TOPICS_PLEASE)
        began_ns = time.monotonic_ns()
        num_sent = 0

        def has_moved() -> bool:
            nonlocal num_sent
            port.write(twist(0.3, 0.0))
            port.read(4096)
            num_sent += 1
            pose = robot.truth().pose
            return math.hypot(pose.x, pose.y) > 0.1

        wait_until(has_moved, "it moves")
        assert robot.truth().stamp_ns > began_ns
        wait_until(lambda: len(robot.commands()) == num_sent, "all commands")
        commands = robot.commands()
        assert commands[0].twist == Twist2D(0.3, 0.0, 0.0)
        assert began_ns < commands[0].at_ns < commands[-1].at_ns < time.monotonic_ns()
        writes = robot.writes("linorobot")
        assert b"".join(data for _, data in writes) == TOPICS_PLEASE + num_sent * twist(0.3, 0.0)
        wait_until(lambda: robot.truth().twist.vx == 0.0, "its watchdog has stopped it")


def test_at_another_speed_both_sides_hear_rubbish(make: Make):
    lines: list[str] = []
    with make("linorobot", "ld19", tell=lines.append) as robot:
        with serial.Serial(str(robot.ports["ld19"]), 115200, timeout=0.02) as port:
            data = bytearray()
            wait_until(lambda: data.extend(port.read(4096)) or len(data) > 1000, "rubbish")
            assert good_packets(bytes(data)) == 0
        with serial.Serial(str(robot.ports["linorobot"]), 115200, timeout=0.3) as port:
            port.write(TOPICS_PLEASE)
            assert port.read(100) == b""
        with serial.Serial(str(robot.ports["linorobot"]), 57600, timeout=0.02) as port:
            port.write(TOPICS_PLEASE)
            data.clear()
            wait_until(lambda: data.extend(port.read(64)) or TIME_PLEASE in data, "an answer")
    assert any("ld19: the host works at 115200 baud, not 230400" in line for line in lines)


def test_the_arduino_reboots_when_its_port_is_opened(make: Make):
    lines: list[str] = []
    with make("arduino_bridge", tell=lines.append) as robot:
        for times in (1, 2):
            began_s = time.monotonic()
            with serial.Serial(str(robot.ports["arduino_bridge"]), 57600, timeout=0.1) as port:
                answer = b""
                while not answer:
                    port.write(b"b\r")
                    answer = port.read(20)
                assert answer.startswith(b"57600\r\n")
                assert time.monotonic() - began_s > 0.7
            wait_until(
                lambda times=times: sum("closed the port" in one for one in lines) == times,
                "it has noticed",
            )


def test_who_opens_a_port_at_once_finds_a_device_that_was_switched_on_before(make: Make):
    with ExitStack() as stack:
        robot = make("create2")
        with robot._lock:  # its world waits meanwhile
            stack.enter_context(robot)
            link = str(robot.ports["create2"])
            port = stack.enter_context(serial.Serial(link, 115200, timeout=0.02))
        assert collect(port, 0.3) == b""


def test_faults_begin_and_end(make: Make):
    lines: list[str] = []
    with make("ld19", tell=lines.append) as robot:
        with serial.Serial(str(robot.ports["ld19"]), 230400, timeout=0.02) as port:
            wait_until(lambda: port.read(4096), "it streams")
            robot.fault("ld19:silence+0.4")
            wait_until(lambda: any("silence ends" in line for line in lines), "its end")
            wait_until(lambda: port.read(4096), "it streams again")
            robot.fault("ld19:silence")
            wait_until(lambda: not port.read(4096), "it is silent")
            robot.fault("ld19:ok")
            robot.fault("ld19:unplug")
            with pytest.raises(serial.SerialException):
                collect(port, PATIENCE_S)
        wait_until(lambda: not robot.ports["ld19"].is_symlink(), "the link is gone")
        robot.fault("ld19:ok")
        wait_until(robot.ports["ld19"].is_symlink, "it is back")
        with serial.Serial(str(robot.ports["ld19"]), 230400, timeout=0.02) as port:
            data = bytearray()
            wait_until(
                lambda: data.extend(port.read(4096)) or good_packets(bytes(data)) > 10, "packets"
            )
        with pytest.raises(FaultError, match="no fault dance"):
            robot.fault("ld19:dance")
    assert [line.split("s  ")[1] for line in lines if "begins" in line or "ends" in line] == [
        "ld19: silence begins (ld19:silence+0.4)",
        "ld19: silence ends",
        "ld19: silence begins (ld19:silence)",
        "ld19: silence ends",
        "ld19: unplug begins (ld19:unplug)",
        "ld19: unplug ends",
    ]


def test_two_of_a_kind_have_two_names_and_everything_is_tidied_up(make: Make, tmp_path: Path):
    folder = tmp_path / "deep" / "ports"
    before = threading.active_count()
    with make("ld19", "ld19", folder=folder) as robot:
        assert sorted(os.listdir(folder)) == ["ld19", "ld19-2"]
        terminals = list(robot.terminals.values())
        assert all(Path(name).exists() for name in terminals)
    assert os.listdir(folder) == []
    assert not any(Path(name).exists() for name in terminals)
    assert threading.active_count() == before


def test_what_there_is_not_is_refused(make: Make):
    for devices, says in {
        ("ld20",): "no device 'ld20'; there are linorobot",
        ("ld19:quiet",): "ld19 has no option quiet; none",
        ("linorobot:loud",): "no option loud; only exact, quiet, no-imu",
        ("linorobot", "arduino_bridge"): "one motor board",
        (): "name a device",
    }.items():
        with pytest.raises(DeviceError, match=says):
            make(*devices)


def test_the_world_keeps_time(make: Make):
    with make("linorobot", "ld19") as robot:
        wait_until(lambda: robot.truth().stamp_ns > time.monotonic_ns() - 10**8, "in time")
        first = robot.truth().stamp_ns
        wait_until(lambda: robot.truth().stamp_ns > first + 5 * 10**8, "it goes on")
        assert robot.truth().stamp_ns <= time.monotonic_ns() + 10_000_000


def test_velocities_arrive_20_times_a_second(make: Make):
    with (
        make("linorobot:quiet,no-imu") as robot,
        serial.Serial(str(robot.ports["linorobot"]), 57600, timeout=0.02) as port,
    ):
        port.write(TOPICS_PLEASE)
        head = b"\xff\xfe\x0c\x00\xf3" + struct.pack("<H", 125)
        data = bytearray()
        wait_until(lambda: data.extend(port.read(4096)) or data.count(head) > 0, "the first")
        began_ns, num_before = robot.truth().stamp_ns, data.count(head)
        wait_until(lambda: data.extend(port.read(4096)) or data.count(head) > 40, "40 of them")
        passed_s = (robot.truth().stamp_ns - began_ns) * 1e-9
        assert data.count(head) - num_before == pytest.approx(20.0 * passed_s, abs=10.0)
