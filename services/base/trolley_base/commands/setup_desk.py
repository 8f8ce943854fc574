"""The desk between the setup, which asks on its thread, and the pages that answer over the wire."""

import itertools
import threading
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from msgspec import structs

from trolley import codes
from trolley.cli.printing import say, say_block
from trolley.codes import Refused
from trolley.messages import SetupChoice, SetupOutcome, SetupQuestion, SetupSight, SetupState
from trolley.messages.request_params import AnswerSetup
from trolley_base.setup.person import StoppedByHand, checked

HOLD = "hold"
"""What answers a question of the kind `hold`."""
SILENCE_S = 1.0
"""Whoever has their hand on Stop and says nothing for so long is gone [s]."""
FIRST_S = 5.0
"""How long a page may take until it holds for the first time; nothing moves before [s]."""
WAKE_S = 0.1
"""How soon a wait notices a signal [s]."""
MOST_SAID = 100
"""Number of sentences that are kept of a step."""
KEEP_IN_SIGHT = "Keep this page in sight while the wheels turn. STOP stops them."
STOPPED = "Stopped."
GONE = (
    "Stopped: the page from which it was started was closed or hidden, or its connection failed, "
    "so nobody there could have stopped the robot."
)


class SetupDesk:
    """The `Person` at a page of the viewer.

    `answer`, `stop` and `state` are called on the service's thread, the rest on the setup's.

    Args:
        run: the name of this run of the setup.
        steps: how many steps there are.
        changed: called, on either thread, whenever `state` has changed.
        now_s: a clock that never jumps.
    """

    def __init__(
        self,
        run: str,
        steps: int,
        changed: Callable[[], None],
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._changed = changed
        self._now_s = now_s
        self._condition = threading.Condition()
        self._state = SetupState(stamp_ns=0, run=run, step=0, steps=steps, title="")
        self._numbers = itertools.count(1)
        self._answer: str | None = None
        self._holder = ""
        """Who answered the last question: they have their hand on Stop."""
        self._held_s: float | None = None
        """When they said so last; None: not yet."""
        self._why_stopped = ""

    # For the service.
    @property
    def state(self) -> SetupState:
        """How far it is."""
        return self._state

    def answer(self, params: AnswerSetup) -> SetupState:
        """Take an answer from somebody.

        Raises:
            Refused: It is none, or not to the question that is open.
        """
        with self._condition:
            question = self._state.question
            is_open = params.run == self._state.run and question is not None
            if question is None or not is_open or params.question != question.number:
                raise Refused(codes.NOT_CURRENT, "That question is no longer open.")
            if question.kind == "hold":
                self._take_hold(params)
                return self._state
            try:
                self._answer = checked(question, params.answer)
            except ValueError as error:
                raise Refused(codes.BAD_REQUEST, str(error)) from error
            self._holder, self._why_stopped = params.who, ""
            self._set(question=None)
            self._condition.notify_all()
            return self._state

    def stop(self) -> None:
        """Stop the robot if it moves, and before it moves if that was allowed just now."""
        with self._condition:
            self._why_stopped = self._why_stopped or STOPPED
            self._condition.notify_all()

    # For the setup.
    def begin(self, step: int, title: str) -> None:
        """Show the title of a step."""
        say(f"{step}. {title}", bold=True)
        self._set(step=step, title=title, said=[], sight=None)

    def tell(self, text: str) -> None:
        """Show a sentence, on the terminal as well."""
        say(text)
        self._set(said=[*self._state.said, text][-MOST_SAID:])

    def show_changes(self, path: Path, difference: str) -> None:
        """Name the file that was changed, and print how on the terminal."""
        say_block(difference, nl=False)
        self.tell(f"Changed in {path}.")

    def show_sight(self, sight: SetupSight) -> None:
        """Show what the lidar sees."""
        self._set(sight=sight)

    def set_outcome(self, outcome: SetupOutcome) -> None:
        """Say how it goes."""
        self._set(outcome=outcome)

    def ask(self, question: SetupQuestion) -> str:
        """Ask until somebody answers."""
        with self._condition:
            self._answer = None
            self._set(question=structs.replace(question, number=next(self._numbers)))
            while self._answer is None:
                self._condition.wait(WAKE_S)
            return self._answer

    def choose(self, text: str, choices: Sequence[SetupChoice]) -> str:
        """Let somebody choose."""
        return self.ask(SetupQuestion(text=text, kind="choice", choices=list(choices)))

    @contextmanager
    def hold(self) -> Generator["SetupDesk"]:
        """Have the hand of whoever answered last on Stop.

        Raises:
            StoppedByHand: They are gone, or the robot was stopped since.
        """
        question = SetupQuestion(text=KEEP_IN_SIGHT, kind="hold", number=next(self._numbers))
        try:
            with self._condition:
                self._held_s = None
                self._set(question=question)
                self._condition.wait_for(
                    lambda: self._held_s is not None or bool(self._why_stopped), FIRST_S
                )
            if self.is_stopped:
                raise StoppedByHand
            yield self
        finally:
            self._set(question=None, doing="")

    @property
    def is_stopped(self) -> bool:
        """Whether somebody has pressed Stop, or nobody could any more; it stays so."""
        with self._condition:
            held_s = self._held_s
            if held_s is None or self._now_s() - held_s > SILENCE_S:
                self._why_stopped = self._why_stopped or GONE
            return bool(self._why_stopped)

    def show(self, doing: str) -> None:
        """Show what the robot does."""
        if doing != self._state.doing:
            self._set(doing=doing)

    @property
    def why_stopped(self) -> str:
        """What has stopped the robot, in words."""
        return self._why_stopped or STOPPED

    # Inside.
    def _take_hold(self, params: AnswerSetup) -> None:
        if params.who != self._holder:
            raise Refused(codes.NOT_CURRENT, "Somebody else has started this; STOP works.")
        if params.answer != HOLD:
            raise Refused(codes.BAD_REQUEST, f"While wheels turn, the answer is {HOLD}.")
        # A silence counts even if nobody has looked during it.
        if self._held_s is not None and self._now_s() - self._held_s > SILENCE_S:
            self._why_stopped = self._why_stopped or GONE
        self._held_s = self._now_s()
        self._condition.notify_all()

    def _set(self, **changed: Any) -> None:
        with self._condition:
            self._state = structs.replace(self._state, **changed)
        self._changed()
