"""WebSockets to the browsers besides viser's own, for the pieces of the page that are ours.

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

from trolley_viz.server import visitors
from trolley_viz.threads import Post

MAX_BYTES = 1000
BAD_MESSAGE = 1008
"""WebSocket close code "policy violation"."""

S = TypeVar("S", bound=Struct)


class Sockets(Generic[S]):
    """The connections of one kind of piece, one for each browser in which it is open.

    Args:
        post: hands a call to the service's thread.
        accepts: the messages that a browser may send.
        received: called there with the number of the piece, viser's number for the browser, and
            the message.
        closed: called there with the number of a piece that is gone.
        operators_only: whether it is closed to those who may only look.
    """

    def __init__(
        self,
        post: Post,
        accepts: type[S],
        received: Callable[[int, int, S], None],
        closed: Callable[[int], None],
        *,
        operators_only: bool,
    ) -> None:
        self._post = post
        self._accepts = accepts
        self._received = received
        self._closed = closed
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
                self._hear(who, client_id, msgspec.json.decode(data, type=self._accepts))
        except websockets.ConnectionClosed:
            pass  # as good a way to go as any
        except (msgspec.MsgspecError, RecursionError):
            await connection.close(BAD_MESSAGE, "not understood")
        finally:
            del self._open[who], self._clients[who]
            self._operators.discard(who)
            self._post(lambda: self._closed(who))

    def clients(self) -> dict[int, int]:
        """Return viser's number for the browser of each piece that is open."""
        return dict(self._clients)

    def may_act(self, who: int) -> bool:
        """Whether the person at a piece may do more than look."""
        return who in self._operators

    def send(self, who: int, message: Struct) -> None:
        """Send a browser a message; from any thread, without waiting for it."""
        found = self._open.get(who)
        if found is not None:
            connection, loop = found
            text = msgspec.json.encode(message).decode()
            loop.call_soon_threadsafe(broadcast, [connection], text)

    def _hear(self, who: int, client_id: int, received: S) -> None:
        self._post(lambda: self._received(who, client_id, received))


def _client_id(connection: ServerConnection) -> int | None:
    """Viser's number for the browser, as its piece names it."""
    query = "" if connection.request is None else connection.request.path.partition("?")[2]
    named = parse_qs(query).get("client", [""])[0]
    return int(named) if named.isdecimal() and len(named) < 10 else None
