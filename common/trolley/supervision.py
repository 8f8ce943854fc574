"""What a service and whoever started it tell each other: ready, alive, stopping, gone.

That is systemd, by its `sd_notify` protocol, or `trolley up`, which speaks the same.
"""

import ctypes
import os
import secrets
import signal
import socket
import sys
from collections.abc import Mapping

START_S = 90.0
"""One that is not ready yet has longer from each sign that it is under way: it waits for its
router, or compiles one more kernel, which may take a Raspberry Pi half a minute."""


class Supervision:
    """Talks to systemd where it started this process; else says nothing.

    Source:
        sd_notify(3), sd_watchdog_enabled(3): one datagram of `NAME=value` to `NOTIFY_SOCKET`.
    """

    def __init__(self) -> None:
        address = os.environ.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        meant_pid = os.environ.get("WATCHDOG_PID", "")
        watchdog_us = int(os.environ.get("WATCHDOG_USEC", "0")) if self._address else 0
        if meant_pid and meant_pid != str(os.getpid()):
            watchdog_us = 0  # inherited from a parent that is watched itself
        self.period_s: float | None = watchdog_us * 1e-6 / 3 if watchdog_us else None
        """How often `alive` is wanted; None: never."""
        # Made now: a process that has run out of files can still say that it lives.
        kind = socket.SOCK_DGRAM | socket.SOCK_CLOEXEC
        self._channel = socket.socket(socket.AF_UNIX, kind) if self._address else None

    def ready(self) -> None:
        """The service does its work from now on."""
        self._notify("READY=1\nSTATUS=")

    def waiting(self, why: str = "") -> None:
        """The service is not ready and asks for `START_S` more."""
        text = f"STATUS={why}\nEXTEND_TIMEOUT_USEC={round(START_S * 1e6)}"
        self._notify(text, socket.MSG_DONTWAIT)

    def alive(self) -> None:
        """The service's thread still turns."""
        self._notify("WATCHDOG=1", socket.MSG_DONTWAIT)

    def stopping(self) -> None:
        """The service is on its way out."""
        self._notify("STOPPING=1")

    def _notify(self, text: str, flags: int = 0) -> None:
        if self._channel is None:
            return
        try:
            self._channel.sendto(text.encode(), flags, self._address)
        except (ConnectionRefusedError, FileNotFoundError, PermissionError):
            return  # whoever listened has gone, or is another user's; there is nobody to tell
        except BlockingIOError:
            return  # whoever listens is stopped itself, and this thread must not wait for it


PARENT_VARIABLE = "TROLLEY_PARENT"
"""Holds the supervisor's process id."""
_PR_SET_PDEATHSIG = 1


def end_with_parent() -> None:
    """Get SIGTERM from the kernel when the supervisor that the environment names has ended.

    Otherwise the services of a supervisor that was killed would wait for its router forever, and
    clash with those of the next one.
    """
    parent = os.environ.get(PARENT_VARIABLE)
    if not parent:
        return
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != int(parent):  # it ended before that
        sys.exit(0)


WATCHDOG_S = 15.0
"""A service whose handlers have not turned for so long hangs."""
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
        self.is_ready = False
        """Whether the child has said that it does its work, as far as `is_silent` has heard."""

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
        self._heard_s, self.is_ready = None, False

    def is_silent(self, now_s: float) -> bool:
        """Whether the child has spoken once, and then not for too long (local monotonic time)."""
        if self._hear():
            self._heard_s = now_s
        if self._heard_s is None:
            return False
        return now_s - self._heard_s > (self._watchdog_s if self.is_ready else START_S)

    def pardon(self, now_s: float) -> None:
        """Count from now on: the watcher itself was away, and the child may have been, too."""
        if self._heard_s is not None:
            self._heard_s = now_s

    def close(self) -> None:
        """Stop listening."""
        self._socket.close()

    def _hear(self) -> bool:
        heard = False
        while True:
            try:
                words = self._socket.recv(_MAX_BYTES)
            except BlockingIOError:
                return heard
            heard = True
            self.is_ready = self.is_ready or b"READY=1" in words.split(b"\n")
