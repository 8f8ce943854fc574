"""What a supervised process does when its supervisor dies without a word: it ends too."""

import ctypes
import os
import signal
import sys

VARIABLE = "TROLLEY_PARENT"
"""Holds the supervisor's process id."""
_PR_SET_PDEATHSIG = 1


def end_with_parent() -> None:
    """Get SIGTERM from the kernel when the supervisor that the environment names has ended.

    Otherwise the services of a supervisor that was killed would wait for its router for ever, and
    clash with those of the next one.
    """
    parent = os.environ.get(VARIABLE)
    if not parent:
        return
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != int(parent):  # it ended before that
        sys.exit(0)
