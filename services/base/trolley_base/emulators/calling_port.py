"""The port of an emulated micro-ROS board on UDP: it calls its agent, one message a datagram."""

import socket

from trolley_base.emulators.micro_ros import MTU, FrameReceiver, framed
from trolley_base.emulators.socket_port import HOST

OVERHEAD = 64


class CallingPort:
    """What a `SocketPort` can do, for a board that sends to a port of this computer.

    The board writes and reads frames; what leaves it are the messages in them. Plugged in again, it
    calls from another port.

    Args:
        number: the agent's port.
        baud: what it says of the host's speed, of which there is none.
    """

    def __init__(self, number: int, baud: int) -> None:
        self._number, self._baud = number, baud
        self._socket: socket.socket | None = None
        self._is_refusing = False
        self._sent = FrameReceiver()
        self.plug()

    @property
    def address(self) -> str:
        """What its host listens at."""
        return f"udp://:{self._number}"

    @property
    def is_plugged(self) -> bool:
        """Whether it is in the network."""
        return self._socket is not None

    @property
    def is_open(self) -> bool:
        """Whether what it sends goes anywhere: it does not know, and sends."""
        return self.is_plugged

    @property
    def fileno(self) -> int | None:
        """What to wait on for the host's bytes; None while no host can send any."""
        return None if self._socket is None or self._is_refusing else self._socket.fileno()

    @property
    def device(self) -> str:
        """What its host listens at; "" while it is not in the network."""
        return self.address if self.is_plugged else ""

    def plug(self) -> None:
        """Appear in the network."""
        self._socket = socket.socket(type=socket.SOCK_DGRAM)
        self._socket.bind((HOST, 0))
        self._socket.setblocking(False)
        self._sent = FrameReceiver()

    def unplug(self) -> None:
        """Leave the network."""
        if self._socket is not None:
            self._socket.close()
        self._socket = None

    def look(self) -> bool:
        """Nobody opens anything: False."""
        return False

    def read(self) -> bytes:
        """Return what the host has sent since the last call, in frames."""
        data = b""
        while self._socket is not None and not self._is_refusing:
            try:
                datagram, sender = self._socket.recvfrom(MTU + OVERHEAD)
            except BlockingIOError:
                break
            if sender == (HOST, self._number):
                data += framed(datagram)
        return data

    def write(self, data: bytes) -> None:
        """Send what is whole, a message a datagram."""
        for message in self._sent.take(data):
            if self._socket is not None:
                self._socket.sendto(message, (HOST, self._number))

    def refuse(self, *, is_refused: bool) -> None:
        """Take nothing of what the host sends, or take it again."""
        self._is_refusing = is_refused

    def host_baud(self) -> int:
        """The device's own: there is no speed to get wrong."""
        return self._baud
