"""What viser's scene is told, and how each page is sent it."""

import asyncio
import contextlib
from collections.abc import AsyncGenerator, Sequence
from itertools import takewhile

from viser.infra import Message
from viser.infra._async_message_buffer import AsyncMessageBuffer

MOST_AT_ONCE = 128
"""So many messages viser sends in one packet."""


class LoopEvent(asyncio.Event):
    """An event that only its loop's thread sets.

    viser sets it from any thread, and then asks the loop to: the first might come between a page's
    look at it and its wait, and the page would never be told of anything again.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__()
        self._thread_loop = loop

    def set(self) -> None:
        """Set it, in its loop's thread."""
        with contextlib.suppress(RuntimeError):  # no loop runs in this thread
            if asyncio.get_running_loop() is self._thread_loop:
                super().set()


class SceneBuffer(AsyncMessageBuffer):
    """Sends a page what is there, and what comes, at once and without a look at what was.

    Messages are numbered, and those that a newer one replaces are dropped. viser's own loop tries
    for each page that comes every number that there ever was: 6 million for a day in which somebody
    watched a robot drive, of which a PC tries 3 million a second, while nothing moves on any page.
    It also waits after each message for more to come: its thread would wake three times for each.
    """

    async def _window_loop(
        self, client_id: int, backlog_last_id: int, backlog_done_message: Message | None
    ) -> AsyncGenerator[Sequence[Message]]:
        """As viser's: what was there when the page came is followed by a message of its own."""
        sent, end_of_replay = -1, backlog_done_message
        try:
            while not self.done:
                window: list[Message] = []
                if self.atomic_counter == 0:
                    newest = self.message_counter - 1 if end_of_replay is None else backlog_last_id
                    waiting = self._waiting(sent, newest)
                    sent = waiting[-1][0] if len(waiting) == MOST_AT_ONCE else newest
                    window = [one for _, one in waiting if one.excluded_self_client != client_id]
                    if end_of_replay is not None and sent == newest:
                        window.append(end_of_replay)
                        end_of_replay = None
                # Of what was removed viser forgets that when all pages have been told.
                self.generator_cursors[client_id] = sent
                if window:
                    yield window
                else:
                    await self.message_event.wait()
                    self.message_event.clear()
                    await asyncio.sleep(0)
        finally:
            self.generator_cursors.pop(client_id, None)

    def _waiting(self, sent: int, newest: int) -> list[tuple[int, Message]]:
        """The first messages after `sent` up to `newest`, with their numbers, in order."""
        with self.buffer_lock:
            later = takewhile(lambda one: one[0] > sent, reversed(self.message_from_id.items()))
            return [one for one in later if one[0] <= newest][: -MOST_AT_ONCE - 1 : -1]
