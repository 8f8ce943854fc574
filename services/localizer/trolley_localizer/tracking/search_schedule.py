"""When the whole map is searched."""

import math
from dataclasses import dataclass

from trolley.scanning import ScanInput
from trolley_localizer.tracking.resting import shows_same


@dataclass(frozen=True, slots=True)
class SearchScheduleParams:
    """When another search may bring what the last ones did not. All values were set by hand."""

    share: float = 0.25
    """Distance between two searches, as a share of what was driven since searching last brought
    something: a place is found after at most this share more than if each scan were searched."""
    most_m: float = 10.0
    """Most of it [m]."""
    same_s: float = 30.0
    """Time after which even a scan like the one that was searched is searched again: by its noise
    it may find another place [s]."""


PARAMS = SearchScheduleParams()


@dataclass(slots=True)
class SearchSchedule:
    """When the whole map is searched. One search runs at a time.

    Searches that bring nothing wait for more and more of what could change that: distance driven.
    """

    is_wanted: bool = True
    running: object | None = None
    """The search that runs, unless the robot was carried off or put elsewhere since it began."""
    since_s: float = math.inf
    """Robot time since the last search began [s]."""
    unproven_m: float = 0.0
    """Distance driven off the map or without a proof, with turns counted in [m]."""
    _since_m: float = 0.0
    """Distance driven since the last search began [m]."""
    _in_vain_m: float = 0.0
    """Distance driven since searching last brought something, or there was a new reason [m]."""
    _searched: ScanInput | None = None
    """The scan of the last search, if nothing has come of it."""

    def predict(self, driven_m: float) -> None:
        """Note a distance driven, with turns counted in [m]."""
        self.unproven_m += driven_m
        self._since_m += driven_m
        self._in_vain_m += driven_m

    def begin(self, search: object, scan: ScanInput) -> None:
        """Note that a search of a scan begins."""
        self.is_wanted, self.running = False, search
        self.since_s = self._since_m = 0.0
        self._searched = scan

    def discard(self, *, is_wanted: bool) -> None:
        """Give up the search that runs, for another one; or say whether one is wanted."""
        self.is_wanted, self.running = is_wanted or self.running is not None, None

    def restart(self) -> None:
        """Note that searching has brought something, or that there is a new reason for it."""
        self._in_vain_m, self._searched = 0.0, None

    def is_due(self, scan: ScanInput, again_s: float) -> bool:
        """Say whether a search may bring what the last ones did not.

        Args:
            scan: the newest.
            again_s: least time between two searches [s].
        """
        if self.since_s <= again_s:
            return False
        if self._since_m < min(PARAMS.share * self._in_vain_m, PARAMS.most_m):
            return False
        if self._searched is None or self.since_s > PARAMS.same_s:
            return True
        return not shows_same(self._searched, scan)
