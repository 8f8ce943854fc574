"""The life line: one socket to each open page, on which both sides hear each other all the time."""

import asyncio
import contextlib
from collections import deque
from collections.abc import Callable

import aiohttp
import msgspec
from aiohttp import web

from trolley_viz.server.messages import Said, Told
from trolley_viz.server.sending import room_of, silence_of
from trolley_viz.server.visitors import Visitor
from trolley_viz.threads import Post

MAX_LINES = 100
"""A household has fewer pages open."""
SMALL_BYTES = 2000
"""With more than that on its way the page waits for what is new."""
MOST_UNHEARD = 32
"""With so many of its words unheard by the service, no more is read from a page: one that floods
the viewer takes nobody's Stop the room."""
UNHEARD_S = 0.02
"""How often it is looked whether they were heard [s]."""
NOT_UNDERSTOOD, TOO_MANY = 1008, 1013
"""WebSocket close codes "policy violation" and "try again later"."""


class Line:
    """The connection to one page; what is sent goes in order, from any thread, without waiting.

    Args:
        socket: to the page.
        key: the page's own secret: who comes again with it is the same page.
        visitor: who it is.
    """

    def __init__(
        self,
        socket: web.WebSocketResponse,
        transport: asyncio.Transport,
        key: str,
        visitor: Visitor,
    ) -> None:
        self.key = key
        self.visitor = visitor
        self.socket = socket
        self._transport = transport
        self._loop = asyncio.get_running_loop()
        self._waiting: deque[Told] = deque()
        self._num_said = 0  # counted on the web server's thread
        self._num_heard = 0  # counted on the service's thread
        self._has_some = asyncio.Event()

    @property
    def is_clear(self) -> bool:
        """Whether everything that was sent is on its way: only then more than beats is sent."""
        return not self._waiting and room_of(self._transport).takes(0, SMALL_BYTES)

    @property
    def silence_s(self) -> float:
        """How long nothing has come from the page [s], be it handled or not."""
        return silence_of(self._transport)

    async def said(self) -> None:
        """Count what the page said; wait while too much of it has not been heard."""
        self._num_said += 1
        while self._num_said - self._num_heard >= MOST_UNHEARD:
            await asyncio.sleep(UNHEARD_S)

    def heard(self) -> None:
        """Count what the service has heard."""
        self._num_heard += 1

    def send(self, told: Told) -> None:
        """Tell the page something."""
        self._waiting.append(told)
        self._call(self._has_some.set)

    def close(self) -> None:
        """Hang up, without waiting for a page that hears nothing, nor for what it was told last."""
        self._call(self._transport.abort)

    async def write(self) -> None:
        """Send what waits, until the line is closed."""
        with contextlib.suppress(ConnectionResetError):  # the page is gone
            while True:
                await self._has_some.wait()
                self._has_some.clear()
                while self._waiting:
                    told = msgspec.json.encode(self._waiting.popleft())
                    await self.socket.send_str(told.decode())

    def _call(self, fn: Callable[[], None]) -> None:
        """Call on the web server's thread, if it still runs."""
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(fn)


class Lines:
    """The life lines of all pages, served on the web server's thread.

    Args:
        post: hands a call to the service's thread, where the following are called; it drops none.
        opened: with a line that is open.
        heard: with a line and what its page said.
        closed: with a line that is gone.
    """

    def __init__(
        self,
        post: Post,
        opened: Callable[[Line], None],
        heard: Callable[[Line, Said], None],
        closed: Callable[[Line], None],
    ) -> None:
        self._post = post
        self._opened, self._heard, self._closed = opened, heard, closed
        self._open: set[Line] = set()

    async def serve(self, line: Line) -> None:
        """Listen to one page until it is gone."""
        socket = line.socket
        if len(self._open) >= MAX_LINES:
            await socket.close(code=TOO_MANY, message=b"too many pages are open")
            return
        self._open.add(line)
        self._post(lambda: self._opened(line))
        writer = asyncio.create_task(line.write())
        try:
            async for message in socket:
                if message.type != aiohttp.WSMsgType.TEXT:
                    raise msgspec.DecodeError("no text")
                self._hear(line, msgspec.json.decode(message.data, type=Said))
                await line.said()
        except (msgspec.MsgspecError, RecursionError):
            await socket.close(code=NOT_UNDERSTOOD, message=b"not understood")
        finally:
            writer.cancel()
            self._open.discard(line)
            self._post(lambda: self._closed(line))

    def _hear(self, line: Line, said: Said) -> None:
        def hear() -> None:
            line.heard()
            self._heard(line, said)

        self._post(hear)
