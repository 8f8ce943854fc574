"""Heavy work in slices, so that nothing else waits for long and it can be given up in between.

A sliced function is a generator that yields where it may be left; what it returns is the same
wherever that happens, and at whatever speed. `yield from` goes on with another one inside.
"""

from collections.abc import Generator
from typing import Any, TypeVar

T = TypeVar("T")
Slices = Generator[None, None, T]


def whole(slices: Slices[T]) -> T:
    """Do all slices at once; returns what they lead to."""
    while True:
        try:
            next(slices)
        except StopIteration as end:
            result: T = end.value
            return result


def is_left(slices: Slices[Any]) -> bool:
    """Do one slice; False if it was the last one."""
    try:
        next(slices)
    except StopIteration:
        return False
    return True
