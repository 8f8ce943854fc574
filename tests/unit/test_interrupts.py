"""What asks a program to end is heard, whatever the interpreter is doing."""

import os
import signal
import weakref
from contextlib import suppress

import pytest

from trolley.interrupts import Interrupts


class Kept:
    """Something that weak references can refer to."""


def lose_one() -> None:
    """Be told to end while a callback runs out of which Python lets no exception."""
    kept = Kept()
    callback = weakref.ref(kept, lambda _: os.kill(os.getpid(), signal.SIGTERM))
    del kept
    assert callback() is None


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_wait_ends_that_begins_after_a_lost_interrupt() -> None:
    """The demo waited for ever, and only SIGKILL ended it."""
    with Interrupts().handled() as interrupts:
        lose_one()
        assert interrupts.number == signal.SIGTERM
        with pytest.raises(KeyboardInterrupt):
            interrupts.wait()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_the_next_signal_interrupts_where_one_was_lost() -> None:
    with Interrupts().handled() as interrupts:
        lose_one()
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
        assert interrupts.number == signal.SIGTERM


def test_nothing_disturbs_the_tidying_up() -> None:
    tidied = []
    with Interrupts().handled(), suppress(KeyboardInterrupt):
        try:
            os.kill(os.getpid(), signal.SIGINT)
        finally:
            os.kill(os.getpid(), signal.SIGINT)
            tidied.append("all")
    assert tidied == ["all"]
