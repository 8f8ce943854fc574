"""How `trolley demo` and `trolley up` begin and end."""

import os
import signal
import socket
from collections.abc import Callable
from pathlib import Path

import pytest
from support.demo import Demo
from support.processes import Process, find_free_port, write_config
from support.waiting import PATIENCE_S, wait_until

from trolley import topics, worlds
from trolley.connection import Connection

SERVICES = {"base", "localizer", "mapper", "planner", "tour"}


def is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_a_busy_port_is_refused_with_who_has_it_and_what_to_do(trolley: Callable) -> None:
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen()
        port = server.getsockname()[1]
        done = trolley("demo", "--headless", "--port", str(port))
        assert done.returncode == 2
        for words in (f"port {port} is taken", f"pid {os.getpid()}", "--port"):
            assert words in done.stderr
        busy = ["--port", str(find_free_port()), "--viz-port", str(port)]
        done = trolley("demo", *busy)
        assert done.returncode == 2
        assert "--viz-port" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["--name", "No Name"], "name"),
        (["--recording", "robot.npz"], "does not exist"),
        (["--start", "1,2"], "X,Y,YAW"),
        (["--world", "moon.toml"], "moon.toml"),
        (["--speed", "0"], "--speed"),
        (["--foxglove"], "viewer"),
    ],
)
def test_what_cannot_be_run_is_refused_before_anything_starts(
    trolley: Callable, arguments: list[str], problem: str
) -> None:
    done = trolley("demo", "--headless", "--port", str(find_free_port()), *arguments)
    assert (done.returncode, done.stdout) == (2, "")
    assert problem in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_no_child_outlives_the_demo(tmp_path: Path, number: signal.Signals) -> None:
    demo = Demo(tmp_path, "--headless")
    wait_until(lambda: demo.children().keys() >= SERVICES, "all services run")
    children = demo.children().values()
    with Connection([demo.endpoint], PATIENCE_S) as connection:  # others are connecting still
        wait_until(lambda: connection.services(demo.name), "the first of them serves")
    demo.process.send(number)
    code = demo.process.wait()
    assert code == (-signal.SIGKILL if number == signal.SIGKILL else 0), demo.process.log
    wait_until(lambda: not any(map(is_running, children)), "all children have ended")
    assert "Traceback" not in demo.process.log


@pytest.mark.slow
def test_two_demos_run_side_by_side(tmp_path: Path) -> None:
    demos: list[Demo] = []
    try:
        for name in ("one", "two"):
            (tmp_path / name).mkdir()
            demos.append(Demo(tmp_path / name, "--headless", name=name))
        for demo in demos:
            with demo.client() as robot:
                wait_until(lambda: robot.latest(topics.POSE), f"{demo.name} has a pose")
    finally:
        for demo in demos:
            demo.end()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "services"),
    [([], SERVICES), (["--mqtt", "127.0.0.1:1"], SERVICES | {"mqtt"})],  # nobody answers there
    ids=["plain", "mqtt"],
)
def test_up_runs_all_services_of_a_configuration(
    tmp_path: Path, options: list[str], services: set[str]
) -> None:
    endpoint = f"tcp/127.0.0.1:{find_free_port()}"
    more = f'[map]\nfile = "{worlds.find("apartment.yaml")}"\n'
    config = write_config(tmp_path / "robot.toml", endpoint, "upper", more)
    up = Process(
        ["-m", "trolley.cli", "up", "--no-viz", "--config", str(config), *options],
        tmp_path / "up.log",
        {"TROLLEY_STATE": str(tmp_path / "state")},
    )
    try:
        with Connection([endpoint], PATIENCE_S) as connection:
            wait_until(
                lambda: {service for _, service in connection.services("upper")} == services,
                "all services are alive",
            )
        assert up.terminate() == 0
        assert "All services have stopped." in up.log
    finally:
        up.kill()


@pytest.mark.slow
def test_up_ends_where_a_service_cannot_run(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{find_free_port()}"
    more = '[base]\ndriver = "recording"\n'  # without a file to play
    config = write_config(tmp_path / "robot.toml", endpoint, "upper", more)
    up = Process(["-m", "trolley.cli", "up", "--no-viz", "--config", str(config)], tmp_path / "log")
    try:
        assert up.wait() == 2
        assert "base cannot run with this configuration" in up.log
        assert "[base.recording]" in up.log
    finally:
        up.kill()
