"""What systemd is told: ready, alive, stopping (the `sd_notify` protocol)."""

import importlib.util
import os


class Supervision:
    """Talks to systemd where it started this process and cysystemd is installed."""

    def __init__(self) -> None:
        known = "NOTIFY_SOCKET" in os.environ and importlib.util.find_spec("cysystemd")
        self._enabled = bool(known)
        watchdog_us = int(os.environ.get("WATCHDOG_USEC", "0")) if self._enabled else 0
        self.period_s: float | None = watchdog_us * 1e-6 / 3 if watchdog_us else None
        """How often `alive` is wanted; None: never."""

    def ready(self) -> None:
        """The service does its work from now on."""
        self._notify("READY", 1)

    def alive(self) -> None:
        """The service's thread still turns."""
        self._notify("WATCHDOG", 1)

    def stopping(self) -> None:
        """The service is on its way out."""
        self._notify("STOPPING", 1)

    def _notify(self, name: str, value: int) -> None:
        if self._enabled:
            from cysystemd.daemon import Notification, notify

            notify(Notification[name], value=value)
