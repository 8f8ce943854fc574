"""Keeps a port open, serial or of the network: a thread that opens, reads and stores, no more.

The thread never touches a dialogue or the service (a line's `responder` is apart from both); what
it met waits in a bounded store until the service's own thread takes it. A port that is lost or
cannot be opened is tried again, with pauses that grow.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from trolley.network_ports import is_network, parse_address
from trolley_base.drivers.dialogue import BITS_PER_BYTE, Line
from trolley_base.drivers.network_port import ListeningPort, NetworkPort
from trolley_base.drivers.serial_port import SerialPort

Port = SerialPort | NetworkPort | ListeningPort

FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.25, 3.0
"""Pauses before the port is opened again [s]."""
STEADY_S = 5.0
"""A port that stayed open for this long begins with the shortest pause again."""
GATHER_S = 0.004
"""Bytes are gathered for this long, so that a fast line does not wake the thread for each of
them."""
POLL_S = 0.1
BACKLOG_S = 0.05
"""After a read of a full port, everything that arrives for this long is discarded with it."""
MOST_STORED = 65536
"""More than this between two reads is a flood, or a service that was stopped."""
BETWEEN_GOODBYES_S = 0.005


@dataclass(frozen=True, slots=True)
class Opened:
    """The port has been opened."""


@dataclass(frozen=True, slots=True)
class Lost:
    """The port could not be opened, or was lost: one sentence why."""

    why: str


@dataclass(frozen=True, slots=True)
class Arrived:
    """Bytes, and the local monotonic time at which the last of them was read [ns]."""

    data: bytes
    monotonic_ns: int


Event = Opened | Lost | Arrived


class SerialDevice:
    """One port and its thread.

    Args:
        path: the port.
        explain: turns an error of the port into a sentence.
        wake: called on the thread when something has arrived, if the line is a prompt one.
        robot_ns: turns local monotonic time into robot time [ns], for the line's responder.
    """

    def __init__(
        self,
        path: str,
        line: Line,
        explain: Callable[[str, OSError], str],
        wake: Callable[[], None] = lambda: None,
        robot_ns: Callable[[int], int] = lambda monotonic_ns: monotonic_ns,
    ) -> None:
        self.path = path
        self._line = line
        self._explain = explain
        self._wake = wake
        self._robot_ns = robot_ns
        self._lock = threading.Lock()
        self._events: list[Event] = []
        self._stored = 0
        self._dropped = 0
        self._port: Port | None = None
        self._is_closing = threading.Event()
        self._wants_reopen = False
        self._thread = threading.Thread(target=self._run, name=f"serial {path}", daemon=True)

    def start(self) -> None:
        """Begin to open the port and to read."""
        self._thread.start()

    def take(self) -> list[Event]:
        """Return what happened since the last call, oldest first."""
        with self._lock:
            events, self._events, self._stored = self._events, [], 0
        return events

    def take_dropped(self) -> int:
        """Return how many bytes were dropped since the last call because too many came."""
        with self._lock:
            dropped, self._dropped = self._dropped, 0
        return dropped

    def take_strangers(self) -> int:
        """Return how many datagrams of others than the device came since the last call."""
        with self._lock:
            port = self._port
            return port.take_strangers() if isinstance(port, ListeningPort) else 0

    def write(self, data: bytes) -> bool:
        """Send bytes; False where the port is not open or takes nothing."""
        with self._lock:
            if self._port is None:
                return False
            try:
                return self._port.write(data)
            except OSError:
                return False  # the reading thread meets the same error and says it

    def reopen(self) -> None:
        """Close the port and open it again, after a pause."""
        self._wants_reopen = True

    def close(self, goodbye: tuple[bytes, ...] = ()) -> None:
        """Say goodbye, let go of the port and end the thread."""
        for last in goodbye:
            self.write(last)
            # On the line before the port is closed: closing drops what has not left.
            time.sleep(len(last) * BITS_PER_BYTE / self._line.baud + BETWEEN_GOODBYES_S)
        self._is_closing.set()
        if self._thread.is_alive():
            self._thread.join(2.0)

    def _run(self) -> None:
        pause_s = FIRST_PAUSE_S
        while not self._is_closing.is_set():
            opened_s = time.monotonic()
            try:
                self._serve(self._open())
            except OSError as error:
                self._store(Lost(self._explain(self.path, error)))
            if time.monotonic() - opened_s > STEADY_S:
                pause_s = FIRST_PAUSE_S
            self._is_closing.wait(pause_s)
            pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)

    def _open(self) -> Port:
        if not is_network(self.path):
            return SerialPort(self.path, self._line)
        if parse_address(self.path).host:
            return NetworkPort(self.path)
        return ListeningPort(self.path, self._line.datagrams)

    def _serve(self, port: Port) -> None:
        """Read until the port is lost, or is to be closed."""
        self._wants_reopen = False
        try:
            self._settle(port)
            with self._lock:
                self._port = port
            self._store(Opened())
            self._read(port)
        finally:
            with self._lock:
                self._port = None
            port.close()

    def _settle(self, port: Port) -> None:
        """Wait for a board that reboots, or wakes, when its port is opened."""
        if self._line.settle_s > 0.0:
            self._is_closing.wait(self._line.settle_s)
            port.discard_input()
        if self._line.clears_rts:
            port.clear_rts()

    def _read(self, port: Port) -> None:
        while not (self._is_closing.is_set() or self._wants_reopen):
            if not port.wait(POLL_S):
                continue
            data = port.read()
            if len(data) >= port.full_bytes:
                self._drop_backlog(port, len(data))
                continue
            if not data:
                continue
            arrived = Arrived(data, time.monotonic_ns())
            self._store(arrived)
            self._respond(arrived)
            if self._line.is_prompt:
                self._wake()
            time.sleep(GATHER_S)

    def _respond(self, arrived: Arrived) -> None:
        if self._line.responder is None:
            return
        answer = self._line.responder(arrived.data, self._robot_ns(arrived.monotonic_ns))
        if answer:
            self.write(answer)

    def _drop_backlog(self, port: Port, dropped: int) -> None:
        """Forget what waits in a full port: nobody has read it for long, or it is a flood.

        How old it is cannot be told; a scan that waited for seconds must not pass for a new one.
        """
        until_s = time.monotonic() + BACKLOG_S
        while time.monotonic() < until_s:
            if port.wait(GATHER_S):
                dropped += len(port.read())
        with self._lock:
            self._dropped += dropped

    def _store(self, event: Event) -> None:
        with self._lock:
            if isinstance(event, Arrived):
                if self._stored + len(event.data) > MOST_STORED:
                    self._drop_stored()
                self._stored += len(event.data)
            self._events.append(event)

    def _drop_stored(self) -> None:
        """Forget the bytes that wait: they are too many, and old."""
        self._dropped += self._stored
        self._stored = 0
        self._events = [event for event in self._events if not isinstance(event, Arrived)]
