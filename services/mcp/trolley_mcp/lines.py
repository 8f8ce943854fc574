"""What the assistant and the robot say, line by line; a stop goes before all that waits."""

import asyncio
import threading
from collections import deque
from collections.abc import Callable
from io import RawIOBase

import msgspec
from msgspec import Struct

MOST_WAITING = 10_000
"""Lines that are read ahead; then the assistant has to wait."""
CHUNK_BYTES = 1 << 16
"""What a pipe holds."""


class _Called(Struct, frozen=True):
    name: str = ""


class _Line(Struct, frozen=True):
    method: str = ""
    params: _Called = _Called()


def is_stop(line: bytes | bytearray) -> bool:
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
        stream: Where they come from, without a buffer: its lock, held by a thread that waits for
            more, would abort the program at its end.
        stop: Called at once, on the reading thread, for each call of `stop`.
    """

    def __init__(self, stream: RawIOBase, stop: Callable[[], None]) -> None:
        self._stream, self._stop = stream, stop
        self._waiting: deque[str] = deque()
        self._has_room = threading.Event()
        self._has_more = asyncio.Event()
        self._loop = asyncio.get_running_loop()
        self._has_ended = False
        threading.Thread(target=self._read, name="stdin", daemon=True).start()

    def _read(self) -> None:
        # Whatever has come is looked through at once. Each line that is read by itself, and each
        # call of the loop, lets the loop go first, which takes milliseconds while it is busy.
        begun = bytearray()
        try:
            while chunk := self._stream.read(CHUNK_BYTES):
                begun += chunk
                if b"\n" in chunk:
                    *whole, begun = begun.split(b"\n")
                    self._add(whole)
            self._add([begun] if begun else [])
            self._has_ended = True
            self._loop.call_soon_threadsafe(self._has_more.set)
        except RuntimeError:
            return  # the session has ended

    def _add(self, lines: list[bytearray]) -> None:
        for line in lines:
            text = line.decode("utf-8", "replace")
            if is_stop(line):
                self._waiting.appendleft(text)
                self._stop()
            else:
                self._waiting.append(text)
        self._loop.call_soon_threadsafe(self._has_more.set)
        while len(self._waiting) > MOST_WAITING:
            self._has_room.clear()
            if len(self._waiting) > MOST_WAITING:
                self._has_room.wait()

    def __aiter__(self) -> "Lines":
        return self

    async def __anext__(self) -> str:
        while not self._waiting:
            if self._has_ended:
                raise StopAsyncIteration
            self._has_more.clear()
            if not self._waiting and not self._has_ended:
                await self._has_more.wait()
        line = self._waiting.popleft()
        if not self._has_room.is_set() and len(self._waiting) <= MOST_WAITING:
            self._has_room.set()
        return line


class Written:
    """A stream to stdout that writes each answer at once.

    The protocol's own writer hands each of them to another thread and waits, twice. An assistant
    that reads nothing holds up its own session, not a stop: that does not need the event loop.
    """

    def __init__(self, stream: RawIOBase) -> None:
        self._stream = stream

    async def write(self, text: str) -> None:
        """Write an answer.

        Raises:
            BrokenPipeError: Nobody reads any more.
        """
        left = memoryview(text.encode())
        while left:
            left = left[self._stream.write(left) :]

    async def flush(self) -> None:
        """There is nothing to flush."""
