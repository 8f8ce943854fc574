"""The connection of one page with viser's scene, through our server."""

import asyncio
import contextlib

import aiohttp
from aiohttp import web

from trolley_viz.server.sending import PAUSE_S, room_of
from trolley_viz.server.thinning import OtherFormat, Thinner

SMALL_BYTES = 4000
"""What is small goes as long as no more than this is on its way, however slow the connection is."""


class SceneLink:
    """Passes on what viser and a page say to each other, thinned where the page is slow.

    Args:
        browser: the connection with the page.
        scene: the connection with viser.
    """

    def __init__(
        self,
        browser: web.WebSocketResponse,
        transport: asyncio.Transport,
        scene: aiohttp.ClientWebSocketResponse,
    ) -> None:
        self._browser, self._transport, self._scene = browser, transport, scene
        self._waiting = Thinner()
        self._has_some = asyncio.Event()

    async def run(self) -> None:
        """Pass on until one of them is gone."""
        ways = [
            asyncio.create_task(way)
            for way in (self._to_scene(), self._to_browser(), self._send_waiting())
        ]
        try:
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for way in ways:
                way.cancel()
            await asyncio.gather(*ways, return_exceptions=True)

    async def _to_scene(self) -> None:
        async for message in self._browser:
            if message.type == aiohttp.WSMsgType.BINARY:
                await self._scene.send_bytes(message.data)

    async def _to_browser(self) -> None:
        """Send what viser says at once where there is room for it, else let it wait."""
        async for message in self._scene:
            if message.type != aiohttp.WSMsgType.BINARY:
                continue
            data: bytes = message.data
            if self._waiting.is_empty and room_of(self._transport).takes(len(data), SMALL_BYTES):
                await self._browser.send_bytes(data)
                continue
            try:
                self._waiting.take(data)
            except OtherFormat:  # of another version: as it is, then
                await self._browser.send_bytes(data)
            self._has_some.set()
            while self._waiting.is_full:
                await asyncio.sleep(PAUSE_S)

    async def _send_waiting(self) -> None:
        with contextlib.suppress(ConnectionResetError):  # the page is gone
            while True:
                await self._has_some.wait()
                self._has_some.clear()
                while not self._waiting.is_empty:
                    await self._send_next()

    async def _send_next(self) -> None:
        """Send what is small as soon as it can be, and something large where there is room."""
        room = room_of(self._transport)
        data = self._waiting.small() if room.takes(0, SMALL_BYTES) else None
        if data is None and (room.is_idle or room.takes(self._waiting.large_size, 0)):
            data = self._waiting.large()
        if data is None:
            await asyncio.sleep(PAUSE_S)
        else:
            await self._browser.send_bytes(data)
