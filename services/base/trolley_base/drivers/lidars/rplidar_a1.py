"""RPLIDAR A1 (SLAMTEC): asked to start, and streams one of two scans.

The express scan (`rplidar_capsules.py`) has no intensity; the standard scan (`rplidar_samples.py`)
has half as many samples, with their quality as intensity. The adapter's DTR stops
the motor, so it is cleared while the sensor works.

Source:
    SLAMTEC RPLIDAR interface protocol; rplidar_sdk.
"""

from trolley.config.hardware import LidarConfig, LidarModel
from trolley_base.drivers.dialogue import Line
from trolley_base.drivers.lidars.handshake import (
    ANSWER_S,
    HEALTH,
    HEALTH_BYTES,
    INFO,
    INFO_BYTES,
    Handshake,
    HandshakeLidar,
    Step,
)
from trolley_base.drivers.lidars.models import Identity, LidarDriver
from trolley_base.drivers.lidars.rplidar_capsules import SAMPLE_S as EXPRESS_S
from trolley_base.drivers.lidars.rplidar_capsules import CapsuleDecoder
from trolley_base.drivers.lidars.rplidar_samples import FACTS, StandardDecoder
from trolley_base.drivers.lidars.rplidar_samples import SAMPLE_S as STANDARD_S

STOP, RESET = b"\xa5\x25", b"\xa5\x40"
GET_INFO, GET_HEALTH, GET_SAMPLERATE = b"\xa5\x50", b"\xa5\x52", b"\xa5\x59"
START_STANDARD = b"\xa5\x20"
START_EXPRESS = bytes.fromhex("A582 05 00 0000 0000 22")
SAMPLERATE = bytes.fromhex("A55A 0400 0000 15")
STANDARD_STREAM = bytes.fromhex("A55A 0500 0040 81")
EXPRESS_STREAM = bytes.fromhex("A55A 5400 0040 82")
A1_SERIES = 1
DRAIN_S, REBOOT_S, START_S, FAULT_PAUSE_S = 0.1, 2.0, 2.0, 5.0
"""After STOP the sensor may go on for this long; RESET reboots it."""
BELIEVED_S = (100e-6, 1000e-6)
"""Sample periods that an A1 can have [s]; others are not believed."""


class RplidarA1(HandshakeLidar):
    """The sensor; see the module.

    Raises:
        DriverError: the configuration asks for what it cannot do.
    """

    def __init__(self, config: LidarConfig) -> None:
        super().__init__(FACTS, config, StandardDecoder)

    @property
    def line(self) -> Line:
        """How the port is opened."""
        return Line(self.baud, dtr=False, dtr_after=True)

    def goodbye(self) -> tuple[bytes, ...]:
        """Stop the scan."""
        return (STOP,)

    def _handshake(self) -> Handshake:
        while True:
            # Whoever used it before may have left it streaming.
            yield Step(STOP, DRAIN_S)
            info = yield Step(GET_INFO, ANSWER_S, INFO, INFO_BYTES)
            if info is None:
                continue
            self._check_model(_is_a1(info[0]), info[0])
            health = yield Step(GET_HEALTH, ANSWER_S, HEALTH, HEALTH_BYTES)
            if health is None:
                continue
            if not self._check_health(health):
                yield Step(RESET, REBOOT_S)
                health = yield Step(GET_HEALTH, ANSWER_S, HEALTH, HEALTH_BYTES)
                if health is None or not self._check_health(health):
                    yield Step(b"", FAULT_PAUSE_S)
                    continue
            periods = yield Step(GET_SAMPLERATE, ANSWER_S, SAMPLERATE, 4)
            if self._config.mode != "standard":
                answer = yield Step(START_EXPRESS, START_S, EXPRESS_STREAM)
                if answer is not None:
                    period_s = _period_s(periods, 2, EXPRESS_S)
                    self._restart(CapsuleDecoder(self._counts, period_s))
                    return
                yield Step(STOP, DRAIN_S)
            if self._config.mode == "express":
                continue
            answer = yield Step(START_STANDARD, START_S, STANDARD_STREAM)
            if answer is not None:
                period_s = _period_s(periods, 0, STANDARD_S)
                self._restart(StandardDecoder(self._counts, period_s))
                return


def _period_s(periods: bytes | None, at: int, usual_s: float) -> float:
    """Return the time between two samples as the sensor says it, if that can be."""
    if periods is None:
        return usual_s
    said_s = int.from_bytes(periods[at : at + 2], "little") * 1e-6
    return said_s if BELIEVED_S[0] <= said_s <= BELIEVED_S[1] else usual_s


def _is_a1(number: int) -> bool:
    return number >> 4 == A1_SERIES


def _other_model(number: int) -> tuple[str, str]:
    series = number >> 4
    title = f"RPLIDAR A{series}" if series in (2, 3) else f"RPLIDAR (model 0x{number:02X})"
    return (
        title,
        f"Trolley has no driver for the {title}; `rplidar_a1` with mode standard may work.",
    )


DRIVERS: dict[LidarModel, LidarDriver] = {
    "rplidar_a1": LidarDriver(
        FACTS,
        RplidarA1,
        identity=Identity(
            stop=(STOP,),
            get_info=GET_INFO,
            get_health=GET_HEALTH,
            is_model=_is_a1,
            other_model=_other_model,
            serial=lambda numbers: numbers.hex().upper(),
        ),
        linorobot_names=("rplidar",),
        ros_packages=("rplidar_ros",),
    )
}
