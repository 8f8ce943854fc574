"""Slamtec RPLIDAR A1, A2, A3, C1, S1, S2, S3: the standard scan, and that of its typical mode.

The A series triangulates. An A1 spins while it scans: a pseudo terminal has no DTR, which switches
the motor of a real one. A2 and A3 do not scan before they have been told to spin, C1 and S spin
when a scan begins. A new request ends a scan.

Source:
    Slamtec RPLIDAR interface protocol; rplidar_sdk: sl_lidar_cmd.h, sl_lidar_driver.cpp.
"""

import dataclasses
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from trolley_base.emulators.lidar import (
    Floats,
    LidarFacts,
    MakeLidar,
    Mount,
    Samples,
    SpinningLidar,
    triangulation_deg,
)
from trolley_base.emulators.requests import Request, Requests, descriptor, xor_of
from trolley_base.world import LidarSpec

SERIAL = bytes(range(0xA0, 0xB0))
QUALITY, DENSE_QUALITY = 15, 47
CAPSULE_SAMPLES, ULTRA_SAMPLES, DENSE_SAMPLES, ULTRA_DENSE_SAMPLES = 32, 96, 40, 64
NO_PREDICTION = 0x1FF
ULTRA_SCALE = ((3328, 16384, 4), (1792, 4096, 3), (1280, 2048, 2), (512, 512, 1))
"""From this number on, at this range [mm], steps of 2 to this power [mm]."""


@dataclass(frozen=True, slots=True)
class Mode:
    """What a sensor can do: its name, the time for a sample [us], what it answers with."""

    name: str
    period_us: float
    answer: int


@dataclass(frozen=True, slots=True)
class Model:
    """A sensor.

    Attributes:
        facts: of its line and its head.
        info: model, firmware's minor and major number, hardware.
        modes: the standard one first, the typical one last.
        motor: the command that runs it; None: it is DTR.
    """

    facts: LidarFacts
    info: tuple[int, int, int, int]
    modes: tuple[Mode, ...]
    motor: int | None = None


def _model(
    info: tuple[int, int, int, int],
    line: tuple[int, float, float, float],
    modes: tuple[Mode, ...],
    motor: int | None = None,
) -> Model:
    baud, turns_hz, near_m, far_m = line
    facts = LidarFacts(baud, turns_hz, near_m, far_m, sample_s=modes[0].period_us * 1e-6)
    return Model(facts, info, modes, motor)


PWM, RPM = 0xF0, 0xA8
A1 = _model(
    (0x18, 29, 1, 7),
    (115200, 5.5, 0.15, 12.0),
    (Mode("Standard", 508, 0x81), Mode("Express", 254, 0x82)),
)
A2 = _model(
    (0x2C, 32, 1, 6),
    (256000, 10.0, 0.2, 12.0),
    (Mode("Standard", 252, 0x81), Mode("Express", 126, 0x82), Mode("Boost", 62.5, 0x84)),
    PWM,
)
A3 = _model(
    (0x31, 26, 1, 6),
    (256000, 15.0, 0.2, 25.0),
    (Mode("Standard", 252, 0x81), Mode("Express", 126, 0x82), Mode("Sensitivity", 62.5, 0x84)),
    PWM,
)
C1 = _model(
    (0x41, 1, 1, 18),
    (460800, 10.0, 0.05, 12.0),
    (Mode("Standard", 200, 0x81), Mode("DenseBoost", 200, 0x85)),
    RPM,
)
S1 = _model(
    (0x61, 6, 1, 18),
    (256000, 10.0, 0.1, 40.0),
    (Mode("Standard", 217, 0x81), Mode("Express", 108.5, 0x82)),
    RPM,
)
S2 = _model(
    (0x71, 1, 1, 18),
    (1_000_000, 10.0, 0.05, 30.0),
    (Mode("Standard", 125, 0x81), Mode("DenseBoost", 31.25, 0x85)),
    RPM,
)
S3 = _model(
    (0x81, 1, 1, 18),
    (1_000_000, 10.0, 0.05, 40.0),
    (Mode("Standard", 125, 0x81), Mode("UltraDense", 31.25, 0x86)),
    RPM,
)
FACTS = A1.facts


def encode_sample(is_first: bool, head_64: int, range_mm: int) -> bytes:
    """Make a sample of the standard scan.

    Args:
        is_first: of a turn.
        head_64: angle in 1/64 degrees.
        range_mm: 0 without an echo.
    """
    quality = QUALITY if range_mm else 0
    flags = quality << 2 | (1 if is_first else 2)
    return struct.pack("<BHH", flags, head_64 << 1 | 1, range_mm << 2)


def encode_capsule(is_first: bool, head_64: int, samples: list[tuple[int, int]]) -> bytes:
    """Make a capsule of the express scan.

    Args:
        is_first: the first one of a scan.
        head_64: where the head points at the first sample, in 1/64 degrees.
        samples: 32 of range [mm], and by how much the beam lags behind the head, in 1/8 degrees.
    """
    cabins: list[bytes] = []
    for (one_mm, one_lag), (two_mm, two_lag) in zip(samples[::2], samples[1::2], strict=True):
        one, two = one_mm << 2 | one_lag >> 4, two_mm << 2 | two_lag >> 4
        cabins.append(struct.pack("<HHB", one, two, (two_lag & 15) << 4 | one_lag & 15))
    body = struct.pack("<H", head_64 | (0x8000 if is_first else 0)) + b"".join(cabins)
    check = xor_of(body)
    return bytes([0xA0 | check & 15, 0x50 | check >> 4]) + body


def _checked(body: bytes) -> bytes:
    """Put the halves of the check before what it is of."""
    check = xor_of(body)
    return bytes([0xA0 | check & 15, 0x50 | check >> 4]) + body


def encode_dense(is_first: bool, head_64: int, ranges_mm: Sequence[int]) -> bytes:
    """Make a capsule of the dense scan, of 40 ranges [mm]."""
    start = head_64 | (0x8000 if is_first else 0)
    return _checked(struct.pack("<H40H", start, *ranges_mm))


def pack_ultra_dense(range_mm: int, quality: int) -> int:
    """Make the 20 bits of a sample of the ultra dense scan.

    Args:
        range_mm: 0 without an echo.
        quality: as it stands in the finest scale, below 256.
    """
    for scale, (begins, step, bits) in enumerate(
        ((0, 2, 10), (2046, 3, 11), (8187, 4, 12), (24567, 5, 13))
    ):
        steps = round((range_mm - begins) / step)
        if steps < 1 << bits:
            # One bit for the range is one less for the quality.
            return scale | steps << 2 | (quality >> scale & (1 << 8 - scale) - 1) << 2 + bits
    return 0


def encode_ultra_dense(
    is_first: bool, head_64: int, ranges_mm: Sequence[int], stamp_us: int
) -> bytes:
    """Make a capsule of the ultra dense scan, of 64 ranges [mm]."""
    body = struct.pack("<IHH", stamp_us & 0xFFFFFFFF, 0, head_64 | (0x8000 if is_first else 0))
    packed = [pack_ultra_dense(mm, DENSE_QUALITY if mm else 0) for mm in ranges_mm]
    for one, two in zip(packed[::2], packed[1::2], strict=True):
        body += struct.pack("<HHB", one & 0xFFFF, two & 0xFFFF, one >> 16 | two >> 16 << 4)
    return _checked(body)


def to_scale(range_mm: int) -> int:
    """Return the twelve bits for a range on the ultra scan's scale."""
    for number, begins, power in (
        (3328, 16384, 4),
        (1792, 4096, 3),
        (1280, 2048, 2),
        (512, 512, 1),
    ):
        if range_mm >= begins:
            return min(number + (range_mm - begins >> power), 0xFFF)
    return range_mm


def on_scale(number: int) -> tuple[int, int]:
    """Return range [mm] and power of its step of a number on that scale."""
    for first, begins, power in ULTRA_SCALE:
        if number >= first:
            return begins + (number - first << power), power
    return number, 0


def encode_ultra(is_first: bool, head_64: int, ranges_mm: Sequence[int]) -> bytes:
    """Make a capsule of the ultra scan.

    Args:
        is_first: the first one of a scan.
        head_64: where the head points at the first sample, in 1/64 degrees.
        ranges_mm: 96 of this capsule, and the first of the next.
    """
    words: list[int] = []
    majors = [on_scale(to_scale(mm)) for mm in ranges_mm[::3]]
    for number in range(ULTRA_SAMPLES // 3):
        own, following = majors[number], majors[number + 1]
        base = following if own[0] == 0 else own
        one = _predict(ranges_mm[3 * number + 1], base)
        two = _predict(ranges_mm[3 * number + 2], following)
        words.append(two << 22 | one << 12 | to_scale(ranges_mm[3 * number]))
    start = head_64 | (0x8000 if is_first else 0)
    return _checked(struct.pack("<H32I", start, *words))


def _predict(range_mm: int, base: tuple[int, int]) -> int:
    """Return ten bits that say how much a range differs; that there is none if they cannot."""
    base_mm, power = base
    steps = range_mm - base_mm >> power
    if range_mm == 0 or not -511 <= steps <= 510:
        return NO_PREDICTION
    return steps & 0x3FF


def ultra_lag_deg(ranges_m: Floats) -> Floats:
    """Return by how much the beam of an ultra scan lags behind the head: 8 degrees far away."""
    part = 98361.0 / np.maximum(4000.0 * ranges_m, 1.0)
    lag = 8.0 - np.degrees((64.0 * part + part**3 / 98304.0) / 65536.0)
    return np.where(ranges_m >= 0.05, lag, 7.5)


class Rplidar(SpinningLidar):
    """The sensor; see the module."""

    def __init__(
        self, mount: Mount, errors: LidarSpec, rng: np.random.Generator, model: Model = A1
    ) -> None:
        super().__init__(model.facts, mount, errors, rng)
        self._model = model
        self._requests = Requests()
        self._mode = model.modes[0]
        self._is_first = self._has_speed = False
        self._last_deg = 360.0
        self._capsule: list[tuple[int, int, int, int]] = []

    def restart(self, now_ns: int) -> None:
        """Stand still and wait for a request."""
        self._requests.clear()
        self._has_speed = False
        self._halt()

    def receive(self, data: bytes, now_ns: int) -> None:
        """Do what the host asks."""
        for request in self._requests.take(data):
            if request.command != self._model.motor:
                self._halt()
            self._do(request, now_ns)

    def _do(self, request: Request, now_ns: int) -> None:
        modes = self._model.modes
        match request.command:
            case 0x20 | 0x21:
                self._begin(now_ns, modes[0])
            case 0x82 if len(request.payload) == 5 and request.payload[0] < len(modes):
                # Mode 0 is the standard scan by its number, and the express scan of old hosts.
                express = [mode for mode in modes if mode.answer == 0x82]
                legacy = (express or [modes[-1]])[0]
                self._begin(now_ns, modes[request.payload[0]] if request.payload[0] else legacy)
            case 0x50:
                self._send(
                    now_ns, descriptor(20, 0x04) + struct.pack("<4B", *self._model.info) + SERIAL
                )
            case 0x52:
                self._send(now_ns, descriptor(3, 0x06) + bytes(3))
            case 0x59:
                periods = (round(modes[0].period_us), round(modes[1].period_us))
                self._send(now_ns, descriptor(4, 0x15) + struct.pack("<HH", *periods))
            case 0x84 if len(request.payload) >= 4:
                answer = self._configuration(request.payload)
                if answer:
                    self._send(now_ns, descriptor(len(answer), 0x20) + answer)
            case self._model.motor if len(request.payload) == 2:
                self._has_speed = request.payload != bytes(2)
            case 0xFF if self._model.motor == PWM:
                self._send(now_ns, descriptor(4, 0xFF) + struct.pack("<I", 1))
            case _:
                pass

    def _begin(self, now_ns: int, mode: Mode) -> None:
        if self._model.motor == PWM and not self._has_speed:
            return
        lengths = {0x81: 5, 0x82: 84, 0x84: 132, 0x85: 84, 0x86: 170}
        self._send(now_ns, descriptor(lengths[mode.answer], mode.answer, repeats=True))
        self._mode, self._is_first = mode, True
        self._last_deg = 360.0
        self._capsule.clear()
        self._spin(now_ns, dataclasses.replace(self.facts, sample_s=mode.period_us * 1e-6))

    def _offset_deg(self, ranges_m: Floats) -> Floats:
        """The beam lags behind the head; the capsules of the express scan say it in eighths."""
        if self._model.info[0] >= 0x40:
            return np.zeros_like(ranges_m)
        if self._mode.answer == 0x84:
            return -ultra_lag_deg(ranges_m)
        return -np.rint(np.maximum(-triangulation_deg(ranges_m), 0.0) * 8.0) / 8.0

    def _emit(self, samples: Samples) -> None:
        if self._mode.answer != 0x81:
            self._emit_capsules(samples)
            return
        lags_deg = -self._offset_deg(np.where(samples.ranges_m > 0.0, samples.ranges_m, 12.0))
        beams_64 = np.rint((samples.heads_deg - lags_deg) * 64.0).astype(np.int64) % 23040
        rows = zip(
            samples.times_ns.tolist(),
            samples.heads_deg.tolist(),
            beams_64.tolist(),
            samples.ranges_mm.tolist(),
            strict=True,
        )
        for time_ns, head_deg, beam_64, range_mm in rows:
            self._send(time_ns, encode_sample(head_deg < self._last_deg, beam_64, range_mm))
            self._last_deg = head_deg

    def _emit_capsules(self, samples: Samples) -> None:
        lags = np.rint(
            -8.0 * self._offset_deg(np.where(samples.ranges_m > 0.0, samples.ranges_m, 12.0))
        )
        self._capsule += zip(
            samples.times_ns.tolist(),
            (np.rint(samples.heads_deg * 64.0).astype(np.int64) % 23040).tolist(),
            samples.ranges_mm.tolist(),
            lags.astype(np.int64).tolist(),
            strict=True,
        )
        count, encode = ENCODERS[self._mode.answer]
        # A capsule of the ultra scan needs the first sample of the next.
        needed = count + 1 if self._mode.answer == 0x84 else count
        while len(self._capsule) >= needed:
            full, self._capsule = self._capsule[:needed], self._capsule[count:]
            self._send(full[count - 1][0], encode(self._is_first, full))
            self._is_first = False

    def _configuration(self, payload: bytes) -> bytes:
        """Answer GET_LIDAR_CONF; nothing to what this firmware does not know."""
        (kind,) = struct.unpack("<I", payload[:4])
        (mode,) = struct.unpack("<H", payload[4:6]) if len(payload) >= 6 else (0,)
        echo, modes = payload[:4], self._model.modes
        if kind == 0x70:
            return echo + struct.pack("<H", len(modes))
        if kind == 0x7C:
            return echo + struct.pack("<H", len(modes) - 1)
        if kind == 0x01 and self._model.motor == RPM:
            return echo + struct.pack("<HH", round(60.0 * self.facts.turns_hz), 0)
        if mode >= len(modes):
            return b""
        values = {
            0x71: struct.pack("<I", round(modes[mode].period_us * 256)),
            0x74: struct.pack("<I", round(self.facts.range_max_m) << 8),
            0x75: bytes([modes[mode].answer]),
            0x7F: modes[mode].name.encode() + b"\0",
        }
        return echo + values[kind] if kind in values else b""


Rows = list[tuple[int, int, int, int]]
"""Time [ns], head [1/64 deg], range [mm], lag [1/8 deg]."""
ENCODERS: dict[int, tuple[int, Callable[[bool, Rows], bytes]]] = {
    0x82: (
        CAPSULE_SAMPLES,
        lambda first, rows: encode_capsule(
            first, rows[0][1], [(mm, lag) for _, _, mm, lag in rows]
        ),
    ),
    0x84: (
        ULTRA_SAMPLES,
        lambda first, rows: encode_ultra(first, rows[0][1], [mm for _, _, mm, _ in rows]),
    ),
    0x85: (
        DENSE_SAMPLES,
        lambda first, rows: encode_dense(first, rows[0][1], [mm for _, _, mm, _ in rows]),
    ),
    0x86: (
        ULTRA_DENSE_SAMPLES,
        lambda first, rows: encode_ultra_dense(
            first, rows[0][1], [mm for _, _, mm, _ in rows], rows[0][0] // 1000
        ),
    ),
}
"""By what the scan is called: samples in a capsule, and what makes one."""
LIDARS: dict[str, MakeLidar] = {
    "rplidar_a1": Rplidar,
    "rplidar_a2": partial(Rplidar, model=A2),
    "rplidar_a3": partial(Rplidar, model=A3),
    "rplidar_c1": partial(Rplidar, model=C1),
    "rplidar_s1": partial(Rplidar, model=S1),
    "rplidar_s2": partial(Rplidar, model=S2),
    "rplidar_s3": partial(Rplidar, model=S3),
}
