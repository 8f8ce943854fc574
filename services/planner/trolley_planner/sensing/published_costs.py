"""The costs that programs publish: kept by who publishes them, for as long as they count."""

from dataclasses import dataclass

from trolley.messages import OccupancyGrid


@dataclass(frozen=True, slots=True)
class PublishedCostsParams:
    """How long and of how many programs costs are kept; by hand."""

    valid_s: float = 10.0
    """Time for which costs count unless they are published again: a program may die."""
    most_sources: int = 8
    """Number of programs whose costs count at once."""


PUBLISHED_COSTS = PublishedCostsParams()


class PublishedCosts:
    """The newest grid of each program."""

    def __init__(self) -> None:
        self._grids: dict[str, tuple[OccupancyGrid, int]] = {}

    def update(self, source: str, grid: OccupancyGrid, now_ns: int) -> str:
        """Keep a program's newest grid; return why not, "" if it counts.

        Args:
            source: the program.
            grid: cells 0 for no cost to 100, in frame `map`, of the map of its name.
            now_ns: robot time.
        """
        self._drop_old(now_ns)
        if grid.frame != "map":
            return "frame"
        if source not in self._grids and len(self._grids) >= PUBLISHED_COSTS.most_sources:
            return "too_many"
        self._grids[source] = grid, now_ns
        return ""

    def on_map(self, name: str, now_ns: int) -> dict[str, OccupancyGrid]:
        """Return the grids that count on a map now, by program."""
        self._drop_old(now_ns)
        return {source: grid for source, (grid, _) in self._grids.items() if grid.name == name}

    def _drop_old(self, now_ns: int) -> None:
        # Robot time begins anew with base: what came later than now is of another run.
        valid_ns = round(PUBLISHED_COSTS.valid_s * 1e9)
        self._grids = {
            source: kept
            for source, kept in self._grids.items()
            if 0 <= now_ns - kept[1] <= valid_ns
        }
