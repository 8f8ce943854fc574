"""What systemd is told: ready, alive, stopping (the `sd_notify` protocol)."""

import os
import socket


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

    def ready(self) -> None:
        """The service does its work from now on."""
        self._notify("READY=1")

    def waiting(self, seconds: float, why: str) -> None:
        """The service is not ready and asks for so many seconds more."""
        self._notify(f"STATUS={why}\nEXTEND_TIMEOUT_USEC={int(seconds * 1e6)}")

    def alive(self) -> None:
        """The service's thread still turns."""
        self._notify("WATCHDOG=1", socket.MSG_DONTWAIT)

    def stopping(self) -> None:
        """The service is on its way out."""
        self._notify("STOPPING=1")

    def _notify(self, text: str, flags: int = 0) -> None:
        if not self._address:
            return
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as channel:
            try:
                channel.sendto(text.encode(), flags, self._address)
            except (ConnectionRefusedError, FileNotFoundError):
                return  # whoever listened has gone; there is nobody left to tell
            except BlockingIOError:
                return  # whoever listens is stopped itself, and this thread must not wait for it
