"""What asks a program with children to end: Ctrl-C, SIGTERM, a terminal that is closed."""

import signal
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager
from typing import NoReturn


class Interrupts:
    """Turns the signals into a KeyboardInterrupt; a context manager's value.

    Nothing disturbs the tidying up after that, and nothing strikes while `held`: what is being
    started is then known to whoever ends it. Python drops an exception that comes while it runs a
    finalizer or the callback of a weak reference: `wait` ends all the same, and so does anything
    else with the next signal.
    """

    ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    POLL_S = 0.2

    def __init__(self) -> None:
        self.number: int | None = None
        """The signal that came first."""
        self._depth = 0
        self._is_held_up = False

    @contextmanager
    def handled(self) -> Generator["Interrupts"]:
        """Take the signals meanwhile; those that are ignored stay so, as under `nohup`."""
        taken = [one for one in self.ENDING if signal.getsignal(one) is not signal.SIG_IGN]
        before = {number: signal.signal(number, self._interrupt) for number in taken}
        try:
            yield self
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    @contextmanager
    def held(self) -> Generator[None]:
        """Let what comes meanwhile wait until the end."""
        self._depth += 1
        try:
            yield
        finally:
            self._depth -= 1
        if self._is_held_up and self._depth == 0:
            self._is_held_up = False
            raise KeyboardInterrupt

    def wait(self) -> NoReturn:
        """Wait for one of them."""
        while self.number is None:
            time.sleep(self.POLL_S)  # not `signal.pause`: it sleeps on when one came just before it
        raise KeyboardInterrupt

    def _interrupt(self, number: int, _frame: object) -> None:
        if self.number is None:
            self.number = number
        if _is_tidying_up():
            return
        if self._depth == 0:
            raise KeyboardInterrupt
        self._is_held_up = True


def _is_tidying_up() -> bool:
    """Whether a KeyboardInterrupt is handled, or what became of it, such as `click.Abort`."""
    error = sys.exc_info()[1]
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return error is not None
