"""What leaves base on the serial line: judged by the emulated board and by the simulated truth."""

import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from support.metal import Metal
from support.processes import Process, find_free_port
from support.waiting import wait_until

from trolley import codes
from trolley.geometry import Twist2D

pytestmark = pytest.mark.again("a device whose emulator is held up has failed")

AHEAD = Twist2D(0.3, 0.0, 0.0)
SLOWLY = Twist2D(0.15, 0.0, 0.0)
BACK = Twist2D(-0.3, 0.0, 0.0)


@pytest.fixture
def make_metal(tmp_path: Path, endpoint: str) -> Callable[..., Metal]:
    def make(
        board: str = "linorobot", lidar: str = "ld19", more: str = "", udp: int | None = None
    ) -> Metal:
        return Metal(tmp_path, endpoint, board, lidar, more, udp=udp)

    return make


@pytest.fixture
def linorobot(make_metal: Callable[..., Metal]) -> Iterator[Metal]:
    with make_metal().running() as metal:
        metal.wait_for("ok")
        yield metal


def test_each_cause_sends_a_zero_for_good(linorobot: Metal) -> None:
    """How soon it leaves is measured by `bench/base/zeros.py`."""
    check_each_cause(linorobot)


@pytest.mark.slow
@pytest.mark.parametrize("board", ["linorobot2", "waveshare_ugv", "create2", "hoverboard"])
def test_each_cause_sends_a_zero_to_other_boards(
    make_metal: Callable[..., Metal], board: str
) -> None:
    with make_metal(board).running() as metal:
        metal.wait_for("ok")
        check_each_cause(metal)


@pytest.mark.slow
def test_each_cause_sends_a_zero_over_udp(make_metal: Callable[..., Metal]) -> None:
    with make_metal("linorobot2", udp=find_free_port()).running() as metal:
        metal.wait_for("ok")
        check_each_cause(metal)


def check_each_cause(metal: Metal) -> None:
    metal.start_driving(AHEAD)
    metal.hand.let_go()
    metal.check_that_it_stays()

    metal.start_driving(BACK)
    assert metal.robot.stop().mode == "stopped"
    metal.check_that_it_stays()
    metal.robot.resume()
    metal.wait_for("ok")

    for fault, twist in (("silence", AHEAD), ("unplug", BACK)):
        metal.start_driving(twist)
        num_said = len(metal.states)
        metal.emulated.fault(f"ld19:{fault}")
        metal.wait_for("held", codes.SCAN_LOST, chassis="up", lidar="down")
        metal.check_that_it_stays()
        for state in metal.states[num_said:]:
            links = {link.name: link.state for link in state.links}
            assert state.mode == "held" or links["lidar"] == "up"
        metal.hand.let_go()
        metal.emulated.fault("ld19:ok")
        metal.wait_for("ok")

    metal.start_driving(AHEAD)
    assert metal.base is not None
    metal.base.send(signal.SIGTERM)
    assert metal.base.wait() == 0
    metal.wait_for_zero()
    metal.wait_for_standing()


def test_without_base_only_the_board_s_watchdog_is_left(linorobot: Metal) -> None:
    def has_stood_untold() -> bool:
        linorobot.start_driving(AHEAD)
        assert linorobot.base is not None
        linorobot.base.kill()
        linorobot.wait_for_standing()
        last = linorobot.last_command
        assert last is not None
        if not last.twist.is_zero:
            return True
        linorobot.start_base()  # the hand was late, and base had told it to stand before
        return False

    wait_until(has_stood_untold, "nobody has told it to stand")


def test_a_board_that_comes_back_does_not_set_off(linorobot: Metal) -> None:
    linorobot.start_driving(SLOWLY)
    linorobot.emulated.fault("linorobot:unplug")
    state = linorobot.wait_for("held", codes.LINK_LOST, chassis="down", lidar="up")
    assert str(linorobot.ports / "linorobot") in state.message
    linorobot.hand.let_go()
    linorobot.wait_for_standing()
    num_before = len(linorobot.emulated.commands())
    linorobot.emulated.fault("linorobot:ok")
    linorobot.wait_for("ok")
    linorobot.check_that_it_stays()
    assert all(one.twist.is_zero for one in linorobot.emulated.commands()[num_before:])
    linorobot.start_driving(SLOWLY)


def test_another_firmware_gets_no_command(make_metal: Callable[..., Metal]) -> None:
    metal = make_metal()
    metal.emulated.fault("linorobot:md5")
    with metal.running():
        metal.wait_for("held", codes.LINK_LOST, lidar="up")  # which is not concerned
        state = wait_until(
            lambda: metal.state if metal.state and "md5" in metal.state.message else None,
            lambda: f"the md5 is named: {metal.state}",
        )
        assert state is not None
        assert "raw_vel" in state.message
        metal.hand.drive(AHEAD)
        wait_until(lambda: metal.hand.num_sent > 20, "the hand drives")
        assert metal.emulated.commands() == ()


@pytest.mark.parametrize("speed", [pytest.param(0.2, marks=pytest.mark.slow), 0.5])
def test_the_stop_field_stops_in_time(linorobot: Metal, speed: float) -> None:
    linorobot.start_driving(Twist2D(speed, 0.0, 0.0), at_least=0.05)
    # A slow machine makes it pause, and creep on.
    wait_until(
        lambda: (
            linorobot.state is not None
            and linorobot.state.reason == codes.STOP_FIELD
            and linorobot.emulated.truth().clearance < 0.2
            and linorobot.speed < 0.005
        ),
        lambda: f"it stands before the wall: {linorobot.emulated.truth()} {linorobot.state}",
    )
    truth = linorobot.emulated.truth()
    assert (truth.collisions, truth.bumps) == (0, 0)
    assert truth.clearance > 0.02


def test_a_base_that_is_held_up_stands_and_blames_no_device(linorobot: Metal) -> None:
    linorobot.start_driving(SLOWLY)
    assert linorobot.base is not None
    num_said = len(linorobot.states)
    for _ in range(5):
        hold_up(linorobot.base)
    linorobot.wait_for("held", codes.OVERLOADED)
    linorobot.wait_for_standing()
    linorobot.wait_for("ok")
    said = {state.reason for state in linorobot.states[num_said:]}
    assert said <= {"", codes.OVERLOADED, codes.COMMAND_LOST}  # the command's time may have passed


@pytest.mark.parametrize(
    ("device", "code"), [("ld19", codes.SCAN_LOST), ("linorobot", codes.LINK_LOST)]
)
def test_a_base_that_is_held_up_says_so_of_a_device_that_is_unplugged(
    linorobot: Metal, device: str, code: str
) -> None:
    linorobot.emulated.fault(f"{device}:unplug")

    def says_so() -> bool:
        assert linorobot.base is not None
        hold_up(linorobot.base)
        return linorobot.state is not None and linorobot.state.reason == code

    wait_until(says_so, lambda: f"it says what is missing: {linorobot.state}")
    num_said = len(linorobot.states)
    for _ in range(10):
        says_so()
    assert {state.reason for state in linorobot.states[num_said:]} <= {code}


def hold_up(base: Process) -> None:
    """Let it turn for a moment only."""
    base.send(signal.SIGSTOP)
    time.sleep(0.3)
    base.send(signal.SIGCONT)
    time.sleep(0.03)


def test_inputs_of_the_board_stop_it(make_metal: Callable[..., Metal]) -> None:
    more = "[base.chassis.inputs]\nbumper_pins = [4]\ncliff_pins = [5]\nbattery_pin = 0\n"
    metal = make_metal("arduino_bridge", more=more)
    for pin in ("d4:1", "d5:0", "a0:2500"):
        metal.emulated.fault(f"arduino_bridge:pin={pin}")
    with metal.running():
        metal.wait_for("ok")
        for pin, calm, code in (("d4:0", "d4:1", codes.BUMPER), ("d5:1", "d5:0", codes.CLIFF)):
            metal.start_driving(SLOWLY)
            metal.emulated.fault(f"arduino_bridge:pin={pin}")
            metal.wait_for("held", code)
            metal.check_that_it_stays()
            metal.start_driving(Twist2D(-0.1, 0.0, 0.0), at_least=0.05)
            metal.hand.let_go()
            metal.wait_for_standing()
            metal.emulated.fault(f"arduino_bridge:pin={calm}")
            metal.wait_for("ok")
        metal.emulated.fault("arduino_bridge:pin=a0:2000")
        metal.wait_for("held", codes.BATTERY)


def test_a_board_with_a_patient_watchdog_drives_slowly(make_metal: Callable[..., Metal]) -> None:
    with make_metal("arduino_bridge").running() as metal:
        metal.wait_for("ok")
        metal.start_driving(Twist2D(-0.5, 0.0, 0.0), at_least=0.15)
        fastest = 0.0
        for _ in range(50):  # it backs off a wall that is 5 m behind it
            fastest = max(fastest, metal.speed)
            time.sleep(0.02)
        assert fastest < 0.22
