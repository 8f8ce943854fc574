"""Lidar dialogues driven through simulated time: a device that answers, and what came of it."""

from collections import Counter
from collections.abc import Iterable
from typing import Any

from bench.base.lidars.catalogue import RECORDS
from bench.base.lidars.record import chunks
from bench.base.lidars.rplidar import EXPRESS

from trolley.config.hardware import LidarConfig
from trolley_base.drivers.dialogue import LidarDialogue, Status
from trolley_base.drivers.interface import LidarScan
from trolley_base.drivers.lidars import make_lidar

START_NS = 1_790_000_000 * 10**9
TICK_NS = 20_000_000
HEALTH = bytes.fromhex("A55A03000000 06")


class Silent:
    """A device that has nothing to say to what it is told."""

    streams = True

    def __init__(self) -> None:
        self.heard: list[bytes] = []

    def hear(self, data: bytes, now_ns: int) -> bytes:
        """Take what the dialogue wrote; return the answer."""
        del now_ns
        if data:
            self.heard.append(data)
        return b""


class Asked:
    """A lidar that streams when it is told to, strict about what it is asked.

    Args:
        title: of its record.
    """

    def __init__(self, title: str) -> None:
        record = RECORDS[title]
        self.answers, self.start = dict(record.answers), dict(record.begins)
        self._stop = record.ends
        self.streams = False
        self.heard: list[bytes] = []

    def hear(self, data: bytes, now_ns: int) -> bytes:
        del now_ns
        if not data:
            return b""
        self.heard.append(data)
        if data in self.start:
            self.streams = True
            return self.start[data]
        if data in self._stop:
            self.streams = False
            return b""
        # While it streams a question is answered in the middle of the stream, as real ones do.
        return self.answers.get(data, b"")


def rplidar(*, express: bool = True, health: bytes = bytes(3), model: int = 0x18) -> Asked:
    """An A1, if need be without the express scan, ill, or another model."""
    device = Asked("RPLIDAR A1 express")
    own = bytes([model, 29, 1, 7]) + bytes(16)
    device.answers[b"\xa5\x50"] = bytes.fromhex("A55A14000000 04") + own
    device.answers[b"\xa5\x52"] = HEALTH + health
    if not express:
        del device.start[EXPRESS]
    return device


def ydlidar(health: bytes = bytes(3)) -> Asked:
    """An X4, if need be ill."""
    device = Asked("YDLIDAR X4")
    device.answers[b"\xa5\x92"] = HEALTH + health
    return device


class Session:
    """A dialogue and its device in simulated time.

    Args:
        config: of the lidar.
        device: at the other end.
    """

    def __init__(self, config: LidarConfig, device: Silent | Asked | None = None) -> None:
        self.lidar: LidarDialogue = make_lidar(config)
        self.device = device or Silent()
        self.now_ns = START_NS
        self.stream_ns = START_NS
        self.scans: list[LidarScan] = []
        self.notes: dict[str, str] = {}
        self.counts: Counter[str] = Counter()
        self.lidar.begin(self.now_ns)

    @property
    def status(self) -> Status:
        return self.lidar.status(self.now_ns)

    def wait(self, seconds: float) -> None:
        """Let time pass without a stream."""
        for _ in range(round(seconds * 1e9 / TICK_NS)):
            self._tick()

    def wait_for_stream(self) -> None:
        """Let time pass until the device has been started; at most 10 s."""
        for _ in range(500):
            if self.device.streams:
                return
            self._tick()
        raise AssertionError("the device was never started")

    def hear(self, arrivals: Iterable[tuple[float, bytes]]) -> None:
        """Let bytes arrive: (time from now [s], bytes)."""
        self.stream_ns = self.now_ns
        for at_s, data in arrivals:
            until_ns = self.stream_ns + round(at_s * 1e9)
            while self.now_ns + TICK_NS <= until_ns:
                self._tick()
            self.now_ns = max(self.now_ns, until_ns)
            self.lidar.receive(data, until_ns)
            self._take()

    def _tick(self) -> None:
        self.now_ns += TICK_NS
        answer = self.device.hear(self.lidar.outgoing(self.now_ns), self.now_ns)
        if answer:
            self.lidar.receive(answer, self.now_ns)
        self._take()

    def _take(self) -> None:
        reading = self.lidar.take(self.now_ns)
        self.scans += reading.scans
        self.notes |= {note.kind: note.text for note in reading.notes}
        self.counts.update(reading.counts)


def stream(title: str, seconds: float, chunk_s: float = 0.02) -> list[tuple[float, bytes]]:
    """An honest stream of a record, as it arrives."""
    record = RECORDS[title]
    return chunks(record.stream(), record.baud, seconds, chunk_s)


def started(title: str, **settings: Any) -> Session:
    """A session with an honest device that has been started and is about to stream."""
    record = RECORDS[title]
    settings.setdefault("mode", record.mode)
    device = Asked(title) if record.begins else Silent()
    session = Session(LidarConfig(model=record.model, **settings), device)
    session.wait_for_stream()
    return session
