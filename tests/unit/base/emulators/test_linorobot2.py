"""linorobot2's firmware, from the agent's side: bytes that were put together by hand."""

import struct
from collections.abc import Callable

import numpy as np
import pytest

from trolley_base.emulators.linorobot2 import Linorobot2, Linorobot2Options
from trolley_base.emulators.micro_ros import Cdr, FrameReceiver, crc_of, framed, part
from trolley_base.world import Simulation

from .boards import Bench

MakeSimulation = Callable[..., Simulation]
PONG = framed(
    bytes.fromhex("80000000 06011C00 000AFFFD 0000 010D 58524345 0100010F 00")
    + bytes.fromhex("010D 00 0100 0000 00000000")
)
STATUS_AGENT = framed(bytes.fromhex("81000000 04010B00 0000 58524345 0100010F 00"))


class Agent:
    """Answers everything a board wants, and remembers it."""

    def __init__(self, board: Linorobot2, simulation: Simulation) -> None:
        self.bench = Bench(board, simulation)
        board.restart(0)
        self._receiver = FrameReceiver()
        self.messages: list[bytes] = []
        self.unanswered: set[int] = set()
        self._number = 0

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 100)):
            data = b"".join(data for _, data in self.bench.wait(0.01))
            while data:
                answers = [self._answer(message) for message in self._receiver.take(data)]
                data = self.bench.write(b"".join(answers))

    def _answer(self, message: bytes) -> bytes:
        self.messages.append(message)
        kind, payload = message[4], message[8:]
        if kind in self.unanswered:
            return b""
        if kind == 2:
            return PONG
        if kind == 0:
            self._number = 0
            return STATUS_AGENT
        if kind == 14:
            now = struct.pack("<iI", 1000, 0)
            return framed(b"\x81\0\0\0" + part(15, now + now + payload[:8]))
        answer = b""
        if message[1] == 0x80:
            following = struct.pack("<H", struct.unpack_from("<H", message, 2)[0] + 1)
            answer = framed(b"\x81\0\0\0" + part(10, following + b"\0\0\x80"))
        if kind == 1:
            answer += self.reliably(part(5, payload[:4] + b"\0\0"))
        return answer

    def reliably(self, data: bytes) -> bytes:
        number, self._number = self._number, self._number + 1
        return framed(b"\x81\x80" + struct.pack("<H", number) + data)

    def drive(self, vx: float) -> None:
        body = struct.pack("<6d", vx, 0, 0, 0, 0, 0)
        self.bench.write(self.reliably(part(9, b"\0\x22\0\x06" + body)))


def agent(simulate: MakeSimulation, **built: bool) -> Agent:
    return Agent(Linorobot2(Linorobot2Options(**built), np.random.default_rng(3)), simulate())


def test_its_sum_and_its_frames_are_those_of_the_c_library() -> None:
    assert crc_of(b"123456789") == 0xBB3D
    ping = bytes.fromhex("80000000 02010800 000AFFFD 02000000")
    assert framed(ping) == bytes.fromhex("7E00001000") + ping + bytes.fromhex("CF12")
    assert FrameReceiver().take(b"\x7d" + framed(b"\x7e\x7d") + b"\0") == [b"\x7e\x7d"]


def test_numbers_lie_at_multiples_of_their_size() -> None:
    assert Cdr().put("B", 1).put("d", 0.0).put("H", 2).text("a").data.hex() == (
        "01" + "00" * 15 + "0200" + "0000" + "02000000" + "6100"
    )


def test_it_looks_for_an_agent_and_creates_its_objects(simulate: MakeSimulation) -> None:
    one = agent(simulate)
    one.run(4.0)
    kinds = [message[4] for message in one.messages]
    assert kinds[:2] == [2, 0]
    created = [message[12] for message in one.messages if message[4] == 1]
    assert created == [1, *[2, 3, 5] * 5, 2, 4, 6]
    assert b"rt/odom/unfiltered\0" in b"".join(one.messages)
    asked = bytes.fromhex("001D 0006 80 00 00 01 FFFF FFFF FFFF 0000")
    assert one.messages[kinds.index(8)][8:] == asked
    assert kinds[kinds.index(8) + 1] == 14
    assert max(map(len, one.messages)) == 508
    assert kinds.count(13) > 40, "odometry comes in fragments"


def test_it_obeys_stops_late_and_drives_on_without_an_agent(simulate: MakeSimulation) -> None:
    one = agent(simulate)
    one.run(4.0)
    board = one.bench.board
    one.drive(0.3)
    one.run(0.1)
    assert board.wheels().vx == pytest.approx(0.3)
    one.run(0.3)
    assert board.wheels().is_zero
    one.drive(0.3)
    one.run(0.05)
    one.unanswered = set(range(16))
    one.run(6.0)
    assert board.wheels().vx == pytest.approx(0.3)
    one.unanswered = set()
    one.run(2.0)
    assert board.wheels().is_zero


def test_where_it_is_not_answered_it_gives_up_until_its_watchdog_restarts_it(
    simulate: MakeSimulation,
) -> None:
    for has_wdt in (True, False):
        one = agent(simulate, has_wdt=has_wdt)
        one.unanswered = {1}
        one.run(4.5)
        one.unanswered = set()
        one.messages.clear()
        one.run(4.0)
        assert not one.messages
        one.run(9.0)
        assert bool(one.messages) == has_wdt
