"""Slamtec RPLIDAR A1: standard scan, 2000 samples a second, and express scan, 4000.

It triangulates. It spins while it scans: a pseudo terminal has no DTR, which switches the motor of
a real one. A new request ends a scan.

Source:
    Slamtec RPLIDAR interface protocol; rplidar_sdk sl_lidar_cmd.h.
"""

import dataclasses
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
from trolley_base.emulators.requests import Request, Requests, descriptor, xor_of
from trolley_base.world import LidarSpec

STANDARD_US, EXPRESS_US = 508, 254
FACTS = LidarFacts(
    baud=115200, turns_hz=5.5, range_min_m=0.15, range_max_m=12.0, sample_s=STANDARD_US * 1e-6
)
INFO = struct.pack("<BBBB", 0x18, 29, 1, 7) + bytes(range(0xA0, 0xB0))
"""Model A1, firmware 1.29, hardware 7, serial number."""
QUALITY = 15
CAPSULE_SAMPLES = 32
MODES = (("Standard", STANDARD_US, 0x81), ("Express", EXPRESS_US, 0x82))


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


class RplidarA1(SpinningLidar):
    """The sensor; see the module."""

    def __init__(self, mount: Mount, errors: LidarSpec, rng: np.random.Generator) -> None:
        super().__init__(FACTS, mount, errors, rng)
        self._requests = Requests()
        self._is_express = self._is_first = False
        self._last_deg = 360.0
        self._capsule: list[tuple[int, int, int, int]] = []

    def restart(self, now_ns: int) -> None:
        """Stand still and wait for a request."""
        self._requests.clear()
        self._halt()

    def receive(self, data: bytes, now_ns: int) -> None:
        """Do what the host asks."""
        for request in self._requests.take(data):
            self._halt()
            self._do(request, now_ns)

    def _do(self, request: Request, now_ns: int) -> None:
        match request.command:
            case 0x20 | 0x21:
                self._send(now_ns, descriptor(5, 0x81, repeats=True))
                self._begin(now_ns, express=False)
            case 0x82 if len(request.payload) == 5 and request.payload[0] < len(MODES):
                self._send(now_ns, descriptor(84, 0x82, repeats=True))
                self._begin(now_ns, express=True)
            case 0x50:
                self._send(now_ns, descriptor(len(INFO), 0x04) + INFO)
            case 0x52:
                self._send(now_ns, descriptor(3, 0x06) + bytes(3))
            case 0x59:
                answer = struct.pack("<HH", STANDARD_US, EXPRESS_US)
                self._send(now_ns, descriptor(4, 0x15) + answer)
            case 0x84 if len(request.payload) >= 4:
                answer = _configuration(request.payload)
                if answer:
                    self._send(now_ns, descriptor(len(answer), 0x20) + answer)
            case _:
                pass

    def _begin(self, now_ns: int, *, express: bool) -> None:
        self._is_express, self._is_first = express, True
        self._last_deg = 360.0
        self._capsule.clear()
        period_us = EXPRESS_US if express else STANDARD_US
        self._spin(now_ns, dataclasses.replace(FACTS, sample_s=period_us * 1e-6))

    def _offset_deg(self, ranges_m: Floats) -> Floats:
        """The beam lags behind the head, by eighths of a degree as the capsules say it."""
        return -np.rint(np.maximum(-triangulation_deg(ranges_m), 0.0) * 8.0) / 8.0

    def _emit(self, samples: Samples) -> None:
        if self._is_express:
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
        while len(self._capsule) >= CAPSULE_SAMPLES:
            full, self._capsule = self._capsule[:CAPSULE_SAMPLES], self._capsule[CAPSULE_SAMPLES:]
            pairs = [(range_mm, lag) for _, _, range_mm, lag in full]
            self._send(full[-1][0], encode_capsule(self._is_first, full[0][1], pairs))
            self._is_first = False


def _configuration(payload: bytes) -> bytes:
    """Answer GET_LIDAR_CONF; nothing to what this firmware does not know."""
    (kind,) = struct.unpack("<I", payload[:4])
    (mode,) = struct.unpack("<H", payload[4:6]) if len(payload) >= 6 else (0,)
    echo = payload[:4]
    if kind == 0x70:
        return echo + struct.pack("<H", len(MODES))
    if kind == 0x7C:
        return echo + struct.pack("<H", 1)
    if mode >= len(MODES):
        return b""
    name, period_us, answer = MODES[mode]
    values = {
        0x71: struct.pack("<I", period_us << 8),
        0x74: struct.pack("<I", round(FACTS.range_max_m) << 8),
        0x75: bytes([answer]),
        0x7F: name.encode() + b"\0",
    }
    return echo + values[kind] if kind in values else b""


LIDARS: dict[str, MakeLidar] = {"rplidar_a1": RplidarA1}
