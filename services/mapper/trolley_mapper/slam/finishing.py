"""The map as it is saved: its walls along the axes, without stray floor, and checked."""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trolley.config.mapper import MapperConfig
from trolley.geometry import Pose2D
from trolley.gridmap import OCCUPIED_FROM, GridMap
from trolley.map_editing import angle_of_walls
from trolley.slices import Slices, whole
from trolley_mapper.slam.keyframe_store import KeyframeStore
from trolley_mapper.slam.map_check import contradictions
from trolley_mapper.slam.occupancy_grid import NO_MIRRORS, LogOddsGrid, draw_map
from trolley_mapper.slam.pose_graph import compose
from trolley_mapper.slam.tidying import tidied

MIN_TURN_RAD = math.radians(0.05)
"""Turn below which a map is straight: half a cell over 25 m [rad]."""


@dataclass(eq=False)
class FinishJob:
    """Turns a new map about where it began, and draws it anew; an extended one stays as it lies.

    Attributes:
        store: a copy, changed by the job.
        config: settings.
        prior: the map that is extended, if one is.
        grid: the map as it is; afterwards as it is to be saved.
        mirrors: (n, 4) of which nothing is drawn that is seen through them.
        new_T_old: the motion by which it was turned.
        occupancy: what it was drawn from, if it was turned.
        doubtful: places x, y [m] on it where it may be wrong, the worst first.
    """

    store: KeyframeStore
    config: MapperConfig
    prior: GridMap | None
    grid: GridMap
    mirrors: NDArray[np.float64] = field(default_factory=lambda: NO_MIRRORS)
    new_T_old: Pose2D = field(default_factory=Pose2D.identity, init=False)
    occupancy: LogOddsGrid | None = field(default=None, init=False)
    doubtful: list[tuple[float, float]] = field(
        default_factory=list[tuple[float, float]], init=False
    )

    def run(self) -> "FinishJob":
        """Do all slices at once; returns itself."""
        whole(self.slices())
        return self

    def slices(self) -> Slices[None]:
        """Straighten, check and tidy."""
        if self.prior is None:
            angle = yield from self._angle()
            if angle is not None and abs(angle) >= MIN_TURN_RAD:
                yield from self._turn(angle)
        store = self.store
        self.doubtful = yield from contradictions(store)
        floor = [store.poses[~store.loose, :2]]
        if self.prior is not None:
            prior = store.keyframes[0].floor
            floor = [floor[0][1:], *([] if prior is None else [prior.astype(np.float64)])]
        yield
        self.grid = yield from tidied(self.grid, np.vstack(floor))

    def _angle(self) -> Slices[float | None]:
        """Return the turn after which most walls run along the axes [rad]."""
        walls = self._walls()
        yield
        return angle_of_walls(walls)

    def _walls(self) -> NDArray[np.float64]:
        """Return points (n, 2) of the walls, one in each of their cells [cells].

        They are the means of what the scans show: cells alone tell the direction of a wall to no
        more than a cell over its length.
        """
        store, grid = self.store, self.grid
        seen = [
            Pose2D.from_array(pose).transform_points(one.points.astype(np.float64))
            for one, pose, is_loose in zip(store.keyframes, store.poses, store.loose, strict=True)
            if not is_loose
        ]
        points = np.vstack(seen)
        points = points[grid.values_at(points) >= OCCUPIED_FROM]
        cells = grid.world_to_cell(points)
        _, group = np.unique(cells[:, 0] * grid.cols + cells[:, 1], return_inverse=True)
        sums = [np.bincount(group, along) for along in points.T]
        return np.column_stack(sums) / (np.bincount(group)[:, None] * grid.resolution)

    def _turn(self, angle: float) -> Slices[None]:
        """Turn all keyframes about the first, and draw the map anew: a turned picture blurs."""
        store = self.store
        x, y = store.poses[0, :2].tolist()
        about = Pose2D(x, y, angle) @ Pose2D(-x, -y, 0.0)
        store.poses = compose(about.as_array(), store.poses)
        self.new_T_old = about
        yield
        mirrors = about.transform_points(self.mirrors.reshape(-1, 2)).reshape(-1, 4)
        blank = LogOddsGrid(self.config.resolution_m, mirrors=mirrors)
        self.occupancy = yield from draw_map(blank, store)
        self.grid = self.occupancy.grid()

    @property
    def start(self) -> Pose2D | None:
        """Where the map began (`map_T_base`); None of one that was extended."""
        return None if self.prior is not None else Pose2D.from_array(self.store.poses[0])
