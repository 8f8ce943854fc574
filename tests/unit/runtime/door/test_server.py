"""The door's own sockets, with a plain socket where the router listens."""

import asyncio
import contextlib
import socket

from support.waiting import PATIENCE_S

from trolley.runtime.door.admission import Limits
from trolley.runtime.door.server import Door

HELLO = bytes([22, 3, 1, 0, 1, 1])
LIMITS = Limits(guests_per_address=4)
CROWD = 32


def test_who_greeted_while_it_waited_to_be_taken_is_not_sent_away_for_a_crowd() -> None:
    """All come at once: heard only after all were taken, the first were the oldest silent one."""
    with contextlib.ExitStack() as stack:
        listener, router = (
            stack.enter_context(socket.create_server(("127.0.0.1", 0), backlog=2 * CROWD))
            for _ in range(2)
        )
        first = stack.enter_context(socket.create_connection(listener.getsockname()))
        first.sendall(HELLO)
        for _ in range(CROWD):
            stack.enter_context(socket.create_connection(listener.getsockname()))
        assert asyncio.run(first_words(listener, router)) == HELLO


async def first_words(listener: socket.socket, router: socket.socket) -> bytes:
    """What the first who is led in says to the router."""
    loop = asyncio.get_running_loop()
    router.setblocking(False)
    running = loop.create_task(Door(listener, [router.getsockname()], LIMITS).run())
    try:
        async with asyncio.timeout(PATIENCE_S):
            led_in, _ = await loop.sock_accept(router)
            with led_in:
                return await loop.sock_recv(led_in, len(HELLO))
    finally:
        running.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await running
