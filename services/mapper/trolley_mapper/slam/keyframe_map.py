"""The map itself: keyframes, poses that are tied to them, and the grid drawn from them."""

import math
from collections.abc import Sequence, Set
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.config.mapper import MapperConfig
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.slices import whole
from trolley_mapper.slam.anchors import Anchors
from trolley_mapper.slam.estimate import Anchor
from trolley_mapper.slam.keyframe import Keyframe
from trolley_mapper.slam.keyframe_store import KeyframeStore
from trolley_mapper.slam.occupancy_grid import LogOddsGrid, draw_map
from trolley_mapper.slam.pose_graph import Edge
from trolley_mapper.slam.prior_map import prior_keyframe
from trolley_mapper.slam.serialization import State


@dataclass(frozen=True, slots=True)
class KeyframeMapParams:
    """When keyframes are redundant. Set by hand."""

    same_place: float = 1.2
    """Share of the distance between keyframes below which two of them show the same."""
    area_m: float = 1.0
    """Distance around the robot within which all keyframes, whatever their heading, are counted
    [m]."""
    per_area: int = 40
    """Number of keyframes within `area_m` above which the most crowded one is dropped: about as
    many as five drives through and a turn on the spot leave."""
    spared_share: float = 0.25
    """Share of these, of the oldest and of the newest each, that is not dropped."""


PARAMS = KeyframeMapParams()


class KeyframeMap:
    """Keyframes with their poses and edges, and what follows from them.

    Args:
        prior: a map made before, which stays where it is.
    """

    def __init__(self, config: MapperConfig, prior: GridMap | None = None) -> None:
        self.prior = prior
        self.store = KeyframeStore()
        self.anchors = Anchors()
        self.next_number = 0
        """Of the next keyframe."""
        self.version = 0
        """Changes whenever `grid` would return something else."""
        self._config = config
        self.blank = LogOddsGrid(config.resolution_m, prior)
        """The grid before any keyframe, not to be drawn on: an earlier map takes long to draw."""
        self._occupancy = self.blank.copy()
        self._grid: tuple[int, GridMap] | None = None
        if prior is not None:
            self.store.add(prior_keyframe(self.next_number, prior), np.zeros(3), [])
            self.next_number += 1
            self.version += 1

    @classmethod
    def restore(cls, config: MapperConfig, state: State) -> "KeyframeMap":
        """Make the map that was stored."""
        restored = cls(config, state.prior)
        restored.store, restored.anchors = state.store, state.anchors
        restored.next_number, restored.version = state.next_number, 1
        restored._draw()
        return restored

    def snapshot(self, pose: Pose2D, num_loops: int) -> State:
        """Return a copy of all that is needed to restore it; cheap."""
        store, anchors = self.store.copy(), self.anchors.copy()
        return State(store, anchors, self.prior, pose, self.next_number, num_loops)

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing yet to compare a scan with."""
        return len(self.store) == 0

    @property
    def num_keyframes(self) -> int:
        """Number of scans that the map is made of."""
        return sum(
            not (one.is_prior or one.is_blind or self.store.is_loose(one.number))
            for one in self.store.keyframes
        )

    @property
    def num_bytes(self) -> int:
        """Bytes of keyframes, graph and grids, about."""
        return self.store.num_bytes + self._occupancy.num_bytes + self.blank.num_bytes

    def grid(self) -> GridMap:
        """Return the occupancy grid; cheap as long as `version` is the same."""
        if self._grid is None or self._grid[0] != self.version:
            self._grid = (self.version, self._occupancy.grid())
        return self._grid[1]

    # The map grows and shrinks.

    def add(
        self,
        keyframe: Keyframe,
        pose: NDArray[np.float64],
        edges: Sequence[Edge],
        spared: Set[int] = frozenset(),
    ) -> None:
        """Add a keyframe taken at map_T_base (3,); drop one where many show the same.

        Args:
            keyframe: to be added.
            pose: where it was taken.
            edges: to earlier ones.
            spared: keyframes that must stay: what they stand for is still to be decided.
        """
        self.store.add(keyframe, pose, edges)
        self.next_number += 1
        if not (keyframe.is_blind or self.store.is_loose(keyframe.number)):
            self._occupancy.add(keyframe, pose)
            self.version += 1
        self._drop_redundant(spared)

    def _drop_redundant(self, spared: Set[int]) -> None:
        """Drop a keyframe where many show the same, so that time alone costs no memory.

        The oldest hold the map in place, the newest show what has changed.
        """
        config = self._config
        alike = self.store.alike(
            PARAMS.same_place * config.keyframe_distance_m,
            PARAMS.same_place * config.keyframe_turn_rad,
        )
        alike = [number for number in alike if number not in spared]
        if len(alike) > config.keyframes_per_place:
            self._drop_one(alike[len(alike) // 2])
            return
        near = [n for n in self.store.alike(PARAMS.area_m, math.inf) if n not in spared]
        if len(near) > PARAMS.per_area:
            ends = round(PARAMS.spared_share * len(near))
            self._drop_one(self.store.most_crowded(near[ends:-ends], near))

    def _drop_one(self, number: int) -> None:
        self.anchors.forget(self.store, [number])
        self.store.dissolve(number)

    def newest_rows(self, age_ns: int, now_ns: int) -> list[int]:
        """Return the rows of the keyframes up to an age; the first stays: the map begins there.

        One that seems to have been taken later than now is of a time that began later.
        """
        rows: list[int] = []
        for row in range(len(self.store) - 1, 0, -1):
            if not 0 <= now_ns - self.store.keyframes[row].stamp_ns <= age_ns:
                break
            rows.insert(0, row)
        return rows

    def remove(self, rows: Sequence[int]) -> None:
        """Remove keyframes, given by their rows, and redraw the map."""
        numbers = [self.store.keyframes[row].number for row in rows]
        self.anchors.forget(self.store, numbers)
        self.store.remove(numbers)
        self._draw()
        self.version += 1

    def drop(self, numbers: list[int]) -> None:
        """Forget keyframes of loose parts, which the grid does not show."""
        self.anchors.forget(self.store, numbers)
        self.store.remove(numbers)

    def drop_loose(self) -> None:
        """Forget all loose parts."""
        self.drop([one.number for one in self.store.keyframes if self.store.is_loose(one.number)])

    def take_over(
        self, optimised: KeyframeStore, occupancy: LogOddsGrid, loops: Sequence[Edge]
    ) -> NDArray[np.float64]:
        """Take over poses and grid of an optimised copy, with the loops that it was made of.

        Returns:
            The motion (3,) of the newest keyframes, new_map_T_old_map.
        """
        for edge in loops:
            self.store.link(edge)
        correction, later = self.store.move_to(optimised)
        if occupancy.mirrors is not self.blank.mirrors:  # they have changed meanwhile
            self._draw()
            self.version += 1
            return correction
        self._occupancy = occupancy
        for one in later:
            if not self.store.is_loose(one.number):
                self._occupancy.add(one, self.store.pose(one.number))
        self.version += 1
        return correction

    def set_mirrors(self, mirrors: NDArray[np.float64]) -> None:
        """Draw the map without what was seen through mirrors (n, 4), x, y [m] of their ends."""
        if not np.array_equal(mirrors, self.blank.mirrors):
            self.blank.mirrors = mirrors
            self._draw()
            self.version += 1

    def _draw(self) -> None:
        self._occupancy = whole(draw_map(self.blank, self.store))

    # Poses that move with it.

    def anchor(self, map_T_pose: Pose2D, hint: int | None) -> Anchor:
        """Tie a pose to the nearest keyframe; to `hint` where that is as good."""
        return self.anchors.tie(self.store, map_T_pose, hint)

    def moved(self, anchor: Anchor) -> Pose2D:
        """Return where an anchored pose lies on the map now: map_T_pose."""
        return self.anchors.place(self.store, anchor)
