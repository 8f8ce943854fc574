"""What asks a program with children to end: Ctrl-C, SIGTERM, a terminal that is closed."""

import signal
from collections.abc import Generator
from contextlib import contextmanager


class Interrupts:
    """Turns the first of the signals into a KeyboardInterrupt; a context manager's value.

    Nothing disturbs the tidying up after that, and nothing strikes while `held`: what is being
    started is then known to whoever ends it.
    """

    ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

    def __init__(self) -> None:
        self.number: int | None = None
        """The signal that came first."""
        self._depth = 0

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
        came_before = self.number is not None
        try:
            yield
        finally:
            self._depth -= 1
        if self.number is not None and not came_before and self._depth == 0:
            raise KeyboardInterrupt

    def _interrupt(self, number: int, _frame: object) -> None:
        if self.number is not None:
            return
        self.number = number
        if self._depth == 0:
            raise KeyboardInterrupt
