"""`trolley teleop`: drive with the keys of the terminal, as long as they are held."""

import contextlib
import math
import signal
import time
from concurrent.futures import ThreadPoolExecutor

import click

from trolley import topics
from trolley.cli.options import where_options
from trolley.cli.robots import one_robot, reports_errors
from trolley.cli.teleop_base import Latest, Wishes, base_line
from trolley.cli.teleop_keys import ASK_ALIVE, HeldKeys, Key, KeyDecoder, Told
from trolley.cli.teleop_pace import Pace
from trolley.cli.terminal import Terminal, TerminalGone
from trolley.client import Robot
from trolley.connection import RobotUnreachable
from trolley.geometry import Twist2D
from trolley.teleop import PERIOD_S, SOURCE, SPEED_MPS, TURN_RADPS, Hand, twist_words

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
{sideways}  Shift  slowly   + -  speed   Space  stand   P  stop   R  resume   X, Esc  leave
"""
SIDEWAYS = "  J, L     sideways\n"


@click.command(name="teleop")
@click.option(
    "--speed",
    type=click.FloatRange(min=0.0, min_open=True),
    default=SPEED_MPS,
    show_default=True,
    help="Speed in m/s, within the robot's own limit.",
)
@click.option(
    "--turn",
    type=click.FloatRange(min=0.0, min_open=True),
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
        wishes = Wishes(robot, aside)
        driving = Driving(robot, terminal, wishes, Pace(speed, turn))
        with terminal:
            try:
                driving.run()
            except TerminalGone:
                terminal.ended_by = signal.SIGHUP
            finally:
                driving.stand()
        wishes.settle()
        if wishes.wants_stop:
            raise RobotUnreachable(f"NOT STOPPED: no connection to base of {robot.name}")
    if terminal.ended_by is not None:
        raise SystemExit(128 + terminal.ended_by)


class Driving:
    """Keys in, commands out, and two lines that say what comes of it."""

    def __init__(self, robot: Robot, terminal: Terminal, wishes: Wishes, pace: Pace) -> None:
        self._robot = robot
        self._terminal = terminal
        self._wishes = wishes
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
        self._terminal.write(HELP.format(name=self._robot.name, sideways=sideways))
        while not self._leaves and self._terminal.ended_by is None:
            self._read_until(time.monotonic() + PERIOD_S)
            if self._terminal.wants_pause:
                self._pause()
            self._drive(time.monotonic())
            self._wishes.tick()
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
                self._keys.hear(now_s)
                events = self._decoder.feed(data)
            else:
                events = self._decoder.flush() if now_s - self._heard_s > ESCAPE_S else []
            for event in events:
                self._take(event, now_s)

    def _take(self, event: Key | Told, now_s: float) -> None:
        match event:
            case Told("has_releases"):
                self._keys.has_releases = True
                self._keys.release_all()
            case Told("focus_lost"):
                self._keys.release_all()
            case Told():
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
                self._wishes.stop()
        elif name == RESUME:
            self._wishes.resume()
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
        about, trouble = self._about.message(), (self._wishes.trouble, "red")
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
        self._terminal.show((line, None), trouble if self._wishes.trouble else base_line(base))
