"""When the whole map is searched."""

import math
from dataclasses import dataclass


@dataclass(slots=True)
class SearchSchedule:
    """When the whole map is searched. One search runs at a time."""

    is_wanted: bool = True
    is_running: bool = False
    is_void: bool = False
    """Whether the running search began before the robot was carried off or put elsewhere."""
    since_s: float = math.inf
    """Robot time since the last search began [s]."""
    unproven_m: float = 0.0
    """Distance driven off the map or without a proof, with turns counted in [m]."""

    def begin(self) -> None:
        """Note that a search begins."""
        self.is_wanted, self.is_running, self.since_s = False, True, 0.0

    def discard(self, *, is_wanted: bool) -> None:
        """Ignore the search that runs, and say whether another one is wanted."""
        self.is_wanted, self.is_void = is_wanted, self.is_running
