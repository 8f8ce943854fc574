"""The door's own sockets, with a plain socket where the router listens."""

import asyncio
import contextlib
import itertools
import socket
from collections.abc import Sequence

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


PROOF_S = 0.3
RETRY, CERTIFICATE, REPLY, WELCOME = bytes(99), bytes(800), bytes(300), bytes(300)


def test_a_second_hello_proves_nothing() -> None:
    """TLS asks for one where it cannot use the first: it was taken for a guest's reply."""
    hanging = (HELLO, RETRY, HELLO, CERTIFICATE)
    assert not is_kept(*hanging)
    assert is_kept(*hanging, REPLY, WELCOME)
    assert is_kept(HELLO, CERTIFICATE, REPLY, WELCOME)


def is_kept(*words: bytes) -> bool:
    """Whether a guest is still led to the router when its time is over, if they talked so."""
    with contextlib.ExitStack() as stack:
        listener, router = (
            stack.enter_context(socket.create_server(("127.0.0.1", 0))) for _ in range(2)
        )
        guest = stack.enter_context(socket.create_connection(listener.getsockname()))
        return asyncio.run(talk(listener, router, guest, words))


async def talk(
    listener: socket.socket, router: socket.socket, guest: socket.socket, words: Sequence[bytes]
) -> bool:
    """Guest and router say these words in turn; whether they are still joined a while later."""
    loop = asyncio.get_running_loop()
    for one in (router, guest):
        one.setblocking(False)
    limits = Limits(proof_s=PROOF_S)
    running = loop.create_task(Door(listener, [router.getsockname()], limits).run())
    try:
        await loop.sock_sendall(guest, words[0])
        led_in, _ = await loop.sock_accept(router)
        with led_in:
            await hear(led_in, words[0])
            speakers = itertools.cycle((led_in, guest))
            for word in words[1:]:
                speaker = next(speakers)
                await loop.sock_sendall(speaker, word)
                await hear(guest if speaker is led_in else led_in, word)
            try:
                async with asyncio.timeout(3.0 * PROOF_S):
                    await loop.sock_recv(led_in, 1)
            except TimeoutError:
                return True
            except ConnectionError:
                pass
            return False
    finally:
        running.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await running


async def hear(end: socket.socket, word: bytes) -> None:
    """Wait until all of a word has come."""
    loop, left = asyncio.get_running_loop(), len(word)
    async with asyncio.timeout(PATIENCE_S):
        while left:
            left -= len(await loop.sock_recv(end, left))
