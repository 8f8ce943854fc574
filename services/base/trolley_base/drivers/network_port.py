"""A device of the network in place of a serial port: a TCP connection, or UDP datagrams.

Most devices are called. A `ListeningPort` is for one that sends to this computer, such as a board
that looks for its agent; whoever speaks first is heard, others only once it has gone silent.
"""

import errno
import fcntl
import os
import select
import socket
import sys
import time

from trolley.network_ports import AddressChangedError, parse_address
from trolley_base.drivers.dialogue import Datagrams

CONNECTS_WITHIN_S = 3.0
GIVES_UP_MS = 1000
"""What is not acknowledged for this long ends a connection, and what waits is never sent: a command
that arrives late would be driven late."""
MOST_UNSENT = 1024
"""A connection with more than this under way takes nothing: who listens has stopped doing so."""
SIOCOUTQ = 0x5411
MOST_READ, FULL_BYTES = 65536, 32768
"""A lidar of a network sends 4 kB a turn, and whoever reads may be some turns late."""
SILENT_S = 0.5
"""A device that calls and has been silent for this long has gone; another may be heard. A board
loses its session sooner."""


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
        if self._is_stream:
            if not data:
                raise OSError(errno.ECONNRESET, os.strerror(errno.ECONNRESET))
            return data
        # All datagrams that wait: a fast lidar sends more of them than there are reads.
        while len(data) < FULL_BYTES:
            try:
                data += self._socket.recv(MOST_READ)
            except BlockingIOError:
                break
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


class ListeningPort:
    """A UDP port of this computer to which a device sends, for one reading and one writing thread.

    Args:
        name: `udp://:port`.
        datagrams: how a stream of bytes is cut into datagrams; None: the bytes are as they come,
            and each write is one datagram.

    Raises:
        OSError: another program listens there.
    """

    full_bytes = FULL_BYTES

    def __init__(self, name: str, datagrams: Datagrams | None) -> None:
        self._datagrams = datagrams
        self._socket = socket.socket(type=socket.SOCK_DGRAM)
        try:
            self._socket.bind(("", parse_address(name).port))
        except OSError:
            self._socket.close()
            raise
        self._socket.setblocking(False)
        self._peer: tuple[str, int] | None = None
        self._heard_s = 0.0
        self._num_strangers = 0

    def wait(self, timeout_s: float) -> bool:
        """Wait for datagrams; whether there are any."""
        return bool(select.select([self._socket], [], [], timeout_s)[0])

    def read(self) -> bytes:
        """Return what the device has sent, b"" where only others have.

        Raises:
            AddressChangedError: the device has gone, and somebody else calls.
        """
        data = b""
        while len(data) < FULL_BYTES:
            try:
                datagram, sender = self._socket.recvfrom(MOST_READ)
            except BlockingIOError:
                break
            # What is no message of such a device at all makes nobody one.
            part = datagram if self._datagrams is None else self._datagrams.join(datagram)
            if part and self._is_heard(sender):
                data += part
        return data

    def _is_heard(self, sender: tuple[str, int]) -> bool:
        now_s = time.monotonic()
        if self._peer is None:
            self._peer = sender
        elif sender != self._peer:
            if now_s - self._heard_s < SILENT_S:
                self._num_strangers += 1
                return False
            raise AddressChangedError(
                errno.EADDRNOTAVAIL,
                f"the device at {self._peer[0]}:{self._peer[1]} is silent, and {sender[0]}:"
                f"{sender[1]} calls instead, which is heard from now on.",
            )
        self._heard_s = now_s
        return True

    def write(self, data: bytes) -> bool:
        """Send bytes to the device without waiting; False while none has called.

        Raises:
            OSError: the network is gone.
        """
        if self._peer is None:
            return False
        try:
            for one in [data] if self._datagrams is None else self._datagrams.cut(data):
                self._socket.sendto(one, self._peer)
        except BlockingIOError:
            return False
        return True

    def take_strangers(self) -> int:
        """Return how many datagrams of others were left out since the last call."""
        number, self._num_strangers = self._num_strangers, 0
        return number

    def discard_input(self) -> None:
        """Drop what has arrived and was not read."""
        while self.wait(0.0):
            self._socket.recv(MOST_READ)

    def clear_rts(self) -> None:
        """Do nothing: there is no such line."""

    def close(self) -> None:
        """Listen no more; may be called more than once."""
        self._socket.close()
