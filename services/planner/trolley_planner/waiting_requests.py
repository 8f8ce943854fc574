"""Requests that wait until base has said whether it is stopped, in the order in which they came."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from trolley.codes import Refused
from trolley.runtime.service import Later

R = TypeVar("R")


@dataclass(slots=True)
class _Waiting:
    """A request, and whether only those before it hold it up."""

    answer: Callable[[], None]
    is_ready: bool


class WaitingRequests:
    """Answers each request once it is ready and those before it are answered.

    Otherwise a goal that came first, and waited, would replace one that came later, or set off
    after it was canceled.
    """

    def __init__(self) -> None:
        self._queue: deque[_Waiting] = deque()

    def __len__(self) -> int:
        """Return how many wait."""
        return len(self._queue)

    def add(self, act: Callable[[], R], later: Later[R], *, is_ready: bool) -> Callable[[], None]:
        """Let a request wait; return what to call when it is ready.

        Args:
            act: does what is asked, and may refuse it.
            later: the answer.
            is_ready: whether it waits only for those before it.
        """

        def answer() -> None:
            try:
                later.reply(act())
            except Refused as refused:
                later.refuse(refused)

        waiting = _Waiting(answer, is_ready)
        self._queue.append(waiting)

        def ready() -> None:
            waiting.is_ready = True
            while self._queue and self._queue[0].is_ready:
                self._queue.popleft().answer()

        return ready
