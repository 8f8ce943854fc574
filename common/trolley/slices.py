"""Heavy work in slices, so that nothing else waits for long and it can be given up in between.

A sliced function is a generator that yields where it may be left; what it returns is the same
wherever that happens, and at whatever speed. `yield from` goes on with another one inside.
"""

from collections.abc import Callable, Generator
from functools import partial
from typing import Any, TypeVar

T = TypeVar("T")
Slices = Generator[None, None, T]
Work = Callable[[Callable[[], bool], Callable[[bool], None]], None]
"""Does something aside, then calls back with what it returned: `Service.work`."""


def whole(slices: Slices[T]) -> T:
    """Do all slices at once; returns what they lead to."""
    while True:
        try:
            next(slices)
        except StopIteration as end:
            result: T = end.value
            return result


def do_aside(
    work: Work,
    slices: Slices[Any],
    then: Callable[[], None],
    is_wanted: Callable[[], bool] = lambda: True,
) -> None:
    """Do slice by slice aside, so that other work has its turn in between.

    Args:
        work: does one of them.
        slices: all of them.
        then: called after the last one.
        is_wanted: asked after each: whether to go on; it is given up otherwise.
    """

    def slice_done(is_more: bool) -> None:
        if not is_wanted():
            return
        if is_more:
            do_aside(work, slices, then, is_wanted)
        else:
            then()

    work(partial(is_left, slices), slice_done)


def is_left(slices: Slices[Any]) -> bool:
    """Do one slice; False if it was the last one."""
    try:
        next(slices)
    except StopIteration:
        return False
    return True
