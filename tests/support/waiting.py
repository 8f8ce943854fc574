"""Waiting for a state instead of for a time, and times that a loaded machine may exceed."""

import threading
import time
from collections.abc import Callable
from typing import Self, TypeVar

T = TypeVar("T")

POLL_S = 0.01
HANDS = 5
"""Threads and processes that a cause passes through until its effect is seen."""


def wait_until(happened: Callable[[], T], seconds: float, what: str) -> T:
    """Ask every 10 ms until `happened()` is true and return that; fail after `seconds`.

    A pause counts as the 10 ms that it should have been: where the machine comes round to this
    process late, it does to those that are waited for, too.
    """
    left_s = seconds
    while True:
        asked_s = time.monotonic()
        result = happened()
        if result:
            return result
        left_s -= time.monotonic() - asked_s + POLL_S
        if left_s < 0.0:
            raise AssertionError(f"not within {seconds} s: {what}")
        time.sleep(POLL_S)


class Lateness:
    """How late this machine comes round to whoever is due, as a thread sees that mostly sleeps."""

    def __init__(self) -> None:
        self._worst_s = 0.0
        self._end = threading.Event()

    def __enter__(self) -> Self:
        self._end.clear()
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()

    def reset(self) -> None:
        """Look from now on."""
        self._worst_s = 0.0

    @property
    def allowance_s(self) -> float:
        """By how much a promised time may be exceeded through nobody's fault."""
        return HANDS * self._worst_s

    def _watch(self) -> None:
        while not self._end.is_set():
            before_s = time.monotonic()
            time.sleep(0.001)
            self._worst_s = max(self._worst_s, time.monotonic() - before_s - 0.001)
