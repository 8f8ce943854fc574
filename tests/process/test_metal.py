"""What leaves base on the serial line: judged by the emulated board and by the simulated truth."""

import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from support.processes import RouterProcess, find_free_port
from support.waiting import wait_until

from trolley import codes
from trolley.geometry import Twist2D

from .metal import Metal

AHEAD = Twist2D(0.3, 0.0, 0.0)
SLOWLY = Twist2D(0.15, 0.0, 0.0)
BACK = Twist2D(-0.3, 0.0, 0.0)
# The zero leaves within 0.1 s; the rest is for a machine that runs other tests as well.
AT_ONCE_S = 0.1 + 0.05
SCAN_SILENCE_S = 0.5
# A revolution that was under way when the lidar fell silent may still be completed.
REVOLUTION_S = 0.1


@pytest.fixture
def endpoint(tmp_path: Path) -> Iterator[str]:
    router = RouterProcess(find_free_port(), tmp_path / "router.log")
    router.start()
    yield router.endpoint
    router.stop()


@pytest.fixture
def make_metal(tmp_path: Path, endpoint: str) -> Callable[..., Metal]:
    def make(board: str = "linorobot", lidar: str = "ld19", more: str = "") -> Metal:
        return Metal(tmp_path, endpoint, board, lidar, more)

    return make


@pytest.fixture
def linorobot(make_metal: Callable[..., Metal]) -> Iterator[Metal]:
    with make_metal().running() as metal:
        metal.wait_for("ok")
        yield metal


def acts_in_time(measure: Callable[[], float], limit_s: float = AT_ONCE_S) -> bool:
    """Whether a cause acts in time in one of three tries; base at fault is late each time."""
    return any(measure() < limit_s for _ in range(3))


def test_each_cause_sends_a_zero_at_once(linorobot: Metal) -> None:
    metal = linorobot

    def let_go() -> float:
        metal.start_driving(AHEAD)
        metal.hand.let_go()
        time.sleep(0.5)
        delay_s = metal.first_zero_after(metal.hand.let_go_ns)
        metal.wait_for_standing()
        return delay_s

    def stop() -> float:
        metal.start_driving(BACK)
        cause_ns = time.monotonic_ns()
        metal.robot.stop()
        delay_s = metal.first_zero_after(cause_ns)
        metal.hand.let_go()
        metal.robot.resume()
        metal.wait_for("ok")
        return delay_s

    def lidar(fault: str, state: str) -> float:
        metal.start_driving(BACK)
        cause_ns = time.monotonic_ns()
        metal.emulated.fault(f"ld19:{fault}")
        delay_s = metal.first_zero_after(cause_ns)
        metal.hand.let_go()
        links = metal.wait_for("held", codes.SCAN_LOST).links
        assert {link.name: link.state for link in links} == {"chassis": "up", "lidar": state}
        metal.wait_for("ok")
        return delay_s

    assert acts_in_time(let_go)
    assert acts_in_time(stop)
    silent_s = SCAN_SILENCE_S + REVOLUTION_S + AT_ONCE_S
    assert acts_in_time(lambda: lidar("silence+2", "up"), silent_s)
    assert acts_in_time(lambda: lidar("unplug+2", "down"))

    metal.start_driving(AHEAD)
    cause_ns = time.monotonic_ns()
    assert metal.base is not None
    metal.base.send(signal.SIGTERM)
    assert metal.first_zero_after(cause_ns) < AT_ONCE_S
    assert metal.base.wait() == 0
    metal.wait_for_standing()


def test_without_base_only_the_board_s_watchdog_is_left(linorobot: Metal) -> None:
    linorobot.start_driving(AHEAD)
    assert linorobot.base is not None
    linorobot.base.kill()
    linorobot.wait_for_standing(0.4 + 0.5)  # its watchdog, and braking


def test_a_board_that_comes_back_does_not_set_off(linorobot: Metal) -> None:
    linorobot.start_driving(SLOWLY)
    linorobot.emulated.fault("linorobot:unplug+2")
    state = linorobot.wait_for("held", codes.LINK_LOST)
    assert str(linorobot.ports / "linorobot") in state.message
    assert {link.name: link.state for link in state.links} == {"chassis": "down", "lidar": "up"}
    linorobot.hand.let_go()
    back_ns = time.monotonic_ns()
    linorobot.wait_for("ok")
    time.sleep(0.5)
    assert all(one.twist.is_zero for one in linorobot.emulated.commands() if one.at_ns > back_ns)
    linorobot.start_driving(SLOWLY)


def test_another_firmware_gets_no_command(make_metal: Callable[..., Metal]) -> None:
    metal = make_metal()
    metal.emulated.fault("linorobot:md5")
    with metal.running():
        state = metal.wait_for("held", codes.LINK_LOST)
        state = wait_until(
            lambda: metal.state if metal.state and "md5" in metal.state.message else None,
            10.0,
            f"the md5 is named: {state}",
        )
        assert state is not None
        assert "raw_vel" in state.message
        metal.hand.drive(AHEAD)
        time.sleep(1.0)
        assert metal.emulated.commands() == ()
        # The lidar is not concerned.
        assert {link.name: link.state for link in state.links}["lidar"] == "up"


@pytest.mark.parametrize("speed", [pytest.param(0.2, marks=pytest.mark.slow), 0.5])
def test_the_stop_field_stops_in_time(linorobot: Metal, speed: float) -> None:
    linorobot.start_driving(Twist2D(speed, 0.0, 0.0), at_least=0.05)
    wait_until(
        lambda: linorobot.emulated.truth().clearance < 0.5 and linorobot.speed < 0.005,
        40.0,
        f"it stands before the wall: {linorobot.emulated.truth()}",
    )
    truth = linorobot.emulated.truth()
    assert (truth.collisions, truth.bumps) == (0, 0)
    assert 0.02 < truth.clearance < 0.2


def test_inputs_of_the_board_stop_it(make_metal: Callable[..., Metal]) -> None:
    more = "[base.chassis.inputs]\nbumper_pins = [4]\ncliff_pins = [5]\nbattery_pin = 0\n"
    metal = make_metal("arduino_bridge", more=more)
    for pin in ("d4:1", "d5:0", "a0:2500"):
        metal.emulated.fault(f"arduino_bridge:pin={pin}")
    with metal.running():
        metal.wait_for("ok")
        for pin, calm, code in (("d4:0", "d4:1", codes.BUMPER), ("d5:1", "d5:0", codes.CLIFF)):
            metal.start_driving(SLOWLY)
            cause_ns = time.monotonic_ns()
            metal.emulated.fault(f"arduino_bridge:pin={pin}")
            assert metal.first_zero_after(cause_ns) < AT_ONCE_S
            metal.wait_for("held", code)
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
        metal.hand.drive(Twist2D(-0.5, 0.0, 0.0))
        time.sleep(2.0)
        assert 0.15 < metal.speed < 0.22
