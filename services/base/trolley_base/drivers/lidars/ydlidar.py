"""YDLIDAR X2, X4, X4 Pro, G2, G4 and T-mini: up to 40 samples a frame (G4: 80).

X2 and X4 Pro stream as soon as they have power and hear nothing; the others are asked to start.

Frame of 10 bytes and the samples: AA 55, kind (bit 0: a turn begins), number of samples, angles of
the first and the last sample, XOR of all words, samples. An angle is bit 0 set and above it 1/64
deg. A sample is a distance [mm / 4], 0 for none; of G2 and T-mini it is an intensity of one byte
and a distance whose two lowest bits tell of interference, and the byte counts as a word of its own
in the XOR.

All but the T-mini triangulate: their angles are the head's, the sensor looks from beside its axis,
so where it looked depends on the distance (`triangulation_deg`). A sample without a distance is
taken to have looked where far things are seen.

A revolution begins where the angle passes zero, so the kind is not needed. Frames of no samples, or
of too many, are none.

Source:
    YDLIDAR X4 development manual; YDLidar-SDK.
"""

from collections import Counter
from collections.abc import Generator
from dataclasses import dataclass
from functools import partial

import numpy as np

from trolley.config.hardware import LidarConfig
from trolley.drivers import API
from trolley_base.drivers.dialogue import Line
from trolley_base.drivers.lidars.decoding import Decoded, FrameDecoder, latest, turned_deg, words
from trolley_base.drivers.lidars.frames import Bytes, Flags, FrameFormat, Frames, Indices
from trolley_base.drivers.lidars.handshake import (
    ANSWER_S,
    Handshake,
    HandshakeLidar,
    Step,
)
from trolley_base.drivers.lidars.models import Identity, LidarDriver, LidarFacts
from trolley_base.drivers.lidars.revolutions import Samples
from trolley_base.drivers.lidars.scan_grid import Floats
from trolley_base.drivers.lidars.streaming import StreamingLidar

HEAD_BYTES = 10
START, STOP, FORCE_STOP = b"\xa5\x60", b"\xa5\x65", b"\xa5\x00"
GET_INFO, GET_HEALTH, GET_RATE = b"\xa5\x90", b"\xa5\x92", b"\xa5\xd1"
STREAM = bytes.fromhex("A55A 0500 0040 81")
RATE = bytes.fromhex("A55A 0100 0000 04")
RATES_PER_S = {0: 4000.0, 1: 8000.0, 2: 9000.0, 3: 10_000.0}
"""What the answer of a G4 to `GET_RATE` says."""
SPIN_UP_S, DRAIN_S, START_S, FAULT_PAUSE_S = 0.5, 0.1, 2.0, 5.0
BASELINE_MM, FOCUS_MM = 21.8, 155.3
"""Constants of the triangulation [mm], from the development manual."""
INTERFERENCE = 3


def _lengths(heads: Bytes, sample_bytes: int, most: int) -> Indices:
    samples = heads[:, 3].astype(np.int64)
    is_head = (heads[:, 0] == 0xAA) & (heads[:, 1] == 0x55) & (samples >= 1)
    is_head &= (samples <= most) & ((heads[:, 4] & heads[:, 6] & 1) == 1)
    return np.where(is_head, HEAD_BYTES + sample_bytes * samples, 0)


def _check(frames: Bytes, sample_bytes: int) -> Flags:
    most = (frames.shape[1] - HEAD_BYTES) // sample_bytes
    samples = frames[:, HEAD_BYTES:].reshape(len(frames), most, sample_bytes)
    inside: Flags = np.arange(most, dtype=np.int64) < frames[:, 3:4]
    summed = np.bitwise_xor.reduce(words(frames[:, :HEAD_BYTES]), axis=1)
    # A distance is the last two bytes of a sample.
    distances = words(samples[:, :, -2:])[:, :, 0]
    summed ^= np.bitwise_xor.reduce(np.where(inside, distances, 0), axis=1)
    if sample_bytes > 2:
        summed ^= np.bitwise_xor.reduce(np.where(inside, samples[:, :, 0], 0), axis=1)
    return summed == 0


def _form(sample_bytes: int, most: int) -> FrameFormat:
    return FrameFormat(
        8,
        HEAD_BYTES + sample_bytes * most,
        partial(_lengths, sample_bytes=sample_bytes, most=most),
        partial(_check, sample_bytes=sample_bytes),
    )


FORMAT, FORMAT_G4, FORMAT_WITH_INTENSITY = _form(2, 40), _form(2, 80), _form(3, 40)


@dataclass(frozen=True, slots=True)
class Kind:
    """What makes the models differ.

    Attributes:
        facts: of the model.
        form: of its frames.
        per_s: samples a second.
        numbers: what it may call itself; (): it says nothing, for it hears nothing.
        triangulates: whether it looks from beside its axis.
        tells_rate: whether it can be asked how many samples a second it takes.
    """

    facts: LidarFacts
    form: FrameFormat
    per_s: float
    numbers: tuple[int, ...] = ()
    triangulates: bool = True
    tells_rate: bool = False

    def has(self, model: int) -> bool:
        """Say whether a model number is its own."""
        return model in self.numbers


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


class YdDecoder(FrameDecoder):
    """Reads its frames.

    Args:
        kind: of the sensor.
        counts: what goes wrong is added here.
        per_s: samples a second, where the sensor has said it.
    """

    def __init__(self, kind: Kind, counts: Counter[str], per_s: float | None = None) -> None:
        super().__init__(kind.form, kind.facts.usual_hz, counts)
        self._kind = kind
        self._per_s = per_s or kind.per_s
        self._rate_dps = 360.0 * kind.facts.usual_hz

    def _samples(self, frames: Frames) -> Decoded:
        sizes = frames.data[:, 3].astype(np.int64)
        ends_deg = (words(frames.data[:, 4:8]) >> 1) / 64.0
        steps_deg = turned_deg(*ends_deg.T) / np.maximum(sizes - 1, 1)
        has_intensity = self._kind.form is FORMAT_WITH_INTENSITY
        body = frames.data[:, HEAD_BYTES:]
        parts = body.reshape(len(frames), -1, 3 if has_intensity else 2)
        inside = np.arange(parts.shape[1], dtype=np.int64) < sizes[:, None]
        frame, number = np.nonzero(inside)
        angle = (ends_deg[frame, 0] + steps_deg[frame] * number) % 360.0
        quarters = words(parts[:, :, -2:])[:, :, 0][inside]
        if has_intensity:
            quarters &= ~np.uint16(INTERFERENCE)
        intensity = parts[:, :, 0][inside].astype(np.float64) if has_intensity else np.empty(0)
        range_m = quarters / 4000.0
        # A frame of one sample does not tell how fast the head turned.
        rates = latest(self._rate_dps, sizes > 1, steps_deg * self._per_s)
        self._rate_dps = float(rates[-1])
        angle, elapsed_s, begins = self._rotation.follow(angle, rates[frame])
        shift = triangulation_deg(range_m) if self._kind.triangulates else np.zeros(len(angle))
        samples = Samples(angle, shift, elapsed_s, begins, range_m, intensity)
        closing = np.cumsum(sizes) - 1
        behind = frames.behind + frames.lengths
        return Decoded(samples, closing, behind, self._rate_dps / 360.0)


class AskedYdlidar(HandshakeLidar):
    """A sensor that is asked to start; see the module. DTR runs the motor of an X4.

    Raises:
        DriverError: the configuration asks for what it cannot do.
    """

    def __init__(self, kind: Kind, config: LidarConfig) -> None:
        self._kind = kind
        super().__init__(kind.facts, config, partial(YdDecoder, kind))

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
            answers = yield from self._ask_who(GET_INFO, GET_HEALTH, self._kind.has)
            if answers is None:
                continue
            _, is_well = answers
            if not is_well:
                yield Step(b"", FAULT_PAUSE_S)
                continue
            per_s = (yield from self._ask_rate()) if self._kind.tells_rate else None
            if (yield Step(START, START_S, STREAM)) is not None:
                self._restart(YdDecoder(self._kind, self._counts, per_s))
                return

    def _ask_rate(self) -> Generator[Step, bytes | None, float | None]:
        answer = yield Step(GET_RATE, ANSWER_S, RATE, 1)
        return None if answer is None else RATES_PER_S.get(answer[0])


class TalkingYdlidar(StreamingLidar):
    """A sensor that hears nothing; see the module. DTR switches the supply of its motor.

    Raises:
        DriverError: the configuration asks for what it cannot do.
    """

    def __init__(self, kind: Kind, config: LidarConfig) -> None:
        super().__init__(kind.facts, config, partial(YdDecoder, kind))

    @property
    def line(self) -> Line:
        """How the port is opened."""
        return Line(self.baud, dtr=True, dtr_after=False)


def _other_model(number: int) -> tuple[str, str]:
    title = f"YDLIDAR (model {number})"
    return title, f"Trolley has no driver for the {title}."


def _serial(numbers: bytes) -> str:
    """Return 16 numbers from 0 to 9 as the vendor's SDK prints them."""
    return "".join(f"{digit:X}" for digit in numbers)


IDENTITY = Identity(
    stop=(FORCE_STOP, STOP),
    get_info=GET_INFO,
    get_health=GET_HEALTH,
    other_model=_other_model,
    serial=_serial,
)


def _facts(
    title: str,
    baud: int,
    ranges_m: tuple[float, float],
    turns_hz: tuple[float, float],
    usual_hz: float,
) -> LidarFacts:
    return LidarFacts(title, baud, *ranges_m, turns_hz, usual_hz)


KINDS: dict[str, Kind] = {
    "ydlidar_x4": Kind(
        _facts("YDLIDAR X4", 128000, (0.12, 10.0), (6.0, 12.0), 7.0), FORMAT, 5000.0, (6,)
    ),
    "ydlidar_x4_pro": Kind(
        _facts("YDLIDAR X4 Pro", 128000, (0.12, 10.0), (5.0, 12.0), 7.0), FORMAT, 5000.0
    ),
    "ydlidar_x2": Kind(_facts("YDLIDAR X2", 115200, (0.1, 8.0), (4.0, 8.0), 6.0), FORMAT, 3000.0),
    "ydlidar_g2": Kind(
        _facts("YDLIDAR G2", 230400, (0.12, 16.0), (5.0, 12.0), 7.0),
        FORMAT_WITH_INTENSITY,
        5000.0,
        (15,),
    ),
    "ydlidar_g4": Kind(
        _facts("YDLIDAR G4", 230400, (0.12, 16.0), (5.0, 12.0), 7.0),
        FORMAT_G4,
        9000.0,
        (5,),
        tells_rate=True,
    ),
    "ydlidar_tmini": Kind(
        _facts("YDLIDAR T-mini", 230400, (0.05, 12.0), (6.0, 12.0), 10.0),
        FORMAT_WITH_INTENSITY,
        4000.0,
        (140, 150, 151),
        triangulates=False,
    ),
}


PAGES = {
    "ydlidar_x4": "ydlidar-x4.md",
    "ydlidar_g2": "ydlidar-g.md",
    "ydlidar_g4": "ydlidar-g.md",
    "ydlidar_tmini": "ydlidar-tmini.md",
}


def _driver(model: str, kind: Kind) -> LidarDriver:
    is_x4 = model == "ydlidar_x4"
    return LidarDriver(
        kind.facts,
        partial(AskedYdlidar if kind.numbers else TalkingYdlidar, kind),
        frames=kind.form,
        identity=IDENTITY if kind.numbers else None,
        is_model=kind.has,
        linorobot_names=("ydlidar",) if is_x4 else (),
        ros_packages=("ydlidar", "ydlidar_ros", "ydlidar_ros_driver") if is_x4 else (),
        api=API,
        page=PAGES.get(model, "ydlidar-x2.md"),
        emulator="trolley_base.emulators.ydlidar:LIDARS",
    )


DRIVERS: dict[str, LidarDriver] = {model: _driver(model, kind) for model, kind in KINDS.items()}
