"""Which services of a robot have fallen silent."""

from collections.abc import Mapping

from trolley.messages import Health

SILENT_NS = 4_000_000_000
"""A service that says nothing of its health for so long is not running."""
AWAITED: tuple[str, ...] = ("localizer", "planner")
"""Services without which a robot does not drive by itself: missed also if never heard."""


class SilentServices:
    """Watches the services of one robot.

    Args:
        patience_ns: who has said nothing of its health for longer is silent.
    """

    def __init__(self, patience_ns: int = SILENT_NS) -> None:
        self._patience_ns = patience_ns
        self._newest: dict[str, tuple[Health | None, int]] = {}
        """By service, and since when it is the newest (local monotonic [ns])."""

    def update(self, newest: Mapping[str, Health], now_ns: int) -> frozenset[str]:
        """Take the newest health of each; return who is silent, or was to be heard by now."""
        for name in AWAITED:
            self._newest.setdefault(name, (None, now_ns))
        for name, health in newest.items():
            before, _ = self._newest.get(name, (None, now_ns))
            if before is not health:
                self._newest[name] = (health, now_ns)
        return frozenset(
            name
            for name, (_, since_ns) in self._newest.items()
            if now_ns - since_ns > self._patience_ns
        )
