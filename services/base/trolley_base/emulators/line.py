"""The sending half of a serial line: bytes leave no faster than the baud rate allows."""

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
