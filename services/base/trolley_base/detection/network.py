"""The port of a device in the network, as a probe uses a serial one; no speed to choose."""

from trolley.network_ports import parse_address
from trolley_base.detection.known import LISTENED
from trolley_base.drivers.network_port import ListeningPort, NetworkPort


class AnyDatagrams:
    """Datagrams of whoever calls: as messages of a board that sends such, else as they are."""

    def join(self, datagram: bytes) -> bytes:
        """Return a datagram as it would be on a line."""
        for known in LISTENED:
            if known.question.datagrams is not None and (
                framed := known.question.datagrams.join(datagram)
            ):
                return framed
        return datagram

    def cut(self, data: bytes) -> list[bytes]:
        """Return what is sent, which is nothing: who calls is listened to."""
        return [data]


class NetworkProbePort:
    """A port that is named by an address.

    Args:
        name: `tcp://host:port`, `udp://host:port`, or `udp://:port`.

    Raises:
        OSError: nobody is there, or another program listens.
    """

    def __init__(self, name: str) -> None:
        self.only_listens = not parse_address(name).host
        self._port = ListeningPort(name, AnyDatagrams()) if self.only_listens else NetworkPort(name)

    def set_baud(self, baud: int) -> None:
        """Forget what came until now; there is no speed."""
        del baud
        self.discard_input()

    def wait(self, timeout_s: float) -> bool:
        """Wait for bytes."""
        return self._port.wait(timeout_s)

    def read(self) -> bytes:
        """Return what has arrived.

        Raises:
            OSError: the device is gone.
        """
        return self._port.read()

    def write(self, data: bytes) -> bool:
        """Send bytes.

        Raises:
            OSError: the device is gone.
        """
        return self._port.write(data)

    def discard_input(self) -> None:
        """Drop what has arrived.

        Raises:
            OSError: the device is gone.
        """
        self._port.discard_input()

    def close(self) -> None:
        """Let go of it."""
        self._port.close()
