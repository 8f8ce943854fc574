"""Signals as the children of tests find them: none ignored, none blocked.

A shell starts what runs in its background with SIGINT ignored, `nohup` with SIGHUP; all processes
below inherit that. A signal with a handler is back at its default in a new program, so this process
goes on ignoring them by a handler that does nothing, and whatever it starts is sent by tests what
a person's Ctrl-C would send. No wrapper and no `preexec_fn` (unsafe beside Zenoh's threads).
"""

import signal
from types import FrameType

PYTHONS_OWN = {signal.SIGPIPE, signal.SIGXFSZ}
"""Python ignores these itself, and `subprocess` restores them in children."""


def start_children_with_defaults() -> None:
    """Let all that this process starts from now on begin with default signals.

    To be called on the main thread before there are others: they inherit its mask.
    """
    for number in signal.valid_signals() - PYTHONS_OWN:
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, _do_nothing)
    signal.pthread_sigmask(signal.SIG_SETMASK, ())


def _do_nothing(_number: int, _frame: FrameType | None) -> None:
    """Ignore a signal without handing that down."""
