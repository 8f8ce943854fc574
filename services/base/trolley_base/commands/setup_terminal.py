"""A person at the terminal: reads, types, and stops the robot with any key."""

import os
import select
import sys
import termios
import tty
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path

import click

from trolley.cli.printing import say, say_block
from trolley.cli.show import Progress
from trolley.messages import SetupQuestion, SetupSight
from trolley_base.setup.person import YES, YES_OR_NO, checked


class Terminal:
    """The `Person` at a terminal."""

    def begin(self, step: int, title: str) -> None:
        """Print the title of a step."""
        if step > 1:
            say()
        say(f"{step}. {title}", bold=True)

    def tell(self, text: str) -> None:
        """Print a line."""
        say(text)

    def show_changes(self, path: Path, difference: str) -> None:
        """Print what was changed in a file."""
        say(f"Changed in {path}:")
        say_block(difference, nl=False)

    def show_sight(self, sight: SetupSight) -> None:
        """Show nothing: a terminal has no pictures."""

    def ask(self, question: SetupQuestion) -> str:
        """Ask until the answer is one."""
        if question.choices == YES_OR_NO:
            return YES if click.confirm(question.text) else "no"
        text = question.text
        if question.kind == "choice":
            say(text)
            say_block("\n".join(f"  {one.answer}  {one.label}" for one in question.choices))
            text = "Answer"

        def read(typed: str) -> str:
            try:
                return checked(question, typed)
            except ValueError as error:
                raise click.BadParameter(str(error)) from error

        return click.prompt(text, default=question.default or None, value_proc=read)

    @contextmanager
    def hold(self) -> Generator["KeyboardHand"]:
        """Let any key stop, without Enter where this is a terminal."""
        number = sys.stdin.fileno()
        before = termios.tcgetattr(number) if sys.stdin.isatty() else None
        if before is not None:
            tty.setcbreak(number)
            termios.tcflush(number, termios.TCIFLUSH)
        hand = KeyboardHand(lambda: bool(select.select([number], [], [], 0.0)[0]))
        try:
            yield hand
        finally:
            hand.let_go()
            if before is not None:
                termios.tcsetattr(number, termios.TCSAFLUSH, before)
            elif hand.is_stopped:
                os.read(number, 4096)  # the key that stopped it answers no question


class KeyboardHand:
    """The `Hand` at the keyboard.

    Where the input ends, nobody has a hand on it any more: that stops, too.
    """

    def __init__(self, is_pressed: Callable[[], bool]) -> None:
        self._is_pressed = is_pressed
        self._progress = Progress()

    @property
    def is_stopped(self) -> bool:
        """Whether a key was pressed."""
        return self._is_pressed()

    def show(self, doing: str) -> None:
        """Say what the robot does, on one line."""
        self._progress.show(f"{doing} (any key stops)", doing)

    def let_go(self) -> None:
        """Take that line away."""
        self._progress.clear()
