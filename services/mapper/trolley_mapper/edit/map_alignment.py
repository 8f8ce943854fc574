"""Where one map lies on another: their walls laid over each other in every way that there is.

Source:
    Carpin, Fast and Accurate Map Merging for Multi-Robot Systems (2008): maps are merged by
    correlation; and Olson, Real-Time Correlative Scan Matching (2009): coarse to fine.
"""

import math
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy import fft as untyped_fft
from scipy import ndimage as untyped_ndimage

from trolley import codes
from trolley.codes import Refused
from trolley.geometry import Pose2D, angle_difference
from trolley.gridmap import OCCUPIED_FROM, GridMap

# SciPy's own types are those of its dispatch, not of what it returns.
fft, ndimage = cast("Any", untyped_fft), cast("Any", untyped_ndimage)
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class AlignmentParams:
    """When walls fit, and where alignment is tried. Set by hand, with tests/unit/mapper."""

    max_points: int = 3000
    """Number of wall points by which a map is compared."""
    coarse_cells: int = 320
    """Cells along the longer side of the grid that all placements are tried on."""
    min_coarse_m: float = 0.1
    """Least edge of those cells [m]."""
    max_coarse_step_rad: float = math.radians(6.0)
    """Largest step between the angles that are tried [rad]."""
    min_coarse_step_rad: float = math.radians(1.0)
    """Smallest step between the angles that are tried [rad]."""
    placements_per_angle: int = 2
    """Placements that are kept for each angle."""
    max_refined: int = 24
    """Placements that are refined."""
    agrees_m: float = 0.12
    """Distance within which a wall agrees with another [m]."""
    contradicts_m: float = 0.25
    """Distance from any wall beyond which a wall on free floor contradicts the map [m]."""
    sigma_m: float = 0.1
    """Standard deviation of a wall [m]."""
    fine_sigma_m: float = 0.03
    """Standard deviation of a wall in the last refinement [m]."""
    min_agreeing_m: float = 3.0
    """Length of walls that must agree [m]."""
    min_share: float = 0.8
    """Share of the walls on known ground that must agree."""
    rival: float = 0.8
    """Share of the best score above which another placement makes it ambiguous."""
    purer: float = 0.03
    """Lead in the share of agreeing walls at which another placement makes it ambiguous, if at
    least `rival_length` long."""
    rival_length: float = 0.2
    """Least agreeing length of such a placement, as a share of the best one's."""
    same_m: float = 0.5
    """Distance within which placements are the same, if they differ by less than `same_rad` [m]."""
    same_rad: float = math.radians(10.0)
    """Turn within which placements are the same, if they lie within `same_m` [rad]."""
    free_penalty: float = 1.5
    """Weight of a wall across free floor against a placement, where a wall on a wall has 1 for it.
    """


PARAMS = AlignmentParams()


@dataclass(frozen=True, slots=True)
class Alignment:
    """Where the other map lies."""

    this_T_other: Pose2D
    agreeing_m: float
    """Length of its walls that lie on walls of this map, about [m]."""
    share: float
    """Share of its walls, where this map is known, that lie on walls, 0 to 1."""


class _Side:
    """One of the two maps: points of its walls, and how far each place is from them."""

    def __init__(self, grid: GridMap) -> None:
        walls = grid.cells >= OCCUPIED_FROM
        found = np.argwhere(walls & ~ndimage.binary_erosion(walls))
        if not len(found):
            raise Refused(codes.BAD_REQUEST, f"The map {grid.name} has no walls to compare.")
        count = min(len(found), PARAMS.max_points)
        chosen = found[np.linspace(0, len(found) - 1, count).astype(np.int64)]
        self.points: Floats = grid.cell_to_world(chosen)
        middle = self.points.mean(axis=0)
        self.middle = Pose2D(float(middle[0]), float(middle[1]), 0.0)
        self.radius = max(1.0, float(np.hypot(*(self.points - middle).T).max()))
        self.point_m = grid.resolution * len(found) / count
        self.grid = grid
        gaps = ndimage.distance_transform_edt(~walls, sampling=grid.resolution)
        self.gaps = np.asarray(gaps, np.float32)
        self.free = (grid.cells >= 0) & ~walls & (self.gaps > PARAMS.contradicts_m)

    def sample(self, points: Floats) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Return the distance to a wall [m] under points of this map, and what is clearly free."""
        cells = self.grid.world_to_cell(points)
        inside = self.grid.contains_cell(cells)
        gaps, free = np.full(len(points), 9.0, np.float32), np.zeros(len(points), np.bool_)
        rows, cols = cells[inside].T
        gaps[inside], free[inside] = self.gaps[rows, cols], self.free[rows, cols]
        return gaps, free


def align_maps(this: GridMap, other: GridMap) -> Alignment:
    """Say where another map lies on this one.

    Args:
        this: the map that stays.
        other: the one to be placed; the two must have a few metres of walls in common.

    Raises:
        Refused: `no_match` where the walls fit nowhere, `ambiguous` where they fit in several ways.
    """
    here, there = _Side(this), _Side(other)
    # Placements are those of the other map's middle, so that a turn alone moves them little.
    refined = [_refined(here, there, middle) for middle in _candidates(here, there)]
    ranked = sorted(refined, key=lambda one: -one[0])
    if not ranked or ranked[0][0] <= 0.0:
        raise Refused(codes.NO_MATCH)
    score, middle = ranked[0]
    _, fine = _refined(here, there, middle, PARAMS.fine_sigma_m)
    best = _judged(here, there, fine)
    if best.agreeing_m < PARAMS.min_agreeing_m or best.share < PARAMS.min_share:
        raise Refused(codes.NO_MATCH)
    rivals = [rival for rival in ranked[1:] if _differ(rival[1], middle)]
    if any(
        rival_score > PARAMS.rival * score or _is_purer(best, _judged(here, there, rival))
        for rival_score, rival in rivals
    ):
        raise Refused(codes.AMBIGUOUS)
    return best


def _candidates(here: _Side, there: _Side) -> list[Pose2D]:
    """Return the placements that fit best on a coarse grid, at all angles."""
    centred = there.middle.inverse().transform_points(there.points)
    radius = there.radius
    low, high = here.points.min(axis=0), here.points.max(axis=0)
    size_m = max(float((high - low).max()), radius)
    coarse = max(PARAMS.min_coarse_m, size_m / PARAMS.coarse_cells)
    low = low - 2.0 * radius - 4.0 * coarse  # room for the other map on each side
    shape = tuple(
        fft.next_fast_len(int(n), real=True)
        for n in np.ceil((high + 2.0 * radius - low) / coarse)[::-1] + 8
    )
    field = fft.rfft2(_field(here, low, coarse, shape), workers=1)
    found: list[tuple[float, Pose2D]] = []
    step = max(1.5 * coarse / max(radius, coarse), PARAMS.min_coarse_step_rad)
    step = min(step, PARAMS.max_coarse_step_rad)
    for angle in np.arange(0.0, 2.0 * math.pi, step).tolist():
        turned = Pose2D(0.0, 0.0, angle).transform_points(centred)
        start = turned.min(axis=0)
        stamp = np.zeros(shape, np.float32)
        cols, rows = np.floor((turned - start) / coarse).astype(np.int64).T
        np.add.at(stamp, (rows, cols), 1.0)
        fits = fft.irfft2(field * np.conj(fft.rfft2(stamp)), s=shape, workers=1)
        for _ in range(PARAMS.placements_per_angle):
            row, col = (int(one) for one in np.unravel_index(int(np.argmax(fits)), shape))
            shift = low + coarse * np.array([col, row]) - start
            found.append((float(fits[row, col]), Pose2D(float(shift[0]), float(shift[1]), angle)))
            fits[max(0, row - 4) : row + 5, max(0, col - 4) : col + 5] = -np.inf
    found.sort(key=lambda one: -one[0])
    chosen: list[Pose2D] = []
    for _, pose in found:
        if len(chosen) < PARAMS.max_refined and all(_differ(pose, one, 0.4) for one in chosen):
            chosen.append(pose)
    return chosen


def _field(here: _Side, low: Floats, coarse: float, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return how much a wall at each place would agree: 1 on walls, below 0 on free floor."""
    rows, cols = np.mgrid[: shape[0], : shape[1]]
    centres = low + coarse * (np.column_stack([cols.ravel(), rows.ravel()]) + 0.5)
    gaps, free = here.sample(centres)
    near = np.exp(-0.5 * (gaps / max(PARAMS.sigma_m, 0.7 * coarse)) ** 2)
    return (near - PARAMS.free_penalty * free).astype(np.float32).reshape(shape)


def _score(here: _Side, there: _Side, middle: Pose2D, sigma_m: float = PARAMS.sigma_m) -> float:
    """Return how much agrees less what contradicts [m of walls], both ways."""
    pose = middle @ there.middle.inverse()
    gaps, free = here.sample(pose.transform_points(there.points))
    agreeing = float(np.exp(-0.5 * (gaps / sigma_m) ** 2).sum()) * there.point_m
    _, back = there.sample(pose.inverse().transform_points(here.points))
    against = float(free.sum()) * there.point_m + float(back.sum()) * here.point_m
    return agreeing - PARAMS.free_penalty * against


def _refined(
    here: _Side, there: _Side, start: Pose2D, sigma_m: float = PARAMS.sigma_m
) -> tuple[float, Pose2D]:
    """Climb from a placement to the best one nearby."""
    at, score, step_m = start, _score(here, there, start, sigma_m), 2.0 * sigma_m
    while step_m > 0.004:
        tries = [
            Pose2D(at.x + dx * step_m, at.y + dy * step_m, at.yaw + turn * step_m / there.radius)
            for dx, dy, turn in (
                (1, 0, 0),
                (-1, 0, 0),
                (0, 1, 0),
                (0, -1, 0),
                (0, 0, 1),
                (0, 0, -1),
            )
        ]
        scores = [_score(here, there, one, sigma_m) for one in tries]
        best = int(np.argmax(scores))
        if scores[best] > score:
            at, score = tries[best], scores[best]
        else:
            step_m *= 0.5
    return score, at


def _is_purer(best: Alignment, rival: Alignment) -> bool:
    """Say whether a rival has less in common but contradicts less: two rooms of one size, say."""
    return rival.share > best.share + PARAMS.purer and rival.agreeing_m > max(
        PARAMS.min_agreeing_m, PARAMS.rival_length * best.agreeing_m
    )


def _judged(here: _Side, there: _Side, middle: Pose2D) -> Alignment:
    pose = (middle @ there.middle.inverse()).wrapped()
    gaps, free = here.sample(pose.transform_points(there.points))
    _, back = there.sample(pose.inverse().transform_points(here.points))
    agreeing = float((gaps < PARAMS.agrees_m).sum()) * there.point_m
    against = float(free.sum()) * there.point_m + float(back.sum()) * here.point_m
    return Alignment(pose, agreeing, agreeing / max(agreeing + against, 1e-9))


def _differ(a: Pose2D, b: Pose2D, share: float = 1.0) -> bool:
    return (
        a.distance_to(b) > share * PARAMS.same_m
        or abs(angle_difference(a.yaw, b.yaw)) > share * PARAMS.same_rad
    )
