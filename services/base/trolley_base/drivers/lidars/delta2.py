"""3irobotix Delta-2A, 2B, 2D and 2G: stream from power-up, a fifteenth or so of a turn in a packet.

Packet, numbers with the high byte first: AA, its length without the sum (16 bits), 01, 61, kind,
length of what follows but the sum (16 bits), speed [1/20 turn/s], and of kind AD an offset of the
angle, the angle of the first sample [0.01 deg], samples of (quality, distance [mm / 4], 0 for
none); then the sum of all bytes before it (16 bits). Kind AE has the speed alone: the head
turns too slowly to measure.

A packet's samples share the angle up to the next packet evenly. Most models divide a turn into 16
packets, the 2G into 15: how many is told by the angles of two packets that follow each other.

Source:
    kaiaai/LDS, LDS_DELTA_2A_115200, _230400, 2B, 2G; it leaves the offset out, and so do we.
"""

from collections import Counter
from functools import partial

import numpy as np

from trolley.config.hardware import LidarConfig
from trolley.drivers import API
from trolley_base.drivers.lidars.decoding import Decoded, FrameDecoder, latest
from trolley_base.drivers.lidars.frames import Bytes, Flags, FrameFormat, Frames, Indices
from trolley_base.drivers.lidars.models import LidarDriver, LidarFacts
from trolley_base.drivers.lidars.revolutions import Samples
from trolley_base.drivers.lidars.scan_grid import Floats
from trolley_base.drivers.lidars.streaming import SILENT_NS, StreamingLidar

HEAD_BYTES, SUM_BYTES = 8, 2
FIRST_SAMPLE = 13
MOST_SAMPLES = 61
SAMPLES, SPEED_ONLY = 0xAD, 0xAE
SPEED_LENGTHS = (1, 5)
"""What follows in a packet with the speed alone: it, perhaps with angles that mean nothing."""
HZ_PER_COUNT = 0.05
USUAL_PACKETS = 16
PACKETS = (10, 24)
"""Into how few and how many packets a turn may be divided."""


def _facts(title: str, baud: int) -> LidarFacts:
    return LidarFacts(
        title=title,
        baud=baud,
        range_min_m=0.13,
        range_max_m=8.0,
        turns_hz=(4.0, 8.0),
        usual_hz=6.0,
        speed_hint="Its motor needs a controller outside the sensor: is it set to 360 rpm?",
    )


FACTS_2A, FACTS_2B = _facts("Delta-2A", 115200), _facts("Delta-2B", 230400)


def _words(data: Bytes) -> Indices:
    """Return (n, 2) bytes as (n,) numbers, the high byte first."""
    return data[:, 0].astype(np.int64) << 8 | data[:, 1]


def _lengths(heads: Bytes) -> Indices:
    packet, body = _words(heads[:, 1:3]), _words(heads[:, 6:8])
    kind = heads[:, 5]
    count, rest = np.divmod(body - 5, 3)
    has_samples = (kind == SAMPLES) & (rest == 0) & (count >= 1) & (count <= MOST_SAMPLES)
    has_speed = (kind == SPEED_ONLY) & np.isin(body, SPEED_LENGTHS)
    is_head = (heads[:, 0] == 0xAA) & (heads[:, 3] == 0x01) & (heads[:, 4] == 0x61)
    is_head &= (packet == HEAD_BYTES + body) & (has_samples | has_speed)
    return np.where(is_head, packet + SUM_BYTES, 0)


def _check(frames: Bytes) -> Flags:
    ends = _words(frames[:, 1:3])
    inside = np.arange(frames.shape[1], dtype=np.int64) < ends[:, None]
    rows = np.arange(len(frames))
    told = frames[rows, ends].astype(np.int64) << 8 | frames[rows, ends + 1]
    return (np.where(inside, frames, 0).sum(axis=1, dtype=np.int64) & 0xFFFF) == told


FORMAT = FrameFormat(HEAD_BYTES, FIRST_SAMPLE + 3 * MOST_SAMPLES + SUM_BYTES, _lengths, _check)


class Delta2Decoder(FrameDecoder):
    """Reads its packets.

    Args:
        facts: of the model.
        counts: what goes wrong is added here.
    """

    def __init__(self, facts: LidarFacts, counts: Counter[str]) -> None:
        super().__init__(FORMAT, facts.usual_hz, counts)
        self._before_deg: float | None = None
        self._packets = float(USUAL_PACKETS)
        self.slow_hz: float | None = None
        """How fast the head turns, where the newest packet says that it is too slow."""

    def decode(self, data: bytes) -> Decoded | None:
        """Return the samples that these bytes complete; None if there are none."""
        frames = self._finder.feed(data)
        if not len(frames):
            return None
        is_slow = frames.data[:, 5] == SPEED_ONLY
        self.slow_hz = float(frames.data[-1, 8]) * HZ_PER_COUNT if is_slow[-1] else None
        good = ~is_slow
        if not good.any():
            self._before_deg = None
            return None
        kept = Frames(
            frames.data[good], frames.lengths[good], frames.behind[good], frames.joins[good]
        )
        return self._samples(kept)

    def _samples(self, frames: Frames) -> Decoded:
        sizes = (frames.lengths - FIRST_SAMPLE - SUM_BYTES) // 3
        first_deg = _words(frames.data[:, 11:13]) / 100.0
        hz = frames.data[:, 8].astype(np.float64) * HZ_PER_COUNT
        body = frames.data[:, FIRST_SAMPLE:-SUM_BYTES].reshape(len(frames), MOST_SAMPLES, 3)
        inside = np.arange(MOST_SAMPLES, dtype=np.int64) < sizes[:, None]
        frame, number = np.nonzero(inside)
        points = body[inside].astype(np.int64)
        step_deg = 360.0 / (self._packets_of(first_deg) * sizes)
        angle = (first_deg[frame] + number * step_deg[frame]) % 360.0
        angle, elapsed_s, begins = self._rotation.follow(angle, 360.0 * hz[frame])
        range_m = (points[:, 1] << 8 | points[:, 2]) / 4000.0
        nowhere = np.zeros(len(angle))
        quality = points[:, 0].astype(np.float64)
        samples = Samples(angle, nowhere, elapsed_s, begins, range_m, quality)
        closing = np.cumsum(sizes) - 1
        return Decoded(samples, closing, frames.behind + frames.lengths, float(hz[-1]))

    def _packets_of(self, first_deg: Floats) -> Floats:
        """Return into how many packets a turn is divided, as of each packet (n,)."""
        before = first_deg[0] if self._before_deg is None else self._before_deg
        steps = np.diff(first_deg, prepend=before) % 360.0
        told = np.rint(360.0 / np.maximum(steps, 1.0))
        packets = latest(self._packets, (told >= PACKETS[0]) & (told <= PACKETS[1]), told)
        self._before_deg, self._packets = float(first_deg[-1]), float(packets[-1])
        return packets


class Delta2(StreamingLidar):
    """The sensor, which only speaks; see the module.

    Raises:
        DriverError: the configuration asks for what it cannot do.
    """

    def __init__(self, facts: LidarFacts, config: LidarConfig) -> None:
        super().__init__(facts, config, partial(Delta2Decoder, facts))

    def _trouble(self, now_ns: int) -> str:
        decoder, is_heard = self._decoder, now_ns - self._bytes_ns <= SILENT_NS
        if is_heard and isinstance(decoder, Delta2Decoder) and decoder.slow_hz is not None:
            return (
                f"The {self.facts.title} turns at {60.0 * decoder.slow_hz:.0f} rpm, too slowly to "
                f"measure. {self.facts.speed_hint}"
            )
        return super()._trouble(now_ns)


def _driver(facts: LidarFacts) -> LidarDriver:
    return LidarDriver(
        facts,
        partial(Delta2, facts),
        frames=FORMAT,
        api=API,
        page="delta-2.md",
        emulator="trolley_base.emulators.delta2:LIDARS",
    )


DRIVERS: dict[str, LidarDriver] = {"delta2a": _driver(FACTS_2A), "delta2b": _driver(FACTS_2B)}
