"""Motor boards that do not obey, on their serial lines: judged by the emulated robot."""

from collections.abc import Callable
from pathlib import Path

import pytest
from support.metal import Metal
from support.waiting import wait_until

from trolley import codes
from trolley.geometry import Twist2D

pytestmark = pytest.mark.again("a board whose emulator is held up does not obey")

AHEAD, TURN = Twist2D(0.15, 0.0, 0.0), Twist2D(0.0, 0.0, 1.0)
NOT_STOPPED = "NOT STOPPED: the motor board does not obey"


@pytest.fixture
def make_metal(tmp_path: Path, endpoint: str) -> Callable[..., Metal]:
    def make(board: str) -> Metal:
        return Metal(tmp_path, endpoint, board, "ld19")

    return make


def resume(metal: Metal) -> None:
    """Mend the board, and let it drive again when it stands."""
    metal.hand.let_go()
    metal.emulated.fault(f"{metal.board}:ok")
    metal.wait_for_standing()
    wait_until(lambda: metal.state is not None and not metal.state.not_stopped, "base sees it")
    metal.robot.resume()
    metal.wait_for("ok")


def drive_and_go_deaf(metal: Metal) -> None:
    """Let the board hear nothing more while it drives.

    It is tried again where the hand was late just then: the board has heard a zero before.
    """

    def is_driving_deaf() -> bool:
        metal.start_driving(AHEAD)
        metal.emulated.fault(f"{metal.board}:deaf")
        num_before = len(metal.emulated.commands())
        wait_until(lambda: len(metal.emulated.commands()) > num_before + 10, "commands go on")
        if metal.speed > 0.05:
            return True
        metal.emulated.fault(f"{metal.board}:ok")
        return False

    wait_until(is_driving_deaf, "it drives and hears nothing")


def test_a_linorobot_that_does_not_obey_is_told_of(make_metal: Callable[..., Metal]) -> None:
    with make_metal("linorobot").running() as metal:
        metal.wait_for("ok")
        drive_and_go_deaf(metal)
        metal.robot.stop()
        state = metal.wait_for("fault", codes.DOES_NOT_OBEY)
        assert state.not_stopped
        assert state.message.startswith(NOT_STOPPED)
        assert metal.robot.stop().mode == "fault", "a stop is answered all the same"
        assert metal.robot.resume().not_stopped, "it is not resumed while it moves"
        num_before = len(metal.emulated.commands())
        wait_until(lambda: len(metal.emulated.commands()) > num_before + 10, "zeros go on")
        assert all(one.twist.is_zero for one in metal.emulated.commands()[num_before:])
        assert metal.speed > 0.05
        resume(metal)

        # With a gyro it is known what of a wheel is broken.
        for fault, word in (
            ("motor=left", "left wheel does not turn: look at the motor"),
            ("encoder=right", "right encoder counts nothing, or"),
        ):
            metal.start_driving(AHEAD)
            metal.emulated.fault(f"linorobot:{fault}")
            state = metal.wait_for("fault", codes.DOES_NOT_OBEY)
            assert word in state.message
            resume(metal)
        metal.start_driving(AHEAD)
        metal.emulated.fault("linorobot:refuse")
        metal.wait_for("held", codes.LINK_LOST, chassis="down")
        wait_until(lambda: metal.state and "accepts nothing" in metal.state.message, "why")
        metal.wait_for_standing()
        metal.hand.let_go()
        metal.emulated.fault("linorobot:ok")
        metal.wait_for("ok")

        metal.emulated.fault("linorobot:reset")
        wait_until(
            lambda: metal.state is not None and "the device restarts" in metal.state.message,
            lambda: f"it is said that the board restarts: {metal.state}",
        )
        metal.hand.drive(AHEAD)
        num_sent = metal.hand.num_sent
        wait_until(lambda: metal.hand.num_sent > num_sent + 40, "the hand drives for 2 s")
        assert metal.speed < 0.01
        assert metal.state is not None
        assert (metal.state.mode, metal.state.reason) == ("held", codes.LINK_LOST)


def test_an_arduino_that_does_not_stop_is_restarted(make_metal: Callable[..., Metal]) -> None:
    with make_metal("arduino_bridge").running() as metal:
        metal.wait_for("ok")
        drive_and_go_deaf(metal)
        metal.robot.stop()
        wait_until(lambda: any(state.not_stopped for state in metal.states), "NOT STOPPED")
        metal.wait_for_standing()
        resume(metal)
        metal.start_driving(AHEAD)
