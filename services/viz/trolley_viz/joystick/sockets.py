"""The joystick's own connection to each browser.

viser sends the changes of all its controls through one slot in which a newer one replaces an older:
what is said ten times a second could swallow a press of Stop. It also stays open for as long as the
page; this one is there only while the pad is.
"""

import asyncio
import itertools
from collections.abc import Callable
from urllib.parse import parse_qs

import msgspec
import websockets
from msgspec import Struct
from websockets.asyncio.server import ServerConnection, broadcast

from trolley_viz import visitors
from trolley_viz.joystick.grips import Grip
from trolley_viz.words import Tone

MAX_BYTES = 1000
BAD_MESSAGE = 1008
"""WebSocket close code "policy violation"."""

Post = Callable[[Callable[[], None]], None]


class Word(Struct, frozen=True, kw_only=True):
    """What a browser is told: whether it may drive, how fast [m/s], and what there is to say."""

    can: bool
    mine: bool
    max_speed: float
    text: str
    tone: Tone


class Sockets:
    """The browsers in which the pad is open.

    Args:
        post: hands a call to the service's thread.
        said: called there with which pad it is, viser's number for the browser, and what it says.
        left: called there when a pad is gone.
    """

    def __init__(
        self, post: Post, said: Callable[[int, int, Grip], None], left: Callable[[int], None]
    ) -> None:
        self._post = post
        self._said = said
        self._left = left
        self._ids = itertools.count()
        self._open: dict[int, tuple[ServerConnection, asyncio.AbstractEventLoop]] = {}
        self._clients: dict[int, int] = {}

    async def serve(self, connection: ServerConnection) -> None:
        """Listen to one browser until it is gone, on the web server's thread."""
        who, client_id = next(self._ids), _client_id(connection)
        if client_id is None:
            await connection.close(BAD_MESSAGE, "no client is named")
            return
        # The number names another browser as easily, so it is asked who is there in truth.
        if visitors.present.get().role != "operator":
            await connection.close(BAD_MESSAGE, "only to look")
            return
        self._clients[who] = client_id
        self._open[who] = connection, asyncio.get_running_loop()
        try:
            async for data in connection:
                if len(data) > MAX_BYTES:
                    await connection.close(BAD_MESSAGE, "too long")
                    return
                self._hear(who, client_id, msgspec.json.decode(data, type=Grip))
        except websockets.ConnectionClosed:
            pass  # as good a way to go as any
        except (msgspec.MsgspecError, RecursionError):
            await connection.close(BAD_MESSAGE, "not understood")
        finally:
            del self._open[who], self._clients[who]
            self._post(lambda: self._left(who))

    def who(self) -> dict[int, int]:
        """Return the pads that are open, and viser's number for the browser of each."""
        return dict(self._clients)

    def tell(self, who: int, word: Word) -> None:
        """Tell a browser something; from any thread, without waiting for it."""
        found = self._open.get(who)
        if found is not None:
            connection, loop = found
            text = msgspec.json.encode(word).decode()
            loop.call_soon_threadsafe(broadcast, [connection], text)

    def _hear(self, who: int, client_id: int, grip: Grip) -> None:
        self._post(lambda: self._said(who, client_id, grip))


def _client_id(connection: ServerConnection) -> int | None:
    """Viser's number for the browser, as its pad names it."""
    query = "" if connection.request is None else connection.request.path.partition("?")[2]
    named = parse_qs(query).get("client", [""])[0]
    return int(named) if named.isdecimal() and len(named) < 10 else None
