"""A Waveshare UGV: an ESP32 that takes and sends JSON, one object a line.

What a board forgets when it boots is told to it on each connection: which robot it sits in, how
often it reports, and that it stops its motors after 0.4 s without a command (3 s as delivered). It
confirms a line by repeating it; nothing is driven until it has repeated those two that say which
robot it is and 0.4 s. Lines of a boot, or silence, take that back.

Newer firmware counts the way of each side (`odl`, `odr`), from which motions are made; older
reports speeds alone, which are integrated. So they are where the way comes in whole centimetres, of
which no speed can be told: firmware that does so reports hundredths of volts, too, by which it is
known. A board without encoders reports its motors' power, up to 255, in place of speeds: it is not
driven.

Counts, below `chassis/`: `stray_lines` (no JSON object, or too long), `bad_messages` (a report that
holds no speeds), `gaps`, `encoder_jumps`, `restarts` (of the board).

Source:
    Waveshare ugv_base_general and ugv_base_ros: json_cmd.h, uart_ctrl.h, movtion_module.h,
    ugv_advance.h; copies of ugv_ws, ugv_bringup.py, which divide ways and voltage by 100.
"""

import math
import re
from typing import Any, Literal

import msgspec
from msgspec import Struct

from trolley.config.hardware import ChassisConfig, WheelsConfig
from trolley.drivers import API, read_settings
from trolley.geometry import Twist2D
from trolley_base.differential import sides_of, twist_of
from trolley_base.drivers.boards.battery import BatteryGauge
from trolley_base.drivers.boards.command_pace import CommandPace
from trolley_base.drivers.boards.last_heard import LastHeard
from trolley_base.drivers.boards.models import (
    SETTINGS,
    Answer,
    BoardDriver,
    BoardFacts,
    BoardQuestion,
)
from trolley_base.drivers.boards.report import Report
from trolley_base.drivers.boards.velocities import VelocityIntegrator
from trolley_base.drivers.boards.wheel_ticks import MOST_SPEED, StreamedOdometry
from trolley_base.drivers.dialogue import Line, Status, travel_ns
from trolley_base.drivers.interface import ChassisReading

UgvType = Literal["ugv_rover", "ugv_beast"]
UGV_TRACKS_M: dict[UgvType, float] = {"ugv_rover": 0.172, "ugv_beast": 0.141}
"""The tracks that the firmware counts with."""
MAIN_TYPES: dict[UgvType, int] = {"ugv_rover": 2, "ugv_beast": 3}
"""How the firmware numbers the robots."""
WATCHDOG_MS = 400
REPORT_MS = 40
"""Extra pause between two reports: the newest firmware's 350 bytes take 30 ms of the line."""
REPORT_NS = REPORT_MS * 1_000_000
CONFIRMS_WITHIN_NS = 3_000_000_000
SET_UP_EVERY_NS = 1_000_000_000
"""A board that has not confirmed is told again; one that has is told its watchdog again."""
FASTEST_SIDE = 2.0
"""The board ignores a command beyond this, to either side [m/s]."""
LONGEST_LINE = 2048
COUNTS_PER_M = 1e6
"""The way of a side is counted in micrometres."""
MOST_BATTERY_V = 32.0
"""Its three cells have 9 to 12.6 V, and what measures them (INA219) ends here: more than this are
hundredths [V]."""
MOST_NUMBER = 1e6
"""Nothing that it reports is larger; a way of a thousand kilometres is none."""

STOP = b'{"T":1,"L":0.0,"R":0.0}\n'
BOOT = re.compile(rb"rst:0x|ets [A-Z]|Initialize |UGV started|WiFi init|Device connected")
"""Lines of a board that boots; they may begin with a line that was cut."""

NO_ENCODERS = (
    "The motor board reports its motors' power in place of speeds: this robot has no encoders, or "
    "its firmware drives without them, and Trolley cannot know how fast it is. The robot does not "
    "drive; flash ugv_base_ros if it has encoders."
)
UNCONFIRMED = (
    "The motor board does not confirm which robot it is in and that it stops by itself after "
    "0.4 s, so the robot does not drive. If this stays so, flash Waveshare's newest firmware."
)


def line_of(**fields: float) -> bytes:
    """Return a command."""
    return msgspec.json.encode(fields) + b"\n"


WATCHDOG = line_of(T=136, cmd=WATCHDOG_MS)
REPORT, SPEED_KEYS, WAY_KEYS = 1001, ("L", "R"), ("odl", "odr")


class WaveshareUgvSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The robot that a `waveshare_ugv` board sits in."""

    type: UgvType
    """Which robot it is; sent to the board on each connection, since its wheels and the direction
    of its motors differ. The tracked UGV Beast was sold as UGV01 as well."""


class SetUp:
    """What the board is told again and again, and whether it has confirmed what matters.

    Args:
        robot: which robot the board sits in.
    """

    def __init__(self, robot: UgvType) -> None:
        self._type_line = line_of(T=900, main=MAIN_TYPES[robot], module=0)
        self.begin()

    def begin(self) -> None:
        """Tell the board everything: the port has been opened."""
        self._told_ns: int | None = None
        self.forget()

    def forget(self) -> None:
        """What the board was told is not known to hold any more."""
        self.expect()
        self._asked_since_ns: int | None = None

    def expect(self) -> None:
        """Wait until the board confirms it all once more."""
        self._unconfirmed = {WATCHDOG, self._type_line}

    @property
    def is_confirmed(self) -> bool:
        """Whether it has repeated which robot it is in, and when it stops by itself."""
        return not self._unconfirmed

    def take(self, line: bytes) -> bool:
        """Take a line that the board repeats; returns whether it confirms something."""
        if self._told_ns is None or line not in self._unconfirmed:
            return False
        self._unconfirmed.remove(line)
        return True

    def is_overdue(self, now_ns: int) -> bool:
        """Whether the board should have confirmed it by now."""
        since_ns = now_ns if self._asked_since_ns is None else self._asked_since_ns
        return now_ns - since_ns > CONFIRMS_WITHIN_NS

    def outgoing(self, now_ns: int) -> bytes:
        """Return what the board is to be told now."""
        if self._told_ns is not None and now_ns - self._told_ns < SET_UP_EVERY_NS:
            return b""
        self._told_ns = now_ns
        if self._asked_since_ns is None:
            self._asked_since_ns = now_ns
        if self.is_confirmed:
            # Not to be repeated: the line is for reports. It ends what a noisy line has begun.
            return b"\n" + line_of(T=143, cmd=0) + WATCHDOG
        return b"".join(
            (
                b"\n",
                line_of(T=605, cmd=1),
                line_of(T=143, cmd=1),
                WATCHDOG,
                self._type_line,
                line_of(T=142, cmd=REPORT_MS),
                line_of(T=131, cmd=1),
            )
        )


class WaveshareUgvDialogue:
    """Talks to the firmware.

    Args:
        robot: which robot the board sits in.
        baud: bits per second.
    """

    def __init__(self, config: ChassisConfig, robot: WaveshareUgvSettings, baud: int) -> None:
        self._baud = baud
        self._report = Report()
        track_m = UGV_TRACKS_M[robot.type]
        self._half_track_m = 0.5 * track_m
        self._setup = SetUp(robot.type)
        # A wheel of one metre around.
        metre = WheelsConfig(
            ticks_per_revolution=COUNTS_PER_M, diameter_m=1.0 / math.pi, track_m=track_m
        )
        self._ways = StreamedOdometry(metre, REPORT_NS, self._report.count)
        self._speeds = VelocityIntegrator(REPORT_NS, self._report.count)
        self._gauge = BatteryGauge(config.inputs)
        self._pace = CommandPace()
        self.begin(0)

    @property
    def line(self) -> Line:
        """How the port is opened."""
        return Line(self._baud)

    def begin(self, now_ns: int) -> None:
        """The port has been opened: set the board up, command nothing."""
        self._partial = b""
        self._wanted = Twist2D.zero()
        self._gauge.reset()
        self._heard = LastHeard(now_ns)
        self._setup.begin()
        self._pace.reset()
        self._is_ugv = self._lacks_encoders = False
        self._ways.reset()
        self._lose()

    def _lose(self) -> None:
        """What the board was told is not known to hold any more."""
        self._setup.forget()
        self._ways.miss()
        self._speeds.reset()

    # What arrives.
    def receive(self, data: bytes, arrived_ns: int) -> None:
        """Take bytes."""
        if not data:
            return
        self._heard.hear(arrived_ns)
        *lines, self._partial = (self._partial + data).split(b"\n")
        following = sum(len(line) + 1 for line in lines) + len(self._partial)
        for line in lines:
            # When the board began to send it.
            late_ns = travel_ns(following, self._baud)
            following -= len(line) + 1
            self._take_line(line.strip(), arrived_ns - late_ns, arrived_ns)
        if len(self._partial) > LONGEST_LINE:
            self._report.count("stray_lines")
            self._partial = b""

    def _take_line(self, line: bytes, left_ns: int, arrived_ns: int) -> None:
        if not line:
            return
        message = parse_line(line)
        if message is None:
            self._report.count("stray_lines")
            self._ways.miss()
            if BOOT.search(line):
                self._ways.reset()
                self._lose()
        elif message.get("T") == REPORT:
            if not self._take_report(message, left_ns, arrived_ns):
                self._report.count("bad_messages")
        elif self._setup.take(line + b"\n"):
            self._is_ugv = True

    def _take_report(self, message: dict[str, Any], left_ns: int, arrived_ns: int) -> bool:
        """Take a report; False if it holds no speeds."""
        speeds = numbers_of(message, SPEED_KEYS)
        if speeds is None:
            return False
        self._is_ugv = True
        self._heard.take_report(arrived_ns)
        voltage, is_coarse = voltage_of(message)
        if voltage is not None:
            self._gauge.take_voltage(voltage, arrived_ns)
        ways = numbers_of(message, WAY_KEYS)
        is_power = ways is None and max(map(abs, speeds)) > MOST_SPEED
        self._lacks_encoders = self._lacks_encoders or is_power
        if self._lacks_encoders or not self._setup.is_confirmed:
            # Reports that were held up come before the confirmation, and together: they would look
            # like haste. The first one after it has the way since the last.
            return True
        if ways is None or is_coarse:
            if max(map(abs, speeds)) > MOST_SPEED:
                return False
            motion = self._speeds.add(twist_of(*speeds, self._half_track_m), left_ns)
        else:
            left, right = (round(way * COUNTS_PER_M) for way in ways)
            motion = self._ways.add(left, right, left_ns)
            if self._ways.wheels.has_jumped:
                self._report.add_jump()
            if self._ways.wheels.has_restarted:
                self._report.count("restarts")
                self._setup.expect()
        if motion is not None:
            self._report.add_motion(motion)
        return True

    # What is sent.
    def drive(self, twist: Twist2D) -> None:
        """Set the wanted velocity; what it says of sideways is left out."""
        self._wanted = Twist2D(twist.vx, 0.0, twist.wz)

    def outgoing(self, now_ns: int) -> bytes:
        """Return a command if one is due, and what the board is to be told."""
        if self._heard.has_reported and not self._heard.is_reporting(now_ns):
            self._lose()
        return self._command(now_ns) + self._setup.outgoing(now_ns)

    def _command(self, now_ns: int) -> bytes:
        """Return a command: stops and starts at once, zeros too, so that its watchdog rests."""
        if not self._is_ugv:
            return b""
        wanted = self._wanted if self._is_usable(now_ns) else Twist2D.zero()
        if not self._pace.is_due(now_ns, stands=wanted.is_zero):
            return b""
        self._pace.note(now_ns, stands=wanted.is_zero)
        if wanted.is_zero:
            return STOP
        left, right = sides_of(wanted, self._half_track_m)
        # Beyond what the board can take: slower on the same arc.
        scale = FASTEST_SIDE / max(abs(left), abs(right), FASTEST_SIDE)
        return line_of(T=1, L=round(scale * left, 4), R=round(scale * right, 4))

    def goodbye(self) -> tuple[bytes, ...]:
        """Stop the wheels, then the reports."""
        return (STOP, line_of(T=131, cmd=0)) if self._is_ugv else ()

    # How it goes.
    def _is_usable(self, now_ns: int) -> bool:
        if not self._setup.is_confirmed or self._lacks_encoders:
            return False
        return self._heard.is_reporting(now_ns)

    def status(self, now_ns: int) -> Status:
        """Say how it goes."""
        if self._heard.is_silent(now_ns):
            return Status(
                "down",
                "The motor board is silent. Is the robot switched on, and is this its port?",
                reopen=True,
            )
        if self._lacks_encoders:
            return Status("down", NO_ENCODERS)
        if self._is_usable(now_ns):
            return Status("up")
        if self._heard.is_reporting(now_ns) and self._setup.is_overdue(now_ns):
            return Status("down", UNCONFIRMED)
        if self._is_ugv and not self._heard.is_reporting(now_ns):
            return Status("down", "The motor board has stopped reporting; it is set up again.")
        if self._heard.has_bytes and not self._is_ugv:
            return Status(
                "searching",
                "What arrives is not a Waveshare UGV's: is this the motor board's port, and is "
                f"{self._baud} its baud rate? A board that boots needs a few seconds.",
            )
        return Status("searching", "The motor board is being set up.")

    def take(self, now_ns: int) -> ChassisReading:
        """Hand over what was reported."""
        return self._report.take(self.status(now_ns), self._gauge.alarms(), self._gauge.battery)


def parse_line(line: bytes) -> dict[str, Any] | None:
    """Return the object in a line, None if it holds none."""
    try:
        return msgspec.json.decode(line, type=dict[str, Any])
    except (msgspec.DecodeError, UnicodeDecodeError):
        return None


def number_of(message: dict[str, Any], key: str) -> float | None:
    """Return a number of a message; None if it is not there, or none that a robot reports."""
    value = message.get(key)
    is_number = isinstance(value, float | int) and not isinstance(value, bool)
    return float(value) if is_number and abs(value) <= MOST_NUMBER else None


def numbers_of(message: dict[str, Any], keys: tuple[str, str]) -> tuple[float, float] | None:
    """Return two numbers of a message, None if they are not there."""
    left, right = (number_of(message, key) for key in keys)
    return None if left is None or right is None else (left, right)


def voltage_of(message: dict[str, Any]) -> tuple[float | None, bool]:
    """Return the battery's voltage [V], and whether the board reports in hundredths."""
    told = number_of(message, "v")
    if told is None or told < 0.0:
        return None, False
    is_coarse = told > MOST_BATTERY_V
    return (0.01 * told if is_coarse else told), is_coarse


def recognise(data: bytes) -> Answer | None:
    """Find a report."""
    for line in data.split(b"\n")[:-1]:
        message = parse_line(line)
        if message is None or message.get("T") != REPORT or not numbers_of(message, SPEED_KEYS):
            continue
        voltage, _ = voltage_of(message)
        return Answer(() if voltage is None else (f"battery at {voltage:.1f} V",))
    return None


def _settings(config: ChassisConfig) -> WaveshareUgvSettings:
    return read_settings(config.settings, WaveshareUgvSettings, SETTINGS)


DRIVERS = {
    "waveshare_ugv": BoardDriver(
        BoardFacts("Waveshare UGV (ESP32)", 115200, WATCHDOG_MS * 1e-3),
        lambda config, baud, _: WaveshareUgvDialogue(config, _settings(config), baud),
        # An empty line ends what other questions have left in its buffer.
        (BoardQuestion(115200, (b'\n{"T":130}\n',), recognise),),
        track_m=lambda config: UGV_TRACKS_M[_settings(config).type],
        api=API,
        page="waveshare-ugv.md",
        settings=WaveshareUgvSettings,
        example={"settings": {"type": "ugv_rover"}},
        emulator="trolley_base.emulators.waveshare_ugv:BOARDS",
    )
}
