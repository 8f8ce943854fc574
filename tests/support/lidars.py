"""Lidar dialogues driven through simulated time: a device that answers, and what came of it."""

import struct
from collections import Counter
from collections.abc import Iterable

from bench.base.decoding import TYPICAL, YDLIDARS, answers_of
from bench.base.lidar_streams import STREAMS, chunks

from trolley.config.hardware import LidarConfig
from trolley_base.drivers.dialogue import LidarDialogue, Status
from trolley_base.drivers.interface import LidarScan
from trolley_base.drivers.lidars import make_lidar

START_NS = 1_790_000_000 * 10**9
TICK_NS = 20_000_000
INFO, HEALTH, RATES = (
    bytes.fromhex(text) for text in ("A55A14000000 04", "A55A03000000 06", "A55A04000000 15")
)
SCAN_STREAM, EXPRESS_STREAM = (
    bytes.fromhex(text) for text in ("A55A05000040 81", "A55A54000040 82")
)


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
    """A lidar of the Slamtec kind, strict about what it is asked.

    Args:
        answers: by request.
        start: requests that start the stream, with their answers.
        stop: requests that stop it.
    """

    def __init__(
        self, answers: dict[bytes, bytes], start: dict[bytes, bytes], stop: set[bytes]
    ) -> None:
        self.answers, self.start, self._stop = answers, start, stop
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
    answers = {
        b"\xa5\x50": INFO + bytes([model, 29, 1, 7]) + bytes(16),
        b"\xa5\x52": HEALTH + health,
        b"\xa5\x59": RATES + struct.pack("<HH", 508, 254),
    }
    start = {b"\xa5\x20": SCAN_STREAM}
    if express:
        start[bytes.fromhex("A58205000000000022")] = EXPRESS_STREAM
    return Asked(answers, start, {b"\xa5\x25", b"\xa5\x40"})


def ydlidar(others: dict[bytes, bytes] | None = None, health: bytes = bytes(3)) -> Asked:
    answers = {
        b"\xa5\x90": INFO + bytes([6, 1, 1, 1]) + bytes(16),
        b"\xa5\x92": HEALTH + health,
    } | (others or {})
    return Asked(answers, {b"\xa5\x60": SCAN_STREAM}, {b"\xa5\x00", b"\xa5\x65"})


def slamtec(title: str) -> Asked:
    """One that is asked for its typical mode."""
    answers = answers_of(title)
    start = {asked: said for asked, said in answers.items() if said[5] & 0x40}
    return Asked(answers, start, {b"\xa5\x25", b"\xa5\x40"})


def hokuyo() -> Asked:
    """One that speaks SCIP 2.0."""
    answers = answers_of("Hokuyo URG")
    start = {asked: said for asked, said in answers.items() if asked.startswith(b"MD")}
    return Asked(answers, start, {b"\nQT\n", b"QT\n"})


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
    """An honest stream of `lidar_streams`, as it arrives."""
    _, baud, make = STREAMS[title]
    return chunks(make(), baud, seconds, chunk_s)


def started(title: str, **settings: object) -> Session:
    """A session with an honest device that has been started and is about to stream."""
    model = STREAMS[title][0]
    if title == "RPLIDAR A1 standard":
        settings.setdefault("mode", "standard")
    device = {"rplidar_a1": rplidar, "ydlidar_x4": ydlidar, "hokuyo_urg": hokuyo}.get(
        model, Silent
    )()
    if title in TYPICAL:
        device = slamtec(title)
    elif title in YDLIDARS:
        device = ydlidar(answers_of(title))
    session = Session(LidarConfig(model=model, **settings), device)  # pyright: ignore[reportArgumentType]
    session.wait_for_stream()
    return session
