"""`trolley teleop` on a real terminal, with a real base in a simulated room."""

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from support.processes import Process, own_router, write_config
from support.standing import HandDriven, stands
from support.terminals import Terminal, trolley
from support.waiting import PATIENCE_S, wait_until

from trolley import topics
from trolley.client import Robot
from trolley.geometry import Twist2D

pytestmark = pytest.mark.again("a terminal that is late has its keys let go of")

ENTER_KITTY, LEAVE_KITTY = "\x1b[>31u", "\x1b[<u"
UP, UP_RELEASE = "\x1b[A", "\x1b[1;1:3A"
A, A_REPEAT, A_RELEASE = "\x1b[97;1:1;97u", "\x1b[97;1:2;97u", "\x1b[97;1:3u"
PRESS_AGAIN_S = 2.0


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
        self.robot = Robot("tester", endpoint, connect_timeout=PATIENCE_S)
        self._driven = HandDriven(self.robot)
        wait_until(lambda: self.robot.now_ns() is not None, lambda: f"base runs: {self.base.log}")

    def start_base(self) -> Process:
        self.base = Process(
            ["-m", "trolley_base", "--config", str(self.config)],
            self._log,
            {"TROLLEY_STATE": str(self.state)},
        )
        return self.base

    def twist(self) -> Twist2D:
        """How the robot really moves."""
        return self._driven.twist()

    def wait_for(self, happened: Callable[[Twist2D], bool], what: str) -> None:
        wait_until(lambda: happened(self.twist()), what)

    def keeps_standing(self) -> bool:
        """Whether it stands for half a second of its own."""
        return self._driven.keeps_standing(0.5)

    def wait_until_it_stands(self) -> None:
        self._driven.wait_until_it_stands()

    def end(self) -> None:
        self.robot.close()
        self.base.kill()


@contextmanager
def open_room(folder: Path) -> Iterator[Room]:
    with own_router() as endpoint:
        room = Room(folder, endpoint)
        yield room
        room.end()


@pytest.fixture(scope="module")
def shared_room(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Room]:
    """The room of all tests that drive no more than a few steps."""
    with open_room(tmp_path_factory.mktemp("room")) as room:
        yield room


@pytest.fixture
def room(shared_room: Room) -> Room:
    shared_room.wait_for(stands, "it stands")
    wait_until(lambda: source(shared_room) is None, "nobody drives it")
    return shared_room


@pytest.fixture
def own_room(tmp_path: Path) -> Iterator[Room]:
    """One for a test that drives to a wall, or breaks something."""
    with open_room(tmp_path) as room:
        yield room


@pytest.fixture
def teleop(tmp_path: Path) -> Iterator[Callable[..., Terminal]]:
    opened: list[Terminal] = []

    def open_it(room: Room, *arguments: str, **options: bool) -> Terminal:
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
        self.num_typed = 0
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
            self.num_typed += 1
            wait_s = 0.04


def test_drives_while_a_key_is_held_and_is_silent_after(
    own_room: Room, teleop: Callable[..., Terminal]
) -> None:
    room = own_room
    terminal = teleop(room, tells_releases=True)
    said = "Forward 0.25 m/s"
    drive_until(terminal, lambda: room.twist().vx > 0.2 and said in terminal.output, said)
    assert room.twist().vx < 0.27
    drive_until(
        terminal, lambda: room.twist().vx > 0.2 and room.twist().wz > 0.5, "a curve", UP + A
    )
    terminal.type(A_RELEASE)
    room.wait_for(lambda twist: abs(twist.wz) < 0.05, "straight on")
    terminal.type(UP_RELEASE)
    room.wait_until_it_stands()
    # Zero for a moment, then silence: a lower source may have the robot back.
    wait_until(lambda: source(room) is None, "teleop gives the robot back")
    with room.robot.subscribe(topics.COMMAND, "teleop") as commands:
        wait_until(lambda: commands.next(0.5) is None, "it is silent")
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
    terminal = teleop(room, "--speed", "0.15")
    held = Repeating(terminal, "w")
    room.wait_for(lambda twist: 0.12 < twist.vx < 0.17, "it drives at the speed asked for")
    wait_until(lambda: held.num_typed > 20, "past the initial delay")
    room.wait_for(lambda twist: 0.12 < twist.vx < 0.17, "it still drives")
    held.release()
    room.wait_until_it_stands()


def test_speed_is_at_most_the_robots(room: Room, teleop: Callable[..., Terminal]) -> None:
    about = room.robot.latest(topics.ROBOT)
    assert about is not None
    terminal = teleop(room, "--turn", "50", tells_releases=True)
    with room.robot.subscribe(topics.COMMAND, "teleop") as commands:
        drive_until(terminal, lambda: room.twist().wz > 0.0, "it turns", A)
        heard = [one.message for one in iter(lambda: commands.next(0.0), None)]
    driven = [command for command in heard if not command.twist.is_zero]
    assert driven
    for command in driven:
        assert command.twist == Twist2D(0.0, 0.0, about.max_wz)
        assert 0.0 < command.valid_for <= 0.3


def drive_until(
    terminal: Terminal, happened: Callable[[], bool], what: str, keys: str = UP
) -> None:
    """Hold keys until something happens.

    A terminal that answers late, as on a loaded machine, looks like a broken connection: the robot
    is let go of, and waits for the keys to be pressed anew.
    """
    terminal.type(keys)
    pressed_s = time.monotonic()

    def has_happened() -> bool:
        nonlocal pressed_s
        if terminal.last_line == "Ready." and time.monotonic() > pressed_s + PRESS_AGAIN_S:
            terminal.type(UP_RELEASE + A_RELEASE + keys)
            pressed_s = time.monotonic()
        return happened()

    wait_until(has_happened, lambda: f"{what}: {terminal.output!r}")


def test_says_what_keeps_it_from_driving(own_room: Room, teleop: Callable[..., Terminal]) -> None:
    room = own_room
    terminal = teleop(room, "--speed", "0.5", tells_releases=True)
    held = "Held: Something is too close in the direction of travel."
    drive_until(terminal, lambda: held in terminal.output, held)
    room.wait_for(stands, "it stands")  # however slowly it creeps up: what counts is the gap
    truth = room.robot.latest(topics.SIM_TRUTH)
    assert truth is not None
    assert truth.collisions == 0
    assert truth.clearance > 0.0


@pytest.mark.parametrize("way", ["killed", "closed", "frozen", "unreachable"])
def test_stands_where_the_keys_are_lost(
    room: Room, teleop: Callable[..., Terminal], way: str
) -> None:
    terminal = teleop(room, tells_releases=True)
    drive_until(terminal, lambda: room.twist().wz > 0.5, "it turns", A)
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
        terminal.type(A_REPEAT)  # still held, but it was let go for safety
        assert room.keeps_standing()
        drive_until(terminal, lambda: room.twist().wz > 0.5, "it turns again", A)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_gives_the_terminal_back_whatever_ends_it(
    room: Room, teleop: Callable[..., Terminal], number: signal.Signals
) -> None:
    terminal = teleop(room, tells_releases=True)
    assert not terminal.is_as_found
    drive_until(terminal, lambda: room.twist().wz > 0.5, "it turns", A)
    terminal.send(number)
    assert terminal.wait() == 128 + number
    assert terminal.is_as_found
    room.wait_until_it_stands()


def test_stop_is_latched_and_resume_lifts_it(room: Room, teleop: Callable[..., Terminal]) -> None:
    terminal = teleop(room)
    terminal.type("p")
    terminal.wait_for("Stopped. R")
    held = Repeating(terminal, "a")
    wait_until(lambda: held.num_typed > 10, "the hand insists")
    held.release()
    assert stands(room.twist())
    terminal.type("r")
    wait_until(lambda: terminal.last_line == "Ready.", "it is resumed")
    held = Repeating(terminal, "a")
    room.wait_for(lambda twist: twist.wz > 0.3, "it drives again")
    held.release()


def test_says_that_nobody_is_there_and_does_not_set_off_by_itself(
    own_room: Room, teleop: Callable[..., Terminal]
) -> None:
    room = own_room
    terminal = teleop(room, tells_releases=True)
    drive_until(terminal, lambda: room.twist().vx > 0.1, "it drives")
    room.base.kill()
    terminal.wait_for("NOT CONNECTED")
    room.start_base()
    wait_until(lambda: terminal.last_line == "Ready.", "base is back")
    assert room.keeps_standing()
    room.base.kill()
    wait_until(lambda: "NOT CONNECTED" in terminal.last_line, "base is gone")
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
        held = Repeating(shell, "a")
        room.wait_for(lambda twist: twist.wz > 0.3, "it drives")
        held.release()
        shell.type("\x1a")
        shell.wait_for("Stopped  ")  # what bash says of its job
        room.wait_until_it_stands()
        shell.type("echo $((6 * 7))\n")
        shell.wait_for("42")
        before = len(shell.output)
        shell.type("fg\n")
        wait_until(lambda: "Ready." in shell.output[before:], "it goes on")
        assert not shell.echoes
        held = Repeating(shell, "a")
        room.wait_for(lambda twist: twist.wz > 0.3, "it drives again")
        held.release()
        shell.type("x")
        wait_until(lambda: shell.output.endswith("shell> "), "it has ended")
    finally:
        shell.end()


def test_without_a_terminal_it_says_so(endpoint: str, trolley: Callable) -> None:
    done = trolley("teleop", "--connect", endpoint)
    assert done.returncode == 2
    assert "this is not a terminal" in done.stderr
