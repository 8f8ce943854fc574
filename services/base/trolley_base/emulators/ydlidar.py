"""YDLIDAR X4, X4 Pro, X2, G2, G4 and T-mini: up to 40 samples a packet, the G4 80.

All but the T-mini triangulate: their packets tell where the head pointed, the host corrects by the
distance. A turn begins with a packet of one sample. X4 Pro and X2 stream from power-up and hear
nothing. The others spin while they scan, since a pseudo terminal has no DTR.

Source:
    YDLIDAR X4 development manual; YDLidar-SDK.
"""

import struct
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
from trolley_base.emulators.requests import Requests, descriptor, xor_of
from trolley_base.world import LidarSpec

FIRMWARE = (1, 1, 1)
SERIAL = bytes(range(0x30, 0x40))
RATES = {4000: 0, 8000: 1, 9000: 2, 10000: 3}


@dataclass(frozen=True, slots=True)
class Model:
    """A sensor.

    Attributes:
        facts: of its line and its head.
        number: what it says it is; None: it hears nothing.
        most_samples: in a packet.
        has_intensity: each sample has a byte of intensity.
        triangulates: it looks from beside its axis.
    """

    facts: LidarFacts
    number: int | None = None
    most_samples: int = 40
    has_intensity: bool = False
    triangulates: bool = True


X4 = Model(LidarFacts(128000, 8.0, 0.12, 10.0, 1.0 / 5000.0), 6)
X4_PRO = Model(LidarFacts(128000, 7.0, 0.12, 10.0, 1.0 / 5000.0))
X2 = Model(LidarFacts(115200, 6.0, 0.10, 8.0, 1.0 / 3000.0))
G2 = Model(LidarFacts(230400, 7.0, 0.28, 16.0, 1.0 / 5000.0), 15, has_intensity=True)
G4 = Model(LidarFacts(230400, 7.0, 0.28, 16.0, 1.0 / 9000.0), 5, most_samples=80)
T_MINI = Model(
    LidarFacts(230400, 10.0, 0.05, 12.0, 1.0 / 4000.0),
    151,
    has_intensity=True,
    triangulates=False,
)


def encode(zero_hz: float | None, heads_64: tuple[int, int], samples: list[int]) -> bytes:
    """Make a packet.

    Args:
        zero_hz: turns per second, in the packet that begins a turn; None in all others.
        heads_64: where the head pointed at the first and the last sample, in 1/64 degrees.
        samples: distances in 1/4 mm, 0 without an echo.
    """
    kind = 0 if zero_hz is None else round(zero_hz * 10) << 1 | 1
    first, last = (head << 1 | 1 for head in heads_64)
    words = (0x55AA, first, *samples, len(samples) << 8 | kind, last)
    check = xor_of(words)
    head = struct.pack("<HBBHHH", 0x55AA, kind, len(samples), first, last, check)
    return head + struct.pack(f"<{len(samples)}H", *samples)


def encode_with_intensity(
    zero_hz: float | None, heads_64: tuple[int, int], samples: list[tuple[int, int]]
) -> bytes:
    """Make a packet of samples with a byte of intensity each.

    Args:
        zero_hz: as above.
        heads_64: as above.
        samples: intensities, and distances in 1/4 mm whose two lowest bits tell of interference.
    """
    kind = 0 if zero_hz is None else round(zero_hz * 10) << 1 | 1
    first, last = (head << 1 | 1 for head in heads_64)
    check = xor_of((0x55AA, len(samples) << 8 | kind, first, last))
    data = b""
    for intensity, quarter_mm in samples:
        check ^= intensity ^ quarter_mm
        data += struct.pack("<BH", intensity, quarter_mm)
    return struct.pack("<HBBHHH", 0x55AA, kind, len(samples), first, last, check) + data


class Ydlidar(SpinningLidar):
    """The sensor; see the module."""

    def __init__(
        self, mount: Mount, errors: LidarSpec, rng: np.random.Generator, model: Model = X4
    ) -> None:
        super().__init__(model.facts, mount, errors, rng)
        self._model = model
        self._requests = Requests(has_payload=lambda _: False)
        self._last_deg = 360.0
        self._samples: list[tuple[int, int, int]] = []

    def restart(self, now_ns: int) -> None:
        """Stand still and wait for a command, if it hears any."""
        self._requests.clear()
        self._halt()
        if self._model.number is None:
            self._begin(now_ns)

    def receive(self, data: bytes, now_ns: int) -> None:
        """Do what the host asks; while it scans it listens only to being stopped."""
        if self._model.number is None:
            return
        for request in self._requests.take(data):
            command = request.command
            if command in (0x00, 0x65, 0x80):
                self._halt()
            elif self._head is not None:
                continue
            elif command in (0x60, 0x61):
                self._send(now_ns, descriptor(5, 0x81, repeats=True))
                self._begin(now_ns)
            elif command == 0x90:
                info = bytes([self._model.number, *FIRMWARE]) + SERIAL
                self._send(now_ns, descriptor(len(info), 0x04) + info)
            elif command in (0x91, 0x92):  # the manual's, and the maker's SDK's
                self._send(now_ns, descriptor(3, 0x06) + bytes(3))
            elif command == 0xD1 and self._model is G4:
                rate = RATES[round(1.0 / (self.facts.sample_s or 1.0))]
                self._send(now_ns, descriptor(1, 0x04) + bytes([rate]))

    def _begin(self, now_ns: int) -> None:
        self._samples.clear()
        self._last_deg = 360.0
        self._spin(now_ns)

    def _offset_deg(self, ranges_m: Floats) -> Floats:
        return triangulation_deg(ranges_m) if self._model.triangulates else np.zeros_like(ranges_m)

    def _emit(self, samples: Samples) -> None:
        rows = zip(
            samples.times_ns.tolist(),
            samples.heads_deg.tolist(),
            (np.rint(samples.heads_deg * 64.0).astype(np.int64) % 23040).tolist(),
            (samples.ranges_mm * 4).tolist(),
            strict=True,
        )
        for time_ns, head_deg, head_64, quarter_mm in rows:
            if head_deg < self._last_deg:
                self._flush()
                self._send(time_ns, self._encode(samples.hz, (head_64, head_64), [quarter_mm]))
            else:
                self._samples.append((time_ns, head_64, quarter_mm))
            self._last_deg = head_deg
            if len(self._samples) == self._model.most_samples:
                self._flush()

    def _flush(self) -> None:
        if self._samples:
            heads_64 = self._samples[0][1], self._samples[-1][1]
            samples = [quarter_mm for _, _, quarter_mm in self._samples]
            self._send(self._samples[-1][0], self._encode(None, heads_64, samples))
            self._samples = []

    def _encode(
        self, zero_hz: float | None, heads_64: tuple[int, int], quarters: list[int]
    ) -> bytes:
        if not self._model.has_intensity:
            return encode(zero_hz, heads_64, quarters)
        # What is far is faint.
        rows = [(max(20, 225 - one // 400) if one else 0, one) for one in quarters]
        return encode_with_intensity(zero_hz, heads_64, rows)


LIDARS: dict[str, MakeLidar] = {
    "ydlidar_x4": Ydlidar,
    "ydlidar_x4_pro": partial(Ydlidar, model=X4_PRO),
    "ydlidar_x2": partial(Ydlidar, model=X2),
    "ydlidar_g2": partial(Ydlidar, model=G2),
    "ydlidar_g4": partial(Ydlidar, model=G4),
    "ydlidar_tmini": partial(Ydlidar, model=T_MINI),
}
