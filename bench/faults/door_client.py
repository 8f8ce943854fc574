"""Hangs at a port with many connections, and comes again if it is sent away.

python -m bench.faults.door_client PORT HOW AGAIN COUNT SECONDS ADDRESS...

`bench.faults` starts it. HOW is `silent`, `half`, `hello`, `drip` (a byte a second) or `rubbish`;
AGAIN is `again` or `once`.
Prints a line once all have connected for the first time.
"""

import asyncio
import contextlib
import os
import ssl
import sys

CALM_S = 1.0
"""Before it comes again; half of them at a time would be a flood, not a crowd."""
SYN_S = 10.0


def hello() -> bytes:
    """What a TLS client says first."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    said = ssl.MemoryBIO()
    with contextlib.suppress(ssl.SSLWantReadError):
        context.wrap_bio(ssl.MemoryBIO(), said, server_hostname="home").do_handshake()
    return said.read()


HELLO = hello()
WORDS = {"silent": b"", "half": HELLO[:100], "hello": HELLO, "drip": HELLO, "rubbish": b"GET /\r\n"}


async def _hang(
    port: int, how: str, address: str, connected: asyncio.Semaphore, *, comes_again: bool
) -> None:
    is_first = True
    while is_first or comes_again:
        writer: asyncio.StreamWriter | None = None
        try:
            opening = asyncio.open_connection("127.0.0.1", port, local_addr=(address, 0))
            reader, writer = await asyncio.wait_for(opening, SYN_S)
            if is_first:
                connected.release()
                is_first = False
            if how == "drip":
                for place in range(len(HELLO)):
                    writer.write(HELLO[place : place + 1])
                    await writer.drain()
                    await asyncio.sleep(1.0)
            writer.write(WORDS[how])
            while await reader.read(4096):
                pass
        except OSError:
            pass  # sent away: that is what it came for
        finally:
            if writer is not None:
                writer.close()
        await asyncio.sleep(CALM_S)


async def _main() -> None:
    port, how, again, count, seconds, *addresses = sys.argv[1:]
    connected = asyncio.Semaphore(0)
    tasks = [
        asyncio.create_task(
            _hang(
                int(port),
                how,
                addresses[i % len(addresses)],
                connected,
                comes_again=again == "again",
            )
        )
        for i in range(int(count))
    ]
    for _ in tasks:
        await connected.acquire()
    print("all there", flush=True)
    await asyncio.sleep(float(seconds))
    os._exit(0)  # all at once, as a host that is switched off


if __name__ == "__main__":
    asyncio.run(_main())
