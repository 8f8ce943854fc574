"""What asks a program to end is heard, whatever the interpreter is doing."""

import os
import signal
import weakref
from contextlib import suppress

import click
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


def interrupted_as(becomes: type[BaseException]) -> None:
    """Be told to end where something else is made of that, as at a question of click's."""
    try:
        os.kill(os.getpid(), signal.SIGINT)
    except KeyboardInterrupt:
        raise becomes from None


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


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_signal_that_is_held_up_is_heard_where_one_was_lost() -> None:
    done = []
    with Interrupts().handled() as interrupts:
        lose_one()

        def start() -> None:
            with interrupts.held():
                os.kill(os.getpid(), signal.SIGINT)
                done.append("started")

        with pytest.raises(KeyboardInterrupt):
            start()
    assert done == ["started"]


@pytest.mark.parametrize("becomes", [KeyboardInterrupt, click.Abort])
def test_nothing_disturbs_the_tidying_up(becomes: type[BaseException]) -> None:
    tidied: list[str] = []
    with Interrupts().handled(), suppress(becomes):
        try:
            interrupted_as(becomes)
        finally:
            try:
                tidied.remove("nothing")
            except ValueError:
                os.kill(os.getpid(), signal.SIGINT)
            tidied.append("all")
    assert tidied == ["all"]
