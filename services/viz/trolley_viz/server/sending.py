"""What is still on its way to a browser, and when it was last heard, as the system knows it."""

import asyncio
import fcntl
import math
import socket
import struct
import termios
from dataclasses import dataclass
from typing import cast

TCP_INFO_BYTES = 168
LAST_DATA_RECEIVED_AT, DELIVERY_RATE_AT = 52, 160
"""Where `tcpi_last_data_recv` (32 bits) and `tcpi_delivery_rate` (64 bits) stand in Linux's
`struct tcp_info`."""
QUEUE_S = 0.15
"""What is sent may wait for what was sent before for this long."""
PACKET_BYTES = 1500
PAUSE_S = 0.02
"""How often it is looked whether there is room again."""


@dataclass(frozen=True)
class Room:
    """How much of what was sent to a browser is still on its way, and how fast it arrives.

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
        info = _tcp_info(connection)
    except (OSError, ValueError):  # it is closed, or being closed: nothing waits any more
        return Room(0, 0.0)
    (unconfirmed,) = struct.unpack("i", answer)
    rate = 0
    if len(info) == TCP_INFO_BYTES:
        (rate,) = struct.unpack_from("Q", info, DELIVERY_RATE_AT)
    return Room(unconfirmed + transport.get_write_buffer_size(), float(rate))


def silence_of(transport: asyncio.Transport) -> float:
    """Return how long ago the newest bytes came in [s], whether or not they were read since.

    May be called on another thread than that which closes it; infinite for what is closed.
    """
    connection = cast("socket.socket", transport.get_extra_info("socket"))
    try:
        info = _tcp_info(connection)
    except (OSError, ValueError):
        return math.inf
    (silent_ms,) = struct.unpack_from("I", info, LAST_DATA_RECEIVED_AT)
    return silent_ms * 1e-3


def _tcp_info(connection: socket.socket) -> bytes:
    return connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, TCP_INFO_BYTES)


async def wait_for_room(transport: asyncio.Transport, size: int) -> None:
    """Wait until so many bytes would arrive soon, or nothing else is under way."""
    while not (transport.is_closing() or room_of(transport).takes(size, size)):
        await asyncio.sleep(PAUSE_S)
