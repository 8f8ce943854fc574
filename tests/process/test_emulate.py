"""`trolley emulate` as a process: its ports, its bytes, its faults, its truth, its end."""

import os
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import pytest
import serial
from support.processes import write_config
from support.waiting import PATIENCE_S, wait_until

from trolley import topics
from trolley.config import load_config
from trolley.connection import Connection
from trolley.messages import Clock
from trolley.runtime import codec
from trolley.supervision import PARENT_VARIABLE

TOPICS_PLEASE = bytes.fromhex("fffe0000ff0000ff")
TROLLEY = str(Path(sys.executable).with_name("trolley"))


class Emulator:
    """The running command; its output goes to a file, faults can be typed."""

    def __init__(self, process: subprocess.Popen[bytes], log: Path, ports: Path) -> None:
        self.process = process
        self.ports = ports
        self._log = log

    @property
    def log(self) -> str:
        return self._log.read_text(encoding="utf-8")

    def wait_for(self, text: str) -> None:
        def said() -> bool:
            assert self.process.poll() is None or text in self.log, self.log
            return text in self.log

        wait_until(said, lambda: f"{text!r} in the output")

    def type(self, line: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{line}\n".encode())
        self.process.stdin.flush()


@pytest.fixture
def emulate(tmp_path: Path) -> Callable[..., AbstractContextManager["Emulator"]]:
    @contextmanager
    def run(*arguments: str) -> Iterator[Emulator]:
        ports, log = tmp_path / "ports", tmp_path / "emulate.log"
        environment = {**os.environ, "TROLLEY_CONFIG": "", "PYTHONUNBUFFERED": "1"}
        with (
            log.open("wb") as output,
            subprocess.Popen(
                [TROLLEY, "emulate", *arguments, "--ports", str(ports)],
                stdin=subprocess.PIPE,
                stdout=output,
                stderr=output,
                env=environment,
            ) as process,
        ):
            emulator = Emulator(process, log, ports)
            try:
                emulator.wait_for("Ctrl-C ends it")
                yield emulator
            finally:
                process.kill()

    return run


def read_some(port: serial.Serial, count: int) -> bytes:
    data = b""

    def enough() -> bool:
        nonlocal data
        data += port.read(4096)
        return len(data) >= count

    wait_until(enough, lambda: f"{count} bytes")
    return data


def crc8(data: bytes) -> int:
    value = 0
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = ((value << 1) ^ (0x4D if value & 0x80 else 0)) & 0xFF
    return value


def test_a_host_negotiates_reads_and_sees_faults(emulate):
    with emulate("linorobot", "ld19", "--world", "room", "--fault", "ld19:noise=1@600") as one:
        board = serial.Serial(str(one.ports / "linorobot"), 57600, timeout=0.05)
        lidar = serial.Serial(str(one.ports / "ld19"), 230400, timeout=0.05)
        with board, lidar:
            board.write(TOPICS_PLEASE)
            told = read_some(board, 700)
            assert told.startswith(bytes.fromhex("fffe0800f70a000000000000000000f5fffe4d00b20000"))
            for text in (b"raw_vel", b"lino_msgs/Imu", b"geometry_msgs/Twist", b"lino_msgs/PID"):
                assert text in told
            assert b"\xff\xfe\x0c\x00\xf3\x7d\x00" in told

            data = read_some(lidar, 47 * 400)
            # Wherever they begin: a port loses what nobody reads for a second.
            begun = [at for at in range(len(data) - 46) if data[at : at + 2] == b"\x54\x2c"]
            good = [at for at in begun if crc8(data[at : at + 46]) == data[at + 46]]
            assert len(good) > 0.9 * len(data) / 47

            one.type("ld19:silence+3")
            one.type("ld19:whatever")
            wait_until(lambda: not lidar.read(4096), "silence")
            wait_until(lambda: lidar.read(4096), "data again")
        one.wait_for("ld19: silence begins (ld19:silence+3)")
        one.wait_for("ld19: silence ends")
        one.wait_for("there is no fault whatever")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_it_ends_cleanly(emulate, number: signal.Signals):
    with emulate("arduino_bridge", "rplidar_a1", "--world", "room") as one:
        assert sorted(os.listdir(one.ports)) == ["arduino_bridge", "rplidar_a1"]
        one.process.send_signal(number)
        assert one.process.wait() == 0
        assert os.listdir(one.ports) == []
        assert "The devices are gone." in one.log
        assert "Traceback" not in one.log


def test_it_ends_with_the_demo_that_started_it(tmp_path: Path):
    words = [TROLLEY, "emulate", "arduino_bridge", "--ports", str(tmp_path / "ports")]
    # As a child whose supervisor was killed before it came to ask.
    orphan = {**os.environ, PARENT_VARIABLE: "1"}
    done = subprocess.run(words, env=orphan, timeout=PATIENCE_S, check=False)
    assert done.returncode == 0
    assert not (tmp_path / "ports").exists()


def test_it_says_what_a_robot_toml_needs(emulate, tmp_path: Path):
    with emulate("arduino_bridge", "rplidar_a1", "--laser", "0.1,0,3.14") as one:
        log = one.log
    lines = log.splitlines()
    assert lines[0].startswith(f"arduino_bridge  {one.ports}/arduino_bridge -> /dev/pts/")
    assert lines[0].endswith("57600 baud")
    text = log[log.index("[base]") : log.index("Ctrl-C")]
    settings = tomllib.loads(text)["base"]
    assert settings["chassis"]["wheels"]["ticks_per_revolution"] == 1550.0
    base = load_config(write_config(tmp_path / "robot.toml", "tcp/127.0.0.1:7447", more=text)).base
    assert base.driver == "hardware"
    assert base.chassis.board == "arduino_bridge"
    assert base.lidar.model == "rplidar_a1"
    assert base.lidar.pose.as_pose().x == 0.1
    assert base.lidar.port == str(one.ports / "rplidar_a1")


def test_it_publishes_the_truth_in_robot_time(emulate, endpoint: str):
    with (
        emulate("ld19", "--robot", "tester", "--connect", endpoint) as one,
        Connection([endpoint]) as connection,
    ):
        one.wait_for("sim/truth of tester goes to")
        clock = Clock(stamp_ns=5_000_000_000, rate=1.0, epoch=1_000_000_000)
        key, mime = topics.CLOCK.key("tester"), codec.MIME["msgpack"]
        with connection.subscribe("tester", topics.SIM_TRUTH) as truths:
            assert truths.next(0.3) is None  # nobody knows what time it is
            began_ns = time.monotonic_ns()

            def stamped():
                connection.bus.put(key, codec.encode(clock, "msgpack"), mime, topics.CLOCK.qos)
                return truths.next(0.05)

            arrival = wait_until(stamped, "the truth")
            assert arrival is not None
            assert arrival.message.world == "apartment"
            passed_ns = time.monotonic_ns() - began_ns
            assert abs(arrival.message.stamp_ns - clock.stamp_ns) < passed_ns + 100_000_000
            assert arrival.message.pose.x == pytest.approx(0.549)
            assert arrival.message.collisions == 0
        latest = connection.latest("tester", topics.SIM_TRUTH)
        assert latest is not None


def test_without_a_router_it_works_alone(emulate, port: int):
    with emulate("ld19", "--robot", "tester", "--connect", f"tcp/127.0.0.1:{port}") as one:
        one.wait_for("working alone until there is one")
        with serial.Serial(str(one.ports / "ld19"), 230400, timeout=0.05) as lidar:
            assert len(read_some(lidar, 1000)) >= 1000
