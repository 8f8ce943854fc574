"""`trolley teleop` on a real terminal, with a real base in a simulated room."""

import math
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from support.processes import Process, write_config
from support.terminals import Terminal, trolley
from support.waiting import wait_until

from trolley import topics
from trolley.client import Robot
from trolley.geometry import Twist2D

ENTER_KITTY, LEAVE_KITTY = "\x1b[>31u", "\x1b[<u"
UP, UP_REPEAT, UP_RELEASE = "\x1b[A", "\x1b[1;1:2A", "\x1b[1;1:3A"
A, A_RELEASE = "\x1b[97;1:1;97u", "\x1b[97;1:3u"
STANDS_WITHIN_S = 1.5
"""Valid time, braking and a loaded machine; what it must beat is driving on for ever."""


class Room:
    """A base in the simulated room, and what it really does."""

    def __init__(self, folder: Path, endpoint: str) -> None:
        config = write_config(
            folder / "robot.toml",
            endpoint,
            more='[map]\nfile = "room"\n[base.simulated]\nworld = "room.toml"\n',
        )
        self.config = config
        self.state = folder / "base-state"
        self.endpoint = endpoint
        self._log = folder / "base.log"
        self.base = self.start_base()
        self.robot = Robot("tester", endpoint)
        self._truth = self.robot.subscribe(topics.SIM_TRUTH)
        self._newest: Twist2D | None = None
        wait_until(lambda: self.robot.now_ns() is not None, 90.0, f"base runs: {self.base.log}")

    def start_base(self) -> Process:
        self.base = Process(
            ["-m", "trolley_base", "--config", str(self.config)],
            self._log,
            {"TROLLEY_STATE": str(self.state)},
        )
        return self.base

    def twist(self) -> Twist2D:
        """How the robot really moves."""
        while (arrival := self._truth.next(0.0)) is not None:
            self._newest = arrival.message.twist
        assert self._newest is not None
        return self._newest

    def wait_for(self, happened: Callable[[Twist2D], bool], what: str, seconds: float = 30.0):
        wait_until(lambda: self._has_truth() and happened(self.twist()), seconds, what)

    def wait_until_it_stands(self, seconds: float = STANDS_WITHIN_S) -> None:
        self.wait_for(stands, "it stands", seconds)

    def _has_truth(self) -> bool:
        if self._newest is None:
            first = self._truth.next(1.0)
            self._newest = None if first is None else first.message.twist
        return self._newest is not None

    def end(self) -> None:
        self.robot.close()
        self.base.kill()


def stands(twist: Twist2D) -> bool:
    return twist.speed < 0.01 and abs(twist.wz) < 0.02


@pytest.fixture
def room(tmp_path: Path, endpoint: str) -> Iterator[Room]:
    room = Room(tmp_path, endpoint)
    yield room
    room.end()


@pytest.fixture
def teleop(room: Room, tmp_path: Path) -> Iterator[Callable[..., Terminal]]:
    opened: list[Terminal] = []

    def open_it(*arguments: str, **options: bool) -> Terminal:
        where = ["--connect", room.endpoint, "--robot", "tester"]
        environment = {"TROLLEY_STATE": str(tmp_path / "cli-state")}
        terminal = Terminal(trolley("teleop", *where, *arguments), environment, **options)  # type: ignore[arg-type]
        opened.append(terminal)
        terminal.wait_for("Ready.")
        return terminal

    yield open_it
    for terminal in opened:
        terminal.end()


class Repeating:
    """A held key of a terminal that repeats characters, as X11 does."""

    def __init__(self, terminal: Terminal, text: str) -> None:
        self._terminal, self._text = terminal, text
        self._released = threading.Event()
        self._thread = threading.Thread(target=self._repeat)
        self._thread.start()

    def release(self) -> None:
        self._released.set()
        self._thread.join()

    def _repeat(self) -> None:
        self._terminal.type(self._text)
        wait_s = 0.4
        while not self._released.wait(wait_s):
            self._terminal.type(self._text)
            wait_s = 0.04


def test_drives_while_a_key_is_held_and_is_silent_after(
    room: Room, teleop: Callable[..., Terminal]
) -> None:
    terminal = teleop(tells_releases=True)
    terminal.type(UP)
    room.wait_for(lambda twist: twist.vx > 0.2, "it drives")
    assert room.twist().vx < 0.27
    terminal.wait_for("Forward 0.25 m/s")
    terminal.type(A)
    room.wait_for(lambda twist: twist.vx > 0.2 and twist.wz > 0.5, "it drives a curve")
    terminal.type(A_RELEASE)
    room.wait_for(lambda twist: twist.vx > 0.2 and abs(twist.wz) < 0.05, "straight on")
    terminal.type(UP_RELEASE)
    room.wait_until_it_stands()
    # Zero for a moment, then silence: a lower source may have the robot back.
    wait_until(lambda: source(room) is None, 10.0, "teleop gives the robot back")
    with room.robot.subscribe(topics.COMMAND, "teleop") as commands:
        assert commands.next(0.5) is None
    terminal.type("\x1b[120;1:1;120u")
    assert terminal.wait() == 0
    assert terminal.is_as_found
    assert LEAVE_KITTY in terminal.output


def source(room: Room) -> str | None:
    base = room.robot.latest(topics.BASE)
    return None if base is None else base.source


def test_a_terminal_that_only_repeats_drives_too(
    room: Room, teleop: Callable[..., Terminal]
) -> None:
    terminal = teleop("--speed", "0.15")
    held = Repeating(terminal, "w")
    room.wait_for(lambda twist: 0.12 < twist.vx < 0.17, "it drives at the speed asked for")
    time.sleep(1.0)  # past the initial delay: it does not stop in between
    assert room.twist().vx > 0.12
    held.release()
    room.wait_until_it_stands()


def test_speed_is_at_most_the_robots(room: Room, teleop: Callable[..., Terminal]) -> None:
    about = room.robot.latest(topics.ROBOT)
    assert about is not None
    terminal = teleop("--turn", "50", tells_releases=True)
    with room.robot.subscribe(topics.COMMAND, "teleop") as commands:
        terminal.type(A)
        arrival = commands.next(30.0)
    assert arrival is not None
    assert arrival.message.twist == Twist2D(0.0, 0.0, about.max_wz)
    assert 0.0 < arrival.message.valid_for <= 0.3


def drive_until(terminal: Terminal, text: str) -> None:
    """Hold a key until something is said.

    A terminal that answers late, as on a loaded machine, looks like a broken connection: the robot
    is let go of, and waits for the key to be pressed anew.
    """
    pressed_s = -math.inf

    def is_said() -> bool:
        nonlocal pressed_s
        if terminal.last_line == "Ready." and time.monotonic() > pressed_s + 2.0:
            terminal.type(UP_RELEASE + UP)
            pressed_s = time.monotonic()
        return text in terminal.output

    wait_until(is_said, 60.0, f"{text!r} in {terminal.output!r}")


def test_says_what_keeps_it_from_driving(room: Room, teleop: Callable[..., Terminal]) -> None:
    terminal = teleop("--speed", "0.5", tells_releases=True)
    drive_until(terminal, "Held: Something is too close in the direction of travel.")
    room.wait_until_it_stands(20.0)  # however slowly it creeps up: what counts is the gap
    truth = room.robot.latest(topics.SIM_TRUTH)
    assert truth is not None
    assert truth.collisions == 0
    assert truth.clearance > 0.0


@pytest.mark.parametrize("way", ["killed", "closed", "frozen", "unreachable"])
def test_stands_where_the_keys_are_lost(
    room: Room, teleop: Callable[..., Terminal], way: str
) -> None:
    terminal = teleop(tells_releases=True)
    terminal.type(UP)
    room.wait_for(lambda twist: twist.vx > 0.2, "it drives")
    if way == "killed":
        terminal.send(signal.SIGKILL)
    elif way == "closed":
        terminal.hang_up()
    elif way == "frozen":
        terminal.send(signal.SIGSTOP)
    else:
        terminal.is_reachable = False  # an SSH connection that hangs: no release comes
    room.wait_until_it_stands()
    if way == "closed":
        assert terminal.wait() != 0
    if way == "unreachable":
        terminal.is_reachable = True
        terminal.type(UP_REPEAT)  # still held, but it was let go for safety
        time.sleep(0.5)
        assert stands(room.twist())
        terminal.type(UP)
        room.wait_for(lambda twist: twist.vx > 0.2, "it drives again")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_gives_the_terminal_back_whatever_ends_it(
    room: Room, teleop: Callable[..., Terminal], number: signal.Signals
) -> None:
    terminal = teleop(tells_releases=True)
    assert not terminal.is_as_found
    terminal.type(UP)
    room.wait_for(lambda twist: twist.vx > 0.1, "it drives")
    terminal.send(number)
    assert terminal.wait() == 128 + number
    assert terminal.is_as_found
    room.wait_until_it_stands()


def test_stop_is_latched_and_resume_lifts_it(room: Room, teleop: Callable[..., Terminal]) -> None:
    terminal = teleop()
    terminal.type("p")
    terminal.wait_for("Stopped:")
    held = Repeating(terminal, "w")
    time.sleep(0.7)
    held.release()
    assert stands(room.twist())
    terminal.type("r")
    wait_until(lambda: terminal.last_line == "Ready.", 30.0, "it is resumed")
    held = Repeating(terminal, "w")
    room.wait_for(lambda twist: twist.vx > 0.1, "it drives again")
    held.release()


def test_says_that_nobody_is_there_and_does_not_set_off_by_itself(
    room: Room, teleop: Callable[..., Terminal]
) -> None:
    terminal = teleop(tells_releases=True)
    terminal.type(UP)
    room.wait_for(lambda twist: twist.vx > 0.1, "it drives")
    room.base.kill()
    terminal.wait_for("NOT CONNECTED")
    room.start_base()
    wait_until(lambda: terminal.last_line == "Ready.", 90.0, "base is back")
    time.sleep(0.5)
    assert stands(room.twist())
    room.base.kill()
    wait_until(lambda: "NOT CONNECTED" in terminal.last_line, 30.0, "base is gone")
    terminal.type("p\x1b[112;1:1;112u")
    terminal.wait_for("NOT STOPPED")
    terminal.type("\x03")
    assert terminal.wait() == 3
    assert terminal.is_as_found


def test_pauses_for_the_shell_and_goes_on(room: Room, tmp_path: Path) -> None:
    shell = Terminal(
        ["bash", "--norc", "--noprofile", "-i"],
        {"PS1": "shell> ", "TROLLEY_STATE": str(tmp_path / "cli"), "HISTFILE": os.devnull},
    )
    try:
        shell.wait_for("shell> ")
        command = " ".join(trolley("teleop", "--connect", room.endpoint, "--robot", "tester"))
        shell.type(f"{command}\n")
        shell.wait_for("Ready.")
        held = Repeating(shell, "w")
        room.wait_for(lambda twist: twist.vx > 0.1, "it drives")
        held.release()
        shell.type("\x1a")
        shell.wait_for("Stopped  ")  # what bash says of its job
        room.wait_until_it_stands()
        shell.type("echo $((6 * 7))\n")
        shell.wait_for("42")
        before = len(shell.output)
        shell.type("fg\n")
        wait_until(lambda: "Ready." in shell.output[before:], 60.0, "it goes on")
        assert not shell.echoes
        held = Repeating(shell, "w")
        room.wait_for(lambda twist: twist.vx > 0.1, "it drives again")
        held.release()
        shell.type("x")
        wait_until(lambda: shell.output.endswith("shell> "), 60.0, "it has ended")
    finally:
        shell.end()


def test_without_a_terminal_it_says_so(endpoint: str, trolley: Callable) -> None:
    done = trolley("teleop", "--connect", endpoint)
    assert done.returncode == 2
    assert "this is no terminal" in done.stderr
