"""Heavy work that is done aside: closing loops, and finding where a loose part belongs."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.config.mapper import MapperConfig
from trolley_mapper.slam.join_watch import CutJob, JoinWatch
from trolley_mapper.slam.joining import JoinJob, Joint
from trolley_mapper.slam.keyframe_map import KeyframeMap
from trolley_mapper.slam.keyframe_store import KeyframeStore
from trolley_mapper.slam.loop_closure import Closure, LoopJob, Place
from trolley_mapper.slam.pose_graph import Edge, compose

MapJob = LoopJob | JoinJob | CutJob


@dataclass(frozen=True, slots=True)
class BackEndParams:
    """Limits of the back end. Set by hand."""

    max_pending: int = 30
    """Number of closures that wait for one that agrees with them."""


PARAMS = BackEndParams()


class BackEnd:
    """Hands out one job at a time."""

    def __init__(self, config: MapperConfig) -> None:
        self._config = config
        self._job: MapJob | None = None
        self._pending: list[Closure] = []
        self._has_new = False
        # The keyframe that loops are searched for, and the places left to search.
        self._query = 0
        self._loops: list[tuple[int, float]] | None = []
        self._joint: Joint | None = None
        # Edges that joined parts where they do not belong.
        self._refuted: list[Edge] = []
        # Where a person says that the newest keyframe was taken (3,).
        self._said: NDArray[np.float64] | None = None
        # Over a part that is to be cut off again.
        self._cut: JoinWatch | None = None
        # Places that were not searched yet from the loose part, and whether they all were once.
        self._places: list[Place] | None = []
        self._is_searched = False

    @property
    def part_begins(self) -> set[int]:
        """Numbers of the keyframes that parts begin with which are to be joined or cut off."""
        joints = (self._joint, None if self._cut is None else self._cut.joint)
        return {joint.number for joint in joints if joint is not None}

    def keyframe_added(self) -> None:
        """Search for the newest keyframe at the next chance."""
        self._has_new = True

    def part_began(self, joint: Joint) -> None:
        """From now on look for where a new part belongs; earlier findings no longer count."""
        self._joint, self._places, self._is_searched = joint, [], False
        self._pending, self._job, self._cut, self._said = [], None, None, None

    def join_as_said(self, said: NDArray[np.float64]) -> None:
        """Join the loose part at the next chance, its newest keyframe about at a pose (3,)."""
        self._job, self._said = None, said

    def cut(self, refuted: JoinWatch) -> None:
        """Cut a part off the map at the next chance, and never join it there again."""
        self._job, self._cut = None, refuted

    def map_turned(self, new_map_T_old_map: NDArray[np.float64]) -> None:
        """Take note that the whole map has moved by a motion (3,): a job that is out is void."""
        self._job, self._places = None, []
        self._said = None if self._said is None else compose(new_map_T_old_map, self._said)
        if self._joint is not None:
            self._joint = self._joint.moved(new_map_T_old_map)

    def next_job(self, made: KeyframeMap, pose: NDArray[np.float64]) -> MapJob | None:
        """Return work to do now, or None; the robot is at a pose (3,) by its odometry."""
        if self._job is not None or made.is_empty:
            return None
        if self._cut is not None:
            cut, store = self._cut, made.store.copy()
            self._job = CutJob(store, self._config, made.blank, cut.joint, cut.edges, cut.sentence)
        elif self._joint is not None and made.store.is_loose(made.store.newest.number):
            self._job = self._join(made, self._joint, pose)
        else:
            self._job = self._close_loops(made)
        return self._job

    def _close_loops(self, made: KeyframeMap) -> LoopJob | None:
        """Return the search of one place for the newest keyframe that was not looked for."""
        if self._has_new:
            self._has_new = False
            self._query, self._loops = made.store.newest.number, None
        if self._loops == [] or self._query not in made.store.rows:
            return None
        return LoopJob(
            made.store.copy(), list(self._pending), self._config, made.blank, self._query,
            self._loops,
        )  # fmt: skip

    def _join(self, made: KeyframeMap, joint: Joint, pose: NDArray[np.float64]) -> JoinJob | None:
        """Return the search of one place: all of them in turn take long in a large building."""
        if self._said is None and not self._places:
            if not self._has_new:
                return None
            self._has_new, self._places = False, None
        return JoinJob(
            made.store.copy(), list(self._pending), self._config, made.blank, joint, pose.copy(),
            self._places, self._is_searched, list(self._refuted), self._said,
        )  # fmt: skip

    def finish(self, job: MapJob, store: KeyframeStore) -> bool:
        """Take a job back; False if it no longer counts, since keyframes were removed meanwhile."""
        if job is not self._job:
            return False
        self._job = None
        closures = [*self._pending, *job.found][-PARAMS.max_pending :]
        self._pending = [
            one
            for one in closures
            if store.has(one.edge) and all(one.edge is not edge for edge in job.accepted)
        ]
        if isinstance(job, LoopJob):
            self._loops = job.places
        elif isinstance(job, CutJob):
            self._refuted += job.refuted
            self.part_began(job.joint)
            self._has_new = True
        else:
            self._places, self._is_searched, self._said = job.places, job.is_searched, None
            if job.accepted:
                self._pending, self._joint = [], None
        return True

    def wants(self, job: MapJob) -> bool:
        """Say whether a job that is out still counts."""
        return job is self._job

    def keyframes_removed(self, store: KeyframeStore) -> None:
        """Drop the job that is out, and closures whose keyframes are gone."""
        self._job, self._loops, self._cut, self._said = None, [], None, None
        self._pending = [one for one in self._pending if store.has(one.edge)]
