"""A board's dialogue on the line of its emulator, in a simulated world and simulated time."""

from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np

from trolley.config.hardware import ChassisConfig
from trolley.geometry import Pose2D, Twist2D
from trolley_base.drivers import ChassisReading
from trolley_base.drivers.boards import make_board
from trolley_base.drivers.dialogue import BoardDialogue
from trolley_base.emulators.create2 import Create2
from trolley_base.emulators.device import Board
from trolley_base.emulators.hoverboard import Hoverboard
from trolley_base.emulators.linorobot2 import Linorobot2, Linorobot2Options
from trolley_base.emulators.waveshare_ugv import WaveshareUgv
from trolley_base.world import STEP_NS, Simulation

MS = 1_000_000
START_NS = 1_790_000_000 * 10**9
SETTINGS: dict[str, dict[str, Any]] = {
    "create2": {},
    "hoverboard": {"settings": {"diameter_m": 0.165, "track_m": 0.34}},
    "linorobot2": {},
    "waveshare_ugv": {"settings": {"type": "ugv_rover"}},
}
"""What `[base.chassis]` says besides the board's name."""
EMULATORS: dict[str, Callable[[], Board]] = {
    "create2": lambda: Create2(is_asleep=False),
    "hoverboard": lambda: Hoverboard(is_tank=False, is_voltage=False),
    "linorobot2": lambda: Linorobot2(Linorobot2Options(), np.random.default_rng(1)),
    "waveshare_ugv": lambda: WaveshareUgv("ugv_rover", is_general=False),
}


def config_of(board: str, **more: Any) -> ChassisConfig:
    return msgspec.convert({"board": board, **SETTINGS[board], **more}, ChassisConfig)


def dialogue_of(board: str, **more: Any) -> BoardDialogue:
    return make_board(config_of(board, **more), "differential")


class EmulatedTalk:
    """Both on one line; the dialogue has its turn every 20 ms.

    `wanted` is driven all the time; `is_cut` lets nothing pass; `spoil` changes what the board
    sends.
    """

    def __init__(self, dialogue: BoardDialogue, board: Board, simulation: Simulation) -> None:
        self.dialogue, self.board, self.simulation = dialogue, board, simulation
        self.now_ns = START_NS
        self.wanted = Twist2D.zero()
        self.is_cut = False
        self.spoil: Callable[[bytes], bytes] = lambda data: data
        self.readings: list[ChassisReading] = []
        self.sent: list[tuple[int, bytes]] = []
        self.pose = Pose2D.identity()
        self._came = b""
        board.restart(self.now_ns)
        dialogue.begin(self.now_ns)

    def step(self) -> None:
        """Let 10 ms of the world go by."""
        twist = self.board.motors.driven(self.board.wheels(), STEP_NS * 1e-9)
        self.simulation.step(twist)
        self.now_ns += STEP_NS
        self.board.step(self.simulation, self.now_ns - STEP_NS, self.now_ns)
        self._collect()

    def _collect(self) -> None:
        data = b"".join(frame.data for frame in self.board.take_frames())
        self._came += b"" if self.is_cut else data

    def hear(self) -> None:
        """Let 20 ms go by, and let the dialogue hear what came."""
        self.step()
        self.step()
        data, self._came = self.spoil(self._came), b""
        if not data:
            return
        responder = self.dialogue.line.responder
        answer = b"" if responder is None else responder(data, self.now_ns)
        if answer and not self.is_cut:
            self.board.receive(answer, self.now_ns)
            self._collect()
        self.dialogue.receive(data, self.now_ns)

    def tick(self) -> ChassisReading:
        """Let 20 ms go by, and give the dialogue its turn."""
        self.hear()
        reading = self.dialogue.take(self.now_ns)
        self.readings.append(reading)
        for motion in reading.motions:
            self.pose = self.pose @ motion.previous_T_base
        self.dialogue.drive(self.wanted)
        out = self.dialogue.outgoing(self.now_ns)
        if out:
            self.sent.append((self.now_ns, out))
            if not self.is_cut:
                self.board.receive(out, self.now_ns)
                self._collect()
        return reading

    def run(self, seconds: float) -> ChassisReading:
        for _ in range(round(seconds * 50)):
            self.tick()
        return self.readings[-1]

    def come_up(self) -> None:
        """Until the dialogue says that the board does as it should."""
        for _ in range(500):
            if self.tick().link.state == "up":
                return
        raise AssertionError(self.readings[-1].link)

    @property
    def told(self) -> Twist2D | None:
        """The newest velocity that the board was told."""
        return self.board.commands[-1].twist if self.board.commands else None

    def total(self, name: str) -> int:
        return sum(reading.counts.get(f"chassis/{name}", 0) for reading in self.readings)
