"""A TCP link that can be cut: what a service sees when only its own link to the router is gone."""

import contextlib
import socket
import threading
from types import TracebackType
from typing import Self

_CHUNK = 1 << 16


class Proxy:
    """Listens on a port and passes everything on to another, until it is cut.

    Args:
        port: where it listens on loopback.
        target: the port that it passes on to.
    """

    def __init__(self, port: int, target: int) -> None:
        self._target = target
        self._flows = threading.Event()
        self._flows.set()
        self._refuses = False
        self._links: list[socket.socket] = []
        self._listener = socket.create_server(("127.0.0.1", port))

    def __enter__(self) -> Self:
        threading.Thread(target=self._accept, daemon=True).start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._refuses = True
        self._flows.set()
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._drop()

    def cut(self) -> None:
        """Pass nothing on, like a pulled cable: neither side is told."""
        self._flows.clear()

    def break_off(self) -> None:
        """End the connections and take no new ones."""
        self._refuses = True
        self._drop()

    def mend(self) -> None:
        """Pass everything on again, first of all what was held back."""
        self._refuses = False
        self._flows.set()

    def _drop(self) -> None:
        for link in self._links:
            with contextlib.suppress(OSError):  # it has ended already
                link.shutdown(socket.SHUT_RDWR)
        self._links = []

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listener.accept()
            except OSError:
                return  # closed
            if self._refuses:
                near.close()
                continue
            try:
                far = socket.create_connection(("127.0.0.1", self._target))
            except ConnectionRefusedError:
                near.close()
                continue
            for link in (near, far):
                link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._links += [near, far]
            for source, sink in ((near, far), (far, near)):
                threading.Thread(target=self._pump, args=(source, sink), daemon=True).start()

    def _pump(self, source: socket.socket, sink: socket.socket) -> None:
        with contextlib.suppress(OSError), source:
            while data := source.recv(_CHUNK):
                self._flows.wait()
                sink.sendall(data)
        with contextlib.suppress(OSError):
            sink.shutdown(socket.SHUT_RDWR)
