"""A robot that moves though it is told to stand: whatever shows "stopped" says so."""

from trolley import codes
from trolley.cli.robot_sentence import robot_sentence
from trolley.cli.status import problems
from trolley.cli.teleop import base_line
from trolley.doctor.robot import RobotFacts, check_base
from trolley.messages import BaseState, Link

SENTENCE = "NOT STOPPED: the motor board does not obey: told to stand, it goes on at 0.30 m/s."
MOVES = BaseState(
    stamp_ns=1, mode="fault", reason=codes.DOES_NOT_OBEY, message=SENTENCE, not_stopped=True
)
STANDS = BaseState(
    stamp_ns=1, mode="fault", reason=codes.DOES_NOT_OBEY, message="It did not obey: so and so."
)


def test_the_one_sentence_is_that_it_does_not_stop() -> None:
    assert robot_sentence(MOVES, None, None, None) == SENTENCE


def test_status_lists_it_without_calling_it_a_fault_or_stopped() -> None:
    found = {"services": {}, "base": MOVES, "pose": None}
    assert problems(found) == [SENTENCE]


def test_who_drives_by_hand_is_told_and_may_not_resume() -> None:
    assert base_line(MOVES) == (SENTENCE, "red")
    assert "R lets it drive" in base_line(STANDS)[0]


def test_the_doctor_finds_it() -> None:
    (found,) = check_base(RobotFacts("one", 5.0, base=MOVES))
    assert found.sentence == SENTENCE


def test_only_a_resume_ends_it() -> None:
    assert MOVES.is_halted
    assert STANDS.is_halted
    assert not BaseState(stamp_ns=1, mode="fault", reason="collision").is_halted


def test_that_it_is_stopped_is_said_once() -> None:
    why = "Stopped. `trolley resume` lets it drive."
    base = BaseState(stamp_ns=1, mode="stopped", reason=codes.BUTTON, message=why)
    assert base_line(base)[0] == "Stopped. R lets it drive again."
    assert problems({"services": {}, "base": base, "pose": None}) == [why]
    assert check_base(RobotFacts("one", 5.0, base=base))[0].sentence == why


UNKNOWN = (
    "A stop holds, but it is not known whether the robot stands still: the cable is unplugged."
)
UNCONFIRMED = BaseState(
    stamp_ns=1,
    mode="stopped",
    reason=codes.BUTTON,
    message=UNKNOWN,
    links=[Link(name="chassis", state="searching")],
)


def test_a_stop_that_the_silent_board_cannot_confirm_is_not_called_stopped() -> None:
    assert problems({"services": {}, "base": UNCONFIRMED, "pose": None}) == [UNKNOWN]
    assert base_line(UNCONFIRMED)[0].startswith(UNKNOWN)
    assert robot_sentence(UNCONFIRMED, None, None, None) == UNKNOWN
