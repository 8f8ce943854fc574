"""A hoverboard's mainboard with the FOC firmware, over its serial cable.

It sends one frame each 10 ms and takes a target for speed and steering, which its firmware mixes:
left = speed + steer / 2, right = speed - steer / 2, in turns per minute where it is built with
SPD_MODE. It makes them safe 0.8 s after the last command. It reports whole turns per minute of each
wheel, no counts, so its odometry is the sum of what was rounded. Stock firmware turns the right
motor the other way round, and reports it so.

Counts, below `chassis/`: `bad_checksum`, `skipped_bytes`, `bad_messages` (speeds that no wheel
has), `gaps`.

Source:
    EFeru hoverboard-firmware-hack-FOC: config.h (VARIANT_USART), main.c, util.c.
"""

import math
import struct
from typing import Annotated, NamedTuple

from msgspec import Meta, Struct

from trolley.config.hardware import ChassisConfig
from trolley.drivers import API, read_settings
from trolley.geometry import Twist2D
from trolley_base.differential import sides_of, twist_of
from trolley_base.drivers.boards.battery import BatteryGauge
from trolley_base.drivers.boards.command_pace import CommandPace
from trolley_base.drivers.boards.fixed_frames import FrameFormat, FrameReader
from trolley_base.drivers.boards.last_heard import LastHeard
from trolley_base.drivers.boards.models import (
    SETTINGS,
    Answer,
    BoardDriver,
    BoardFacts,
    BoardQuestion,
    count_nothing,
)
from trolley_base.drivers.boards.report import Report
from trolley_base.drivers.boards.velocities import VelocityIntegrator
from trolley_base.drivers.boards.wheel_ticks import MOST_SPEED
from trolley_base.drivers.dialogue import Line, Status, travel_ns
from trolley_base.drivers.interface import ChassisReading

HEAD_WORD = 0xABCD
HEAD = struct.pack("<H", HEAD_WORD)
FEEDBACK, COMMAND = struct.Struct("<H6hHH"), struct.Struct("<HhhH")
MOST_TARGET_RPM = 1000
FEEDBACK_NS = 10_000_000
ENOUGH_FEEDBACK = 5
"""Frames with two known bytes and a sum of 16 bits: so many are no coincidence."""
NO_RPM = (
    "The hoverboard reports speeds that no robot can have; they are not used. Look at the cables "
    "of its motors' Hall sensors."
)


class HoverboardSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Wheels and firmware of a `hoverboard`."""

    diameter_m: Annotated[float, Meta(gt=0.0, le=1.0)]
    """Diameter of a wheel under load; most hoverboards have about 0.165 m."""
    track_m: Annotated[float, Meta(gt=0.0, le=3.0)]
    """Distance between the middles of both wheels."""
    invert_left: bool = False
    """Whether the firmware is built with INVERT_L_DIRECTION."""
    invert_right: bool = False
    """Whether the firmware is built with INVERT_R_DIRECTION."""
    tank_steering: bool = False
    """Whether the firmware is built with TANK_STEERING."""


class Feedback(NamedTuple):
    """What a frame holds; turns per minute as the firmware counts them."""

    steer: int
    speed: int
    right_rpm: int
    left_rpm: int
    centivolts: int
    decidegrees: int
    leds: int


def is_sound(frame: bytes) -> bool:
    """Whether the last word is the exclusive or of the others."""
    *words, check = struct.unpack(f"<{len(frame) // 2}H", frame)
    for word in words:
        check ^= word
    return check == 0


FRAME = FrameFormat(HEAD, FEEDBACK.size, is_sound)


def parse_feedback(frame: bytes) -> Feedback:
    """Read a sound frame."""
    return Feedback(*FEEDBACK.unpack(frame)[1:-1])


def command(steer: int, speed: int) -> bytes:
    """Return a command."""
    check = HEAD_WORD ^ (steer & 0xFFFF) ^ (speed & 0xFFFF)
    return COMMAND.pack(HEAD_WORD, steer, speed, check)


STOP = command(0, 0)


class HoverboardDialogue:
    """Talks to the firmware.

    Args:
        wheels: of the robot.
        baud: bits per second.
    """

    def __init__(self, config: ChassisConfig, wheels: HoverboardSettings, baud: int) -> None:
        self._baud = baud
        self._build = wheels
        self._half_track_m = 0.5 * wheels.track_m
        self._m_per_rpm_s = math.pi * wheels.diameter_m / 60.0
        self._report = Report()
        self._reader = FrameReader(FRAME, self._report.count)
        self._wheels = VelocityIntegrator(FEEDBACK_NS, self._report.count)
        self._gauge = BatteryGauge(config.inputs)
        self._pace = CommandPace()
        self.begin(0)

    @property
    def line(self) -> Line:
        """How the port is opened."""
        return Line(self._baud)

    def begin(self, now_ns: int) -> None:
        """The port has been opened: wait for a frame, command nothing."""
        self._reader.reset()
        self._wheels.reset()
        self._gauge.reset()
        self._wanted = Twist2D.zero()
        self._heard = LastHeard(now_ns)
        self._pace.reset()
        self._rest = (0.0, 0.0)

    # What arrives.
    def receive(self, data: bytes, arrived_ns: int) -> None:
        """Take bytes."""
        if not data:
            return
        self._heard.hear(arrived_ns)
        frames, _ = self._reader.feed(data)
        for frame in frames:
            late_ns = travel_ns(frame.following, self._baud)
            self._take(parse_feedback(frame.data), arrived_ns - late_ns, arrived_ns)

    def _take(self, told: Feedback, left_ns: int, arrived_ns: int) -> None:
        left = self._m_per_rpm_s * told.left_rpm * (-1 if self._build.invert_left else 1)
        right = self._m_per_rpm_s * told.right_rpm * (1 if self._build.invert_right else -1)
        if max(abs(left), abs(right)) > MOST_SPEED:
            self._report.note("warning", NO_RPM)
            self._report.count("bad_messages")
            self._heard.take_nonsense(arrived_ns)
            return
        self._heard.take_report(arrived_ns)
        self._gauge.take_voltage(max(0, told.centivolts) * 1e-2, arrived_ns)
        motion = self._wheels.add(twist_of(left, right, self._half_track_m), left_ns)
        if motion is not None:
            self._report.add_motion(motion)

    # What is sent.
    def drive(self, twist: Twist2D) -> None:
        """Set the wanted velocity; what it says of sideways is left out."""
        self._wanted = Twist2D(twist.vx, 0.0, twist.wz)

    def outgoing(self, now_ns: int) -> bytes:
        """Return a command: stops and starts at once, zeros too, or it beeps and lets go."""
        if not self._heard.has_reported:
            return b""
        wanted = self._wanted if self._heard.is_reporting(now_ns) else Twist2D.zero()
        if not self._pace.is_due(now_ns, stands=wanted.is_zero):
            return b""
        self._pace.note(now_ns, stands=wanted.is_zero)
        return self._command(wanted)

    def _command(self, wanted: Twist2D) -> bytes:
        if wanted.is_zero:
            self._rest = (0.0, 0.0)
            return STOP
        sides = sides_of(wanted, self._half_track_m)
        left, right = (side / self._m_per_rpm_s for side in sides)
        # Mixed, the two targets are the mean and the difference of the sides.
        exact = (left, right) if self._build.tank_steering else (left - right, 0.5 * (left + right))
        # Beyond what the board can take: slower on the same arc.
        scale = MOST_TARGET_RPM / max(abs(exact[0]), abs(exact[1]), MOST_TARGET_RPM)
        # What rounding leaves over is added to the next target.
        due = scale * exact[0] + self._rest[0], scale * exact[1] + self._rest[1]
        whole = round(due[0]), round(due[1])
        self._rest = due[0] - whole[0], due[1] - whole[1]
        most = MOST_TARGET_RPM
        return command(max(-most, min(most, whole[0])), max(-most, min(most, whole[1])))

    def goodbye(self) -> tuple[bytes, ...]:
        """Stop the wheels."""
        return (STOP,) if self._heard.has_reported else ()

    # How it goes.
    def status(self, now_ns: int) -> Status:
        """Say how it goes."""
        if self._heard.is_silent(now_ns):
            return Status(
                "down",
                "The hoverboard is silent. Is it switched on (it switches itself off after 8 min "
                "of rest), and is its firmware built with VARIANT_USART?",
                reopen=True,
            )
        if self._heard.is_reporting(now_ns):
            return Status("up")
        if self._heard.is_talking_nonsense(now_ns):
            return Status("down", NO_RPM)
        if self._heard.has_reported:
            return Status("down", "The hoverboard has stopped reporting.")
        if self._heard.has_bytes:
            return Status(
                "searching",
                "What arrives is not a hoverboard's feedback: is this its port, is its firmware "
                f"built with VARIANT_USART, and is {self._baud} its baud rate?",
            )
        return Status("searching", "The hoverboard is being waited for.")

    def take(self, now_ns: int) -> ChassisReading:
        """Hand over what was reported."""
        return self._report.take(self.status(now_ns), self._gauge.alarms(), self._gauge.battery)


def recognise(data: bytes) -> Answer | None:
    """Find feedback, which it sends unasked."""
    frames, _ = FrameReader(FRAME, count_nothing).feed(data)
    if len(frames) < ENOUGH_FEEDBACK:
        return None
    told = parse_feedback(frames[-1].data)
    return Answer((f"battery at {told.centivolts * 1e-2:.1f} V",))


def _settings(config: ChassisConfig) -> HoverboardSettings:
    return read_settings(config.settings, HoverboardSettings, SETTINGS)


DRIVERS = {
    "hoverboard": BoardDriver(
        BoardFacts("hoverboard (FOC firmware)", 115200, 0.8),
        lambda config, baud, _: HoverboardDialogue(config, _settings(config), baud),
        (BoardQuestion(115200, (), recognise, wait_s=0.0),),
        track_m=lambda config: _settings(config).track_m,
        api=API,
        page="hoverboard.md",
        settings=HoverboardSettings,
        example={
            "settings": {"diameter_m": 0.165, "track_m": 0.34},
            "inputs": {"battery_empty_v": 35.0, "battery_full_v": 42.0},
        },
        emulator="trolley_base.emulators.hoverboard:BOARDS",
    )
}
