"""A device of the network in place of a serial port: a TCP connection, or UDP datagrams."""

import errno
import fcntl
import os
import select
import socket
import sys

from trolley.network_ports import parse_address

CONNECTS_WITHIN_S = 3.0
GIVES_UP_MS = 1000
"""What is not acknowledged for this long ends a connection, and what waits is never sent: a command
that arrives late would be driven late."""
MOST_UNSENT = 1024
"""A connection with more than this under way takes nothing: who listens has stopped doing so."""
SIOCOUTQ = 0x5411
MOST_READ, FULL_BYTES = 65536, 32768
"""A lidar of a network sends 4 kB a turn, and whoever reads may be some turns late."""


class NetworkPort:
    """An open connection, for one reading and one writing thread.

    Args:
        name: `tcp://host:port` or `udp://host:port`.

    Raises:
        OSError: nobody is there.
    """

    full_bytes = FULL_BYTES
    """After a read of so many, more may wait that is old."""

    def __init__(self, name: str) -> None:
        kind, host, port = parse_address(name)
        self._is_stream = kind == "tcp"
        if self._is_stream:
            self._socket = socket.create_connection((host, port), CONNECTS_WITHIN_S)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, GIVES_UP_MS)
        else:
            family, *_, where = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
            self._socket = socket.socket(family, socket.SOCK_DGRAM)
            # Connected, so that only what comes from there counts, and refusals are reported.
            self._socket.connect(where)
        self._socket.setblocking(False)
        self._unsent = b""

    def wait(self, timeout_s: float) -> bool:
        """Wait for bytes; whether there are any (or the device is gone, which `read` tells)."""
        return bool(select.select([self._socket], [], [], timeout_s)[0])

    def read(self) -> bytes:
        """Return what has arrived; to be called when `wait` said so.

        Raises:
            OSError: the device is gone.
        """
        data = self._socket.recv(MOST_READ)
        if not data and self._is_stream:
            raise OSError(errno.ECONNRESET, os.strerror(errno.ECONNRESET))
        return data

    def write(self, data: bytes) -> bool:
        """Send bytes without waiting; False where they were dropped.

        Of what a connection took in part the rest is sent first at the next call, so that no frame
        is cut.

        Raises:
            OSError: the device is gone.
        """
        waiting = self._unsent + data
        if not waiting:
            return True
        if self._is_stream and self._queued() > MOST_UNSENT:
            return False
        try:
            sent = self._socket.send(waiting)
        except BlockingIOError:
            return False
        self._unsent = waiting[sent:]
        return True

    def _queued(self) -> int:
        """Return how many bytes are not acknowledged."""
        answer = fcntl.ioctl(self._socket.fileno(), SIOCOUTQ, bytes(4))
        return int.from_bytes(answer, sys.byteorder)

    def discard_input(self) -> None:
        """Drop what has arrived and was not read.

        Raises:
            OSError: the device is gone.
        """
        while self.wait(0.0):
            self.read()

    def clear_rts(self) -> None:
        """Do nothing: there is no such line."""

    def close(self) -> None:
        """End the connection; may be called more than once."""
        self._socket.close()
