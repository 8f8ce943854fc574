"""The occupancy grid: which cells are walls, which are free, drawn from keyframes."""

import copy
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, segments_meet
from trolley.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from trolley.slices import Slices
from trolley_mapper.kernels.trace import Cells, trace_keyframe
from trolley_mapper.slam.keyframe import Keyframe
from trolley_mapper.slam.keyframe_store import KeyframeStore


@dataclass(frozen=True, slots=True)
class OccupancyParams:
    """Log-odds in hundredths, and what follows from them (Thrun 2005, table 9.1). Set by hand."""

    rise: int = 60
    """Log-odds that a cell gains where a beam ends."""
    fall: int = 20
    """Log-odds that a cell loses where a beam passes."""
    wall_from: int = 45
    """Log-odds from which on a cell is a wall: one end, and no beam that crosses it squarely; later
    as long as at least one beam in four ends there."""
    limit: int = 600
    """Greatest log-odds of a cell, up or down."""
    mirror_m: float = 0.15
    """Distance behind a mirror up to which an echo is of its frame, or of its wall [m]."""
    drawn_together: int = 40
    """Number of keyframes that are drawn in one slice."""
    looked_up_together: int = 1 << 18
    """Number of cells whose value on an earlier map is looked up at once: each takes some 100
    bytes meanwhile."""
    began_m: float = 0.5
    """Distance from where the map begins within which floor is free, if the lidar does not look
    there, until it does: the robot stands there, and must be able to turn [m]."""
    hidden_rad: float = 1.0
    """Angle without an echo that is no direction in which nothing is, but one that the lidar does
    not look in [rad]."""
    margin_cells: int = 40
    """Cells that are added on each side when the grid must grow."""


PARAMS = OccupancyParams()

NAME = "map"

NO_MIRRORS = np.empty((0, 4))


class LogOddsGrid:
    """A grid that grows; its cells lie on multiples of the resolution in `map`.

    Args:
        resolution: cell edge [m].
        prior: a map to begin with; its cells count as seen several times.
        mirrors: (n, 4) x, y [m] in `map` where each begins and ends.
    """

    def __init__(
        self,
        resolution: float,
        prior: GridMap | None = None,
        mirrors: NDArray[np.float64] = NO_MIRRORS,
    ) -> None:
        self.mirrors = mirrors
        """Beams through them are not drawn: they show rooms that are not there."""
        self._resolution = resolution
        self._origin = np.zeros(2, np.int64)
        self._cells = _blank(0, 0)
        self._mark = 0
        if prior is not None:
            self._draw_prior(prior)

    def copy(self) -> "LogOddsGrid":
        """Return a copy that can be drawn on."""
        other, cells = copy.copy(self), self._cells
        other._cells = Cells(  # noqa: SLF001
            cells.log_odds.copy(), cells.marks.copy(), cells.normals.copy()
        )
        return other

    @property
    def num_bytes(self) -> int:
        """Bytes of the cells."""
        return sum(one.nbytes for one in self._cells)

    def add(self, keyframe: Keyframe, pose: NDArray[np.float64]) -> None:
        """Draw a keyframe as seen from map_T_base (3,)."""
        if len(keyframe.points) == 0 or keyframe.is_prior:
            return
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        turn = np.array([[cos, -sin], [sin, cos]])
        points, normals = keyframe.points, keyframe.normals
        ends = points @ turn.T + pose[:2]
        shares = share_before(turn @ keyframe.laser + pose[:2], ends, self.mirrors)
        is_behind = shares < 1.0
        before = keyframe.laser + shares[is_behind, None] * (points[is_behind] - keyframe.laser)
        ends[is_behind] = before @ turn.T + pose[:2]
        self._grow(np.minimum(ends.min(axis=0), pose[:2]), np.maximum(ends.max(axis=0), pose[:2]))
        self._mark += 1
        corner = self._origin * self._resolution
        # Beams pass up to a mirror, and raise no wall there: its line may reach beyond it.
        for seen, across, rise in (
            (points[~is_behind], normals[~is_behind], PARAMS.rise),
            (before.astype(np.float32), np.zeros_like(normals[is_behind]), 0),
        ):
            trace_keyframe(
                self._cells,
                np.array([corner[0], corner[1], 1.0 / self._resolution]),
                seen,
                across,
                (pose, keyframe.laser),
                (self._mark, rise, PARAMS.fall, PARAMS.limit),
            )
        if keyframe.number == 0:
            self._draw_beginning(hidden_floor(keyframe) @ turn.T + pose[:2])

    def _draw_beginning(self, floor: NDArray[np.float64]) -> None:
        """Draw places (n, 2) [m] in `map` free as far as no beam has shown what is there."""
        if len(floor) == 0:
            return
        self._grow(floor.min(axis=0), floor.max(axis=0))
        cols, rows = np.floor(floor / self._resolution).astype(np.int64).T
        rows, cols = rows - self._origin[1], cols - self._origin[0]
        unseen = self._cells.marks[rows, cols] == 0
        self._cells.marks[rows[unseen], cols[unseen]] = self._mark
        self._cells.log_odds[rows[unseen], cols[unseen]] = -1

    def grid(self) -> GridMap:
        """Return walls, free floor and what is not known, cut to what was seen."""
        seen = self._cells.marks != 0
        rows, cols = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
        if rows.size == 0:
            cells = np.full((1, 1), UNKNOWN, np.int8)
            return GridMap(NAME, self._resolution, Pose2D.identity(), cells)
        part = np.s_[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
        odds = self._cells.log_odds[part]
        cells = np.full(odds.shape, UNKNOWN, np.int8)
        cells[odds < 0] = FREE
        cells[odds >= PARAMS.wall_from] = OCCUPIED
        corner = (self._origin + np.array([cols[0], rows[0]])) * self._resolution
        return GridMap(
            NAME, self._resolution, Pose2D(float(corner[0]), float(corner[1]), 0.0), cells
        )

    def _grow(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> None:
        """Make room for a rectangle [m] in `map`."""
        first = np.floor(low / self._resolution).astype(np.int64) - 2
        last = np.floor(high / self._resolution).astype(np.int64) + 3
        rows, cols = self._cells.marks.shape
        end = self._origin + np.array([cols, rows])
        if rows and (first >= self._origin).all() and (last <= end).all():
            return
        first, last = first - PARAMS.margin_cells, last + PARAMS.margin_cells
        if rows:
            first, last = np.minimum(first, self._origin), np.maximum(last, end)
        width, height = last - first
        at = self._origin - first
        wider = _blank(int(height), int(width))
        for old, new in zip(self._cells, wider, strict=True):
            if rows:
                new[at[1] : at[1] + rows, at[0] : at[0] + cols] = old
        self._cells, self._origin = wider, first

    def _draw_prior(self, prior: GridMap) -> None:
        """Take over the cells of a map, which may be turned and of another resolution."""
        corners = prior.corners()
        self._grow(corners.min(axis=0), corners.max(axis=0))
        self._mark += 1
        rows, cols = self._cells.marks.shape
        x = (self._origin[0] + np.arange(cols) + 0.5) * self._resolution
        y = (self._origin[1] + np.arange(rows) + 0.5) * self._resolution
        for part in _bands(rows, cols):
            centres = np.column_stack([np.tile(x, len(y[part])), np.repeat(y[part], cols)])
            values = prior.values_at(centres).reshape(-1, cols)
            self._cells.log_odds[part][values >= 0] = -6 * PARAMS.fall
            self._cells.log_odds[part][prior_walls(values)] = 3 * PARAMS.rise
            self._cells.marks[part][values >= 0] = self._mark
        # Centres further apart than a wall is thick may all miss it.
        for part in _bands(prior.rows, prior.cols):
            walls = np.argwhere(prior_walls(prior.cells[part]))
            walls[:, 0] += part.start
            index = np.floor(prior.cell_to_world(walls) / self._resolution).astype(np.int64)
            col, row = (index - self._origin).T
            self._cells.log_odds[row, col] = 3 * PARAMS.rise
            self._cells.marks[row, col] = self._mark


def _bands(rows: int, cols: int) -> Iterator[slice]:
    """Cut the rows of a grid into bands that are looked up at once."""
    together = max(PARAMS.looked_up_together // cols, 1)
    for first in range(0, rows, together):
        yield slice(first, first + together)


def _blank(rows: int, cols: int) -> Cells:
    """Cells that nothing is known of."""
    return Cells(
        np.zeros((rows, cols), np.int16),
        np.zeros((rows, cols), np.int32),
        np.zeros((rows, cols, 2), np.int8),
    )


def draw_map(blank: LogOddsGrid, store: KeyframeStore) -> Slices[LogOddsGrid]:
    """Draw all keyframes except those of loose parts over a copy of a grid."""
    occupancy = blank.copy()
    shown = np.flatnonzero(~store.loose).tolist()
    for count, row in enumerate(shown, 1):
        occupancy.add(store.keyframes[row], store.poses[row])
        if count % PARAMS.drawn_together == 0:
            yield
    return occupancy


def hidden_floor(keyframe: Keyframe) -> NDArray[np.float64]:
    """Return the places (n, 2) [m] in `base_link` close to the robot that its lidar does not see.

    Args:
        keyframe: of at least one beam.
    """
    ends = keyframe.points - keyframe.laser
    bearings = np.sort(np.arctan2(ends[:, 1], ends[:, 0]).astype(np.float64))
    gaps = np.diff(bearings, append=bearings[0] + 2.0 * math.pi)
    widest = int(np.argmax(gaps))
    if gaps[widest] < PARAMS.hidden_rad:
        return np.empty((0, 2))
    steps = np.arange(-PARAMS.began_m, PARAMS.began_m, 0.02)
    around = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    around = around[np.hypot(around[:, 0], around[:, 1]) <= PARAMS.began_m]
    seen_from = around - keyframe.laser
    away = (np.arctan2(seen_from[:, 1], seen_from[:, 0]) - bearings[widest]) % (2.0 * math.pi)
    return around[away < gaps[widest]]


def share_before(
    start: NDArray[np.float64], ends: NDArray[np.float64], lines: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the share (n,) of beams from a start (2,) that lies before lines, 1 where all does.

    Args:
        start: of all beams [m].
        ends: (n, 2) of the beams [m].
        lines: (m, 4) x, y, x, y [m].
    """
    if len(lines) == 0:
        return np.ones(len(ends))
    beams = ends - start
    lengths = np.hypot(beams[:, 0], beams[:, 1])
    # Up to where an echo would be of the mirror's own frame or wall.
    share = 1.0 - PARAMS.mirror_m / np.maximum(lengths, PARAMS.mirror_m)
    before = start + share[:, None] * beams
    meets = segments_meet(start, before[:, None], lines[:, :2], lines[:, 2:])
    normals = np.stack([lines[:, 3] - lines[:, 1], lines[:, 0] - lines[:, 2]])
    away = np.sum((lines[:, :2] - start).T * normals, axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = np.where(meets, np.nan_to_num(away / (beams @ normals)), 1.0)
    return np.asarray(np.clip(shares, 0.0, 1.0).min(axis=1))


def prior_walls(values: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Say which cells of a given map are walls."""
    return values >= 65
