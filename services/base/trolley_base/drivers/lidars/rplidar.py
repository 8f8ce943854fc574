"""RPLIDAR A1, A2, A3, C1, S1, S2 and S3 (SLAMTEC): asked to start, and stream one of their scans.

An A1 is asked for its express scan, which has twice as many samples as the standard one but no
intensity. The others are asked which of their modes is the typical one, and how long it takes for a
sample. What answers says which scan it is (`rplidar_capsules.py`, `rplidar_samples.py`), and that
is believed.

Motors: the adapter's DTR stops that of an A1, so it is cleared while the sensor works; A2 and A3
have a command for how much current it gets, C1 and S for how fast it turns.

Source:
    SLAMTEC RPLIDAR interface protocol; rplidar_sdk.
"""

import struct
from collections.abc import Generator
from dataclasses import dataclass
from functools import partial
from typing import Literal

from trolley.config.hardware import LidarConfig
from trolley.drivers import API
from trolley_base.drivers.dialogue import Line
from trolley_base.drivers.lidars.handshake import (
    ANSWER_S,
    HEALTH,
    HEALTH_BYTES,
    Handshake,
    HandshakeLidar,
    Step,
)
from trolley_base.drivers.lidars.models import Identity, LidarDriver, LidarFacts
from trolley_base.drivers.lidars.rplidar_capsules import KINDS, CapsuleDecoder
from trolley_base.drivers.lidars.rplidar_capsules import SAMPLE_S as EXPRESS_S
from trolley_base.drivers.lidars.rplidar_samples import SAMPLE_S as STANDARD_S
from trolley_base.drivers.lidars.rplidar_samples import StandardDecoder

STOP, RESET = b"\xa5\x25", b"\xa5\x40"
GET_INFO, GET_HEALTH, GET_SAMPLERATE = b"\xa5\x50", b"\xa5\x52", b"\xa5\x59"
START_STANDARD = b"\xa5\x20"
SAMPLERATE = bytes.fromhex("A55A 0400 0000 15")
ANSWER, DESCRIPTOR_BYTES = b"\xa5\x5a", 5
STANDARD_STREAM = bytes.fromhex("0500 0040 81")
EXPRESS_SCAN, GET_CONFIGURATION, SET_PWM, SET_RPM = 0x82, 0x84, 0xF0, 0xA8
SAMPLE_US, TYPICAL_MODE, DESIRED_ROTATION = 0x71, 0x7C, 0x01
"""Keys of the configuration: 1/256 us for a sample of a mode; a mode; rpm."""
CONFIGURES_FROM = (1, 24)
"""The first firmware of an A2 or A3 that answers to them."""
DRAIN_S, REBOOT_S, START_S, FAULT_PAUSE_S, MOTOR_S = 0.1, 2.0, 2.0, 5.0, 0.1
"""After STOP the sensor may go on for this long; RESET reboots it."""
BELIEVED_S = (20e-6, 1000e-6)
"""Sample periods that a sensor can have [s]; others are not believed."""
USUAL_PWM, USUAL_RPM, MOST_RPM = 660, 600, 1500
"""Of the SDK, where the sensor does not say."""


@dataclass(frozen=True, slots=True)
class Series:
    """What makes the models differ.

    Attributes:
        facts: of the model.
        number: upper half of the model's number.
        motor: what runs its motor.
    """

    facts: LidarFacts
    number: int
    motor: Literal["dtr", "pwm", "rpm"]

    def has(self, model: int) -> bool:
        """Say whether a model number is of this series."""
        return model >> 4 == self.number


@dataclass(frozen=True, slots=True)
class Pace:
    """How a sensor measures, as it says.

    Attributes:
        standard_s: between two samples of the standard scan [s].
        mode: number of another scan; None: it has none.
        sample_s: between two samples of that.
    """

    standard_s: float
    mode: int | None
    sample_s: float


def request(command: int, payload: bytes) -> bytes:
    """Return a command that brings something along: with its length, and the XOR of all."""
    body = bytes([0xA5, command, len(payload)]) + payload
    check = 0
    for byte in body:
        check ^= byte
    return body + bytes([check])


def start_mode(mode: int) -> bytes:
    """Return the command that starts a mode."""
    return request(EXPRESS_SCAN, struct.pack("<BHH", mode, 0, 0))


class Rplidar(HandshakeLidar):
    """The sensor; see the module.

    Raises:
        DriverError: the configuration asks for what it cannot do.
    """

    def __init__(self, series: Series, config: LidarConfig) -> None:
        self._series = series
        self._rpm = USUAL_RPM
        super().__init__(series.facts, config, StandardDecoder)

    @property
    def line(self) -> Line:
        """How the port is opened."""
        if self._series.motor == "rpm":
            return Line(self.baud)
        return Line(self.baud, dtr=False, dtr_after=True)

    def goodbye(self) -> tuple[bytes, ...]:
        """Stop the scan, and the motor."""
        return (STOP, *filter(None, [self._motor(is_on=False)]))

    def _handshake(self) -> Handshake:
        while True:
            # Whoever used it before may have left it streaming.
            yield Step(STOP, DRAIN_S)
            answers = yield from self._ask_who(GET_INFO, GET_HEALTH, self._series.has)
            if answers is None:
                continue
            info, is_well = answers
            if not is_well:
                yield Step(RESET, REBOOT_S)
                health = yield Step(GET_HEALTH, ANSWER_S, HEALTH, HEALTH_BYTES)
                if health is None or not self._check_health(health):
                    yield Step(b"", FAULT_PAUSE_S)
                    continue
            motor = self._series.motor
            if motor == "rpm" or (motor == "pwm" and (info[2], info[1]) >= CONFIGURES_FROM):
                pace = yield from self._ask_mode()
            else:
                pace = yield from self._ask_periods()
            if motor == "rpm":
                rotation = yield from _ask(struct.pack("<I", DESIRED_ROTATION), 4)
                rpm = int.from_bytes((rotation or b"")[:2], "little")
                self._rpm = rpm if 0 < rpm <= MOST_RPM else USUAL_RPM
            if motor != "dtr":
                yield Step(self._motor(is_on=True), MOTOR_S)
            if (yield from self._start(pace)):
                return

    def _ask_periods(self) -> Generator[Step, bytes | None, Pace]:
        """Ask for the periods of the standard and of the express scan, which is mode 0."""
        periods = yield Step(GET_SAMPLERATE, ANSWER_S, SAMPLERATE, 4)
        standard_us, express_us = struct.unpack("<HH", periods or bytes(4))
        standard_s = _believed(standard_us * 1e-6, STANDARD_S)
        return Pace(standard_s, 0, _believed(express_us * 1e-6, EXPRESS_S))

    def _ask_mode(self) -> Generator[Step, bytes | None, Pace]:
        """Ask for the typical mode, and for the periods."""
        typical = yield from _ask(struct.pack("<I", TYPICAL_MODE), 2)
        standard = yield from _ask(struct.pack("<IH", SAMPLE_US, 0), 4)
        standard_s = _believed(_micros(standard), STANDARD_S)
        if not typical or typical == bytes(2):  # mode 0 is the standard scan here
            return Pace(standard_s, None, standard_s)
        period = yield from _ask(struct.pack("<I", SAMPLE_US) + typical, 4)
        mode = int.from_bytes(typical, "little")
        return Pace(standard_s, mode, _believed(_micros(period), EXPRESS_S))

    def _start(self, pace: Pace) -> Generator[Step, bytes | None, bool]:
        """Start the scan that the settings want; True where it streams."""
        wanted = self._config.mode
        if wanted != "standard" and pace.mode is not None:
            answer = yield Step(start_mode(pace.mode), START_S, ANSWER, DESCRIPTOR_BYTES)
            if answer is not None:
                if self._listen(answer, pace):
                    return True
                self._note(
                    "lidar_mode",
                    f"The {self.facts.title} sends scans of kind 0x{answer[-1]:02X}, which Trolley "
                    f'cannot read; the standard scan is used instead (mode = "standard").',
                )
            yield Step(STOP, DRAIN_S)
        if wanted == "express":
            return False
        answer = yield Step(START_STANDARD, START_S, ANSWER, DESCRIPTOR_BYTES)
        return answer is not None and self._listen(answer, pace)

    def _listen(self, descriptor: bytes, pace: Pace) -> bool:
        """Begin to read the scan that an answer announces; False where it is not known."""
        kind = KINDS.get(descriptor)
        if descriptor == STANDARD_STREAM:
            self._restart(StandardDecoder(self._counts, pace.standard_s))
        elif kind is not None:
            self._restart(CapsuleDecoder(self._counts, pace.sample_s, kind))
        else:
            return False
        return True

    def _motor(self, *, is_on: bool) -> bytes:
        """Return the command that runs or stops the motor; b"" where there is none."""
        if self._series.motor == "pwm":
            return request(SET_PWM, struct.pack("<H", USUAL_PWM if is_on else 0))
        if self._series.motor == "rpm":
            return request(SET_RPM, struct.pack("<H", self._rpm if is_on else 0))
        return b""


def _ask(key: bytes, size: int) -> Generator[Step, bytes | None, bytes | None]:
    """Ask for a value of the configuration that has so many bytes; None where none came."""
    beginning = ANSWER + struct.pack("<IB", 4 + size, 0x20) + key[:4]
    return (yield Step(request(GET_CONFIGURATION, key), ANSWER_S, beginning, size))


def _micros(answer: bytes | None) -> float:
    """Return a period [s] that the configuration gives in 1/256 us; 0 without an answer."""
    return int.from_bytes(answer or b"", "little") / 256.0 * 1e-6


def _believed(said_s: float, usual_s: float) -> float:
    """Return the time between two samples as the sensor says it, if that can be."""
    return said_s if BELIEVED_S[0] <= said_s <= BELIEVED_S[1] else usual_s


def _other_model(number: int) -> tuple[str, str]:
    title = f"RPLIDAR (model 0x{number:02X})"
    return title, f"Trolley has no driver for the {title}; one with mode standard may work."


IDENTITY = Identity(
    stop=(STOP,),
    get_info=GET_INFO,
    get_health=GET_HEALTH,
    other_model=_other_model,
    serial=lambda numbers: numbers.hex().upper(),
)
_MODES = ("auto", "standard")

SERIES: dict[str, Series] = {
    "rplidar_a1": Series(
        LidarFacts(
            title="RPLIDAR A1",
            baud=115200,
            range_min_m=0.15,
            range_max_m=12.0,
            turns_hz=(2.0, 10.0),
            usual_hz=5.5,
            modes=("auto", "standard", "express"),
        ),
        1,
        "dtr",
    ),
    "rplidar_a2": Series(
        LidarFacts(
            title="RPLIDAR A2",
            baud=256000,
            other_bauds=(115200,),
            range_min_m=0.15,
            range_max_m=16.0,
            turns_hz=(5.0, 15.0),
            usual_hz=10.0,
            modes=_MODES,
        ),
        2,
        "pwm",
    ),
    "rplidar_a3": Series(
        LidarFacts(
            title="RPLIDAR A3",
            baud=256000,
            range_min_m=0.15,
            range_max_m=25.0,
            turns_hz=(5.0, 20.0),
            usual_hz=10.0,
            modes=_MODES,
        ),
        3,
        "pwm",
    ),
    "rplidar_c1": Series(
        LidarFacts(
            title="RPLIDAR C1",
            baud=460800,
            range_min_m=0.05,
            range_max_m=12.0,
            turns_hz=(8.0, 12.0),
            usual_hz=10.0,
            modes=_MODES,
        ),
        4,
        "rpm",
    ),
    "rplidar_s1": Series(
        LidarFacts(
            title="RPLIDAR S1",
            baud=256000,
            range_min_m=0.1,
            range_max_m=40.0,
            turns_hz=(8.0, 15.0),
            usual_hz=10.0,
            modes=_MODES,
        ),
        6,
        "rpm",
    ),
    "rplidar_s2": Series(
        LidarFacts(
            title="RPLIDAR S2",
            baud=1_000_000,
            range_min_m=0.05,
            range_max_m=30.0,
            turns_hz=(8.0, 15.0),
            usual_hz=10.0,
            modes=_MODES,
        ),
        7,
        "rpm",
    ),
    "rplidar_s3": Series(
        LidarFacts(
            title="RPLIDAR S3",
            baud=1_000_000,
            other_bauds=(460800,),
            range_min_m=0.05,
            range_max_m=40.0,
            turns_hz=(8.0, 20.0),
            usual_hz=10.0,
            modes=_MODES,
        ),
        8,
        "rpm",
    ),
}


PAGES = {
    "rplidar_a1": "rplidar-a1.md",
    "rplidar_a2": "rplidar-a2.md",
    "rplidar_a3": "rplidar-a2.md",
    "rplidar_c1": "rplidar-c1.md",
}


def _driver(series: Series, page: str) -> LidarDriver:
    is_a1 = series.motor == "dtr"
    return LidarDriver(
        series.facts,
        partial(Rplidar, series),
        identity=IDENTITY,
        is_model=series.has,
        linorobot_names=("rplidar",) if is_a1 else (),
        ros_packages=("rplidar_ros",) if is_a1 else (),
        api=API,
        page=page,
        emulator="trolley_base.emulators.rplidar:LIDARS",
    )


DRIVERS: dict[str, LidarDriver] = {
    model: _driver(series, PAGES.get(model, "rplidar-s.md")) for model, series in SERIES.items()
}
