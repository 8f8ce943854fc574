"""A serial line: bytes leave no faster than the baud rate allows.

Who listens at another speed hears other bytes.
"""

from collections import deque

from trolley_base.drivers.dialogue import BITS_PER_BYTE
from trolley_base.units import NS_PER_S

BUFFER_BYTES = 1024
"""What a device's own transmit buffer holds; what does not fit is lost."""


class Line:
    """Queues what a device sends and hands it over byte by byte, as the line carries it.

    Args:
        baud: bits per second.
        buffer_bytes: how much may wait.
    """

    def __init__(self, baud: int, buffer_bytes: int = BUFFER_BYTES) -> None:
        self._byte_ns = BITS_PER_BYTE * NS_PER_S / baud
        self._buffer_bytes = buffer_bytes
        self._queue: deque[tuple[float, bytes]] = deque()
        self._free_ns = 0.0
        self.dropped = 0
        """Bytes that found the buffer full."""

    def push(self, due_ns: int, data: bytes) -> None:
        """Send from `due_ns` on, or as soon as the line is free."""
        start_ns = max(float(due_ns), self._free_ns)
        room = self._buffer_bytes - int((start_ns - due_ns) / self._byte_ns)
        self.dropped += max(0, len(data) - max(0, room))
        data = data[: max(0, room)]
        if data:
            self._queue.append((start_ns, data))
            self._free_ns = start_ns + len(data) * self._byte_ns

    def take(self, now_ns: int) -> bytes:
        """Return the bytes that have been fully transmitted by now."""
        gone: list[bytes] = []
        while self._queue:
            start_ns, data = self._queue[0]
            count = int((now_ns - start_ns) / self._byte_ns)
            if count <= 0:
                break
            gone.append(data[:count])
            if count < len(data):
                self._queue[0] = (start_ns + count * self._byte_ns, data[count:])
                break
            self._queue.popleft()
        return b"".join(gone)

    def clear(self) -> None:
        """Drop what is queued."""
        self._queue.clear()
        self._free_ns = 0.0


def misheard(data: bytes, sent_baud: int, heard_baud: int) -> bytes:
    """Return what a receiver at another speed makes of bytes that were sent without a pause.

    Each byte is a start bit (low), eight data bits, lowest first, and a stop bit (high). The
    receiver waits for the line to fall and samples the middle of each of its own bits. A stop bit
    that is low goes unnoticed, as with most firmware.

    Args:
        data: what was sent.
        sent_baud: bits per second of the sender.
        heard_baud: bits per second of the receiver.
    """
    wave = [bit for byte in data for bit in (0, *(byte >> place & 1 for place in range(8)), 1)]
    sent_per_heard = sent_baud / heard_baud
    heard = bytearray()
    at = 0
    while at < len(wave):
        if wave[at]:
            at += 1
            continue
        middles = (at + (place + 1.5) * sent_per_heard for place in range(8))
        bits = [wave[int(middle)] if middle < len(wave) else 1 for middle in middles]
        heard.append(sum(bit << place for place, bit in enumerate(bits)))
        # From the middle of the stop bit on it waits until the line is high, and falls again.
        at = int(at + 9.5 * sent_per_heard)
        while at < len(wave) and not wave[at]:
            at += 1
    return bytes(heard)
