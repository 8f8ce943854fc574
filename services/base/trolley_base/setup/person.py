"""The person whom the setup asks, whether they sit at a terminal or at a page of the viewer."""

import math
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Protocol

from trolley.messages import SetupChoice, SetupQuestion, SetupSight
from trolley.topics import names_robot


class StoppedByHand(Exception):
    """The person stopped the robot, or can no longer be heard."""


class Hand(Protocol):
    """A person's hand on Stop."""

    @property
    def is_stopped(self) -> bool:
        """Whether it has stopped the robot; it stays so."""
        ...

    def show(self, doing: str) -> None:
        """Say what the robot does now."""
        ...


class Person(Protocol):
    """Reads what the setup says, and answers."""

    def begin(self, step: int, title: str) -> None:
        """Say that a step begins."""
        ...

    def tell(self, text: str) -> None:
        """Say something."""
        ...

    def show_changes(self, path: Path, difference: str) -> None:
        """Show what was changed in a file, as `diff -u` writes it."""
        ...

    def show_sight(self, sight: SetupSight) -> None:
        """Show what the lidar sees, where pictures can be shown."""
        ...

    def ask(self, question: SetupQuestion) -> str:
        """Ask until there is an answer that `checked` accepts."""
        ...

    def hold(self) -> AbstractContextManager[Hand]:
        """Have a hand on Stop meanwhile.

        Raises:
            StoppedByHand: Nobody has one.
        """
        ...


YES = "yes"
YES_OR_NO = [SetupChoice(answer=YES, label="Yes"), SetupChoice(answer="no", label="No")]


def is_confirmed(person: Person, question: str) -> bool:
    """Ask a question that can be answered by yes or no."""
    asked = SetupQuestion(text=question, kind="choice", choices=YES_OR_NO)
    return person.ask(asked) == YES


def ask_number(person: Person, text: str, least: float, greatest: float) -> float:
    """Ask for a number within bounds."""
    return float(
        person.ask(SetupQuestion(text=text, kind="number", least=least, greatest=greatest))
    )


def value_of(question: SetupQuestion, answer: str) -> str | float:
    """Return an answer that `checked` accepts as what it says: a number, or words."""
    match question.kind:
        case "whole":
            return int(answer)
        case "number":
            return float(answer)
        case _:
            return answer


def checked(question: SetupQuestion, answer: str) -> str:
    """Return an answer as it counts: without blanks around it, the default if it is empty.

    Raises:
        ValueError: It is no answer to this question, with the reason.
    """
    answer = answer.strip() or question.default
    match question.kind:
        case "choice":
            if answer not in (one.answer for one in question.choices):
                allowed = ", ".join(one.answer for one in question.choices)
                raise ValueError(f"Not understood: answer with one of {allowed}.")
        case "name":
            if not names_robot(answer):
                raise ValueError("A robot's name has 1 to 32 of a-z, 0-9, _ and -.")
        case "text":
            if not answer:
                raise ValueError("Please answer something.")
        case "number":
            _check_number(question, answer, float)
        case "whole":
            _check_number(question, answer, int)
        case "hold":
            raise ValueError("This is no question that can be answered.")
    return answer


def _check_number(question: SetupQuestion, answer: str, read: Callable[[str], float]) -> None:
    what = "a whole number" if read is int else "a number"
    try:
        number = float(read(answer))
    except (ValueError, OverflowError):
        raise ValueError(f"Please answer with {what}.") from None
    if not math.isfinite(number):
        raise ValueError(f"Please answer with {what}.")
    least, greatest = question.least, question.greatest
    is_too_low = least is not None and (number <= least if question.is_above else number < least)
    if is_too_low:
        raise ValueError(f"It must be {'above' if question.is_above else 'at least'} {least:g}.")
    if greatest is not None and number > greatest:
        raise ValueError(f"It must be at most {greatest:g}.")
