"""`trolley calibrate` with real services in a simulated room."""

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from support.processes import Process, own_router, write_config
from support.upkeep import save_turned_lidar
from support.waiting import PATIENCE_S, wait_until

from trolley import topics, worlds
from trolley.config import load_config
from trolley.connection import Connection

WORLD = """\
map = "{map}"
start = {{ x = -2.0, y = -1.6, yaw = 0.0 }}
[wheels]
left_scale = 1.05
scale_std = 0.0
turn_scale_std = 0.0
"""
REST = """
[map]
file = "{map}"
[start]
pose = {{ x = -2.0, y = -1.6, yaw = 0.0 }}
[base.simulated]
world = "wrong.toml"
seed = 4
[base.odometry]
track_m = 0.2  # by the ruler
"""
COMMAND = [str(Path(sys.executable).with_name("trolley")), "calibrate"]


@contextmanager
def running_robot(folder: Path) -> Iterator[Path]:
    """Base and localizer run, and know where they are; their robot.toml."""
    room = worlds.find("room.yaml")
    (folder / "wrong.toml").write_text(WORLD.format(map=room))
    environment = {"TROLLEY_STATE": str(folder / "state")}
    with own_router() as endpoint:
        path = write_config(folder / "robot.toml", endpoint, more=REST.format(map=room))
        services = [
            Process(["-m", name, "--config", str(path)], folder / f"{name}.log", environment)
            for name in ("trolley_base", "trolley_localizer")
        ]
        try:
            with connected(path) as connection:
                wait_until(lambda: _is_localized(connection), "the robot is localized")
            yield path
        finally:
            for service in services:
                service.kill()


@contextmanager
def running_base(robot_file: Path) -> Iterator[Process]:
    """Base alone."""
    folder = robot_file.parent
    environment = {"TROLLEY_STATE": str(folder / "state")}
    arguments = ["-m", "trolley_base", "--config", str(robot_file)]
    base = Process(arguments, folder / "base.log", environment)
    try:
        yield base
    finally:
        base.kill()


def connected(robot_file: Path) -> Connection:
    return Connection(load_config(robot_file).zenoh.connect)


def _is_localized(connection: Connection) -> bool:
    pose = connection.latest("tester", topics.POSE)
    return pose is not None and pose.state == "localized"


@pytest.fixture
def robot_file(tmp_path: Path) -> Iterator[Path]:
    with running_robot(tmp_path) as path:
        yield path


@pytest.fixture(scope="module")
def standing_robot_file(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """One robot for all tests that do not drive it."""
    with running_robot(tmp_path_factory.mktemp("robot")) as path:
        yield path


def start(robot_file: Path, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [*COMMAND, *arguments, "--config", str(robot_file)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        stdin=subprocess.PIPE,
        text=True,
        env={**os.environ, "TROLLEY_STATE": str(robot_file.parent / "state")},
    )


@pytest.mark.slow
def test_a_square_finds_the_wheels_and_writes_them_down(robot_file: Path) -> None:
    with start(robot_file, "square", "--side", "0.8", "--runs", "1", "--yes", "--write") as process:
        printed, problem = process.communicate(timeout=2 * PATIENCE_S)
    assert process.returncode == 0, problem
    # A person reads of a clear improvement ...
    before, after = map(float, re.findall(r"E_max,syst (\S+) m", printed))
    assert after < 0.4 * before
    # ... and the file holds what is true.
    odometry = load_config(robot_file).base.odometry
    mean = 0.5 * (1.0 + 1.0 / 1.05)
    assert odometry.wheel_ratio == pytest.approx(1.05, abs=0.01)
    assert odometry.linear_scale == pytest.approx(mean, abs=0.02)  # a single small square
    assert odometry.angular_scale == pytest.approx(mean, abs=0.015)
    assert "# by the ruler" in robot_file.read_text()


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGKILL, -9)])
def test_a_calibration_that_is_broken_off_leaves_the_robot_standing(
    robot_file: Path, number: signal.Signals, code: int
) -> None:
    with connected(robot_file) as connection:

        def speed() -> float:
            truth = connection.latest("tester", topics.SIM_TRUTH)
            return 0.0 if truth is None else abs(truth.twist.vx) + abs(truth.twist.wz)

        with start(robot_file, "square", "--side", "0.8", "--yes") as process:
            wait_until(lambda: speed() > 0.1, "the robot drives")
            process.send_signal(number)
            process.communicate(timeout=PATIENCE_S)
        assert process.returncode == code
        wait_until(lambda: speed() < 0.001, "the robot stands")


def test_where_there_is_no_room_nothing_is_driven(standing_robot_file: Path) -> None:
    with start(standing_robot_file, "square", "--side", "5.0", "--yes") as process:
        _, problem = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 1
    assert "Something is in the way" in problem


@pytest.mark.parametrize("command", ["square", "compare"])
def test_scales_that_base_does_not_use_yet_are_not_corrected(
    standing_robot_file: Path, tmp_path: Path, command: str
) -> None:
    """Written by a calibration, after which base was not restarted: they were corrected twice."""
    written = tmp_path / "robot.toml"
    text = standing_robot_file.read_text().replace(
        "[base.odometry]", "[base.odometry]\nlinear_scale = 0.95"
    )
    written.write_text(text.replace('"wrong.toml"', f'"{standing_robot_file.parent}/wrong.toml"'))
    with start(written, command, "--write") as process:
        _, problem = process.communicate("n\n", timeout=PATIENCE_S)
    assert process.returncode == 2
    assert "restart base" in problem


def test_nothing_is_driven_before_somebody_says_yes(standing_robot_file: Path) -> None:
    with start(standing_robot_file, "square", "--side", "0.8") as process:
        printed, _ = process.communicate("n\n", timeout=PATIENCE_S)
    assert process.returncode != 0
    assert "2 squares" not in printed
    assert "6 squares of 0.8 m" in printed


def test_a_pc_whose_file_has_no_robot_calibrates_too(
    standing_robot_file: Path, tmp_path: Path
) -> None:
    pc_file = tmp_path / "robot.toml"
    pc_file.write_text(f"[zenoh]\nconnect = {load_config(standing_robot_file).zenoh.connect}\n")
    with start(pc_file, "square", "--side", "0.8") as process:
        printed, _ = process.communicate("n\n", timeout=PATIENCE_S)
    assert "6 squares of 0.8 m" in printed


def run(robot_file: Path, *arguments: str) -> str:
    with start(robot_file, *arguments) as process:
        printed, problem = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, problem
    return printed


def test_what_is_accepted_counts_once_base_is_restarted(tmp_path: Path) -> None:
    room = worlds.find("room.yaml")
    (tmp_path / "wrong.toml").write_text(WORLD.format(map=room))
    with own_router() as endpoint:
        path = write_config(tmp_path / "robot.toml", endpoint, more=REST.format(map=room))
        name = load_config(path).robot.name
        save_turned_lidar(load_config(path), tmp_path / "state" / name, 0.05)

        def lidar_yaw() -> float | None:
            with connected(path) as connection:
                laser = connection.latest("tester", topics.TF, "laser")
                return None if laser is None else round(laser.pose.yaw, 3)

        with running_base(path) as base:
            wait_until(lambda: lidar_yaw() == 0.0, "base uses what the file says")
            assert "turned by 2.9°" in run(path, "proposed")
            printed = run(path, "proposed", "--accept", "lidar")
            assert "Restart base for it to take effect" in printed
            # It has said the truth: nothing has changed so far.
            assert lidar_yaw() == 0.0
            assert "turned by 2.9°" in run(path, "proposed")
            assert base.terminate() == 0
        assert "# by the ruler" in path.read_text()
        with running_base(path):
            wait_until(lambda: lidar_yaw() == 0.05, "base uses what was accepted")
            assert "Nothing is proposed" in run(path, "proposed")


def test_what_is_dismissed_is_no_longer_listed(tmp_path: Path) -> None:
    room = worlds.find("room.yaml")
    (tmp_path / "wrong.toml").write_text(WORLD.format(map=room))
    with own_router() as endpoint:
        path = write_config(tmp_path / "robot.toml", endpoint, more=REST.format(map=room))
        name = load_config(path).robot.name
        save_turned_lidar(load_config(path), tmp_path / "state" / name, 0.05)
        before = path.read_text()
        with running_base(path), connected(path) as connection:
            wait_until(
                lambda: connection.latest("tester", topics.PROPOSALS) is not None, "base proposes"
            )
            assert "lidar will not be proposed again" in run(path, "proposed", "--dismiss", "lidar")
            assert "Nothing is proposed" in run(path, "proposed")
        assert path.read_text() == before
