"""A page answers the setup, has its hand on Stop, and is gone."""

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor

import pytest
from support.waiting import wait_until

from trolley import codes
from trolley.codes import Refused
from trolley.messages import SetupQuestion
from trolley.messages.request_params import AnswerSetup
from trolley_base.commands import setup_desk
from trolley_base.commands.setup_desk import GONE, HOLD, STOPPED, SetupDesk
from trolley_base.setup.person import YES_OR_NO, StoppedByHand

GO = SetupQuestion(text="Go?", kind="choice", choices=YES_OR_NO)


class Desk:
    """A desk, with a setup on a thread of its own."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.desk = SetupDesk("run1", 3, lambda: None, lambda: self.now_s)
        self.is_driving = threading.Event()
        self.setup = ThreadPoolExecutor(1)

    def do(self, what: Callable[[], str]) -> "Future[str]":
        return self.setup.submit(what)

    def wait_for(self, kind: str) -> None:
        wait_until(
            lambda: self.desk.state.question is not None and self.desk.state.question.kind == kind,
            f"it asks for {kind}",
        )

    def say(self, answer: str, who: str = "anna", question: int | None = None) -> None:
        asked = self.desk.state.question
        number = question if question is not None else asked.number if asked else 0
        self.desk.answer(AnswerSetup(run="run1", question=number, answer=answer, who=who))

    def code_of(self, answer: str, who: str = "anna", question: int | None = None) -> str:
        with pytest.raises(Refused) as refused:
            self.say(answer, who, question)
        return refused.value.code

    def drive(self, until: threading.Event) -> "Future[str]":
        """Ask whether it may go, then drive until it is stopped or the event is set."""

        def run() -> str:
            self.desk.ask(GO)
            try:
                with self.desk.hold() as hand:
                    self.is_driving.set()
                    while not until.is_set():
                        if hand.is_stopped:
                            return self.desk.why_stopped
            except StoppedByHand:
                return f"never moved: {self.desk.why_stopped}"
            return "arrived"

        return self.do(run)


@pytest.fixture
def desk() -> Iterator[Desk]:
    one = Desk()
    yield one
    one.setup.shutdown()


def test_a_question_waits_until_it_is_answered_well(desk: Desk) -> None:
    asked = desk.do(lambda: desk.desk.ask(GO))
    desk.wait_for("choice")
    assert desk.code_of("perhaps") == codes.BAD_REQUEST
    assert desk.code_of("yes", question=77) == codes.NOT_CURRENT
    with pytest.raises(Refused):
        desk.desk.answer(AnswerSetup(run="other", question=1, answer="yes", who="anna"))
    assert not asked.done()
    desk.say("yes")
    assert asked.result() == "yes"
    # A second page that answers the same question comes too late.
    assert desk.code_of("no", "ben", question=1) == codes.NOT_CURRENT


def test_who_answered_has_the_hand_on_stop_and_nobody_else(desk: Desk) -> None:
    arrived = threading.Event()
    driven = desk.drive(arrived)
    desk.wait_for("choice")
    desk.say("yes", "anna")
    desk.wait_for("hold")
    assert desk.code_of(HOLD, "ben") == codes.NOT_CURRENT
    assert desk.code_of("rubbish", "anna") == codes.BAD_REQUEST
    desk.say(HOLD, "anna")
    desk.now_s += 0.9
    desk.say(HOLD, "anna")
    desk.now_s += 0.9
    desk.say(HOLD, "anna")
    assert not driven.done()
    arrived.set()
    assert driven.result() == "arrived"
    assert desk.desk.state.question is None


def test_a_page_that_falls_silent_stops_the_robot_whoever_else_looks_on(desk: Desk) -> None:
    driven = desk.drive(threading.Event())
    desk.wait_for("choice")
    desk.say("yes", "anna")
    desk.wait_for("hold")
    desk.say(HOLD, "anna")
    desk.is_driving.wait()
    desk.now_s += 1.1
    assert driven.result() == GONE


def test_a_silence_counts_even_if_the_page_is_back_before_anybody_looked(desk: Desk) -> None:
    desk.desk.show("x")
    entered, looked = threading.Event(), threading.Event()

    def run() -> str:
        desk.desk.ask(GO)
        with desk.desk.hold() as hand:
            entered.set()
            looked.wait()
            return desk.desk.why_stopped if hand.is_stopped else "drives"

    driven = desk.do(run)
    desk.wait_for("choice")
    desk.say("yes")
    desk.wait_for("hold")
    desk.say(HOLD)
    entered.wait()
    desk.now_s += 1.1
    desk.say(HOLD)
    looked.set()
    assert driven.result() == GONE


def test_stop_of_anybody_stops_it_also_before_it_moves(desk: Desk) -> None:
    driven = desk.drive(threading.Event())
    desk.wait_for("choice")
    desk.say("yes")
    desk.wait_for("hold")
    desk.desk.stop()
    assert driven.result() == f"never moved: {STOPPED}"
    driven = desk.drive(threading.Event())
    desk.wait_for("choice")
    desk.say("yes")  # a stop holds until somebody says again that it may drive
    desk.wait_for("hold")
    desk.say(HOLD)
    desk.is_driving.wait()
    desk.desk.stop()
    assert driven.result() == STOPPED


def test_without_a_page_that_holds_nothing_moves(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(setup_desk, "FIRST_S", 0.0)
    driven = desk.drive(threading.Event())
    desk.wait_for("choice")
    desk.say("yes")
    assert driven.result() == f"never moved: {GONE}"
