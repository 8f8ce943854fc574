"""What the assistant says on stdin, line by line; a stop goes before everything that waits."""

import asyncio
import threading
from collections import deque
from collections.abc import Callable
from typing import BinaryIO

import msgspec
from msgspec import Struct

MOST_WAITING = 10_000
"""Lines that are read ahead; then the assistant has to wait."""


class _Called(Struct, frozen=True):
    name: str = ""


class _Line(Struct, frozen=True):
    method: str = ""
    params: _Called = _Called()


def is_stop(line: bytes) -> bool:
    """Whether a line calls the tool `stop`."""
    if b"stop" not in line:
        return False
    try:
        said = msgspec.json.decode(line, type=_Line)
    except (msgspec.MsgspecError, RecursionError):
        return False  # the protocol answers what it does not understand
    return (said.method, said.params.name) == ("tools/call", "stop")


class Lines:
    """Lines that a thread reads as they come; iterate over them on the event loop.

    The protocol's own reader handles one line after another, and a thousand take it a second.

    Args:
        stream: Where they come from.
        stop: Called at once, on the reading thread, for each call of `stop`.
    """

    def __init__(self, stream: BinaryIO, stop: Callable[[], None]) -> None:
        self._stream, self._stop = stream, stop
        self._waiting: deque[str] = deque()
        self._room = threading.Semaphore(MOST_WAITING)
        self._has_more = asyncio.Event()
        self._loop = asyncio.get_running_loop()
        self._has_ended = False
        threading.Thread(target=self._read, name="stdin", daemon=True).start()

    def _read(self) -> None:
        try:
            for line in self._stream:
                text = line.decode("utf-8", "replace")
                if is_stop(line):
                    self._stop()
                    self._waiting.appendleft(text)
                else:
                    self._waiting.append(text)
                self._loop.call_soon_threadsafe(self._has_more.set)
                self._room.acquire()
            self._has_ended = True
            self._loop.call_soon_threadsafe(self._has_more.set)
        except RuntimeError:
            return  # the session has ended

    def __aiter__(self) -> "Lines":
        return self

    async def __anext__(self) -> str:
        while not self._waiting:
            if self._has_ended:
                raise StopAsyncIteration
            self._has_more.clear()
            if not self._waiting and not self._has_ended:
                await self._has_more.wait()
        self._room.release()
        return self._waiting.popleft()
