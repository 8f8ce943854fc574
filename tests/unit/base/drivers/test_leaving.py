"""Who leaves a board that drives on without a host waits until its wheels stand."""

from collections.abc import Callable, Iterator
from typing import Any, cast

import pytest
from support.emulated_boards import EMULATORS, MS, EmulatedTalk, dialogue_of

from trolley.geometry import Twist2D
from trolley.messages import Link
from trolley_base.drivers.real_hardware import SerialChassis
from trolley_base.world import Simulation

MakeSimulation = Callable[..., Simulation]


class TalkLink:
    """What a chassis needs of a link, over an emulated board in simulated time."""

    def __init__(self, talk: EmulatedTalk) -> None:
        self.dialogue = talk.dialogue
        self._talk = talk

    def listen(self, now_ns: int) -> None:
        while self._talk.now_ns < now_ns:
            self._talk.hear()

    def speak(self, now_ns: int) -> None:
        data = self.dialogue.outgoing(now_ns)
        if data and not self._talk.is_cut:
            self._talk.board.receive(data, now_ns)

    def link(self, now_ns: int) -> Link:
        return Link(name="chassis", state=self.dialogue.status(now_ns).state, message="")

    def counts(self, known: dict[str, int]) -> dict[str, int]:
        return known


def leave(talk: EmulatedTalk) -> int:
    """Let a chassis go; return how often it looked."""
    moments: Iterator[int] = iter(range(talk.now_ns + 20 * MS, talk.now_ns + 10**10, 20 * MS))
    looks: list[int] = []

    def clock() -> int:
        looks.append(next(moments))
        return looks[-1]

    chassis = SerialChassis(cast("Any", TalkLink(talk)), talk.now_ns)
    chassis.leave(clock)
    return len(looks)


@pytest.mark.parametrize("board", ["linorobot2", "create2"])
def test_the_wheels_stand_when_it_is_let_go(simulate: MakeSimulation, board: str) -> None:
    talk = EmulatedTalk(dialogue_of(board), EMULATORS[board](), simulate())
    talk.come_up()
    talk.wanted = Twist2D(0.2, 0.0, 0.0)
    talk.run(1.0)
    assert talk.simulation.truth().twist.vx > 0.15
    num_looks = leave(talk)
    if board == "linorobot2":
        assert 0 < num_looks < 60
        talk.is_cut, talk.wanted = True, Twist2D.zero()
        before = talk.simulation.truth().pose
        talk.run(3.0)
        assert talk.simulation.truth().pose.distance_to(before) < 0.01
    else:
        assert num_looks == 0, "what it was told holds"


def test_a_board_that_is_gone_is_not_waited_for(simulate: MakeSimulation) -> None:
    talk = EmulatedTalk(dialogue_of("linorobot2"), EMULATORS["linorobot2"](), simulate())
    talk.come_up()
    talk.is_cut = True
    talk.run(1.0)
    assert leave(talk) == 0
