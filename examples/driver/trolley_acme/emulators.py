"""Both devices as programs: they share nothing with the drivers, so that each checks the other."""

import struct

import numpy as np

from trolley.geometry import Twist2D
from trolley_base.emulators.degree_lidar import DegreeLidar
from trolley_base.emulators.device import Board
from trolley_base.emulators.lidar import LidarFacts, MakeLidar, Mount
from trolley_base.emulators.surroundings import EmulatedBoard
from trolley_base.world import LidarSpec, Simulation

HALF_TRACK_M = 0.1
FIRMWARE_STOPS_NS, REPORTS_NS = 400_000_000, 20_000_000


class AcmeX1(DegreeLidar):
    """The lidar: a sample a degree."""

    def __init__(self, mount: Mount, errors: LidarSpec, rng: np.random.Generator) -> None:
        super().__init__(LidarFacts(460800, 8.0, 0.1, 10.0), 10, mount, errors, rng)

    def _encode(self, index: int, hz: float, ranges_mm: list[int]) -> bytes:
        body = struct.pack("<BBBB10H", 0xAC, 1, index, round(hz * 20.0), *ranges_mm)
        return body + struct.pack("<H", sum(body))


class AcmeM1(Board):
    """The motor board."""

    def __init__(self) -> None:
        super().__init__(115200, HALF_TRACK_M)
        self.restart(0)

    def restart(self, now_ns: int) -> None:
        """Start from scratch."""
        self.motors.stand()
        self._heard = b""
        self._told = Twist2D.zero()
        self._told_ns: int | None = None
        self._reported_ns = now_ns

    def receive(self, data: bytes, now_ns: int) -> None:
        """Obey lines."""
        *lines, self._heard = (self._heard + data).split(b"\n")
        for words in (line.split() for line in lines):
            if words == [b"?"]:
                self._send(now_ns, b"Acme M1 firmware 7\r\n")
            elif len(words) == 3 and words[0] == b"V":
                try:
                    forward, turn = (int(word) * 1e-3 for word in words[1:])
                except ValueError:
                    continue
                self._told, self._told_ns = Twist2D(forward, 0.0, turn), now_ns
                self._keep(now_ns, self._told)

    def wheels(self) -> Twist2D:
        """Return what the motors do."""
        return self._told

    def step(self, simulation: Simulation, from_ns: int, to_ns: int) -> None:
        """Stop without commands, and report."""
        twist = self.motors.counted(simulation.take_motion().twist)
        if self._told_ns is None:
            return
        if to_ns - self._told_ns > FIRMWARE_STOPS_NS:
            self._told = Twist2D.zero()
        if to_ns - self._reported_ns >= REPORTS_NS:
            self._reported_ns = to_ns
            text = f"S {round(twist.vx * 1e3)} {round(twist.wz * 1e3)}\r\n"
            self._send(to_ns, text.encode())


LIDARS: dict[str, MakeLidar] = {"acme_x1": AcmeX1}
BOARDS = {"acme_m1": EmulatedBoard(lambda _options, _around, _rng: AcmeM1())}
