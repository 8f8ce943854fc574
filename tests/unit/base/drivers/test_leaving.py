"""Who leaves a board that drives on without a host waits until its wheels stand."""

import os
import time
import tty
from collections.abc import Callable, Iterator
from typing import Any, cast

import pytest
from support.emulated_boards import EMULATORS, MS, EmulatedTalk, dialogue_of
from support.waiting import wait_until

from trolley.config.hardware import LidarConfig
from trolley.geometry import Twist2D
from trolley.messages import Link
from trolley.serial_diagnosis import explain
from trolley_base.drivers.boards.hoverboard import STOP
from trolley_base.drivers.lidars import make_lidar
from trolley_base.drivers.real_hardware import RealHardware, SerialChassis
from trolley_base.world import Simulation

MakeSimulation = Callable[..., Simulation]


class TalkLink:
    """What a chassis needs of a link, over an emulated board in simulated time."""

    def __init__(self, talk: EmulatedTalk) -> None:
        self.dialogue = talk.dialogue
        self.is_gone = False
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


FEEDBACK = bytes.fromhex("CD AB 00 00 00 00 00 00 00 00 D8 0E 36 01 00 00 23 A4")


def test_a_driver_that_fails_says_goodbye_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    dialogue = dialogue_of("hoverboard")
    lidar = make_lidar(LidarConfig(model="ld19")), "/dev/no_such_lidar"
    board = dialogue, os.ttyname(slave)
    hardware = RealHardware(board, lidar, 0, lambda now: now, lambda _: None, explain)

    def is_up() -> bool:
        os.write(master, FEEDBACK)
        hardware.advance(time.monotonic_ns())
        return hardware.chassis.read().link.state == "up"

    def fail(_: int) -> bytes:
        raise ArithmeticError("of the driver")

    try:
        wait_until(is_up, "the board is up")
        monkeypatch.setattr(dialogue, "outgoing", fail)
        with pytest.raises(ArithmeticError):
            hardware.close()
        assert os.read(master, 100).endswith(STOP)
    finally:
        os.close(slave)
        os.close(master)
