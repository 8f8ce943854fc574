"""Waiting for a state instead of for a time."""

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

PATIENCE_S = 180.0
"""The one limit of all waits: it only catches what hangs, and judges nobody's speed.

How quickly something must happen is judged in lock-step, by the robot's own clock, by the order of
bytes on a line, or measured by a program of `bench/`. A slow machine makes a test slower, not red.
"""
POLL_S, LONGEST_POLL_S = 0.01, 0.05
"""The first pause and the longest; each is a tenth longer than the one before.

What comes soon is seen soon, and what takes seconds costs those that work for it less.
"""


def wait_until(
    happened: Callable[[], T], what: str | Callable[[], str], patience_s: float = PATIENCE_S
) -> T:
    """Ask again and again until `happened()` is true and return that; fail where it seems to hang.

    What is waited for is told then, by a function as it stands at that time.

    A pause counts as what it should have been: where the machine comes round to this process late,
    it does to those that are waited for, too.
    """
    left_s, pause_s = patience_s, POLL_S
    while True:
        asked_s = time.monotonic()
        result = happened()
        if result:
            return result
        left_s -= time.monotonic() - asked_s + pause_s
        if left_s < 0.0:
            told = what if isinstance(what, str) else what()
            raise AssertionError(f"it hangs, after {patience_s:g} s: {told}")
        time.sleep(pause_s)
        pause_s = min(1.1 * pause_s, LONGEST_POLL_S)
