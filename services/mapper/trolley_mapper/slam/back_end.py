"""Heavy work that is done aside: closing loops, and finding a lost robot again."""

import math
from dataclasses import dataclass

from trolley.config.mapper import MapperConfig
from trolley.scanning import ScanInput
from trolley_mapper.slam.keyframe_map import KeyframeMap
from trolley_mapper.slam.keyframe_store import KeyframeStore
from trolley_mapper.slam.loop_closure import Closure, LoopJob
from trolley_mapper.slam.relocalization import RelocalizationJob
from trolley_mapper.slam.sweep import Sweep

MapJob = LoopJob | RelocalizationJob


@dataclass(frozen=True, slots=True)
class BackEndParams:
    """How often to search, and what to remember. Set by hand."""

    search_again_s: float = 2.0
    """Time between two searches for a lost robot [s]."""
    max_pending: int = 30
    """Closures that wait for one that agrees with them."""


PARAMS = BackEndParams()


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """A scan as it was measured, and its points."""

    scan: ScanInput
    sweep: Sweep


class BackEnd:
    """Hands out one job at a time.

    Args:
        config: of the mapper.
    """

    def __init__(self, config: MapperConfig) -> None:
        self._config = config
        self._job: MapJob | None = None
        self._pending: list[Closure] = []
        self._wants_loops = False
        self._since_search_s = math.inf

    def keyframe_added(self) -> None:
        """Search loops for the newest keyframe at the next chance."""
        self._wants_loops = True

    def time_passed(self, elapsed_s: float) -> None:
        """Count the time since the last search for a lost robot."""
        self._since_search_s += elapsed_s

    def next_job(self, made: KeyframeMap, latest: Observation, *, is_lost: bool) -> MapJob | None:
        """Return work to do now, or None."""
        if self._job is not None or made.is_empty:
            return None
        if is_lost:
            if self._since_search_s < PARAMS.search_again_s or latest.sweep.is_blind:
                return None
            self._since_search_s = 0.0
            self._job = RelocalizationJob(made.store.copy(), latest.sweep, latest.scan.odom_T_base)
        elif self._wants_loops:
            self._wants_loops = False
            self._job = LoopJob(made.store.copy(), list(self._pending), self._config, made.prior)
        return self._job

    def finish(self, job: MapJob, store: KeyframeStore) -> bool:
        """Take a job back; False if it no longer counts, since keyframes were removed meanwhile."""
        if job is not self._job:
            return False
        self._job = None
        if isinstance(job, LoopJob):
            closures = [*self._pending, *job.found][-PARAMS.max_pending :]
            self._pending = [
                one
                for one in closures
                if store.has(one.edge) and all(one.edge is not edge for edge in job.accepted)
            ]
        return True

    def keyframes_removed(self, store: KeyframeStore) -> None:
        """Drop the job that is out, and closures whose keyframes are gone."""
        self._job = None
        self._pending = [one for one in self._pending if store.has(one.edge)]
