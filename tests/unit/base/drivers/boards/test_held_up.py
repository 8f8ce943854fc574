"""A board whose reports were held up, by a busy computer or by its line, is not accused.

Base judges motor boards by what they report; here are sound boards that obey, whose reports come
late and then faster than they were made, and the rules by which base judges them.
"""

from collections.abc import Callable
from typing import Any, cast

import pytest
from support.emulated_boards import EMULATORS, MS, START_NS, EmulatedTalk, dialogue_of

from trolley.geometry import Twist2D
from trolley_base.emulators.device import Board
from trolley_base.safety.motion_diagnosis import Fault, Finding
from trolley_base.safety.motion_limits import MotionLimits
from trolley_base.safety.motion_supervision import MotionSupervision
from trolley_base.world import STEP_NS, Simulation
from trolley_base.world.faulty_wheels import Trouble

pytestmark = pytest.mark.drives

MakeSimulation = Callable[..., Simulation]
AHEAD = Twist2D(0.2, 0.0, 0.0)
LIMITS = MotionLimits(
    speed=0.5, wz=1.5, acceleration=0.8, deceleration=1.0, angular_acceleration=4.0
)
TICK_NS = 20 * MS


class Line:
    """Holds all bytes for a while, and then lets them go faster than they came.

    Args:
        hold_s: how long it holds them.
        factor: how many times as fast.
    """

    def __init__(self, talk: EmulatedTalk, hold_s: float, factor: float) -> None:
        self._talk = talk
        self._until_ns = talk.now_ns + round(hold_s * 1e9)
        self._factor = factor
        self._held: list[bytes] = []
        self._let_go = 0.0
        talk.spoil = self._pass

    def _pass(self, data: bytes) -> bytes:
        self._held.append(data)
        if self._talk.now_ns < self._until_ns:
            return b""
        self._let_go += self._factor
        count = int(self._let_go)
        self._let_go -= count
        given, self._held = self._held[:count], self._held[count:]
        if not self._held:
            self._let_go = 0.0
        return b"".join(given)


class DeafBoard:
    """A board that hears later what it is told while its world stands still."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self.is_deaf = False
        self._unheard: list[bytes] = []

    def __getattr__(self, name: str) -> Any:
        return getattr(self._board, name)

    def receive(self, data: bytes, now_ns: int) -> None:
        self._unheard.append(data)
        if not self.is_deaf:
            self.hear(now_ns)

    def hear(self, now_ns: int) -> None:
        unheard, self._unheard = self._unheard, []
        for data in unheard:
            self._board.receive(data, now_ns)


class LateTalk(EmulatedTalk):
    """A board and its world that stand still for a while, and then make up for it."""

    def __init__(self, name: str, simulation: Simulation) -> None:
        self.until_ns = 0
        self.factor = 1.0
        self.world_ns = START_NS
        self._steps = 0.0
        self.deaf = DeafBoard(EMULATORS[name]())
        super().__init__(dialogue_of(name), cast("Board", self.deaf), simulation)

    def step(self) -> None:
        self.now_ns += STEP_NS
        self.deaf.is_deaf = self.now_ns < self.until_ns
        if self.deaf.is_deaf:
            return
        self.deaf.hear(self.now_ns)
        self._steps += self.factor
        while self._steps >= 1.0 and self.world_ns < self.now_ns:
            self._steps -= 1.0
            twist = self.board.motors.driven(self.board.wheels(), STEP_NS * 1e-9)
            self.simulation.step(twist)
            self.world_ns += STEP_NS
            self.board.step(self.simulation, self.world_ns - STEP_NS, self.world_ns)
        self._steps = min(self._steps, 1.0)
        self._collect()


class Judged:
    """Drives a board as base does: not while its link is down; and judges it."""

    def __init__(self, talk: EmulatedTalk) -> None:
        self.talk = talk
        self.supervision = MotionSupervision(LIMITS, 0.12)
        self.findings: list[tuple[float, Finding]] = []
        self.wanted = AHEAD

    def run(self, seconds: float) -> None:
        talk = self.talk
        for _ in range(round(seconds * 1e9 / TICK_NS)):
            reading = talk.tick()
            self.supervision.take(talk.now_ns, [(motion, None) for motion in reading.motions])
            found = self.supervision.take_finding()
            if found is not None:
                self.findings.append(((talk.now_ns - START_NS) * 1e-9, found))
            is_up = reading.link.state == "up"
            talk.wanted = self.wanted if is_up else Twist2D.zero()
            if is_up:
                self.supervision.command(talk.now_ns, talk.wanted)
            else:
                self.supervision.forget()


@pytest.mark.parametrize("stops", [False, True], ids=["goes on", "is to stop"])
@pytest.mark.parametrize(("hold_s", "factor"), [(0.4, 2.0), (1.1, 2.0), (1.1, 4.0)])
@pytest.mark.parametrize("what", ["line", "world"])
@pytest.mark.parametrize("board", sorted(EMULATORS))
def test_it_is_not_accused(
    simulate: MakeSimulation, board: str, what: str, hold_s: float, factor: float, stops: bool
) -> None:
    talk = LateTalk(board, simulate())
    talk.come_up()
    judged = Judged(talk)
    judged.run(1.0)
    if what == "line":
        Line(talk, hold_s, factor)
    else:
        talk.until_ns, talk.factor = talk.now_ns + round(hold_s * 1e9), factor
    judged.run(0.5 * hold_s)
    if stops:
        judged.wanted = Twist2D.zero()
    judged.run(0.5 * hold_s + 4.0)
    assert judged.findings == []


@pytest.mark.parametrize("board", ["create2", "waveshare_ugv"])
def test_one_that_ignores_a_stop_is_found_after_its_reports_were_held_up(
    simulate: MakeSimulation, board: str
) -> None:
    talk = LateTalk(board, simulate())
    talk.come_up()
    judged = Judged(talk)
    judged.run(1.0)
    Line(talk, 0.4, 4.0)
    talk.board.motors.trouble = Trouble(goes_on=True)
    judged.wanted = Twist2D.zero()
    began_ns = talk.now_ns
    judged.run(2.5)
    assert judged.findings
    at_s, finding = judged.findings[0]
    assert finding.fault >= Fault.GOES_ON
    assert at_s - (began_ns - START_NS) * 1e-9 < 2.0


@pytest.mark.parametrize("board", ["create2", "waveshare_ugv"])
def test_reports_that_stall_again_and_again_hide_no_fault_for_long(
    simulate: MakeSimulation, board: str
) -> None:
    talk = LateTalk(board, simulate())
    talk.come_up()
    judged = Judged(talk)
    judged.run(1.0)
    talk.board.motors.trouble = Trouble(goes_on=True)
    judged.wanted = Twist2D.zero()
    began_ns = talk.now_ns
    for _ in range(18):
        Line(talk, 0.25, 100.0)
        judged.run(0.3)
    assert any(
        finding.fault >= Fault.GOES_ON and at_s - (began_ns - START_NS) * 1e-9 < 5.0
        for at_s, finding in judged.findings
    )


@pytest.mark.parametrize("what", ["line", "world"])
@pytest.mark.parametrize("board", sorted(EMULATORS))
def test_one_whose_reports_stall_again_and_again_is_not_accused(
    simulate: MakeSimulation, board: str, what: str
) -> None:
    talk = LateTalk(board, simulate())
    talk.come_up()
    judged = Judged(talk)
    judged.run(1.0)
    for _ in range(20):
        if what == "line":
            Line(talk, 0.4, 100.0)
        else:
            talk.until_ns, talk.factor = talk.now_ns + 400 * MS, 4.0
        judged.run(0.5)
    assert judged.findings == []


@pytest.mark.parametrize("board", ["create2", "waveshare_ugv"])
def test_one_that_is_pushed_from_rest_while_reports_are_held_up_does_not_go_on(
    simulate: MakeSimulation, board: str
) -> None:
    talk = LateTalk(board, simulate())
    talk.come_up()
    judged = Judged(talk)
    judged.wanted = Twist2D.zero()
    judged.run(2.0)
    Line(talk, 0.25, 100.0)
    talk.board.motors.trouble = Trouble(pushed=0.4)
    judged.run(2.0)
    assert {finding.fault for _, finding in judged.findings} == {Fault.MOVES}
