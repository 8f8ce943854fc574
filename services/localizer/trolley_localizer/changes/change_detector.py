"""Detects what has come or gone since the map was made.

While the robot drives and knows where it is, each look at a cell is a vote. Looks within a short
time are one visit; only what several visits agree on, over a long enough time and from different
places, is proposed: people walk on, and doors open and close.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trolley.config.localizer import LocalizerConfig
from trolley.gridmap.kernels import spread_over
from trolley.messages.map_changes import ChangeKind
from trolley_localizer.changes.change_grid import ChangeGrid
from trolley_localizer.changes.mirror_detector import judge_beams
from trolley_localizer.changes.shapes import Box, Cells, box_of, convex_hull, runs_of, shared
from trolley_localizer.kernels import changes as kernels
from trolley_localizer.kernels import reflection
from trolley_localizer.kernels.changes import Moment
from trolley_localizer.kernels.layout import Lines
from trolley_localizer.matching.likelihood_field import LikelihoodField
from trolley_localizer.matching.map_matcher import BeamSet

KINDS: dict[ChangeKind, int] = {"appeared": kernels.APPEARED, "gone": kernels.GONE}


@dataclass(frozen=True, slots=True)
class ChangeParams:
    """When a change of the map is proposed. All values were found by hand."""

    step_m: float = 0.2
    """Distance after which the next scan is looked at: scans from one place say the same [m]."""
    step_s: float = 5.0
    """Time after which the next scan is looked at at the latest [s]."""
    max_gap_s: float = 1.0
    """Most of a gap between scans that counts as observed time [s]."""
    max_dev_m: float = 0.05
    """Standard deviation of the position above which scans are not used [m]."""
    max_dev_rad: float = 0.02
    """Standard deviation of the heading above which scans are not used [rad]."""
    max_turn_radps: float = 0.7
    """Turn rate above which scans are not used [rad/s]."""
    reach_m: float = 5.0
    """Range above which echoes are not used: the error of the heading scatters them too far [m]."""
    margin_m: float = 0.15
    """Distance from the end of a beam within which a wall may be where it ended [m]."""
    visits_beside: int = 2
    """Visits for a change that a cell needs for the change to grow over it."""
    visits_in_time: int = 5
    """Number of visits that fit into the time after which a change is proposed."""
    visits: int = 4
    """Visits for a change that a cell needs for the change to begin there."""
    looks_against: int = 3
    """Looks against a change within one visit that end it at once."""
    parallax_m: float = 0.5
    """Least distance between the places from which a change was seen [m]."""
    gap_m: float = 0.15
    """Gap below which neighbouring cells belong to one object [m]."""
    mirror_m: float = 0.3
    """Distance from a mirror or a pane within which echoes may be reflections [m]."""
    same_share: float = 0.4
    """Share of the smaller box that two boxes of one object have in common."""
    max_changes: int = 20
    """Number of changes that are proposed at once; more mean another map."""
    max_strokes: int = 300
    """Number of strokes of a change above which it means another map, too."""


PARAMS = ChangeParams()
_LEAST_CELLS: dict[ChangeKind, int] = {"appeared": 4, "gone": 6}
"""Least number of cells of a change, by its kind."""
MOST_DISMISSED = 200
"""Number of dismissals that are remembered; the oldest are forgotten first."""


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """Something that has come or is gone."""

    id: str
    """Stays the same while the change is proposed."""
    kind: ChangeKind
    cells: Cells
    """(n, 2) row, column on the map."""
    box: Box
    """Smallest box that holds the cells."""
    seconds: int
    """Observed time since the change was first seen [s]."""
    score: float
    """Confidence in the change, 0 ... 1, in steps of 0.1."""

    @property
    def outline(self) -> NDArray[np.float64]:
        """Convex outline (n, 2) x, y [cells]."""
        return convex_hull(self.cells)

    @property
    def strokes(self) -> NDArray[np.float64]:
        """Strokes (n, 2, 2) x, y [cells] that, one cell wide, cover the cells."""
        return runs_of(self.cells)


@dataclass(frozen=True, slots=True)
class MarkedChange:
    """Where a change was proposed, or dismissed, under its id."""

    id: str
    kind: ChangeKind
    box: Box


class ChangeDetector:
    """Gathers evidence for changes on one map.

    Args:
        field: of the map.
        config: says how long a change must have lasted to be proposed.
    """

    def __init__(self, field: LikelihoodField, config: LocalizerConfig) -> None:
        self._field = field
        self._cells = 1.0 / field.resolution
        self._after_s = config.change_after_s
        self._visit_s = max(1, int(self._after_s / PARAMS.visits_in_time))
        self.change_grid = ChangeGrid(field.grid)
        """What is known of the cells."""
        self.clock_s = 0.0
        """Observed time: the robot ran and knew where it was [s]."""
        self.proposed: list[Change] = []
        """The surest first."""
        self.dismissed: list[MarkedChange] = []
        """What is not proposed again."""
        self.named: list[MarkedChange] = []
        """What keeps its id: the latest proposals."""
        self.next_number = 1
        """Of the next id."""
        self._look = 0
        self._looked: tuple[float, float, float] | None = None
        self._before: tuple[int, float] | None = None

    def update(
        self,
        stamp_ns: int,
        pose: NDArray[np.float64],
        covariance: NDArray[np.float64],
        beams: BeamSet,
        classes: NDArray[np.uint8],
    ) -> None:
        """Take one scan into account.

        Args:
            stamp_ns: robot time of the scan [ns].
            pose: (3,) x, y [cells], yaw [rad] in `grid`; believed.
            covariance: (3, 3) of it over x, y [m], yaw [rad].
            beams: of the scan.
            classes: (n,) of the beams; what lies behind mirrors is left out.
        """
        if not self._is_due(stamp_ns, pose, covariance):
            return
        self._look += 1
        self.change_grid.make_room()
        evidence, grid = self.change_grid.arrays, self._field.grid.cells
        rays = np.empty((classes.size, 5))
        kernels.place_rays(rays, pose, beams.end, beams.start)
        verdicts, _, keys = judge_beams(self._field, pose, beams, classes)
        mirrored = np.where(verdicts >= reflection.MIRRORED, keys // 4, -1)
        moment = Moment(
            self._look, int(self.clock_s), self._visit_s, round(pose[0]), round(pose[1])
        )
        limits = np.array([PARAMS.reach_m, PARAMS.margin_m]) * self._cells
        kernels.take_echoes(evidence, rays, classes, mirrored, grid, limits, moment)
        maps = (grid, self._field.distance)
        kernels.take_passages(evidence, rays, classes, verdicts, maps, limits, moment)

    def propose(self, mirrors: Sequence[Lines]) -> None:
        """Find what is to be proposed now.

        Args:
            mirrors: known and suspected mirrors and panes [cells].
        """
        where, rows = self.change_grid.changed()
        visits = rows[:, kernels.VISITS].copy()
        ahead = rows[:, kernels.FOR] - rows[:, kernels.AGAINST]
        visits[ahead > 0] += 1
        visits[-ahead >= PARAMS.looks_against] = 0
        lasted = rows[:, kernels.LAST] - rows[:, kernels.FIRST] >= self._after_s
        near = PARAMS.mirror_m * self._cells
        found: list[Change] = []
        for kind, number in KINDS.items():
            beside = (rows[:, kernels.KIND] == number) & (visits >= PARAMS.visits_beside)
            seeds = beside & (visits >= PARAMS.visits) & lasted
            for group in _groups(where, beside, seeds, round(PARAMS.gap_m * self._cells)):
                change = self._change(kind, where[group], rows[group], visits[group])
                if change is not None and not (kind == "gone" and _is_at(change, near, mirrors)):
                    found.append(change)
        found.sort(key=lambda one: (-one.score, one.box))
        self.proposed = self._with_ids([one for one in found if not self._is_dismissed(one)])
        self.named = [MarkedChange(one.id, one.kind, one.box) for one in self.proposed]

    def dismiss(self, change: Change) -> None:
        """Do not propose a change again."""
        one = MarkedChange(change.id, change.kind, change.box)
        self.dismissed = [*self.dismissed, one][-MOST_DISMISSED:]
        self.proposed = [other for other in self.proposed if not self._is_dismissed(other)]

    # Looks.

    def _is_due(
        self, stamp_ns: int, pose: NDArray[np.float64], covariance: NDArray[np.float64]
    ) -> bool:
        """Count the time, and say whether a scan is worth a look."""
        before, self._before = self._before, (stamp_ns, float(pose[2]))
        if before is None:
            return False
        elapsed_s = min(max((stamp_ns - before[0]) * 1e-9, 0.0), PARAMS.max_gap_s)
        self.clock_s += elapsed_s
        turned = abs(math.remainder(float(pose[2]) - before[1], math.tau))
        deviations = np.sqrt(covariance.diagonal())
        if (
            turned > PARAMS.max_turn_radps * elapsed_s
            or max(deviations[0], deviations[1]) > PARAMS.max_dev_m
            or deviations[2] > PARAMS.max_dev_rad
        ):
            return False
        looked = self._looked
        if looked is not None:
            way = math.hypot(pose[0] - looked[0], pose[1] - looked[1])
            if way < PARAMS.step_m * self._cells and self.clock_s - looked[2] < PARAMS.step_s:
                return False
        self._looked = float(pose[0]), float(pose[1]), self.clock_s
        return True

    # Proposals.

    def _change(
        self,
        kind: ChangeKind,
        cells: Cells,
        rows: NDArray[np.int32],
        visits: NDArray[np.int32],
    ) -> Change | None:
        """Return what a group of cells is, without its id; None if it is too little to tell."""
        parallax = math.hypot(
            rows[:, kernels.RIGHT].max() - rows[:, kernels.LEFT].min(),
            rows[:, kernels.HIGH].max() - rows[:, kernels.LOW].min(),
        )
        if len(cells) < _LEAST_CELLS[kind] or parallax < PARAMS.parallax_m * self._cells:
            return None
        first_s = int(rows[:, kernels.FIRST].min())
        if kind == "gone":
            cells = self._with_edges(cells, int(np.median(rows[:, kernels.FIRST])))
        if len(runs_of(cells)) > PARAMS.max_strokes:
            return None
        score = round(float(np.minimum(visits / kernels.MOST_VISITS, 1.0).mean()), 1)
        return Change("", kind, cells, box_of(cells), int(self.clock_s) - first_s, score)

    def _with_edges(self, cells: Cells, since_s: int) -> Cells:
        """Add the cells of walls at the edges of what is gone that were not seen to stand since.

        Near its edges nothing can be looked through for certain.
        """
        grid, reach = self._field.grid.cells, kernels.REACH
        first_row, first_col, last_row, last_col = box_of(cells)
        low = max(first_row - reach, 0), max(first_col - reach, 0)
        high = min(last_row + reach + 1, grid.shape[0]), min(last_col + reach + 1, grid.shape[1])
        mask = np.zeros((high[0] - low[0], high[1] - low[1]), np.uint8)
        mask[cells[:, 0] - low[0], cells[:, 1] - low[1]] = 1
        kernels.grow_gone(mask, low, self.change_grid.arrays, grid, since_s)
        return np.argwhere(mask) + low

    def _is_dismissed(self, change: Change) -> bool:
        return any(_is_same(one, change) for one in self.dismissed)

    def _with_ids(self, found: Sequence[Change]) -> list[Change]:
        """Give changes their ids, those that they had where they had one."""
        left = list(self.named)
        out: list[Change] = []
        for change in found[: PARAMS.max_changes]:
            known = next((one for one in left if _is_same(one, change)), None)
            if known is not None:
                left.remove(known)
                out.append(replace(change, id=known.id))
                continue
            out.append(replace(change, id=f"{change.kind}-{self.next_number}"))
            self.next_number += 1
        return out


def _groups(
    where: Cells, beside: NDArray[np.bool_], seeds: NDArray[np.bool_], gap: int
) -> list[NDArray[np.int64]]:
    """Return the groups of cells that hold a seed, as indices into `where`."""
    if not seeds.any():
        return []
    index = np.flatnonzero(beside)
    low = where[index].min(axis=0)
    places = where[index] - low
    shape = tuple((places.max(axis=0) + 1).tolist())
    masks = np.zeros((2, *shape), np.uint8)
    masks[0, places[:, 0], places[:, 1]] = seeds[index]
    masks[1, places[:, 0], places[:, 1]] = 1
    labels = np.empty(shape, np.int32)
    count = spread_over(labels, masks[0], masks[1], gap)
    label = labels[places[:, 0], places[:, 1]]
    return [index[label == number + 1] for number in range(count)]


def _is_same(one: MarkedChange, change: Change) -> bool:
    return one.kind == change.kind and shared(one.box, change.box) >= PARAMS.same_share


def _is_at(change: Change, near: float, mirrors: Sequence[Lines]) -> bool:
    """Say whether a change lies where there is, or may be, a mirror or a pane."""
    points = change.cells[:, ::-1].astype(np.float64) + 0.5
    return any(bool((_distance(points, one) <= near).any()) for one in mirrors)


def _distance(points: NDArray[np.float64], lines: Lines) -> NDArray[np.float64]:
    """Return the distance of points (n, 2) from the nearest of some lines, in cells."""
    nearest = np.full(len(points), np.inf)
    for ax, ay, bx, by in zip(*lines, strict=True):
        start, edge = np.array([ax, ay]), np.array([bx - ax, by - ay])
        share = np.clip((points - start) @ edge / max(float(edge @ edge), 1e-9), 0.0, 1.0)
        away = points - start - share[:, None] * edge
        nearest = np.minimum(nearest, np.hypot(away[:, 0], away[:, 1]))
    return nearest
