"""How much is still on its way to a browser, as the system knows it."""

import asyncio
import fcntl
import socket
import struct
import termios
from dataclasses import dataclass
from typing import cast

TCP_INFO_BYTES = 168
DELIVERY_RATE_AT = 160
"""Where `tcpi_delivery_rate` stands in Linux's `struct tcp_info`: a 64-bit number."""
QUEUE_S = 0.15
"""What is sent may wait for what was sent before for this long."""
PACKET_BYTES = 1500
PAUSE_S = 0.02
"""How often it is looked whether there is room again."""


@dataclass(frozen=True)
class Room:
    """What a connection has to spare.

    Attributes:
        waiting: what was sent and has not arrived yet [B].
        rate: how much arrived of late [B/s].
    """

    waiting: int
    rate: float

    @property
    def is_idle(self) -> bool:
        """Whether next to nothing is under way."""
        return self.waiting <= PACKET_BYTES

    def takes(self, size: int, small: int) -> bool:
        """Whether so many bytes would arrive soon; `small` may wait, however slow it is [B]."""
        return self.waiting + size <= max(QUEUE_S * self.rate, small)


def room_of(transport: asyncio.Transport) -> Room:
    """Return what a TCP connection has to spare, by what its other end has confirmed.

    May be called on another thread than that which closes it.
    """
    connection = cast("socket.socket", transport.get_extra_info("socket"))
    try:
        answer = fcntl.ioctl(connection, termios.TIOCOUTQ, struct.pack("i", 0))
        info = connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, TCP_INFO_BYTES)
    except (OSError, ValueError):  # it is closed, or being closed: nothing waits any more
        return Room(0, 0.0)
    (unconfirmed,) = struct.unpack("i", answer)
    rate = 0
    if len(info) == TCP_INFO_BYTES:
        (rate,) = struct.unpack_from("Q", info, DELIVERY_RATE_AT)
    return Room(unconfirmed + transport.get_write_buffer_size(), float(rate))


async def wait_for_room(transport: asyncio.Transport, size: int) -> None:
    """Wait until so many bytes would arrive soon, or nothing else is under way."""
    while not (transport.is_closing() or room_of(transport).takes(size, size)):
        await asyncio.sleep(PAUSE_S)
