"""`trolley detect` at the ports of emulated devices."""

import json
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import serial
from support.metal import make_hall
from support.processes import write_config
from support.waiting import PATIENCE_S, wait_until

from trolley.config import load_config
from trolley_base.emulators import EmulatedRobot, RobotInWorld
from trolley_base.emulators.catalogue import LIDARS
from trolley_base.world import STEP_NS
from trolley_base.world.world_file import load_world

Trolley = Callable[..., subprocess.CompletedProcess[str]]

BOARDS_AT_115200 = ("linorobot2", "waveshare_ugv", "create2", "hoverboard")
BAUDS = {
    "linorobot": 57600,
    "rplidar_a1": 115200,
    "rplidar_c1": 460800,
    "ydlidar_x4": 128000,
    "ydlidar_tmini": 230400,
    "lds01": 230400,
    "coin_d4": 230400,
    "hokuyo_urg": 115200,
}

pytestmark = pytest.mark.again("a port is listened to for a moment only")


@contextmanager
def emulated(folder: Path, *devices: str) -> Iterator[EmulatedRobot]:
    body = RobotInWorld(load_world(make_hall(folder)), seed=3)
    with EmulatedRobot(devices, body, folder / "ports") as robot:
        yield robot


def detect(trolley: Trolley, *arguments: object) -> dict[str, Any]:
    done = trolley("detect", *map(str, arguments), "--json")
    assert done.returncode in (0, 1), done.stderr
    report = json.loads(done.stdout)
    assert (done.returncode == 0) == any(port["found"] for port in report["ports"])
    return report


def models(report: dict[str, Any]) -> dict[str, str | None]:
    """The models found, by the last part of their ports' names."""
    return {
        Path(port["port"]).name: port["found"] and port["found"]["model"]
        for port in report["ports"]
    }


def detect_all(trolley: Trolley, robot: EmulatedRobot) -> dict[str, Any]:
    """Detect until each device is found: an emulator that is held up for 0.3 s is not heard."""
    report: dict[str, Any] = {}

    def is_all_found() -> bool:
        report.update(detect(trolley, *robot.ports.values()))
        return models(report) == {name: name for name in robot.devices}

    wait_until(is_all_found, lambda: f"all are found: {report}")
    return report


def wait_for_a_pass(robot: EmulatedRobot) -> None:
    """Until the emulator has come round to what it was told."""
    told_ns = time.monotonic_ns()
    wait_until(lambda: robot.truth().stamp_ns > told_ns + 2 * STEP_NS, "the emulator goes on")


def bytes_in(robot: EmulatedRobot, name: str) -> int:
    """How much a device sends unasked in half a second of the emulator."""
    with serial.Serial(str(robot.ports[name]), BAUDS[name], timeout=0.0) as line:
        opened_ns = time.monotonic_ns()
        wait_until(lambda: robot.truth().stamp_ns > opened_ns + 500_000_000, "the emulator goes on")
        return len(line.read(4096))


def test_recognises_every_device_and_leaves_it_as_it_was(tmp_path: Path, trolley: Trolley) -> None:
    devices = ("linorobot", "rplidar_a1", "ydlidar_x4", "ld19", "xv11", "lds01")
    # Its log lines go on after a session, as the firmware has it.
    with emulated(tmp_path, "linorobot:quiet", *devices[1:]) as robot:
        before = robot.truth().pose
        report = detect_all(trolley, robot)
        assert all(not port["problems"] for port in report["ports"])
        assert robot.truth().pose == before
        assert robot.commands() == ()
        with serial.Serial(str(robot.ports["lds01"]), BAUDS["lds01"], timeout=PATIENCE_S) as line:
            assert len(line.read(1000)) == 1000, "it streams, as it did before"
        for name in ("linorobot", "rplidar_a1", "ydlidar_x4"):
            assert bytes_in(robot, name) == 0


@pytest.mark.slow
@pytest.mark.parametrize("first", range(3))
def test_recognises_every_lidar_among_the_others(
    tmp_path: Path, trolley: Trolley, first: int
) -> None:
    devices = list(LIDARS)[first::3]  # so many at once that the emulator keeps up
    with emulated(tmp_path, *devices) as robot:
        report = detect(trolley, *robot.ports.values())
        # An LDS02RR sends what an XV11 does, and only a look at its head tells them apart.
        twins = {"lds02rr": "xv11"}
        assert models(report) == {name: twins.get(name, name) for name in devices}
        bauds = {Path(port["port"]).name: port["found"]["baud"] for port in report["ports"]}
        assert bauds == {name: robot.devices[name].baud for name in devices}
        assert report["settings"] == {}  # which of them is the robot's it leaves to the person


@pytest.mark.slow
def test_recognises_every_other_board_and_moves_none(tmp_path: Path, trolley: Trolley) -> None:
    for board in BOARDS_AT_115200:
        with emulated(tmp_path, board, "ld19", "rplidar_a1") as robot:
            before = robot.truth().pose
            report = detect(trolley, *robot.ports.values())
            assert models(report) == {name: name for name in (board, "ld19", "rplidar_a1")}
            assert robot.truth().pose == before
            assert all(one.twist.is_zero for one in robot.commands())
            feels = any(name.startswith("base.scans.") for name in report["settings"])
            assert feels == (board == "create2")


def test_wakes_a_sleeping_lidar_and_lets_it_sleep_again(tmp_path: Path, trolley: Trolley) -> None:
    with emulated(tmp_path, "lds01") as robot:
        port = robot.ports["lds01"]
        with serial.Serial(str(port), 230400) as line:
            line.write(b"e")
            wait_until(lambda: robot.writes("lds01"), "it is told to sleep")
        assert models(detect(trolley, port)) == {"lds01": "lds01"}
        assert bytes_in(robot, "lds01") == 0


def test_takes_lidars_over_that_were_left_streaming(tmp_path: Path, trolley: Trolley) -> None:
    start = {
        "rplidar_a1": b"\xa5\x20",
        "rplidar_c1": bytes.fromhex("a58205010000000023"),
        "ydlidar_x4": b"\xa5\x60",
        "ydlidar_tmini": b"\xa5\x60",
        "coin_d4": bytes.fromhex("aa55f00f"),
        "hokuyo_urg": b"MD0044072501000\n",
    }
    with emulated(tmp_path, *start) as robot:
        for name, command in start.items():
            with serial.Serial(str(robot.ports[name]), BAUDS[name], timeout=PATIENCE_S) as line:
                line.write(command)
                assert line.read(200)
        detect_all(trolley, robot)


def test_says_that_a_sketch_cannot_drive(tmp_path: Path, trolley: Trolley) -> None:
    with emulated(tmp_path, "arduino_bridge:no-base") as robot:
        (port,) = detect(trolley, *robot.ports.values())["ports"]
        assert port["found"]["model"] == "arduino_bridge"
        assert "USE_BASE" in port["problems"][0]
        assert robot.commands() == ()


def test_does_not_propose_a_board_with_other_messages(tmp_path: Path, trolley: Trolley) -> None:
    with emulated(tmp_path, "linorobot") as robot:
        robot.fault("linorobot:md5")
        wait_for_a_pass(robot)
        report = detect(trolley, *robot.ports.values())
        assert models(report) == {"linorobot": None}
        assert "md5" in report["ports"][0]["problems"][0]
        assert report["settings"] == {}


def test_says_why_nothing_was_found(tmp_path: Path, trolley: Trolley) -> None:
    with emulated(tmp_path, "ld19", "xv11") as robot:
        robot.fault("ld19:silence")
        robot.fault("xv11:cut=1")
        wait_for_a_pass(robot)
        gone = tmp_path / "ttyUSB9"
        report = detect(trolley, *robot.ports.values(), gone)
        assert models(report) == {"ld19": None, "xv11": None, "ttyUSB9": None}
        silent, cut, missing = (port["problems"][0] for port in report["ports"])
        assert silent.startswith("Nothing answers: does the device have power")
        assert cut.startswith("Bytes arrive")
        assert "unplugged" in missing


def test_names_the_program_that_has_the_port(tmp_path: Path, trolley: Trolley) -> None:
    with emulated(tmp_path, "ld19") as robot:
        port = robot.ports["ld19"]
        with serial.Serial(str(port), 230400, exclusive=True):
            (seen,) = detect(trolley, port)["ports"]
        assert seen["found"] is None
        assert "is in use by" in seen["problems"][0]


def test_writes_robot_toml_and_a_rule(tmp_path: Path, trolley: Trolley) -> None:
    config = write_config(tmp_path / "robot.toml", "tcp/127.0.0.1:1", "haro", "# the end\n")
    rule = tmp_path / "99-trolley.rules"
    with emulated(tmp_path, "linorobot", "ld19") as robot:
        ports = list(map(str, robot.ports.values()))
        done = trolley("detect", *ports, "--write", str(config), "--udev", str(rule))
        assert done.returncode == 0, done.stderr
        assert '+board = "linorobot"' in done.stdout
        base = load_config(config).base
        assert base.driver == "hardware"
        assert (base.chassis.port, base.lidar.port) == tuple(ports)
        assert "# the end" in config.read_text()
        assert "udevadm control --reload" in rule.read_text()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--write"], "make one first"),
        (["--write", "missing.toml"], "trolley init missing.toml"),
        (["--write", "/dev/ttyUSB0"], "/dev/ttyUSB0 is not a *.toml file"),
        (["--udev", "/tmp/ports/ld19"], "/tmp/ports/ld19 is not a *.rules file"),
    ],
)
def test_refuses_before_it_looks(
    trolley: Trolley, monkeypatch: pytest.MonkeyPatch, arguments: list[str], words: str
) -> None:
    monkeypatch.delenv("TROLLEY_CONFIG", raising=False)
    done = trolley("detect", *arguments)
    assert done.returncode == 2
    assert words in done.stderr
