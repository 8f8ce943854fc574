"""Connections to the browsers beside viser's own, for pieces of the page that are ours.

viser sends the changes of all its controls through one slot in which a newer one replaces an older:
what is said ten times a second could swallow a press of Stop. It also stays open for as long as the
page; these are there only while their piece is.
"""

import asyncio
import itertools
from collections.abc import Callable
from typing import Generic, TypeVar
from urllib.parse import parse_qs

import msgspec
import websockets
from msgspec import Struct
from websockets.asyncio.server import ServerConnection, broadcast

from trolley_viz import visitors

MAX_BYTES = 1000
BAD_MESSAGE = 1008
"""WebSocket close code "policy violation"."""

Post = Callable[[Callable[[], None]], None]
S = TypeVar("S", bound=Struct)


class Sockets(Generic[S]):
    """The browsers in which a piece is open.

    Args:
        post: hands a call to the service's thread.
        hears: what a browser may say.
        said: called there with which piece it is, viser's number for the browser, and what it says.
        left: called there when a piece is gone.
        operators_only: whether it is closed to those who may only look.
    """

    def __init__(
        self,
        post: Post,
        hears: type[S],
        said: Callable[[int, int, S], None],
        left: Callable[[int], None],
        *,
        operators_only: bool,
    ) -> None:
        self._post = post
        self._hears = hears
        self._said = said
        self._left = left
        self._ids = itertools.count()
        self._open: dict[int, tuple[ServerConnection, asyncio.AbstractEventLoop]] = {}
        self._clients: dict[int, int] = {}
        self._operators_only = operators_only
        self._operators: set[int] = set()

    async def serve(self, connection: ServerConnection) -> None:
        """Listen to one browser until it is gone, on the web server's thread."""
        who, client_id = next(self._ids), _client_id(connection)
        if client_id is None:
            await connection.close(BAD_MESSAGE, "no client is named")
            return
        # The number names another browser as easily, so it is asked who is there in truth.
        is_operator = visitors.present.get().role == "operator"
        if self._operators_only and not is_operator:
            await connection.close(BAD_MESSAGE, "only to look")
            return
        if is_operator:
            self._operators.add(who)
        self._clients[who] = client_id
        self._open[who] = connection, asyncio.get_running_loop()
        try:
            async for data in connection:
                if len(data) > MAX_BYTES:
                    await connection.close(BAD_MESSAGE, "too long")
                    return
                self._hear(who, client_id, msgspec.json.decode(data, type=self._hears))
        except websockets.ConnectionClosed:
            pass  # as good a way to go as any
        except (msgspec.MsgspecError, RecursionError):
            await connection.close(BAD_MESSAGE, "not understood")
        finally:
            del self._open[who], self._clients[who]
            self._operators.discard(who)
            self._post(lambda: self._left(who))

    def who(self) -> dict[int, int]:
        """Return the pieces that are open, and viser's number for the browser of each."""
        return dict(self._clients)

    def may_act(self, who: int) -> bool:
        """Whether the person at a piece may do more than look."""
        return who in self._operators

    def tell(self, who: int, word: Struct) -> None:
        """Tell a browser something; from any thread, without waiting for it."""
        found = self._open.get(who)
        if found is not None:
            connection, loop = found
            text = msgspec.json.encode(word).decode()
            loop.call_soon_threadsafe(broadcast, [connection], text)

    def _hear(self, who: int, client_id: int, said: S) -> None:
        self._post(lambda: self._said(who, client_id, said))


def _client_id(connection: ServerConnection) -> int | None:
    """Viser's number for the browser, as its piece names it."""
    query = "" if connection.request is None else connection.request.path.partition("?")[2]
    named = parse_qs(query).get("client", [""])[0]
    return int(named) if named.isdecimal() and len(named) < 10 else None
