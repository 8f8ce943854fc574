"""Waiting for a state instead of for a time."""

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


def wait_until(happened: Callable[[], T], seconds: float, what: str) -> T:
    """Ask every 10 ms until `happened()` is true and return that; fail after `seconds`."""
    end_s = time.monotonic() + seconds
    while True:
        result = happened()
        if result:
            return result
        if time.monotonic() > end_s:
            raise AssertionError(f"not within {seconds} s: {what}")
        time.sleep(0.01)
