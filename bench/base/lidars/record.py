"""What is known of a lidar apart from its driver: its bytes, and a plain decoder of them.

Each family has a module here with a dict `RECORDS` by title, named like that of its driver. What a
record holds was written from the maker's documents, so that driver and emulator can both be judged
by it; nothing here shares code with the drivers, except the two fields that say what is judged.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from trolley_base.drivers.lidars.decoding import Decoder
from trolley_base.drivers.lidars.frames import FrameFormat

BITS_PER_BYTE = 10

Polar = list[tuple[float, float]]
"""Angles [deg] and distances [mm]."""
Length = Callable[[bytes], int | None]
"""Of the first bytes: how long the frame is, 0 for none, None while that cannot be told."""
Make = Callable[[np.random.Generator], list[bytes]]
"""Frames that follow each other, with random distances."""


@dataclass(frozen=True)
class Frame:
    """Bytes that leave the sensor from `at_s` on."""

    at_s: float
    data: bytes


class Finder(Protocol):
    """A plain search for frames."""

    bad: int
    """Frames whose checksum was wrong."""
    skipped: int
    """Bytes that belonged to no frame."""

    def feed(self, data: bytes) -> list[bytes]:
        """Return the frames that these bytes complete."""
        ...


@dataclass(frozen=True)
class Example:
    """Bytes that the maker's documents give, or its rules make, and what they say."""

    data: str
    """In hexadecimal."""
    angle_deg: ArrayLike
    range_m: ArrayLike
    intensity: ArrayLike
    turns_hz: float | None = None


@dataclass(frozen=True)
class Judged:
    """A decoder of the driver's, and frames that follow each other with random distances."""

    decoder: Callable[[Counter[str]], Decoder]
    frames: Make | None = None


class Start(NamedTuple):
    """What makes an emulated lidar stream."""

    command: bytes = b""
    answer: bytes = b""


BY_ITSELF = Start()


@dataclass(frozen=True, kw_only=True)
class LidarRecord:
    """One lidar, or one way in which it measures."""

    model: str
    """What robot.toml calls it."""
    mode: Literal["auto", "standard"] = "auto"
    """The setting of that name."""
    baud: int
    turns_hz: float
    """How fast the head turns."""
    samples_per_s: float
    is_counter_clockwise: bool = False
    beside_deg: float = 0.0
    """How far beside its head it looks; beams are fired while the head points there."""
    most_unseen: float = 0.12
    """Largest share of beams without an echo in a hall of 8 m by 4 m, with 20 degrees masked."""
    sees_deg: tuple[float, float] = (-180.0, 180.0)
    """From where to where it sees, counter-clockwise from ahead."""
    stuck_deg: float = 0.2
    """What its angles span while its head stands: a packet's, where those are fixed."""
    ramp_bytes: int = 0
    """How much the emulated one sends before its head turns evenly, which does not count."""
    is_coarse: bool = False
    """Its maker computes angles coarsely."""
    is_twin: bool = False
    """Differs from another by numbers alone, or takes its time: tried in the slow run."""
    sends_whole_turns: bool = False

    # What it sends.
    stream: Callable[[], Iterator[Frame]]
    """An honest stream at its full rate, in the room of `distance_m`."""
    finder: Callable[[], Finder]
    """Finds its frames."""
    reader: Callable[[], Callable[[bytes], Polar]]
    """Reads the samples of a frame."""
    examples: tuple[Example, ...] = ()

    # What it is told.
    answers: Mapping[bytes, bytes] = field(default_factory=dict[bytes, bytes])
    """What it says to what it is asked before it streams."""
    begins: Mapping[bytes, bytes] = field(default_factory=dict[bytes, bytes])
    """What it says to what starts its stream; empty if it streams by itself."""
    ends: frozenset[bytes] = frozenset()
    """What stops its stream."""
    emulated: Start | None = BY_ITSELF
    """What makes the emulated one stream; None if the emulator sends what another record says."""

    # What is judged.
    form: FrameFormat | None = None
    """How the driver finds its frames; None where another record tries the same."""
    header: bytes = b""
    """What looks like the beginning of a frame for as long as possible."""
    judged: Judged | None = None
    """None where another record tries the same."""


def distance_m(angle_deg: float) -> float:
    """How far it is in a direction of the sensor: a rectangular room, 6 m by 4 m."""
    angle = math.radians(angle_deg)
    return min(3.0 / max(abs(math.cos(angle)), 1e-9), 2.0 / max(abs(math.sin(angle)), 1e-9))


def chunks(
    frames: Iterator[Frame], baud: int, seconds: float, chunk_s: float
) -> list[tuple[float, bytes]]:
    """Cut a stream into what has arrived at each reading: (time of reading [s], bytes)."""
    data, times = bytearray(), []
    line_s = 0.0
    for frame in frames:
        if frame.at_s >= seconds:
            break
        line_s = max(line_s, frame.at_s)
        for _ in frame.data:
            line_s += BITS_PER_BYTE / baud
            times.append(line_s)
        data += frame.data
    edges = np.searchsorted(times, np.arange(1, int(seconds / chunk_s) + 1) * chunk_s, "right")
    found, start = [], 0
    for number, edge in enumerate(edges.tolist()):
        if edge > start:
            found.append(((number + 1) * chunk_s, bytes(data[start:edge])))
        start = edge
    return found


def degree_stream(
    per_frame: int, make: Callable[[int, float, list[int]], bytes], hz: float = 5.0
) -> Iterator[Frame]:
    """A sample in each degree."""
    index = 0
    while True:
        samples = [round(1000 * distance_m(index % 360 + i)) for i in range(per_frame)]
        frame = make(index % 360 // per_frame, 60.0 * hz, samples)
        index += per_frame
        yield Frame((index - 1) / (360.0 * hz), frame)


class PlainFrames:
    """Finds frames: at each position a good frame, or on at the next byte."""

    def __init__(self, length: Length, check: Callable[[bytes], bool]) -> None:
        self._length = length
        self._check = check
        self.held = bytearray()
        self.bad = self.skipped = 0

    def feed(self, data: bytes) -> list[bytes]:
        """Return the frames that these bytes complete."""
        found: list[bytes] = []
        for byte in data:
            self.held.append(byte)
            while self.held:
                length = self._length(bytes(self.held))
                if length is None or len(self.held) < length:
                    break
                frame = bytes(self.held[:length])
                if length and self._check(frame):
                    found.append(frame)
                    del self.held[:length]
                    continue
                self.bad += length > 0
                self.skipped += 1
                del self.held[0]
        return found


def distances(rng: np.random.Generator, most: int, count: int) -> list[int]:
    """Whole numbers of which every fifth or so is 0: nothing came back."""
    found = rng.integers(1, most, count)
    return np.where(rng.random(count) < 0.2, 0, found).tolist()
