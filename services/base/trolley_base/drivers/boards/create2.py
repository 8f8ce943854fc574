"""An iRobot Create 2, or a Roomba of the 500 to 900 series, over its Open Interface.

The robot is woken, started and put into safe mode, in which it stops by itself at a cliff, when a
wheel drops, and when it is charged; it then falls back to passive mode, in which it does not drive.
It is asked for a stream: every 15 ms one frame with what it senses. **It drives on with the last
command for ever**: nothing stops it when its host is gone.

A command has no checksum: where a byte is lost, the next one may be taken for its rest. So commands
are repeated, zeros too, and the mode is watched. Within 20 ms after a change of mode the robot may
miss what it is sent, so nothing is.

When it boots it says so in lines of text. Its counts begin anew then, usually at zero.

Counts, below `chassis/`: `bad_checksum`, `skipped_bytes`, `encoder_jumps`, `restarts`.

Source:
    iRobot Create 2 Open Interface Specification (2018); AutonomyLab libcreate; what Roombas of the
    600 and 700 series print when they boot.
"""

import math
import re
import struct
from typing import NamedTuple

from trolley import codes
from trolley.config.hardware import ChassisConfig, WheelsConfig
from trolley.drivers import API, FELT_KEPT_S, BoardSensor
from trolley.geometry import Twist2D
from trolley_base.differential import sides_of
from trolley_base.drivers.boards.battery import BatteryGauge
from trolley_base.drivers.boards.command_pace import CommandPace
from trolley_base.drivers.boards.fixed_frames import FrameFormat, FrameReader
from trolley_base.drivers.boards.last_heard import LastHeard
from trolley_base.drivers.boards.models import (
    Answer,
    BoardDriver,
    BoardFacts,
    BoardQuestion,
    count_nothing,
)
from trolley_base.drivers.boards.report import Report
from trolley_base.drivers.boards.wheel_ticks import Counts, StreamedOdometry
from trolley_base.drivers.dialogue import Line, Status, travel_ns
from trolley_base.drivers.interface import ChassisReading, Contact, DriverError, Sector

START, SAFE, DRIVE_DIRECT, STREAM = 128, 131, 145, 148
FIELDS = (
    (7, "B"),  # bumps and wheel drops
    (8, "B"),  # wall
    (9, "B"),  # cliff left
    (10, "B"),  # cliff front left
    (11, "B"),  # cliff front right
    (12, "B"),  # cliff right
    (14, "B"),  # overcurrents
    (18, "B"),  # buttons
    (21, "B"),  # charging state
    (22, "H"),  # voltage [mV]
    (25, "H"),  # charge [mAh]
    (26, "H"),  # capacity [mAh]
    (34, "B"),  # charging sources
    (35, "B"),  # mode
    (43, "H"),  # left encoder
    (44, "H"),  # right encoder
    (45, "B"),  # light bumper
)
"""The packets that are asked for, with their layouts."""
BODY = struct.Struct(">" + "".join(f"B{layout}" for _, layout in FIELDS))
HEAD = bytes((0x13, BODY.size))
WHOLE = len(HEAD) + BODY.size + 1
ASK_STREAM = bytes((STREAM, len(FIELDS), *(number for number, _ in FIELDS)))
PAUSE_STREAM, RESUME_STREAM, END = bytes((150, 0)), bytes((150, 1)), bytes((173,))
STOP = bytes((DRIVE_DIRECT, 0, 0, 0, 0))

BOOT = re.compile(rb"bl-start|bootloader|by iRobot|battery-current")
"""Words of the lines that it says when it boots; one of them may be cut."""
SAFE_MODE = 2
BUMPS, WHEEL_DROPS, WHEEL_OVERCURRENTS, CLEAN_BUTTON = 0b0011, 0b1100, 0b11000, 0b1
CHARGES = (1, 2, 3)
"""Charging states in which it is being charged."""

WAKE_S = 0.7
"""RTS, on which the cable has the robot's BRC pin, stays low for this long: it wakes."""
STREAM_NS, COUNTED_FRAMES = 15_000_000, 2
"""A frame's pace. Of so many frames one is taken for the odometry: a count is half a millimetre,
which in 15 ms is 3 cm/s."""
MODE_NS = 60_000_000
"""Nothing is sent for this long after a change of mode."""
START_EVERY_NS, SAFE_EVERY_NS = 1_000_000_000, 500_000_000
FASTEST_MMPS = 500
SETTLES_NS = 300_000_000
"""After a silence frames that were held up come together, and would look like haste: for this long
they are not counted, and it does not drive."""
EMPTY_CHARGE = 0.05
"""Share of its capacity below which it counts as empty."""
ENOUGH_FRAMES = 3
"""Frames with a sum and fifteen numbers of packets: so many are no coincidence."""
COUNT_RANGE = 1 << 16
NEAR_START = 100
"""One whose counts both lie within this of zero after a silence, but not before, has just booted,
even if what it said of that was lost: 4 cm. Unless it was heading there."""
FIRST_COUNT = 1 << 20
"""Counts go on from here, far from those of a board that has just started."""
TRACK_M = 0.235
"""Between the middles of its wheels."""
RADIUS_M = 0.17
WHEELS = WheelsConfig(ticks_per_revolution=508.8, diameter_m=0.072, track_m=TRACK_M)


def _sector(from_deg: float, to_deg: float) -> Sector:
    return math.radians(from_deg), math.radians(to_deg)


# Where its sensors look; the interface names them left to right and gives no angles, which are
# estimated by photographs of the robot.
BUMPED = {0b01: _sector(-75, -5), 0b10: _sector(5, 75), 0b11: _sector(-30, 30)}
"""By the bits of the bumper, of which bit 0 is the right half."""
CLIFFS = _sector(45, 75), _sector(5, 25), _sector(-25, -5), _sector(-75, -45)
"""Left, front left, front right, right."""
LIGHT = (
    _sector(50, 75),
    _sector(25, 50),
    _sector(0, 25),
    _sector(-25, 0),
    _sector(-50, -25),
    _sector(-75, -50),
)
"""By the bits of the light bumper: left, front left, centre left, and so on to the right."""
WALL = _sector(-75, -60)
LIGHT_M = 0.05
"""How far from the bumper what the light sensors see is taken to be: how strongly it reflects
decides, from a few millimetres to about 10 cm [m]."""


class Sensors(NamedTuple):
    """What a frame holds."""

    bumps: int
    wall: int
    cliff_left: int
    cliff_front_left: int
    cliff_front_right: int
    cliff_right: int
    overcurrents: int
    buttons: int
    charging: int
    millivolts: int
    charge: int
    capacity: int
    sources: int
    mode: int
    left: int
    right: int
    light: int

    @property
    def is_charged(self) -> bool:
        """Whether it stands on its dock, or its charger is plugged in."""
        return self.sources != 0 or self.charging in CHARGES

    @property
    def is_dropped(self) -> bool:
        """Whether a wheel hangs in the air."""
        return bool(self.bumps & WHEEL_DROPS)

    @property
    def _cliffs(self) -> tuple[int, ...]:
        return self.cliff_left, self.cliff_front_left, self.cliff_front_right, self.cliff_right

    def contacts(self) -> tuple[Contact, ...]:
        """Return what it feels, and where."""
        bump = BUMPED.get(self.bumps & BUMPS)
        cliffs = [where for where, is_felt in zip(CLIFFS, self._cliffs, strict=True) if is_felt]
        light = [where for bit, where in enumerate(LIGHT) if self.light >> bit & 1]
        light += [WALL] if self.wall else []
        return (
            Contact(codes.BUMPER, () if bump is None else (bump,)),
            Contact(codes.CLIFF, tuple(cliffs)),
            Contact(LIGHT_BUMPER, tuple(light), LIGHT_M),
        )

    def alarms(self) -> set[str]:
        """Return the codes that hold."""
        cliffs = any(self._cliffs) or self.is_dropped
        found = {codes.CLIFF} if cliffs else set[str]()
        if self.bumps & BUMPS:
            found.add(codes.BUMPER)
        if self.buttons & CLEAN_BUTTON:
            found.add(codes.BUTTON)
        return found


def is_sound(frame: bytes) -> bool:
    """Whether a frame's sum is right and its packets are those that were asked for."""
    if sum(frame) % 256:
        return False
    return BODY.unpack_from(frame, len(HEAD))[::2] == tuple(number for number, _ in FIELDS)


FRAME = FrameFormat(HEAD, WHOLE, is_sound)


def parse_frame(frame: bytes) -> Sensors:
    """Read a sound frame."""
    return Sensors(*BODY.unpack_from(frame, len(HEAD))[1::2])


def drive_direct(left_mmps: int, right_mmps: int) -> bytes:
    """Return a command: speeds of the wheels [mm/s]."""
    return struct.pack(">Bhh", DRIVE_DIRECT, right_mmps, left_mmps)


class Create2Dialogue:
    """Talks to the robot.

    Args:
        baud: bits per second.

    Raises:
        DriverError: its frames do not fit that speed, and would come garbled.
    """

    def __init__(self, config: ChassisConfig, baud: int) -> None:
        if travel_ns(WHOLE, baud) > STREAM_NS:
            raise DriverError(
                f"[base.chassis] baud = {baud} is too slow for what a Create reports: remove the "
                "line, and take the robot's battery out for a moment; it speaks at 115200 then"
            )
        self._baud = baud
        self._report = Report()
        self._reader = FrameReader(FRAME, self._report.count)
        self._wheels = StreamedOdometry(WHEELS, COUNTED_FRAMES * STREAM_NS, self._report.count)
        self._gauge = BatteryGauge(config.inputs)
        self._pace = CommandPace()
        self.begin(0)

    @property
    def line(self) -> Line:
        """How the port is opened: opening it wakes the robot."""
        return Line(self._baud, settle_s=WAKE_S, clears_rts=True)

    def begin(self, now_ns: int) -> None:
        """The port has been opened: start the robot, command nothing."""
        self._reader.reset()
        self._wheels.reset()
        self._gauge.reset()
        self._wanted = Twist2D.zero()
        self._sensors: Sensors | None = None
        self._counts: tuple[int, int] | None = None
        self._num_frames = self._settled_ns = 0
        self._heard = LastHeard(now_ns)
        self._pace.reset()
        self._started_ns: int | None = None
        self._mode_ns: int | None = None
        self._steps: list[bytes] = []

    # What arrives.
    def receive(self, data: bytes, arrived_ns: int) -> None:
        """Take bytes."""
        if not data:
            return
        self._heard.hear(arrived_ns)
        frames, has_skipped = self._reader.feed(data)
        if has_skipped:
            self._wheels.miss()
        for frame in frames:
            late_ns = travel_ns(frame.following, self._baud)
            self._take(parse_frame(frame.data), arrived_ns - late_ns, arrived_ns)
        if BOOT.search(data):
            self._forget_counts()

    def _forget_counts(self) -> None:
        """It has booted: its counts begin anew."""
        if self._counts is not None:
            self._report.count("restarts")
            self._wheels.reset()
            self._counts = None

    def _take(self, sensors: Sensors, left_ns: int, arrived_ns: int) -> None:
        before = self._sensors
        if self._heard.has_reported and not self._heard.is_reporting(arrived_ns):
            self._settled_ns = arrived_ns + SETTLES_NS
            self._wheels.miss()
            if _is_near_start(sensors) and not (before and _is_near_start(before)):
                new = Counts(*self._unwrapped(sensors), left_ns)
                if not self._wheels.wheels.continues(new):
                    self._forget_counts()
        self._sensors = sensors
        self._heard.take_report(arrived_ns)
        if sensors.capacity:
            share = sensors.charge / sensors.capacity
            is_charging = sensors.charging in CHARGES
            voltage = sensors.millivolts * 1e-3
            self._gauge.take_charge(share, EMPTY_CHARGE, voltage, arrived_ns, charging=is_charging)
        if sensors.overcurrents & WHEEL_OVERCURRENTS and not (before and before.overcurrents):
            self._report.note(
                "warning", "A wheel of the Create takes too much current: it is stuck."
            )
        self._num_frames += 1
        if self._num_frames % COUNTED_FRAMES or arrived_ns < self._settled_ns:
            return
        motion = self._wheels.add(*self._unwrapped(sensors), left_ns)
        if self._wheels.wheels.has_jumped:
            self._report.add_jump()
        if self._wheels.wheels.has_restarted:
            self._report.count("restarts")
        if motion is not None:
            self._report.add_motion(motion)

    def _unwrapped(self, sensors: Sensors) -> tuple[int, int]:
        """Return the counts of 16 bits as such that go on beyond them."""
        if self._counts is None:
            self._counts = (FIRST_COUNT + sensors.left, FIRST_COUNT + sensors.right)
        left, right = self._counts
        self._counts = (
            left + _shorter(sensors.left - left),
            right + _shorter(sensors.right - right),
        )
        return self._counts

    # What is sent.
    def drive(self, twist: Twist2D) -> None:
        """Set the wanted velocity; what it says of sideways is left out."""
        self._wanted = Twist2D(twist.vx, 0.0, twist.wz)

    def outgoing(self, now_ns: int) -> bytes:
        """Return a command if one is due, else what starts the robot or makes it drive again."""
        if self._mode_ns is not None and now_ns - self._mode_ns < MODE_NS:
            return b""
        return self._command(now_ns) or self._start(now_ns)

    def _command(self, now_ns: int) -> bytes:
        """Return a command: stops and starts at once, zeros too, since one may be lost."""
        if not self._heard.has_reported:
            return b""
        wanted = self._wanted if self._is_usable(now_ns) else Twist2D.zero()
        if not self._pace.is_due(now_ns, stands=wanted.is_zero):
            return b""
        if self._must_change_mode(now_ns) and self._pace.is_standing and wanted.is_zero:
            return b""  # what it would not obey
        self._pace.note(now_ns, stands=wanted.is_zero)
        left, right = (1000.0 * side for side in sides_of(wanted, 0.5 * TRACK_M))
        # Beyond what the robot can take: slower on the same arc.
        scale = min(1.0, FASTEST_MMPS / max(abs(left), abs(right), 1.0))
        return drive_direct(round(scale * left), round(scale * right))

    def _must_change_mode(self, now_ns: int) -> bool:
        """Whether it is to be started, or put into safe mode, now."""
        if not self._heard.is_reporting(now_ns):
            waited = self._started_ns is None or now_ns - self._started_ns >= START_EVERY_NS
            return waited or bool(self._steps)
        sensors = self._sensors
        if sensors is None or sensors.mode == SAFE_MODE or not self._may_become_safe:
            return False
        return self._mode_ns is None or now_ns - self._mode_ns >= SAFE_EVERY_NS

    def _start(self, now_ns: int) -> bytes:
        """Start it step by step while it does not report; else put it back into safe mode."""
        if not self._must_change_mode(now_ns):
            return b""
        self._mode_ns = now_ns
        if self._heard.is_reporting(now_ns):
            self._steps = []
            return bytes((SAFE,))
        if not self._steps:
            # One that an earlier host has left driving heeds a stop before it is started anew.
            first = STOP if self._started_ns is None else b""
            self._started_ns = now_ns
            self._steps = [first + bytes((START,)), bytes((SAFE,)), ASK_STREAM + RESUME_STREAM]
        return self._steps.pop(0)

    @property
    def _may_become_safe(self) -> bool:
        sensors = self._sensors
        return sensors is not None and not (sensors.is_charged or sensors.is_dropped)

    def goodbye(self) -> tuple[bytes, ...]:
        """Stop the wheels, then the reports, then the interface: its buttons work again."""
        return (STOP, PAUSE_STREAM + END) if self._heard.has_reported else ()

    # How it goes.
    def _is_usable(self, now_ns: int) -> bool:
        sensors = self._sensors
        if sensors is None or sensors.mode != SAFE_MODE or now_ns < self._settled_ns:
            return False
        return self._heard.is_reporting(now_ns)

    def status(self, now_ns: int) -> Status:
        """Say how it goes."""
        if self._heard.is_silent(now_ns):
            return Status(
                "down",
                "The Create is silent. Is it switched on? Press its Clean button once to wake it, "
                "and look at the cable.",
                reopen=True,
            )
        if self._is_usable(now_ns):
            return Status("up")
        if self._heard.is_reporting(now_ns) and self._sensors is not None:
            return Status("down", _why_not(self._sensors))
        if self._heard.has_reported:
            return Status("down", "The Create has stopped reporting; it is started again.")
        if self._heard.has_bytes:
            return Status(
                "searching",
                "What arrives is not a Create's: is this its port? If Clean was held when it was "
                "switched on it speaks too slowly: take its battery out for a moment.",
            )
        return Status("searching", "The Create is being woken.")

    def take(self, now_ns: int) -> ChassisReading:
        """Hand over what was reported."""
        found, contacts = set(self._gauge.alarms()), ()
        if self._sensors is not None:
            found |= self._sensors.alarms()
            contacts = self._sensors.contacts() if self._heard.is_reporting(now_ns) else ()
        alarms = tuple(sorted(found))
        return self._report.take(self.status(now_ns), alarms, self._gauge.battery, contacts)


def _why_not(sensors: Sensors) -> str:
    """Say why it is not in safe mode."""
    if sensors.is_charged:
        return (
            "The Create is being charged, and does not drive meanwhile: take it off its dock, or "
            "pull its charger."
        )
    if sensors.is_dropped:
        return "A wheel of the Create hangs in the air: put it on the floor."
    if sensors.mode == SAFE_MODE:
        return "The Create reports again; it is watched for a moment."
    return "The Create has left its safe mode, in which it drives; it is put into it again."


def _is_near_start(sensors: Sensors) -> bool:
    return max(abs(_shorter(sensors.left)), abs(_shorter(sensors.right))) < NEAR_START


def _shorter(difference: int) -> int:
    """Return a difference of 16-bit counts as the shorter way round."""
    return (difference + COUNT_RANGE // 2) % COUNT_RANGE - COUNT_RANGE // 2


def recognise(data: bytes) -> Answer | None:
    """Find frames of its stream."""
    frames, _ = FrameReader(FRAME, count_nothing).feed(data)
    if len(frames) < ENOUGH_FRAMES:
        return None
    sensors = parse_frame(frames[-1].data)
    details = (f"battery at {sensors.millivolts * 1e-3:.1f} V",)
    problems = ("It is being charged, and does not drive meanwhile.",) if sensors.is_charged else ()
    return Answer(details, problems)


# It is started, which moves nothing, asked for its stream, and left off again.
QUESTION = BoardQuestion(115200, (bytes((START,)), ASK_STREAM), recognise, leave=PAUSE_STREAM + END)
LIGHT_BUMPER = "light_bumper"
SENSORS = (
    BoardSensor(
        name=codes.BUMPER,
        meaning="its bumper. For a minute the robot drives around what it has hit. The echoes lie "
        "along its footprint, on the side that was hit; so it has no pose.",
        settings={"z_m": 0.05, "kept_s": FELT_KEPT_S},
    ),
    BoardSensor(
        name=codes.CLIFF,
        meaning="its four cliff sensors. For a minute the robot keeps off the edge that it has "
        "met. The echoes lie along its footprint; so they have no pose.",
        settings={"z_m": 0.0, "kept_s": FELT_KEPT_S},
    ),
    BoardSensor(
        name=LIGHT_BUMPER,
        meaning="the light sensors of its bumper, which see things at about 5 cm, by how much "
        "they reflect: mark plans around them, stop also stops before them, and before a white "
        "wall perhaps too early.",
        settings={"z_m": 0.04, "uses": ["mark"]},
        is_usual=False,
    ),
)
DRIVERS = {
    "create2": BoardDriver(
        BoardFacts("Create 2 or Roomba", 115200, math.inf, radius_m=RADIUS_M),
        lambda config, baud, _: Create2Dialogue(config, baud),
        (QUESTION,),
        track_m=lambda _: TRACK_M,
        api=API,
        sensors=SENSORS,
        page="create2.md",
        emulator="trolley_base.emulators.create2:BOARDS",
    )
}
