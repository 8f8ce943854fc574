"""What a runtime gives a service besides the bus: time, files, ids, a worker."""

from collections.abc import Callable
from typing import Any, Protocol

from trolley.runtime.state import StateFolder


class Host(Protocol):
    """The computer that a service runs on, real or simulated."""

    @property
    def state(self) -> StateFolder:
        """This robot's state."""
        ...

    @property
    def maps(self) -> StateFolder:
        """The host's maps."""
        ...

    def monotonic_ns(self) -> int:
        """The local monotonic clock."""
        ...

    def since_boot_ns(self) -> int:
        """Time since the computer was started, which goes on while it sleeps."""
        ...

    def unix_ns(self) -> int:
        """The host's clock, synchronised or not."""
        ...

    def utc_now(self) -> str | None:
        """UTC as ISO 8601, None until the host's clock is synchronised."""
        ...

    def new_id(self) -> str:
        """A fresh id."""
        ...

    def work(self, fn: Callable[[], Any], done: Callable[[Any], None]) -> None:
        """Run `fn` in the background, then call `done` (on any thread) with its result."""
        ...

    def usage(self) -> tuple[float, int]:
        """Share of one core since the last call, and resident bytes."""
        ...
