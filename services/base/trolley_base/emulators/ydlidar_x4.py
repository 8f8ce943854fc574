"""YDLIDAR X4: 5000 samples a second, about 8 turns a second, up to 40 samples a packet.

It triangulates: its packets tell where the head pointed, the host corrects by the distance. A turn
begins with a packet of one sample. It spins while it scans, since a pseudo terminal has no DTR.

Source:
    YDLIDAR X4 development manual; YDLidar-SDK.
"""

import struct

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

FACTS = LidarFacts(
    baud=128000, turns_hz=8.0, range_min_m=0.12, range_max_m=10.0, sample_s=1.0 / 5000.0
)
MOST_SAMPLES = 40
INFO = struct.pack("<BBBB", 0x06, 1, 1, 1) + bytes(range(0x30, 0x40))
"""Model X4, firmware, hardware, serial number."""


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


class YdlidarX4(SpinningLidar):
    """The sensor; see the module."""

    def __init__(self, mount: Mount, errors: LidarSpec, rng: np.random.Generator) -> None:
        super().__init__(FACTS, mount, errors, rng)
        self._requests = Requests(has_payload=lambda _: False)
        self._last_deg = 360.0
        self._samples: list[tuple[int, int, int]] = []

    def restart(self, now_ns: int) -> None:
        """Stand still and wait for a command."""
        self._requests.clear()
        self._halt()

    def receive(self, data: bytes, now_ns: int) -> None:
        """Do what the host asks; while it scans it listens only to being stopped."""
        for request in self._requests.take(data):
            command = request.command
            if command in (0x00, 0x65, 0x80):
                self._halt()
            elif self._head is not None:
                continue
            elif command in (0x60, 0x61):
                self._send(now_ns, descriptor(5, 0x81, repeats=True))
                self._samples.clear()
                self._last_deg = 360.0
                self._spin(now_ns)
            elif command == 0x90:
                self._send(now_ns, descriptor(len(INFO), 0x04) + INFO)
            elif command == 0x92:
                self._send(now_ns, descriptor(3, 0x06) + bytes(3))

    def _offset_deg(self, ranges_m: Floats) -> Floats:
        return triangulation_deg(ranges_m)

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
                self._send(time_ns, encode(samples.hz, (head_64, head_64), [quarter_mm]))
            else:
                self._samples.append((time_ns, head_64, quarter_mm))
            self._last_deg = head_deg
            if len(self._samples) == MOST_SAMPLES:
                self._flush()

    def _flush(self) -> None:
        if self._samples:
            heads_64 = self._samples[0][1], self._samples[-1][1]
            samples = [quarter_mm for _, _, quarter_mm in self._samples]
            self._send(self._samples[-1][0], encode(None, heads_64, samples))
            self._samples = []


LIDARS: dict[str, MakeLidar] = {"ydlidar_x4": YdlidarX4}
