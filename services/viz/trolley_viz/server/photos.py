"""Photos of past trips, fetched from the robot for the web server's pages."""

import asyncio
import contextlib

import msgspec

from trolley import requests
from trolley.codes import Refused
from trolley.messages import Photo
from trolley.messages.request_params import WhichPhoto
from trolley.runtime.service import Service
from trolley.topics import names_robot

PATIENCE_S = 10.0
"""The robot answers within this, or nobody is there."""


class Photos:
    """Asks the robots' tour services; a page shows only what is looked at, so nothing is kept.

    Args:
        service: whose requests are used.
    """

    def __init__(self, service: Service) -> None:
        self._service = service

    async def fetch(self, robot: str, name: str) -> bytes | None:
        """A photo (JPEG); None where there is none, or not any more."""
        try:
            params = msgspec.convert({"name": name}, WhichPhoto)
        except msgspec.ValidationError:
            return None
        if not names_robot(robot):
            return None
        loop = asyncio.get_running_loop()
        answer: asyncio.Future[Photo | Refused] = loop.create_future()

        def settle(reply: Photo | Refused) -> None:
            if not answer.done():
                answer.set_result(reply)

        def told(reply: Photo | Refused) -> None:
            with contextlib.suppress(RuntimeError):  # the web server has ended meanwhile
                loop.call_soon_threadsafe(settle, reply)

        self._service.call_soon(
            lambda: self._service.request(requests.TOUR_PHOTO, params, told, robot=robot)
        )
        try:
            reply = await asyncio.wait_for(answer, PATIENCE_S)
        except TimeoutError:
            return None
        return reply.jpeg if isinstance(reply, Photo) else None
