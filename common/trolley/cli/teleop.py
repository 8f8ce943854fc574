"""`trolley teleop`: drive with the keys of the terminal, as long as they are held."""

import contextlib
import math
import signal
import time
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic, TypeVar

import click
import msgspec

from trolley import codes, topics
from trolley.cli.options import FloatRange, where_options
from trolley.cli.robots import one_robot, reports_errors
from trolley.cli.teleop_keys import ASK_ALIVE, HeldKeys, Key, KeyDecoder, Pace, TerminalReport
from trolley.cli.terminal import Terminal, TerminalGone
from trolley.client import Robot
from trolley.codes import Refused
from trolley.connection import Arrival, RobotUnreachable
from trolley.geometry import Twist2D
from trolley.messages import BaseState
from trolley.sanitize import escape
from trolley.teleop import PERIOD_S, SOURCE, SPEED_MPS, TURN_RADPS, Hand, twist_words
from trolley.topics import Topic

M = TypeVar("M", bound=msgspec.Struct)

LEAVE, STAND, STOP, RESUME = ("x", "escape"), "space", "p", "r"
FASTER, SLOWER = ("+", "="), ("-", "_")
ESCAPE_S = 0.1
"""An Escape that nothing follows for so long was the key."""
ALIVE_PERIOD_S = 0.1
DRIVEN_S = 0.5
"""`cmd_vel` that is older says nothing about now."""

HELP = """\
Hold a key to drive {name}; let go and it stops.
  W, Up    forward      A, Left   turn left      Q  forward and left
  S, Down  back         D, Right  turn right     E  forward and right
{sideways}  Shift  slowly   + -  speed   Space  halt   P  stop   R  resume   X, Esc  quit
"""
SIDEWAYS = "  J, L     sideways\n"
_COLOURS = {"ok": None, "held": "yellow", "stopped": "red", "fault": "red"}


@click.command(name="teleop")
@click.option(
    "--speed",
    type=FloatRange(min=0.0, min_open=True),
    default=SPEED_MPS,
    show_default=True,
    help="Speed in m/s, within the robot's own limit.",
)
@click.option(
    "--turn",
    type=FloatRange(min=0.0, min_open=True),
    default=TURN_RADPS,
    show_default=True,
    help="Turn rate in rad/s, within the robot's own limit.",
)
@where_options
@reports_errors
def teleop_command(speed: float, turn: float) -> None:
    """Drive by hand, with the keys of this terminal (over SSH too).

    The robot moves only while a key is held, and stops if the connection is lost. Whatever it was
    doing on its own is paused.
    """
    terminal = Terminal()
    with one_robot() as robot, ThreadPoolExecutor(1) as aside:
        stop_requests = StopRequests(robot, aside)
        driving = Teleop(robot, terminal, stop_requests, Pace(speed, turn))
        with terminal:
            try:
                driving.run()
            except TerminalGone:
                terminal.ended_by = signal.SIGHUP
            finally:
                driving.stand()
        stop_requests.settle()
        if stop_requests.wants_stop:
            raise RobotUnreachable(f"NOT STOPPED: no connection to base of {robot.name}")
    if terminal.ended_by is not None:
        raise SystemExit(128 + terminal.ended_by)


class Latest(Generic[M]):
    """The newest message of a topic of the robot."""

    def __init__(self, robot: Robot, topic: Topic[M]) -> None:
        self._arrivals = robot.subscribe(topic)
        self._newest: Arrival[M] | None = None

    def message(self, most_age_s: float = math.inf) -> M | None:
        """Return it, None where there is none or it came too long ago."""
        while (arrival := self._arrivals.next(0.0)) is not None:
            self._newest = arrival
        newest = self._newest
        if newest is None or time.monotonic() - newest.arrived_s > most_age_s:
            return None
        return newest.message


class StopRequests:
    """Stop and resume, asked aside: driving does not wait for the answer."""

    def __init__(self, robot: Robot, aside: ThreadPoolExecutor) -> None:
        self._robot = robot
        self._aside = aside
        self._asked: Future[BaseState] | None = None
        self._wants_resume = False
        self.wants_stop = False
        """Whether a stop is not answered yet; it is asked again until it is."""
        self.trouble = ""
        """Why the last wish was not fulfilled, "" if it was."""

    def stop(self) -> None:
        """Stop the robot until it is resumed."""
        self.wants_stop, self._wants_resume = True, False
        self.tick()

    def resume(self) -> None:
        """Let it drive again."""
        self.wants_stop, self._wants_resume, self.trouble = False, True, ""
        self.tick()

    def tick(self) -> None:
        """Take the answer if it is there, and ask what is to be asked next."""
        if self._asked is not None and self._asked.done():
            self.settle()
        if self._asked is None and self.wants_stop:
            self._asked = self._aside.submit(self._robot.stop)
        elif self._asked is None and self._wants_resume:
            self._wants_resume = False
            self._asked = self._aside.submit(self._robot.resume)

    def settle(self) -> None:
        """Wait for the answer to what was asked."""
        if self._asked is None:
            return
        asked, self._asked = self._asked, None
        try:
            state = asked.result()
        except (Refused, RobotUnreachable) as error:
            self.trouble = str(error)
        else:
            self.trouble = ""
            self.wants_stop = self.wants_stop and not state.is_halted


def base_line(base: BaseState | None) -> tuple[str, str | None]:
    """Say how base is, in words and a colour."""
    if base is None:
        return "", None
    text, colour = "Ready.", _COLOURS[base.mode]
    why = base.message or codes.SENTENCES.get(base.reason, base.reason)
    if base.mode == "ok" and base.reason:
        text, colour = why, _COLOURS["held"]
    elif base.mode == "stopped":
        text = "Stopped."
    elif base.mode != "ok":
        text = f"{base.mode.capitalize()}: {why}" if why else f"{base.mode.capitalize()}."
    if base.may_still_move:
        text = base.message
    elif base.is_halted:
        text += " R lets it drive again."
    if base.battery is not None and base.battery.fraction is not None:
        text += f"  Battery {base.battery.fraction:.0%}."
    return text, colour


class Teleop:
    """Keys in, commands out, and two lines that say what comes of it."""

    def __init__(
        self, robot: Robot, terminal: Terminal, stop_requests: StopRequests, pace: Pace
    ) -> None:
        self._robot = robot
        self._terminal = terminal
        self._stop_requests = stop_requests
        self._pace = pace
        self._decoder = KeyDecoder()
        self._keys = HeldKeys()
        self._hand = Hand()
        self._about = Latest(robot, topics.ROBOT)
        self._base = Latest(robot, topics.BASE)
        self._driven = Latest(robot, topics.CMD_VEL)
        self._is_connected = robot.now_ns() is not None
        self._leaves = False
        self._heard_s = self._asked_alive_s = -math.inf

    def run(self) -> None:
        """Drive until a key or a signal ends it.

        Raises:
            TerminalGone: The terminal was closed.
        """
        about = self._about.message()
        sideways = SIDEWAYS if about is not None and about.drive == "mecanum" else ""
        self._terminal.write(HELP.format(name=escape(self._robot.name), sideways=sideways))
        while not self._leaves and self._terminal.ended_by is None:
            self._read_until(time.monotonic() + PERIOD_S)
            if self._terminal.wants_pause:
                self._pause()
            self._drive(time.monotonic())
            self._stop_requests.tick()
            self._show()

    def stand(self) -> None:
        """Say zero as the last word, unless the hand is silent anyway."""
        self._keys.release_all()
        self._send(None)

    # Keys.
    def _read_until(self, until_s: float) -> None:
        """Take what is typed; what came later than asked for waits for the next turn."""
        while not self._leaves and (left_s := until_s - time.monotonic()) > 0.0:
            data = self._terminal.read(left_s)
            now_s = time.monotonic()
            if data:
                self._heard_s = now_s
                self._keys.note_alive(now_s)
                events = self._decoder.feed(data)
            else:
                events = self._decoder.flush() if now_s - self._heard_s > ESCAPE_S else []
            for event in events:
                self._take(event, now_s)

    def _take(self, event: Key | TerminalReport, now_s: float) -> None:
        match event:
            case TerminalReport("has_releases"):
                self._keys.has_releases = True
                self._keys.release_all()
            case TerminalReport("focus_lost"):
                self._keys.release_all()
            case TerminalReport():
                pass
            case Key("c", ctrl=True):
                self._leaves = True
            case Key("z", ctrl=True):
                self._terminal.wants_pause = True
            case Key(ctrl=True):
                pass
            case Key():
                self._keys.take(event, now_s)
                if event.kind in ("typed", "press"):
                    self._obey(event.name)

    def _obey(self, name: str) -> None:
        """Do what a key is for besides driving."""
        if name in LEAVE:
            self._leaves = True
        elif name in (STAND, STOP):
            self._keys.release_all()
            if name == STOP:
                self._stop_requests.stop()
        elif name == RESUME:
            self._stop_requests.resume()
        elif name in SLOWER:
            self._pace.slower()
        elif name in FASTER and (about := self._about.message()) is not None:
            self._pace.faster(about)

    def _pause(self) -> None:
        self.stand()
        self._terminal.pause()
        self._keys.has_releases = False  # it may go on in another terminal

    # The robot.
    def _drive(self, now_s: float) -> None:
        about = self._about.message()
        self._is_connected = about is not None and self._robot.now_ns() is not None
        if about is None or not self._is_connected:
            self._keys.release_all()  # back again, nothing moves before a key is pressed
            return
        held = self._keys.held(now_s)
        wanted = self._pace.twist(held, about, is_slow=self._keys.is_slow)
        self._send(wanted)
        is_due = now_s - self._asked_alive_s > ALIVE_PERIOD_S
        if held and self._keys.has_releases and is_due:
            self._asked_alive_s = now_s
            self._terminal.write(ASK_ALIVE)

    def _send(self, wanted: Twist2D | None) -> None:
        twist = self._hand.step(wanted, time.monotonic_ns())
        if twist is not None:
            with contextlib.suppress(RobotUnreachable):  # `_show` says so
                self._robot.drive(twist)

    # What comes of it.
    def _show(self) -> None:
        about, trouble = self._about.message(), (self._stop_requests.trouble, "red")
        if about is None or not self._is_connected:
            self._terminal.show((f"NOT CONNECTED to base of {self._robot.name}", "red"), trouble)
            return
        base = self._base.message()
        driven = self._driven.message(DRIVEN_S)
        twist = Twist2D.zero() if driven is None else driven.twist
        source = "" if base is None or base.source in (None, SOURCE) else f" ({base.source})"
        speed, turn = self._pace.limits(about)
        motion = f"{twist_words(twist)}{source}".capitalize()
        line = f"{motion:<46}  keys: {speed:.2f} m/s, {turn:.2f} rad/s"
        self._terminal.show(
            (line, None), trouble if self._stop_requests.trouble else base_line(base)
        )
