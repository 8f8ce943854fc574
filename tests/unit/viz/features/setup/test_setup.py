"""The guided setup on the page: one question at a time, and a hand on Stop."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from msgspec import structs
from support.pages import page_of

import trolley_base.commands
import trolley_base.setup
from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.messages import BaseState, SetupChoice, SetupQuestion, SetupSight, SetupState
from trolley.messages.request_params import AnswerSetup, Nothing
from trolley.runtime.service import Service, answers, every
from trolley_viz.controls.controls import NotThere
from trolley_viz.controls.messages import Look
from trolley_viz.languages.translator import translator_of
from trolley_viz.server.messages import Hold, Said
from trolley_viz.server.visitors import Visitor

if TYPE_CHECKING:
    from ...conftest import Browser, Stage

FREE = SetupQuestion(
    number=1,
    text="Do the wheels hang free?",
    kind="choice",
    choices=[SetupChoice(answer="yes", label="Yes"), SetupChoice(answer="no", label="No")],
)
NAME = SetupQuestion(number=2, text="Name of the robot", kind="name", default="trolley")
LENGTH = SetupQuestion(number=3, text="Length of the robot in metres", kind="number")
KEEP = SetupQuestion(
    number=4,
    text="Keep this page in sight while the wheels turn. STOP stops them.",
    kind="hold",
)
ROBOT = "kart"


class PretendSetup(Service):
    """Asks what it is told to ask, and keeps what it is answered."""

    name = "setup"

    def __init__(self) -> None:
        self.now = SetupState(
            stamp_ns=0, run="r1", step=2, steps=3, title="Wheels in the air", question=FREE
        )
        self.answered: list[AnswerSetup] = []
        self.holder = ""
        self.stops = 0
        self.is_silent = False

    @every(0.5, clock="local")
    def tell(self) -> None:
        if not self.is_silent:
            self.publish(topics.SETUP, self.now)

    @answers(requests.SETUP_ANSWER)
    def answer(self, params: AnswerSetup) -> SetupState:
        self.answered.append(params)
        if params.answer == "hold" and self.holder not in ("", params.who):
            raise Refused(codes.NOT_CURRENT, "Somebody else has started this; STOP works.")
        if params.answer == "Karl":
            raise Refused(codes.BAD_REQUEST, "A robot's name has 1 to 32 of a-z, 0-9, _ and -.")
        return self.now

    @answers(requests.BASE_STOP)
    def stop_now(self, _: Nothing) -> BaseState:
        self.stops += 1
        return BaseState(stamp_ns=0, mode="stopped")


class Setting:
    """A viewer whose page follows a robot that is being set up and has no base."""

    def __init__(self, stage: "Stage") -> None:
        self.stage = stage
        self.setup = PretendSetup()
        stage.runtime.add(self.setup, robot=ROBOT)
        self.browser = self.open(0)

    def open(self, number: int, visitor: Visitor | None = None) -> "Browser":
        stage = self.stage
        browser = stage.browse(number) if visitor is None else stage.browse(number, visitor)
        stage.page(number).session.follow(ROBOT)
        stage.runtime.run(1.5)
        return browser

    def ask(self, question: SetupQuestion | None, **changed: object) -> None:
        self.setup.now = structs.replace(self.setup.now, question=question, **changed)
        self.stage.runtime.run(1.5)

    def hold(self, number: int = 0, late_ms: float = 0.0) -> None:
        """Say as the page's script does that it is in sight."""
        controls = self.stage.page(number).controls.all
        (control,) = [id_ for id_, one in controls.items() if one.look.kind == "hold"]
        hold = Hold(at_ms=self.stage.now_ms - late_ms, control=control)
        self.stage.say(self.stage.browsers[number], Said(hold=hold))
        self.stage.runtime.run(0.1)


@pytest.fixture
def setting(stage: "Stage") -> Setting:
    return Setting(stage)


def test_the_page_shows_the_setup_and_nothing_else(setting: Setting) -> None:
    page = page_of(setting.stage)
    text = page.text()
    assert "2. Wheels in the air" in text
    assert "1. Devices ✓" in text
    assert "Do the wheels hang free?" in text
    assert not page.is_shown("Go")
    state = setting.browser.state
    assert state.is_set_up
    assert state.sentence.headline == "Setting up the robot: step 2 of 3."


def looks_of(setting: Setting) -> list[tuple[int, Look]]:
    controls = setting.stage.page().controls.all
    return [(id_, one.look) for id_, one in controls.items()]


def test_a_question_is_answered_once(setting: Setting) -> None:
    page = page_of(setting.stage)
    (no,) = [id_ for id_, look in looks_of(setting) if look.label == "No"]
    page.press("Yes")
    assert not page.is_shown("No")
    with pytest.raises(NotThere):  # a second press that was under way
        setting.stage.page().controls.handle(no, None)
    setting.stage.runtime.run(0.5)
    (answer,) = setting.setup.answered
    assert (answer.run, answer.question, answer.answer) == ("r1", 1, "yes")
    setting.ask(None)
    assert not page_of(setting.stage).is_shown("Yes")


def test_what_is_refused_can_be_answered_again(setting: Setting) -> None:
    setting.ask(NAME)
    page = page_of(setting.stage)
    assert page.value("Your answer") == "trolley"
    page.type("Your answer", "Karl")
    page.press("Next")
    setting.stage.runtime.run(0.5)
    page.type("Your answer", "karl")
    page.press("Next")
    setting.stage.runtime.run(0.5)
    assert [one.answer for one in setting.setup.answered] == ["Karl", "karl"]


def test_a_number_is_sent_as_it_was_typed_and_an_empty_field_as_nothing(setting: Setting) -> None:
    setting.ask(LENGTH)
    page = page_of(setting.stage)
    page.press("Next")
    setting.stage.runtime.run(0.5)
    setting.ask(LENGTH, run="r2")
    page = page_of(setting.stage)
    page.type("Your answer", 0.3)
    page.press("Next")
    setting.stage.runtime.run(0.5)
    assert [one.answer for one in setting.setup.answered] == ["", "0.3"]


def test_a_page_holds_as_often_as_it_says_that_it_is_in_sight(setting: Setting) -> None:
    setting.ask(KEEP)
    setting.hold()
    setting.hold()
    setting.hold(late_ms=900.0)  # held up on its way: that tells nothing of now
    held = [(one.question, one.answer) for one in setting.setup.answered]
    assert held == [(4, "hold"), (4, "hold")]
    setting.stage.runtime.run(5.0)  # the viewer says nothing of its own accord
    assert len(setting.setup.answered) == 2


def test_a_second_page_has_no_hand_on_stop_but_can_stop(setting: Setting) -> None:
    setting.open(1)
    setting.ask(KEEP)
    setting.hold(0)
    setting.setup.holder = setting.setup.answered[0].who
    setting.hold(1)
    setting.stage.runtime.run(1.0)
    assert "Another page has its hand on Stop" in page_of(setting.stage, 1).text()
    setting.hold(1)
    assert len(setting.setup.answered) == 2
    setting.stage.page(1).session.press_stop()
    setting.stage.runtime.run(0.5)
    assert setting.setup.stops >= 1


def test_who_may_only_look_answers_nothing(setting: Setting) -> None:
    setting.open(1, Visitor("guest", role="viewer"))
    for question in (FREE, NAME, LENGTH, KEEP):
        setting.ask(question)
        page = page_of(setting.stage, 1)
        assert question.text in page.text()
        assert "Somebody who may drive has to answer." in page.text()
        assert not {"Yes", "Next", "Your answer"} & set(page.labels)
        kinds = {one.look.kind for one in setting.stage.page(1).controls.all.values()}
        assert "hold" not in kinds
    assert setting.setup.answered == []


def test_a_setup_that_died_is_not_shown_any_more(setting: Setting) -> None:
    setting.setup.is_silent = True
    setting.stage.runtime.run(4.0)
    assert not setting.browser.state.is_set_up
    assert "Do the wheels hang free?" not in page_of(setting.stage).text()


def test_what_it_says_is_text_and_no_markup(setting: Setting) -> None:
    bad = "Something <is> so."  # `MADE_UP` in conftest.py
    setting.ask(structs.replace(FREE, text=bad), said=[bad], doing=bad)
    assert "<is>" not in page_of(setting.stage).html()


SIGHT = SetupSight(
    points=[(1.0, 0.5), (-0.8, 0.0), (90.0, 0.0)],
    outline=[(0.2, 0.1), (0.2, -0.1), (-0.1, -0.1), (-0.1, 0.1)],
    laser=(0.05, 0.0),
    room_m=0.76,
)


def test_the_page_shows_what_the_lidar_sees_with_the_front_up(setting: Setting) -> None:
    assert "<svg" not in page_of(setting.stage).html()
    setting.ask(FREE, sight=SIGHT)
    html = page_of(setting.stage).html()
    # Ahead is up and left is left; what is far out of the picture is left out.
    assert 'd="M-0.500,-1.000h0M-0.000,0.800h0"' in html
    assert "if it is mounted as robot.toml says" in html
    setting.ask(FREE, sight=structs.replace(SIGHT, is_measured=True))
    assert "compare it with the room" in page_of(setting.stage).text()
    setting.ask(None)
    setting.setup.now = structs.replace(setting.setup.now, sight=None)
    setting.stage.runtime.run(1.5)
    assert "<svg" not in page_of(setting.stage).html()


SPOKEN = {"SetupRefused", "tell", "_confirm", "is_confirmed", "give_up", "ask_number"}
"""What is called with a sentence that a page shows."""


WORDS = {
    "the encoder of the 7 wheel does not count": ("left", "right"),
    "The 7 has fallen silent.": ("motor board", "lidar"),
}
"""Where a word varies instead, and what it may be."""


def sentences() -> Iterator[str]:
    """The sentences in the source of the setup, with a number in place of what varies."""
    for package in (trolley_base.setup, trolley_base.commands):
        for path in sorted(Path(str(package.__file__)).parent.glob("*.py")):
            if package is trolley_base.setup or path.name.startswith("setup"):
                yield from _sentences_in(ast.parse(path.read_text(encoding="utf-8")))


def _sentences_in(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and _name_of(node.func) in SPOKEN:
            for argument in node.args:
                text = _text_of(argument)
                others = [words for part, words in WORDS.items() if part in text]
                if " " in text and not re.fullmatch("7(: 7)?", text):
                    yield from (text.replace("7", word) for word in (others or [("7",)])[0])


def _name_of(function: ast.expr) -> str:
    return getattr(function, "attr", getattr(function, "id", ""))


def _text_of(argument: ast.expr) -> str:
    match argument:
        case ast.Constant(value=str() as text):
            return text
        case ast.JoinedStr(values=parts):
            return "".join(_text_of(part) for part in parts)
        case ast.FormattedValue():
            return "7"
        case _:
            return ""


def test_every_sentence_of_the_setup_can_be_said_in_german() -> None:
    words = translator_of("de")
    assert words is not None
    found = set(sentences())
    assert len(found) > 40
    assert sorted(one for one in found if not words.knows(one)) == []
