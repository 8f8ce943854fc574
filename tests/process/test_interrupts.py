"""Ctrl-C, or a closed terminal, at any moment of a start: no traceback, and children end first.

The moments are counted in what the program does (its audit events: imports, files, processes), not
in seconds, so they are the same on any machine. They begin with Trolley's own first line: what
Python does before that is beyond any program in it. While services are started the moments are
counted in `socket.bind`: one looks whether the router's port is free, the others are of a socket
for each service, made just before it.
"""

import signal
import tomllib
import uuid
from pathlib import Path

import pytest
from support.processes import Process, find_free_port, write_config
from support.waiting import wait_until

STRIKE = """
import _thread, os, sys
moment, number, counted = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
del sys.argv[1:4]
main, count, is_armed = _thread.get_ident(), 0, False
def strike(event, arguments):
    global count
    if is_armed and event.startswith(counted) and _thread.get_ident() == main:
        count += 1
        if count == moment:
            os.kill(os.getpid(), number)
sys.addaudithook(strike)
"""
COMMAND = f"""{STRIKE}
from trolley.start import command
sys.argv[0] = "trolley"
is_armed = True
command()
"""
SERVICE = f"""{STRIKE}
from trolley.start import service
is_armed = True
service("trolley_tour.service", "TourService")
"""
WHOLE = """
import atexit, sys
from trolley.start import command
atexit.register(print, "Python shuts down")
sys.argv = ["trolley", *sys.argv[1:]]
command()
"""
MARK = "TROLLEY_TEST_MARK"
RUNS = ("Ctrl-C ends", "starting")
"""What a program says when it runs."""


def relatives(mark: str) -> list[int]:
    """The processes that carry a mark in their environment."""
    found: list[int] = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                environment = (folder / "environ").read_bytes()
            except OSError:
                continue
            if f"{MARK}={mark}".encode() in environment.split(b"\0"):
                found.append(int(folder.name))
    return found


def struck(
    folder: Path,
    moment: int,
    number: signal.Signals,
    *arguments: str,
    program: str = COMMAND,
    counted: str = "",
) -> tuple[int, str]:
    """Run a program that is sent a signal at a moment: its exit code and its words.

    The moment is the number of an event. One whose moment does not come gets the signal when it has
    said that it runs; where only events `counted` are, the moment has to come.
    """
    mark = uuid.uuid4().hex
    process = Process(
        ["-c", program, str(moment), str(int(number)), counted, *arguments],
        folder / "struck.log",
        {MARK: mark, "TROLLEY_STATE": str(folder / "state")},
    )
    try:
        if not counted:
            wait_until(
                lambda: not process.is_running or any(word in process.log for word in RUNS),
                "it runs, or has ended",
            )
            if process.is_running:
                process.send(number)
        code = process.wait()
    finally:
        process.kill()  # should it hang
    assert relatives(mark) == [], "its children have ended before it"
    return code, process.log


def ways_to_end(number: signal.Signals) -> set[int]:
    """By the signal itself, as it says to shells, or as asked while all was running."""
    return {-number, 128 + number, 0 if number == signal.SIGINT else 128 + number}


@pytest.fixture
def config(tmp_path: Path) -> Path:
    return write_config(tmp_path / "robot.toml", f"tcp/127.0.0.1:{find_free_port()}")


@pytest.mark.parametrize(
    ("moment", "number"),
    [
        *((moment, signal.SIGINT) for moment in (2, 60, 700, 2100, 3000, 3400, 10**9)),
        *((moment, signal.SIGHUP) for moment in (700, 10**9)),
    ],
)
def test_the_demo_ends_at_any_moment(tmp_path: Path, moment: int, number: signal.Signals) -> None:
    arguments = ("demo", "--headless", "--port", str(find_free_port()))
    code, log = struck(tmp_path, moment, number, *arguments)
    assert code in ways_to_end(number), log
    assert "Traceback" not in log
    assert "Exception ignored" not in log


@pytest.mark.parametrize(
    ("moment", "number"), [(2, signal.SIGINT), (4, signal.SIGHUP), (6, signal.SIGINT)]
)
@pytest.mark.parametrize("command", [("demo", "--headless"), ("up", "--no-viz")])
def test_it_ends_while_it_starts_its_services(
    tmp_path: Path, config: Path, command: tuple[str, ...], moment: int, number: signal.Signals
) -> None:
    rest = ("--config", str(config)) if command[0] == "up" else ("--port", str(find_free_port()))
    code, log = struck(tmp_path, moment, number, *command, *rest, counted="socket.bind")
    assert code in ways_to_end(number), log
    assert "Traceback" not in log
    assert "Exception ignored" not in log


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
@pytest.mark.parametrize("moment", [900, 2500, 10**9])
def test_up_ends_at_any_moment(
    tmp_path: Path, config: Path, moment: int, number: signal.Signals
) -> None:
    code, log = struck(tmp_path, moment, number, "up", "--no-viz", "--config", str(config))
    assert code in ways_to_end(number), log
    assert "Traceback" not in log


@pytest.mark.parametrize("moment", [2, 300, 1500, 2600])
@pytest.mark.parametrize(
    "arguments", [("status", "--connect", "tcp/127.0.0.1:1"), ("run", "tour"), ("map", "--help")]
)
def test_other_commands_end_at_any_moment(
    tmp_path: Path, config: Path, moment: int, arguments: tuple[str, ...]
) -> None:
    if arguments[0] == "run":
        arguments = (*arguments, "--config", str(config))
        if moment > 2500:  # it waits for its router then, which no moment ends
            pytest.skip("covered by the service itself")
    code, log = struck(tmp_path, moment, signal.SIGINT, *arguments)
    assert code in {-signal.SIGINT, 130, 0, 3}, log
    assert "Traceback" not in log


@pytest.mark.parametrize("moment", [2, 200, 800])
def test_a_service_ends_at_any_moment(tmp_path: Path, config: Path, moment: int) -> None:
    arguments = ("--config", str(config))
    code, log = struck(tmp_path, moment, signal.SIGINT, *arguments, program=SERVICE)
    assert code in {-signal.SIGINT, 0}, log
    assert "Traceback" not in log


def test_it_is_the_program_that_people_start() -> None:
    """What `trolley` runs is where the tests above begin."""
    root = Path(__file__).resolve().parents[2]
    project = tomllib.loads((root / "common" / "pyproject.toml").read_text("utf-8"))["project"]
    assert project["scripts"] == {"trolley": "trolley.start:command"}


@pytest.mark.parametrize(("words", "code"), [("--version", 0), ("doctor", 1), ("nonsense", 2)])
def test_a_command_ends_without_a_shutdown_that_threads_of_zenohs_would_abort(
    tmp_path: Path, words: str, code: int
) -> None:
    nobody = ["--connect", f"tcp/127.0.0.1:{find_free_port()}"] if words == "doctor" else []
    process = Process(["-c", WHOLE, words, *nobody], tmp_path / "log")
    assert process.wait() == code
    assert process.log.count("\n") >= 1
    assert "Python shuts down" not in process.log
