"""The other end of `sd_notify`: whether a child process still turns, as systemd would know it."""

import secrets
import socket
from collections.abc import Mapping

WATCHDOG_S = 15.0
"""A service whose handlers have not turned for so long hangs."""
START_S = 90.0
"""One that is not ready yet, or waits for its router, has longer to say so."""
_MAX_BYTES = 4096


class Watchdog:
    """Hears the signs of life of one child after another under the same name.

    A program that never says a word is not watched.
    """

    def __init__(self, watchdog_s: float = WATCHDOG_S) -> None:
        self._watchdog_s = watchdog_s
        self._address = f"trolley-{secrets.token_hex(12)}"
        kind = socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK
        self._socket = socket.socket(socket.AF_UNIX, kind)
        self._socket.bind(f"\0{self._address}")
        self._heard_s: float | None = None
        self._is_ready = False

    @property
    def environment(self) -> Mapping[str, str]:
        """What the child needs to know."""
        return {
            "NOTIFY_SOCKET": f"@{self._address}",
            "WATCHDOG_USEC": str(round(self._watchdog_s * 1e6)),
            "WATCHDOG_PID": "",  # not the one that watches this process itself
        }

    def begin(self) -> None:
        """Forget the child before."""
        self._hear()
        self._heard_s, self._is_ready = None, False

    def is_silent(self, now_s: float) -> bool:
        """Whether the child has spoken once, and then not for too long (local monotonic time)."""
        if self._hear():
            self._heard_s = now_s
        if self._heard_s is None:
            return False
        return now_s - self._heard_s > (self._watchdog_s if self._is_ready else START_S)

    def pardon(self, now_s: float) -> None:
        """Count from now on: the watcher itself was away, and the child may have been, too."""
        if self._heard_s is not None:
            self._heard_s = now_s

    def close(self) -> None:
        """Listen no more."""
        self._socket.close()

    def _hear(self) -> bool:
        heard = False
        while True:
            try:
                words = self._socket.recv(_MAX_BYTES)
            except BlockingIOError:
                return heard
            heard = True
            self._is_ready = self._is_ready or b"READY=1" in words.split(b"\n")
