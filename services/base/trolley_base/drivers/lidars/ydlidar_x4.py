"""YDLIDAR X4: 5000 samples a second without intensity, up to 40 a frame; asked to start.

Frame of 10 bytes and 2 for each sample: AA 55, kind (bit 0: a turn begins), number of samples,
angles of the first and the last sample, XOR of all words, samples [mm / 4], 0 for none. An angle
is bit 0 set and above it 1/64 deg. The angles are the head's: the sensor looks from beside its
axis, so where it looked depends on the distance (`triangulation_deg`). A sample without a distance
is taken to have looked where far things are seen.

A revolution begins where the angle passes zero, so the kind is not needed. Frames of no samples, or
of more than 40, are none.

Source:
    YDLIDAR X4 development manual; YDLidar-SDK.
"""

from collections import Counter

import numpy as np

from trolley.config.hardware import LidarConfig, LidarModel
from trolley_base.drivers.dialogue import Line
from trolley_base.drivers.lidars.decoding import Decoded, FrameDecoder, words
from trolley_base.drivers.lidars.frames import Bytes, Flags, FrameFormat, Frames, Indices
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
from trolley_base.drivers.lidars.models import Identity, LidarDriver, LidarFacts
from trolley_base.drivers.lidars.revolutions import Samples
from trolley_base.drivers.lidars.scan_grid import Floats

HEAD_BYTES, MOST_SAMPLES = 10, 40
SAMPLE_S = 1.0 / 5000.0
START, STOP, FORCE_STOP = b"\xa5\x60", b"\xa5\x65", b"\xa5\x00"
GET_INFO, GET_HEALTH = b"\xa5\x90", b"\xa5\x92"
STREAM = bytes.fromhex("A55A 0500 0040 81")
MODEL_NUMBER = 6
SPIN_UP_S, DRAIN_S, START_S, FAULT_PAUSE_S = 0.5, 0.1, 2.0, 5.0
BASELINE_MM, FOCUS_MM = 21.8, 155.3
"""Constants of the triangulation [mm], from the development manual."""

FACTS = LidarFacts(
    title="YDLIDAR X4",
    baud=128000,
    range_min_m=0.12,
    range_max_m=10.0,
    turns_hz=(6.0, 12.0),
    usual_hz=7.0,
)


def _lengths(heads: Bytes) -> Indices:
    samples = heads[:, 3].astype(np.int64)
    is_head = (heads[:, 0] == 0xAA) & (heads[:, 1] == 0x55) & (samples >= 1)
    is_head &= (samples <= MOST_SAMPLES) & ((heads[:, 4] & heads[:, 6] & 1) == 1)
    return np.where(is_head, HEAD_BYTES + 2 * samples, 0)


def _check(frames: Bytes) -> Flags:
    numbers = words(frames)
    ends = HEAD_BYTES // 2 + frames[:, 3].astype(np.int64)
    inside = np.arange(numbers.shape[1], dtype=np.int64) < ends[:, None]
    return np.bitwise_xor.reduce(np.where(inside, numbers, 0), axis=1) == 0


FORMAT = FrameFormat(8, HEAD_BYTES + 2 * MOST_SAMPLES, _lengths, _check)


def triangulation_deg(range_m: Floats) -> Floats:
    """Return what to add to the head's angle for where the sensor looked.

    Args:
        range_m: (n,) what it found, 0 for nothing.

    Source:
        YDLIDAR X4 development manual, second-level angle analysis.
    """
    millimetres = np.where(range_m > 0.0, range_m * 1000.0, 1e6)
    offset = BASELINE_MM * (FOCUS_MM - millimetres) / (FOCUS_MM * millimetres)
    return np.degrees(np.arctan(offset))


class X4Decoder(FrameDecoder):
    """Reads its frames."""

    def __init__(self, counts: Counter[str]) -> None:
        super().__init__(FORMAT, FACTS.usual_hz, counts)
        self._rate_dps = 360.0 * FACTS.usual_hz

    def _samples(self, frames: Frames) -> Decoded:
        numbers = words(frames.data)
        sizes = frames.data[:, 3].astype(np.int64)
        ends_deg = (numbers[:, 2:4] >> 1) / 64.0
        steps_deg = ((ends_deg[:, 1] - ends_deg[:, 0]) % 360.0) / np.maximum(sizes - 1, 1)
        inside = np.arange(MOST_SAMPLES, dtype=np.int64) < sizes[:, None]
        frame, number = np.nonzero(inside)
        angle = (ends_deg[frame, 0] + steps_deg[frame] * number) % 360.0
        range_m = numbers[:, HEAD_BYTES // 2 :][inside] / 4000.0
        rates = self._rates(steps_deg, sizes)
        angle, elapsed_s, begins = self._rotation.follow(angle, rates[frame])
        shift = triangulation_deg(range_m)
        samples = Samples(angle, shift, elapsed_s, begins, range_m, np.empty(0))
        closing = np.cumsum(sizes) - 1
        behind = frames.behind + frames.lengths
        return Decoded(samples, closing, behind, float(rates[-1]) / 360.0)

    def _rates(self, steps_deg: Floats, sizes: Indices) -> Floats:
        """Return how fast the head turned (n,) [deg/s]; a frame of one sample does not tell."""
        tells = np.flatnonzero(sizes > 1)
        known = np.concatenate([[self._rate_dps], steps_deg[tells] / SAMPLE_S])
        rates = known[np.searchsorted(tells, np.arange(len(sizes)), side="right")]
        self._rate_dps = float(known[-1])
        return rates


class YdlidarX4(HandshakeLidar):
    """The sensor; see the module. DTR runs its motor.

    Raises:
        DriverError: the configuration asks for what it cannot do.
    """

    def __init__(self, config: LidarConfig) -> None:
        super().__init__(FACTS, config, X4Decoder)

    @property
    def line(self) -> Line:
        """How the port is opened."""
        return Line(self.baud, dtr=True, dtr_after=False)

    def goodbye(self) -> tuple[bytes, ...]:
        """Stop the scan."""
        return FORCE_STOP, STOP

    def _handshake(self) -> Handshake:
        yield Step(b"", SPIN_UP_S)
        while True:
            yield Step(FORCE_STOP, 0.005)
            yield Step(STOP, DRAIN_S)
            info = yield Step(GET_INFO, ANSWER_S, INFO, INFO_BYTES)
            if info is None:
                continue
            self._check_model(info[0] == MODEL_NUMBER, info[0])
            health = yield Step(GET_HEALTH, ANSWER_S, HEALTH, HEALTH_BYTES)
            if health is None:
                continue
            if not self._check_health(health):
                yield Step(b"", FAULT_PAUSE_S)
                continue
            if (yield Step(START, START_S, STREAM)) is not None:
                self._restart(X4Decoder(self._counts))
                return


def _other_model(number: int) -> tuple[str, str]:
    title = f"YDLIDAR (model {number})"
    return title, f"Trolley has no driver for the {title}."


def _serial(numbers: bytes) -> str:
    """Return 16 numbers from 0 to 9 as the vendor's SDK prints them."""
    return "".join(f"{digit:X}" for digit in numbers)


DRIVERS: dict[LidarModel, LidarDriver] = {
    "ydlidar_x4": LidarDriver(
        FACTS,
        YdlidarX4,
        identity=Identity(
            stop=(FORCE_STOP, STOP),
            get_info=GET_INFO,
            get_health=GET_HEALTH,
            other_model=_other_model,
            serial=_serial,
        ),
        is_model=lambda number: number == MODEL_NUMBER,
        linorobot_names=("ydlidar",),
        ros_packages=("ydlidar", "ydlidar_ros", "ydlidar_ros_driver"),
    )
}
