"""The port of an emulated device that is reached over the network: TCP, or UDP datagrams.

One host at a time. Over TCP another one is turned away; over UDP the device answers whoever spoke
last, and does not notice that somebody has left.
"""

import socket
from typing import Any, Literal

from trolley_base.emulators.pseudo_terminal import MOST_UNREAD, READ_BYTES, PortError

HOST = "127.0.0.1"


class SocketPort:
    """One port, with what a `PseudoTerminal` can do.

    Args:
        kind: how it is reached.
        number: the port's; 0: any that is free.
        baud: what it says of the host's speed, of which there is none.

    Raises:
        PortError: the port is taken.
    """

    def __init__(self, kind: Literal["tcp", "udp"], number: int, baud: int) -> None:
        self._kind, self._number, self._baud = kind, number, baud
        self._listening: socket.socket | None = None
        self._host: socket.socket | None = None
        self._peer: Any = None
        self._unread = b""
        self._is_refusing = False
        self.plug()

    @property
    def address(self) -> str:
        """Where a host finds it."""
        return f"{self._kind}://{HOST}:{self._number}"

    @property
    def is_plugged(self) -> bool:
        """Whether it is in the network."""
        return self._listening is not None

    @property
    def is_open(self) -> bool:
        """Whether a host has connected, or spoken."""
        return self._host is not None and (self._kind == "tcp" or self._peer is not None)

    @property
    def fileno(self) -> int | None:
        """What to wait on for the host's bytes; None while no host can send any."""
        return None if self._host is None or self._is_refusing else self._host.fileno()

    @property
    def device(self) -> str:
        """Its address; "" while it is not in the network."""
        return self.address if self.is_plugged else ""

    def plug(self) -> None:
        """Appear in the network."""
        stream = self._kind == "tcp"
        listening = socket.socket(type=socket.SOCK_STREAM if stream else socket.SOCK_DGRAM)
        try:
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, int(stream))
            listening.bind((HOST, self._number))
            if stream:
                listening.listen()
        except OSError as error:
            listening.close()
            raise PortError(f"{self.address} cannot be used: {error.strerror}") from error
        listening.setblocking(False)
        self._number = listening.getsockname()[1]
        self._listening = listening
        self._host = None if stream else listening
        self._is_refusing = False

    def unplug(self) -> None:
        """Leave the network: connections end."""
        for one in {self._listening, self._host} - {None}:
            assert one is not None
            one.close()
        self._listening = self._host = self._peer = None
        self._unread = b""

    def look(self) -> bool:
        """Find out whether a host is there; True when one has just come."""
        return self._meet() if self._kind == "udp" else self._accept()

    def _meet(self) -> bool:
        """Look at who has spoken; what was said stays to be read."""
        if self._host is None:
            return False
        try:
            _, peer = self._host.recvfrom(1, socket.MSG_PEEK)
        except OSError:  # nobody has, or the last one has gone
            return False
        is_new, self._peer = peer != self._peer, peer
        return is_new

    def _accept(self) -> bool:
        if self._listening is None:
            return False
        try:
            host, _ = self._listening.accept()
        except BlockingIOError:
            return False
        if self._host is not None:
            host.close()
            return False
        host.setblocking(False)
        host.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._host = host
        return True

    def read(self) -> bytes:
        """Return what the host has sent since the last call."""
        if self._host is None or self._is_refusing:
            return b""
        try:
            data = self._host.recv(READ_BYTES)
        except BlockingIOError:
            return b""
        except ConnectionError:
            data = b""
        if self._kind == "tcp" and not data:
            self._host.close()
            self._host, self._unread = None, b""
        return data

    def write(self, data: bytes) -> None:
        """Send bytes to the host, if one is there and reads now and then."""
        if self._host is None or not self.is_open:
            return
        self._unread = (self._unread + data)[:MOST_UNREAD]
        if not self._unread:
            return
        try:
            if self._kind == "udp":
                self._host.sendto(self._unread, self._peer)
                self._unread = b""
            else:
                self._unread = self._unread[self._host.send(self._unread) :]
        except BlockingIOError:
            return
        except ConnectionError:  # it has gone, which the next read tells
            self._unread = b""

    def refuse(self, *, is_refused: bool) -> None:
        """Take nothing of what the host sends, or take it again."""
        self._is_refusing = is_refused

    def host_baud(self) -> int:
        """The device's own: there is no speed to get wrong."""
        return self._baud
