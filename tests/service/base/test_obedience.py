"""A board that does not do as it is told, through the whole service in a simulated room."""

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import pytest

from trolley import codes, requests
from trolley.geometry import Pose2D, Twist2D
from trolley.messages import BaseState, Link
from trolley_base.drivers import MotionSample
from trolley_base.simulation.simulated_hardware import SimulatedChassis
from trolley_base.world.faulty_wheels import BOTH, LEFT, NONE, RIGHT, Trouble

from .conftest import Rig

NOT_STOPPED = "NOT STOPPED: the motor board does not obey"
GRAIN_S = 0.05


def break_wheels(rig: Rig, trouble: Trouble) -> float:
    """Break them; robot time now [s]."""
    chassis = rig.base.hardware.chassis
    assert isinstance(chassis, SimulatedChassis)
    chassis.wheels.trouble = trouble
    return rig.now_ns * 1e-9


def fault_after(rig: Rig, since_s: float) -> float | None:
    """Seconds until base said that the board does not obey; None: it has not said so."""
    for state in rig.states:
        at_s = state.stamp_ns * 1e-9
        if at_s >= since_s and state.reason == codes.DOES_NOT_OBEY:
            assert state.mode == "fault"
            return at_s - since_s
    return None


@pytest.mark.parametrize("speed", [0.1, 0.3, 0.5])
def test_a_board_that_ignores_a_stop_is_told_of_within_half_a_second(
    rig: Rig, speed: float
) -> None:
    rig.drive(1.2, speed)
    asked_s = break_wheels(rig, Trouble(goes_on=True))
    assert rig.lockstep.ask(requests.BASE_STOP).mode == "stopped"
    rig.run(1.0)
    late_s = fault_after(rig, asked_s)
    assert late_s is not None
    assert late_s <= 0.5
    assert rig.state.message.startswith(NOT_STOPPED)
    assert rig.state.not_stopped
    assert rig.lockstep.ask(requests.BASE_STOP).mode == "fault"
    reply = rig.lockstep.ask(requests.BASE_RESUME)
    assert (reply.mode, reply.not_stopped) == ("fault", True), "it still moves"
    assert all(one.twist.is_zero for one in rig.driven if one.stamp_ns * 1e-9 > asked_s + 0.1)


@pytest.mark.parametrize("wz", [0.5, 1.5])
def test_a_board_that_turns_on_after_its_command_is_lost_is_told_of(rig: Rig, wz: float) -> None:
    rig.drive(1.2, 0.0, wz)
    rig.send(Twist2D.zero())
    began_s = break_wheels(rig, Trouble(goes_on=True))
    rig.drive(1.0, 0.0)
    late_s = fault_after(rig, began_s)
    assert late_s is not None
    assert late_s <= 0.7, "it is braked along a ramp of 0.4 s"
    assert rig.state.not_stopped


def test_the_fault_holds_until_somebody_resumes_a_robot_that_stands(rig: Rig) -> None:
    rig.drive(1.2, 0.3)
    break_wheels(rig, Trouble(goes_on=True))
    rig.drive(1.0, 0.0)
    assert rig.state.not_stopped
    break_wheels(rig, Trouble())
    rig.drive(2.0, 0.3)
    assert rig.truth.twist.is_zero
    assert (rig.state.mode, rig.state.reason) == ("fault", codes.DOES_NOT_OBEY)
    assert not rig.state.not_stopped
    assert "trolley resume" in rig.state.message
    rig.restart()
    rig.drive(1.0, 0.3)
    assert rig.state.mode == "stopped", "what was latched outlives base"
    assert rig.lockstep.ask(requests.BASE_RESUME).mode == "ok"
    rig.drive(1.0, 0.3)
    assert rig.truth.twist.vx == pytest.approx(0.3)


@pytest.mark.parametrize(
    "trouble", [Trouble(dead_motors=frozenset({LEFT})), Trouble(stuck_encoders=BOTH)]
)
def test_who_was_mended_and_resumed_at_once_is_not_blamed_for_before(
    rig: Rig, trouble: Trouble
) -> None:
    rig.drive(1.2, 0.3)
    began_s = break_wheels(rig, trouble)
    rig.drive(1.0, 0.3)
    assert fault_after(rig, began_s) is not None
    break_wheels(rig, Trouble())
    assert rig.lockstep.run_until(lambda: not rig.state.not_stopped, 5.0)
    assert rig.lockstep.ask(requests.BASE_RESUME).mode == "ok"
    rig.drive(1.0, 0.3)
    assert (rig.state.mode, rig.state.reason) == ("ok", "")
    assert rig.truth.twist.vx == pytest.approx(0.3)


def test_a_board_that_is_not_reached_is_not_accused(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What its port refuses it has not ignored: it drives on until its own watchdog stops it."""
    read = SimulatedChassis.read
    refuses = Link(name="chassis", state="down", message="The port accepts nothing.")
    rig.drive(1.2, 0.3)
    began_s = break_wheels(rig, Trouble(goes_on=True))
    monkeypatch.setattr(SimulatedChassis, "read", lambda self: replace(read(self), link=refuses))
    rig.drive(1.0, 0.3)
    assert rig.state.reason == codes.LINK_LOST
    monkeypatch.undo()  # and what waited in the port drives it for another moment
    rig.run(0.1)
    break_wheels(rig, Trouble())
    rig.drive(1.5, 0.3)
    assert fault_after(rig, began_s) is None
    assert rig.truth.twist.vx == pytest.approx(0.3)


def test_a_board_that_drives_by_itself_is_told_of(rig: Rig) -> None:
    rig.run(3.0)
    began_s = break_wheels(rig, Trouble(drives=0.2))
    rig.run(2.0)
    late_s = fault_after(rig, began_s)
    assert late_s is not None
    assert late_s <= 0.5
    assert rig.state.not_stopped
    assert "drives by itself" in rig.state.message
    break_wheels(rig, Trouble())
    rig.run(5.0)
    assert (rig.state.mode, rig.state.not_stopped) == ("fault", False)


def test_a_board_that_goes_on_is_restarted_once_a_second_until_it_stands(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    restarted_s: list[float] = []

    def restart(_: SimulatedChassis) -> bool:
        restarted_s.append(rig.now_ns * 1e-9)
        return True

    monkeypatch.setattr(SimulatedChassis, "restart", restart)
    rig.run(3.0)
    break_wheels(rig, Trouble(pushed=0.4))
    rig.run(1.0)
    break_wheels(rig, Trouble())
    rig.run(2.0)
    assert restarted_s == [], "whoever pushes it is no fault of the board"
    rig.drive(1.0, 0.3)
    began_s = break_wheels(rig, Trouble(goes_on=True))
    rig.drive(2.6, 0.0)
    assert restarted_s[0] - began_s < 1.0
    assert [b - a for a, b in pairwise(restarted_s)] == pytest.approx([1.0] * 2, abs=0.05)
    assert rig.counters["motion/board_restarts"] == 3
    break_wheels(rig, Trouble())
    rig.run(3.0)
    assert len(restarted_s) == 3


def test_a_robot_that_was_pushed_by_hand_may_drive_on_when_it_stands(rig: Rig) -> None:
    rig.run(3.0)
    began_s = break_wheels(rig, Trouble(pushed=0.4))
    rig.run(0.6)
    late_s = fault_after(rig, began_s)
    assert late_s is not None
    assert rig.state.not_stopped
    assert "by hand" in rig.state.message
    rig.run(5.0)
    break_wheels(rig, Trouble())
    rig.run(2.5)
    assert rig.state.mode == "ok"
    rig.drive(1.0, 0.3)
    assert rig.truth.twist.vx == pytest.approx(0.3)


DRIVEN_WRONG: dict[str, tuple[Trouble, Twist2D, float, str]] = {
    "backwards": (Trouble(factor=-1.0), Twist2D(0.3, 0.0, 0.0), 0.5, "other"),
    "twice as fast": (Trouble(factor=2.0), Twist2D(0.25, 0.0, 0.0), 0.5, "other"),
    "at a crawl": (Trouble(factor=0.4), Twist2D(0.3, 0.0, 0.0), 2.0, "instead of 0.30 m/s"),
    "not at all": (Trouble(dead_motors=BOTH), Twist2D(0.3, 0.0, 0.0), 0.6, "do not turn"),
    "left motor dead": (Trouble(dead_motors=frozenset((LEFT,))), Twist2D(0.3, 0, 0), 0.8, "left"),
    "slow left motor": (Trouble(dead_motors=frozenset((LEFT,))), Twist2D(0.1, 0, 0), 0.5, "left"),
    "right encoder": (
        Trouble(stuck_encoders=frozenset((RIGHT,))),
        Twist2D(0.3, 0, 0),
        0.5,
        "right",
    ),
    "swapped": (Trouble(swapped_encoders=True), Twist2D(0.0, 0.0, 1.5), 0.5, "wrong way"),
}


@pytest.mark.parametrize("kind", DRIVEN_WRONG)
def test_a_robot_that_drives_otherwise_than_told_is_told_of(rig: Rig, kind: str) -> None:
    trouble, told, within_s, word = DRIVEN_WRONG[kind]
    rig.drive(1.5, told.vx, told.wz)
    began_s = break_wheels(rig, trouble)
    rig.drive(2.0, told.vx, told.wz)
    late_s = fault_after(rig, began_s)
    assert late_s is not None
    assert late_s <= within_s
    assert word in rig.state.message
    assert (rig.state.mode, rig.state.reason) == ("fault", codes.DOES_NOT_OBEY)
    assert rig.driven[-1].twist.is_zero


@pytest.mark.parametrize("told", [Twist2D(0.3, 0.0, 0.0), Twist2D(0.0, 0.0, 1.0)])
def test_a_board_without_power_is_told_of_when_it_is_to_set_off(rig: Rig, told: Twist2D) -> None:
    began_s = break_wheels(rig, Trouble(dead_motors=BOTH))
    rig.drive(3.0, told.vx, told.wz)
    late_s = fault_after(rig, began_s)
    assert late_s is not None
    assert late_s <= 2.0
    assert "do not turn" in rig.state.message
    assert not rig.state.not_stopped


def lawful(rig: Rig, drive: Callable[[], None]) -> list[BaseState]:
    """The states that say that something is wrong with a robot in order."""
    break_wheels(rig, Trouble(dead_motors=NONE))
    drive()
    return [state for state in rig.states if state.reason == codes.DOES_NOT_OBEY]


def test_a_robot_in_order_is_never_blamed(rig: Rig) -> None:
    def drive() -> None:
        for vx, wz in ((0.5, 0.0), (-0.4, 0.0), (0.0, 1.5), (0.0, -1.5), (0.5, 1.5), (0.02, 0.0)):
            rig.drive(0.7, vx, wz)
            rig.lockstep.ask(requests.BASE_STOP)
            rig.run(1.0)
            rig.lockstep.ask(requests.BASE_RESUME)
            rig.drive(1.0, vx, wz)

    assert lawful(rig, drive) == []


LEAPS = {
    "far": Pose2D(5.0, 0.0, 0.0),
    "not a number": Pose2D(math.nan, 0.0, 0.0),
    "endless": Pose2D(math.inf, 0.0, 0.0),
}


@pytest.mark.parametrize("kind", LEAPS)
def test_odometry_that_leaps_is_never_published_and_not_driven_with(rig: Rig, kind: str) -> None:
    def leap() -> None:
        chassis = rig.base.hardware.chassis
        assert isinstance(chassis, SimulatedChassis)
        chassis.store(MotionSample(rig.now_ns, LEAPS[kind], Twist2D.zero()), 0.02)

    leap()
    rig.drive(2.0, 0.2)
    assert rig.state.mode == "ok", "once it was misread"
    for _ in range(3):
        leap()
        rig.drive(0.2, 0.2)
    rig.drive(1.0, 0.2)
    assert (rig.state.mode, rig.state.reason) == ("fault", codes.DOES_NOT_OBEY)
    assert "leaps" in rig.state.message
    assert rig.truth.twist.is_zero
    assert all(one.pose.is_finite() and one.pose.x < 1.0 for one in rig.odometry)
    assert rig.counters["odometry/jump"] == 4
