"""Mirrors that are not on the map, suspected from what is seen behind its walls.

A beam that goes on behind a wall may have met a mirror, an open door, a pane, or a wall that is no
longer there. In a mirror it sees what stands in front of the wall, or the robot itself, wherever
the robot is; through a gap it does so only by chance. So evidence is gathered for each cell of the
walls while the robot drives, and lines are drawn through the cells that agree.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley_localizer.kernels import reflection
from trolley_localizer.kernels.layout import Lines
from trolley_localizer.matching.likelihood_field import LikelihoodField
from trolley_localizer.matching.map_matcher import BeamSet


@dataclass(frozen=True, slots=True)
class MirrorParams:
    """When a wall is suspected to be a mirror. All values were found by hand."""

    step_m: float = 0.1
    """Distance after which the next scan counts: scans from nearly one place say the same [m]."""
    max_looks: float = 20.0
    """Looks that a cell remembers; later ones outweigh earlier ones."""
    share_to_suspect: float = 0.65
    """Share of the looks that must speak for a mirror to suspect one."""
    share_to_keep: float = 0.45
    """Share of the looks that must speak for a mirror to go on suspecting it."""
    min_looks: float = 25.0
    """Number of looks at a line's cells that must speak for a mirror."""
    max_missed: float = 1.0
    """Number of looks, without the robot's own image, above which there is no mirror, unless the
    image was seen more often."""
    min_length_m: float = 0.4
    """Shortest line [m]."""
    min_parallax_m: float = 0.6
    """Least distance between the places from which the robot looked [m]."""
    min_depth_dev_m: float = 0.25
    """Least standard deviation of the depths of what is mirrored: a plain wall behind a gap may lie
    as deep as one stands before it [m]."""
    line_width_m: float = 0.1
    """Distance from a line within which a cell belongs to it [m]."""
    max_gap_m: float = 0.3
    """Widest gap within a line [m]."""
    same_normal: float = 0.9
    """Least product of a cell's normal and the line's (cosine)."""
    known_m: float = 0.3
    """Distance from a known mirror or pane within which a line is not reported [m]."""
    max_lines: int = 20
    """Number of lines that are proposed at most."""


PARAMS = MirrorParams()

_FOR, _AGAINST, _IMAGE, _NO_IMAGE, _BEHIND, _X, _Y, _NX, _NY, _DEPTH, _DEPTH_2 = range(11)
_LEFT, _LOW, _RIGHT, _HIGH = range(11, 15)
_COLUMNS = 15
_SUMS = slice(_FOR, _DEPTH_2 + 1)
"""Columns of what is kept of a cell: looks for and against a mirror; looks at the robot's image,
and where it was missing; looks behind the wall, and sums over them of the wall's place and normal;
sums over the looks for a mirror of the depth and its square; then the corners of where those came
from."""


@dataclass(frozen=True, slots=True)
class Suspect:
    """A straight line that behaves like a mirror."""

    start: tuple[float, float]
    """One end [cells in `grid`]."""
    end: tuple[float, float]
    """The other end."""
    score: float
    """Confidence in the mirror, 0 ... 1, in steps of 0.1."""


class MirrorDetector:
    """Gathers evidence for mirrors on the walls of one map."""

    def __init__(self, field: LikelihoodField) -> None:
        self._field = field
        self._cells = 1.0 / field.resolution
        self.reset()

    def reset(self) -> None:
        """Suspect nothing and begin anew."""
        self.suspects: list[Suspect] = []
        self._rows: dict[int, int] = {}
        self._table = np.zeros((64, _COLUMNS))
        self._place: NDArray[np.float64] | None = None

    def lines(self) -> Lines:
        """Return the suspected lines in cells."""
        table = np.array([[*one.start, *one.end] for one in self.suspects]).reshape(-1, 4)
        return Lines(*(np.ascontiguousarray(column) for column in table.T))

    def update(
        self,
        pose: NDArray[np.float64],
        beams: BeamSet,
        classes: NDArray[np.uint8],
        known: Lines,
    ) -> bool:
        """Take one scan into account.

        Args:
            pose: (3,) x, y [cells], yaw [rad] in `grid`; believed.
            beams: of the scan.
            classes: (n,) of the beams; what lies behind known mirrors is left out.
            known: mirrors and panes of the map [cells].

        Returns:
            Whether `suspects` have changed.
        """
        place = self._place
        if place is not None and np.hypot(*(pose[:2] - place)) < PARAMS.step_m * self._cells:
            return False
        self._place = pose[:2].copy()
        verdicts, places, keys = judge_beams(self._field, pose, beams, classes)
        if not self._gather(pose, verdicts, places, keys):
            return False
        before = self.suspects
        self.suspects = self._find(before, known)
        return self.suspects != before

    def _gather(
        self,
        pose: NDArray[np.float64],
        verdicts: NDArray[np.uint8],
        places: NDArray[np.float64],
        keys: NDArray[np.int64],
    ) -> bool:
        """Add the verdicts of one scan to the cells; say whether there were any."""
        telling = verdicts >= reflection.PASSED
        for key in np.unique(keys[telling]).tolist():
            self._row(key)
        index = np.array([self._rows.get(key, -1) for key in keys.tolist()])
        counted = (index >= 0) & (verdicts != reflection.NOTHING)
        if not counted.any():
            return False
        rows, group = np.unique(index[counted], return_inverse=True)
        verdict = verdicts[counted]
        mirrored = (verdict >= reflection.MIRRORED).astype(np.float64)
        image, no_image = verdict == reflection.IMAGE, verdict == reflection.NO_IMAGE
        behind = telling[counted].astype(np.float64)
        looks = np.bincount(group)
        share = np.bincount(group, mirrored) / looks
        x, y, nx, ny, depth = places[counted].T * behind
        seen = (mirrored, 1.0 - mirrored, image, no_image, behind)
        wall = (x, y, nx, ny, mirrored * depth, mirrored * depth * depth)
        for column, values in enumerate(seen + wall):
            self._table[rows, column] += np.bincount(group, values) / looks
        total = self._table[rows, _FOR] + self._table[rows, _AGAINST]
        self._table[rows, _SUMS] *= np.minimum(1.0, PARAMS.max_looks / total)[:, None]
        rows = rows[share > 0.0]
        for column, least in ((_LEFT, pose[0]), (_LOW, pose[1])):
            self._table[rows, column] = np.minimum(self._table[rows, column], least)
        for column, most in ((_RIGHT, pose[0]), (_HIGH, pose[1])):
            self._table[rows, column] = np.maximum(self._table[rows, column], most)
        return True

    def _row(self, key: int) -> int:
        """Return where a cell is kept."""
        row = self._rows.setdefault(key, len(self._rows))
        if row == len(self._table):
            self._table = np.concatenate([self._table, np.zeros_like(self._table)])
        if self._table[row, _FOR] + self._table[row, _AGAINST] == 0.0:
            self._table[row, _LEFT : _HIGH + 1] = (np.inf, np.inf, -np.inf, -np.inf)
        return row

    def _find(self, before: Sequence[Suspect], known: Lines) -> list[Suspect]:
        """Draw lines through the cells that behave like a mirror."""
        table = self._table[: len(self._rows)]
        points = table[:, [_X, _Y]] / table[:, [_BEHIND]]
        normals = table[:, [_NX, _NY]]
        normals = normals / np.hypot(*normals.T)[:, None]
        left = (table[:, _FOR] > table[:, _AGAINST]) & (table[:, _FOR] >= 1.0)
        found: list[Suspect] = []
        while left.any() and len(found) < PARAMS.max_lines:
            seed = int(np.argmax(np.where(left, table[:, _FOR], 0.0)))
            across = (points - points[seed]) @ normals[seed]
            tangent = np.array([-normals[seed, 1], normals[seed, 0]])
            along = (points - points[seed]) @ tangent
            near = (np.abs(across) <= PARAMS.line_width_m * self._cells) & (
                normals @ normals[seed] >= PARAMS.same_normal
            )
            low, high = _run(np.sort(along[near & left]), PARAMS.max_gap_m * self._cells)
            inside = near & (along >= low) & (along <= high)
            left &= ~inside
            left[seed] = False
            weights = table[inside, _FOR]
            middle = points[seed] + normals[seed] * (across[inside] @ weights / weights.sum())
            ends = middle + tangent * low, middle + tangent * high
            score = self._score(table[inside], high - low, _is_near(ends, before, self._cells))
            if score is not None and not self._is_known(0.5 * (ends[0] + ends[1]), known):
                found.append(Suspect(self._rounded(ends[0]), self._rounded(ends[1]), score))
        return sorted(found, key=lambda one: one.start)

    def _score(self, cells: NDArray[np.float64], length: float, is_suspected: bool) -> float | None:
        """Return how sure it is that cells of one line are a mirror, None if not sure enough."""
        looks, against = cells[:, _FOR].sum(), cells[:, _AGAINST].sum()
        share = looks / (looks + against)
        if cells[:, _NO_IMAGE].sum() > max(cells[:, _IMAGE].sum(), PARAMS.max_missed):
            return None
        depth = cells[:, _DEPTH].sum() / looks
        variance = cells[:, _DEPTH_2].sum() / looks - depth * depth
        parallax = math.hypot(
            cells[:, _RIGHT].max() - cells[:, _LEFT].min(),
            cells[:, _HIGH].max() - cells[:, _LOW].min(),
        )
        if (
            looks < PARAMS.min_looks
            or share < (PARAMS.share_to_keep if is_suspected else PARAMS.share_to_suspect)
            or length < PARAMS.min_length_m * self._cells
            or variance < (PARAMS.min_depth_dev_m * self._cells) ** 2
            or parallax < PARAMS.min_parallax_m * self._cells
        ):
            return None
        return round(float(share * looks / (looks + PARAMS.min_looks)), 1)

    def _rounded(self, point: NDArray[np.float64]) -> tuple[float, float]:
        """Return a point on a raster of half a line's width, so that a line rarely moves."""
        raster = 0.5 * PARAMS.line_width_m * self._cells
        x, y = (np.rint(point / raster) * raster).tolist()
        return x, y

    def _is_known(self, middle: NDArray[np.float64], known: Lines) -> bool:
        """Say whether a mirror or pane of the map is there already."""
        a = np.column_stack([known.ax, known.ay])
        edge = np.column_stack([known.bx, known.by]) - a
        square = np.maximum((edge * edge).sum(axis=1), 1e-9)
        share = np.clip(((middle - a) * edge).sum(axis=1) / square, 0.0, 1.0)
        distance = np.hypot(*(middle - a - share[:, None] * edge).T)
        return bool((distance <= PARAMS.known_m * self._cells).any())


def _run(along: NDArray[np.float64], gap: float) -> tuple[float, float]:
    """Return the ends of the run about 0 in sorted numbers that has no wider gap."""
    breaks = np.flatnonzero(np.diff(along) > gap)
    start = int(np.searchsorted(along[breaks], -1e-9)) if breaks.size else 0
    first = breaks[start - 1] + 1 if start > 0 else 0
    last = breaks[start] if start < breaks.size else along.size - 1
    return float(along[first]), float(along[last])


def _is_near(
    ends: tuple[NDArray[np.float64], NDArray[np.float64]],
    before: Sequence[Suspect],
    cells: float,
) -> bool:
    """Say whether a line was suspected before: its middle is on one of the lines."""
    x, y = 0.5 * (ends[0] + ends[1])
    for one in before:
        centre = 0.5 * (one.start[0] + one.end[0]), 0.5 * (one.start[1] + one.end[1])
        half = 0.5 * math.dist(one.start, one.end)
        if math.hypot(x - centre[0], y - centre[1]) <= half + PARAMS.line_width_m * cells:
            return True
    return False


def judge_beams(
    field: LikelihoodField,
    pose: NDArray[np.float64],
    beams: BeamSet,
    classes: NDArray[np.uint8],
) -> tuple[NDArray[np.uint8], NDArray[np.float64], NDArray[np.int64]]:
    """Say what each beam tells of the wall that it ought to end at.

    Args:
        field: of the map.
        pose: (3,) x, y [cells], yaw [rad] in `grid`.
        beams: of the scan.
        classes: (n,) of the beams.

    Returns:
        Verdicts (n,), places (n, 5) [cells] and keys (n,) of the walls, as
        `kernels.reflection.judge_beams` writes them.
    """
    count = classes.size
    verdicts = np.empty(count, np.uint8)
    places = np.zeros((count, 5))
    keys = np.zeros(count, np.int64)
    reflection.judge_beams(
        verdicts,
        places,
        keys,
        pose,
        (beams.end, beams.start),
        classes,
        field.distance,
        field.resolution,
    )
    return verdicts, places, keys
