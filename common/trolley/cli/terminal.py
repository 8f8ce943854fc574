"""A terminal whose keys arrive one by one, and which is left as it was found."""

import contextlib
import os
import select
import shutil
import signal
import sys
import termios
from types import TracebackType
from typing import Any, Self

import click

from trolley.cli.teleop_keys import (
    ASK_FOR_FOCUS,
    ASK_FOR_RELEASES,
    NO_MORE_FOCUS,
    NO_MORE_RELEASES,
)
from trolley.sanitize import escape

ENDING = (signal.SIGTERM, signal.SIGHUP, signal.SIGINT)
_HIDE_CURSOR, _SHOW_CURSOR = "\x1b[?25l", "\x1b[?25h"
_OTHER_SCREEN, _FIRST_SCREEN = "\x1b[?1049h", "\x1b[?1049l"
_HOME, _REST_OF_LINE, _REST_OF_SCREEN = "\x1b[H", "\x1b[K", "\x1b[J"
_INPUT, _LOCAL = 0, 3
"""Where `termios.tcgetattr` has the flags of these kinds."""


class TerminalGone(Exception):
    """The terminal was closed, or its connection was lost."""


class Terminal:
    """The terminal of this process; a context manager, on the main thread.

    Signals only set flags here, so that whoever drives ends, or pauses, in its own time.

    Args:
        whole_screen: show lines on a screen of their own from the top, as `top` does; else keys
            tell when they are released, and lines stand where the cursor was.

    Raises:
        click.UsageError: On making it, where input or output is no terminal.
    """

    def __init__(self, *, whole_screen: bool = False) -> None:
        if not (sys.stdin.isatty() and sys.stdout.isatty()):
            raise click.UsageError(
                "this is not a terminal: teleop needs one for input and output (over SSH: ssh -t)"
            )
        self.ended_by: int | None = None
        """The signal that asks this process to end."""
        self.wants_pause = False
        """Whether this process was asked to pause (SIGTSTP; Ctrl-Z arrives as a key)."""
        self._has_colours = not os.environ.get("NO_COLOR")
        self._wants_keys = False
        self._whole_screen = whole_screen
        self._input, self._output = sys.stdin.fileno(), sys.stdout.fileno()
        self._found = termios.tcgetattr(self._input)
        self._shown: list[str] = []
        self._handlers: dict[int, Any] = {}

    def __enter__(self) -> Self:
        handlers = {signal.SIGTSTP: self._asked_to_pause, signal.SIGCONT: self._going_on}
        for number, handler in {**dict.fromkeys(ENDING, self._asked_to_end), **handlers}.items():
            self._handlers[number] = signal.signal(number, handler)
        self._take_keys()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with contextlib.suppress(OSError, termios.error):  # it may be gone
            self._give_back()
        for number, handler in self._handlers.items():
            signal.signal(number, handler)

    def read(self, timeout_s: float) -> bytes:
        """Wait for keys; nothing where none come in time.

        Raises:
            TerminalGone: It was closed.
        """
        if self._wants_keys:  # after a stop that could not be seen coming
            if not self._whole_screen:
                self.write(NO_MORE_RELEASES)
            self._take_keys()
        ready, _, _ = select.select([self._input], [], [], max(0.0, timeout_s))
        if not ready:
            return b""
        try:
            data = os.read(self._input, 4096)
        except OSError as error:
            raise TerminalGone from error
        if not data:
            raise TerminalGone
        return data

    def write(self, text: str) -> None:
        """Write to it.

        Raises:
            TerminalGone: It was closed.
        """
        data = text.encode(sys.stdout.encoding or "utf-8", "replace")
        try:
            while data:
                data = data[os.write(self._output, data) :]
        except OSError as error:
            raise TerminalGone from error

    def show(self, *lines: tuple[str, str | None]) -> None:
        """Show live lines, each with its colour if any, in place of the last ones.

        They are cut to the width of the terminal.
        """
        width = shutil.get_terminal_size().columns - 1
        plain = [(escape(text)[:width], colour) for text, colour in lines]
        cut = [
            click.style(text, fg=colour) if colour and self._has_colours else text
            for text, colour in plain
        ]
        if self._whole_screen:
            ends = f"{_REST_OF_LINE}\n"
            self.write(_HOME + ends.join(cut) + _REST_OF_LINE + _REST_OF_SCREEN)
        elif cut != self._shown:
            up = f"\x1b[{len(self._shown)}A" if self._shown else ""
            self.write(f"{up}\r" + "".join(f"\x1b[2K{line}\n" for line in cut))
            self._shown = cut

    def pause(self) -> None:
        """Give the shell its terminal until this process goes on (`fg`)."""
        self._give_back()
        signal.signal(signal.SIGTSTP, signal.SIG_DFL)
        os.kill(0, signal.SIGTSTP)  # the whole group, as Ctrl-Z does
        signal.signal(signal.SIGTSTP, self._asked_to_pause)
        self.wants_pause = False
        self._shown = []
        self._take_keys()

    def _take_keys(self) -> None:
        self._wants_keys = False
        mode = termios.tcgetattr(self._input)
        mode[_INPUT] &= ~(termios.IXON | termios.ICRNL)
        mode[_LOCAL] &= ~(termios.ECHO | termios.ICANON | termios.ISIG | termios.IEXTEN)
        termios.tcsetattr(self._input, termios.TCSADRAIN, mode)
        asked = _OTHER_SCREEN if self._whole_screen else ASK_FOR_FOCUS + ASK_FOR_RELEASES
        self.write(_HIDE_CURSOR + asked)

    def _give_back(self) -> None:
        with contextlib.suppress(TerminalGone):
            asked = _FIRST_SCREEN if self._whole_screen else NO_MORE_RELEASES + NO_MORE_FOCUS
            self.write(asked + _SHOW_CURSOR)
        # What is still on its way, such as the release of the last key, is not for the shell.
        termios.tcsetattr(self._input, termios.TCSAFLUSH, self._found)

    def _asked_to_end(self, number: int, _frame: object) -> None:
        self.ended_by = number

    def _asked_to_pause(self, _number: int, _frame: object) -> None:
        self.wants_pause = True

    def _going_on(self, _number: int, _frame: object) -> None:
        self._wants_keys = True
