"""A board in a simulated room: time goes by, what it sends is taken apart by hand."""

import struct
from collections.abc import Iterator

from trolley_base.emulators.device import Board
from trolley_base.world import STEP_NS, Simulation

MS = 1_000_000


class Bench:
    """A board and its world."""

    def __init__(self, board: Board, simulation: Simulation) -> None:
        self.board = board
        self.simulation = simulation
        self.now_ns = 0
        self.sent: list[tuple[int, bytes]] = []

    def wait(self, seconds: float) -> list[tuple[int, bytes]]:
        """Let time go by; what was sent in it."""
        self.sent = []
        for _ in range(round(seconds * 100)):
            self.simulation.step(self.board.wheels())
            self.now_ns += STEP_NS
            self.board.step(self.simulation, self.now_ns - STEP_NS, self.now_ns)
            self.sent += [(frame.due_ns, frame.data) for frame in self.board.take_frames()]
        return self.sent

    def write(self, data: bytes) -> bytes:
        """What it answers at once."""
        self.board.receive(data, self.now_ns)
        return b"".join(frame.data for frame in self.board.take_frames())


def messages(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Topic and payload of frames that follow each other without a gap, both checksums right."""
    while data:
        sync, version, size, size_check, topic = struct.unpack("<BBHBH", data[:7])
        assert (sync, version) == (0xFF, 0xFE)
        assert (data[2] + data[3] + size_check) % 256 == 255
        assert (sum(data[5 : 7 + size]) + data[7 + size]) % 256 == 255
        yield topic, data[7 : 7 + size]
        data = data[8 + size :]
