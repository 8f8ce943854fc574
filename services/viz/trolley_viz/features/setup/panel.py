"""The guided setup: what `trolley setup --page` says and asks, and the hand on Stop."""

from collections.abc import Callable

from trolley import codes, requests
from trolley.codes import Refused
from trolley.messages import SetupQuestion, SetupState
from trolley.messages.request_params import AnswerSetup
from trolley.runtime.service import Service
from trolley_viz.controls.controls import Controls
from trolley_viz.controls.markup import note, row, sentence
from trolley_viz.features.setup.sight import sight_html
from trolley_viz.words.sentences import StatusLine, Tell, Tone, refusal

HOLD = "hold"
STEPS = ("Devices", "Wheels in the air", "On the floor")
HELD_ELSEWHERE = "Another page has its hand on Stop. STOP works here, too."
LOOKS_ONLY = "Somebody who may drive has to answer."
ANSWER = "Your answer"


class SetupPanel:
    """One question at a time, above what was said so far.

    Args:
        service: carries the answers.
        robot: the name of the robot that is set up.
        may_answer: whether the page's person may.
    """

    def __init__(
        self,
        gui: Controls,
        service: Service,
        robot: Callable[[], str],
        tell: Tell,
        *,
        may_answer: bool,
    ) -> None:
        self._gui = gui
        self._service, self._robot, self._tell = service, robot, tell
        self._may_answer = may_answer
        self._who = service.new_id()
        self._state: SetupState | None = None
        self._shown: tuple[str, int] | None = None
        """The run and the number of the question that there are controls for."""
        self._sent: tuple[str, int] | None = None
        """Those of the question that was answered here and is open still."""
        self._is_held_elsewhere = False
        self._folder = gui.add_folder(visible=False)
        with self._folder:
            self._steps = gui.add_html("")
            self._said = gui.add_html("")
            self._sight = gui.add_html("", visible=False)
            self._asked = gui.add_html("", visible=False)
            self._place = gui.add_folder()
            self._doing = gui.add_html("", visible=False)

    def update(self, state: SetupState | None) -> None:
        """Show how far it is; None: there is no setup."""
        self._state = state
        self._folder.visible = state is not None
        if state is None:
            self._ask(None)
            return
        self._steps.content = _steps(state)
        self._said.content = "".join(map(note, state.said))
        self._sight.visible = state.sight is not None
        self._sight.content = "" if state.sight is None else sight_html(state.sight)
        self._ask(state)
        is_elsewhere = self._is_held_elsewhere and state.question is not None
        doing = [state.doing] if state.doing else []
        lines = [*doing, *([HELD_ELSEWHERE] if is_elsewhere else [])]
        self._doing.visible = bool(lines)
        self._doing.content = "".join(row(StatusLine(line, "busy")) for line in lines)

    # Inside.
    def _ask(self, state: SetupState | None) -> None:
        """Make the controls of a new question in place of those of the one before."""
        question = None if state is None else state.question
        now = None if state is None or question is None else (state.run, question.number)
        if now == self._shown:
            return
        self._shown, self._is_held_elsewhere = now, False
        self._place.clear()
        self._place.visible = True
        self._asked.visible = question is not None
        if question is None:
            return
        self._asked.content = sentence(StatusLine(question.text, "busy"))
        with self._place:
            if not self._may_answer:
                self._gui.add_html(note(LOOKS_ONLY))
            elif question.kind == HOLD:
                self._gui.add_hold().on_hold(self._hold)
            elif question.kind == "choice":
                self._add_choices(question)
            else:
                self._add_field(question)

    def _add_choices(self, question: SetupQuestion) -> None:
        for one in question.choices:
            button = self._gui.add_button(one.label, colour="teal")
            button.on_press(lambda answer=one.answer: self._answer(answer))

    def _add_field(self, question: SetupQuestion) -> None:
        gui, read = self._gui, self._reader(question)
        gui.add_button("Next", icon="player-play", colour="green").on_press(
            lambda: self._answer(read())
        )

    def _reader(self, question: SetupQuestion) -> Callable[[], str]:
        """Add a field for an answer; what is returned reads it."""
        if question.kind in ("number", "whole"):
            number = self._gui.add_number(ANSWER, None)
            return lambda: "" if number.is_empty else f"{number.value:.15g}"
        text = self._gui.add_text(ANSWER, question.default)
        return lambda: text.value

    def _answer(self, answer: str) -> None:
        """Answer the open question, once."""
        if self._shown is None or self._shown == self._sent:
            return
        asked = self._sent = self._shown
        self._place.visible = False  # until it is refused, or something else is asked

        def finish(reply: SetupState | Refused) -> None:
            if isinstance(reply, Refused):
                if self._sent == asked:
                    self._sent, self._place.visible = None, True
                self._tell("Not done", refusal(reply), "warn")

        self._say(asked, answer, finish)

    def _hold(self) -> None:
        """Say that the page is there: it comes as often as the page says so itself."""

        def finish(reply: SetupState | Refused) -> None:
            is_refused = isinstance(reply, Refused) and reply.code == codes.NOT_CURRENT
            if is_refused and self._shown == asked:
                self._is_held_elsewhere = True

        asked = self._shown
        if asked is not None and not self._is_held_elsewhere:
            self._say(asked, HOLD, finish)

    def _say(
        self, asked: tuple[str, int], answer: str, then: Callable[[SetupState | Refused], None]
    ) -> None:
        run, number = asked
        self._service.request(
            requests.SETUP_ANSWER,
            AnswerSetup(run=run, question=number, answer=answer[:1000], who=self._who),
            then,
            robot=self._robot(),
        )


def _steps(state: SetupState) -> str:
    """The titles of the steps, as HTML: what is done, what is under way, what is to come."""
    lines: list[str] = []
    for number, title in enumerate(STEPS, start=1):
        is_done = number < state.step or state.outcome == "done"
        is_here = number == state.step and not is_done
        tone: Tone = "good" if is_done else "idle"
        if is_here:
            tone = "warn" if state.outcome == "interrupted" else "busy"
        mark = " ✓" if is_done else ""
        lines.append(row(StatusLine(f"{number}. {title}{mark}", tone)))
    return "".join(lines)
