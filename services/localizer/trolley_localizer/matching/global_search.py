"""Find the robot anywhere on the map from one scan."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.gridmap import GridMap, distance_transform
from trolley.scanning import Points
from trolley.slices import Slices, whole
from trolley_localizer.kernels import search as kernels
from trolley_localizer.matching.likelihood_field import LikelihoodField, floor_of
from trolley_localizer.matching.map_matcher import BeamSet, MapMatcher, MatchScore


@dataclass(frozen=True, slots=True)
class SearchParams:
    """How the whole map is searched. All values were found by hand."""

    sigma_m: float = 0.12
    """Standard deviation of an end point from the wall: wider than in the filter, since cells and
    headings are tried in steps [m]."""
    apart_m: float = 0.6
    """Distance within which only the best of several poses is aligned [m]."""
    apart_rad: float = 0.5
    """Turn within which only the best of several poses is aligned [rad]."""
    same_m: float = 0.3
    """Distance within which aligned poses are one place [m]."""
    same_rad: float = 0.3
    """Turn within which aligned poses are one place [rad]."""
    max_places: int = 40
    """Number of places that get a closer look."""
    score_margin: float = 0.12
    """Margin below the best mean score (0 ... 1) beyond which a place gets no closer look."""
    min_score: float = 0.25
    """Mean score below which a place gets no closer look."""
    num_beams: int = 90
    """Number of beams of the scan that are searched with."""
    clear: float = 0.75
    """Support of the best place below which the first few are searched around: much has been moved,
    and the search, which sees ends only, may have kept a place beside the right one."""
    num_unclear: int = 3
    """Number of places that are searched around then."""
    around_steps: int = 3
    """Number of steps to each side of such a place."""
    around_step_m: float = 0.25
    """Length of such a step [m]."""
    around_rad: float = 0.25
    """Turn to each side of such a place [rad]."""
    top_block_m: float = 1.6
    """Edge of the largest blocks of cells of branch and bound, unless there were too many [m]."""
    most_top_blocks: int = 40_000
    """Number of these blocks at most; each has a bound for each of some 480 headings. The largest
    map in cells of 5 cm has 33,000."""
    leaf_block_m: float = 0.1
    """Edge of the smallest blocks of cells of branch and bound [m]."""
    slice_turns: int = 4
    """Number of headings for which the largest blocks are bounded in one slice."""
    slice_bounds: float = 50_000
    """Number of bounds after which a slice of branch and bound ends, some 10 ms."""
    edge_m: float = 0.1
    """Distance by which the robot may stand on what the map has as a wall [m]."""
    beside_floor_m: float = 1.0
    """Distance from free floor up to which the robot may stand on what the map does not know: where
    furniture stood that has been moved [m]."""


PARAMS = SearchParams()


@dataclass(frozen=True, slots=True)
class Place:
    """A pose that the scan speaks for."""

    pose: NDArray[np.float64]
    """(3,) x, y [cells], yaw [rad] in `grid`."""
    support: MatchScore


def build_pyramid(field: LikelihoodField) -> kernels.Pyramid:
    """Compute the maxima of the score over blocks of cells, level by level."""
    resolution = field.resolution
    levels = max(1, round(math.log2(PARAMS.top_block_m / resolution))) + 1
    rows = [field.grid.rows]
    cols = [field.grid.cols]
    while len(rows) < levels or rows[-1] * cols[-1] > PARAMS.most_top_blocks:
        rows.append((rows[-1] + 1) // 2)
        cols.append((cols[-1] + 1) // 2)
    levels = len(rows)
    sizes = np.array([r * c for r, c in zip(rows, cols, strict=True)], np.int64)
    offset = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64)
    pyramid = kernels.Pyramid(
        score=np.zeros(int(sizes.sum()), np.uint8),
        free=np.zeros(int(sizes.sum()), np.uint8),
        offset=offset,
        rows=np.array(rows, np.int64),
        cols=np.array(cols, np.int64),
    )
    sigma = PARAMS.sigma_m / resolution
    inner = field.distance[1:-1, 1:-1]
    cells = np.rint(255.0 * np.exp(np.float32(-0.5 / sigma**2) * inner * inner)).astype(np.uint8)
    pyramid.score[: sizes[0]] = cells.ravel()
    pyramid.free[: sizes[0]] = _standing_room(field.grid).ravel()
    blocks = cells.ravel().copy()
    for level in range(1, levels):
        kernels.reduce_level(pyramid, blocks, level)
    return pyramid


def _standing_room(grid: GridMap) -> NDArray[np.bool_]:
    """Say where the robot may stand (rows, cols): on free floor, and on the unknown beside it."""
    limit_m = PARAMS.beside_floor_m + grid.resolution
    away_m = distance_transform(floor_of(grid), grid.resolution, limit_m)
    return (away_m <= PARAMS.beside_floor_m) & (grid.occupied_mask() == 0)


def num_turns(points: Points, resolution: float) -> int:
    """Choose how many headings to try: far end points move by about a search sigma between."""
    reach = np.hypot(points.x, points.y) * resolution
    far = max(float(np.percentile(reach, 60)), 1.0) if reach.size else 1.0
    step = min(max(1.2 * PARAMS.sigma_m / far, math.radians(0.75)), math.radians(4.0))
    return math.ceil(2.0 * math.pi / step)


class SearchMap:
    """A map's pyramid, computed when it is first needed: it costs as long as a search."""

    def __init__(self, field: LikelihoodField) -> None:
        self.field = field
        self._pyramid: kernels.Pyramid | None = None

    def pyramid(self) -> kernels.Pyramid:
        """Return the pyramid. Jobs have one thread, so nobody else computes it now."""
        if self._pyramid is None:
            self._pyramid = build_pyramid(self.field)
        return self._pyramid


class SearchJob:
    """One search of the whole map with one scan; it may run on another thread."""

    def __init__(
        self,
        search_map: SearchMap,
        matcher: MapMatcher,
        beams: BeamSet,
        odom_T_base: Pose2D,
        followed: NDArray[np.float64] | None,
    ) -> None:
        self._map = search_map
        self._matcher = matcher
        self._beams = beams
        self.odom_T_base = odom_T_base
        """Odometry at the scan."""
        self.followed = followed
        """The estimate to compare with (3,) [cells, rad], or None."""
        self.places: list[Place] = []
        """What was found, best first."""
        self.support: MatchScore | None = None
        """What the scan says about `followed`."""

    def run(self) -> "SearchJob":
        """Do all slices at once, and return the job."""
        whole(self.slices())
        return self

    def slices(self) -> Slices[None]:
        """Search, and fill `places` and `support`."""
        field, pyramid = self._map.field, self._map.pyramid()
        yield
        self.places = yield from find_places(field, pyramid, self._beams, self._matcher)
        if self.followed is not None:
            near = places_around(self.followed, field, self._beams, self._matcher)
            self.places = _distinct([*self.places, *near], field.resolution)
            self.support = self._matcher.score(self.followed, self._beams)


def is_near(one: NDArray[np.float64], other: NDArray[np.float64], resolution: float) -> bool:
    """Say whether two aligned poses (3,) [cells, rad] are the same place."""
    shift = one - other
    turn = math.remainder(float(shift[2]), 2.0 * math.pi)
    return (
        math.hypot(shift[0], shift[1]) * resolution < PARAMS.same_m and abs(turn) < PARAMS.same_rad
    )


def find_places(
    field: LikelihoodField,
    pyramid: kernels.Pyramid,
    beams: BeamSet,
    matcher: MapMatcher,
) -> Slices[list[Place]]:
    """Return the places that explain a scan best, best first, each aligned with the map."""
    points = beams.spread(PARAMS.num_beams)
    turns = num_turns(points, field.resolution)
    found = yield from _search(field, pyramid, points, turns)
    places: list[Place] = []
    for k in np.argsort(-found.score, kind="stable"):
        if found.score[k] < 0.0:
            continue
        coarse = np.empty(3)
        coarse[:] = found.col[k] + 0.5, found.row[k] + 0.5, 2.0 * math.pi * found.turn[k] / turns
        places += _settled(coarse, beams, matcher, field.resolution)[:1]
    places.sort(key=lambda place: -place.support.value)
    if places and places[0].support.value < PARAMS.clear:
        for place in places[: PARAMS.num_unclear]:
            yield
            places += places_around(place.pose, field, beams, matcher)
    return _distinct(places, field.resolution)


def places_around(
    pose: NDArray[np.float64],
    field: LikelihoodField,
    beams: BeamSet,
    matcher: MapMatcher,
) -> list[Place]:
    """Align from all round about a pose: furniture that was moved can hold it in a wrong place.

    Args:
        pose: (3,) x, y [cells], yaw [rad] in `grid`.
        field: of the map.
        beams: of the scan.
        matcher: of the map.
    """
    steps = np.arange(-PARAMS.around_steps, PARAMS.around_steps + 1) * (
        PARAMS.around_step_m / field.resolution
    )
    places: list[Place] = []
    for turn in (-PARAMS.around_rad, 0.0, PARAMS.around_rad):
        for dx in steps:
            for dy in steps:
                start = pose + np.array([dx, dy, turn])
                places += _settled(start, beams, matcher, field.resolution)
    return places


def _settled(
    pose: NDArray[np.float64], beams: BeamSet, matcher: MapMatcher, resolution: float
) -> list[Place]:
    """Align a rough pose in two ways; return where the robot may stand, the better first.

    It may stand where the map has the edge of furniture: that has been moved, or the pose is a
    little off. Of two flats alike only one was found where a pose fell on such a cell in the other.
    """
    beside = PARAMS.edge_m / resolution
    around = np.array([[0.0, 0.0], [beside, 0.0], [-beside, 0.0], [0.0, beside], [0.0, -beside]])
    return [
        Place(aligned, support)
        for aligned, support in matcher.settle(pose, beams)
        if any(matcher.may_stand(aligned[:2] + shift) for shift in around)
    ]


def _search(
    field: LikelihoodField, pyramid: kernels.Pyramid, points: Points, turns: int
) -> Slices[kernels.Found]:
    """Run branch and bound; empty slots have a negative score."""
    beam_rows = np.empty((turns, points.x.size), np.int32)
    beam_cols = np.empty((turns, points.x.size), np.int32)
    kernels.turn_points(beam_rows, beam_cols, points, turns)
    top = pyramid.rows.size - 1
    leaf = min(top, max(0, math.floor(math.log2(PARAMS.leaf_block_m / field.resolution) + 1e-6)))
    bounds = np.empty((turns, int(pyramid.rows[top]), int(pyramid.cols[top])), np.float32)
    for first in range(0, turns, PARAMS.slice_turns):
        some = slice(first, first + PARAMS.slice_turns)
        kernels.bound_top(bounds[some], pyramid, top, beam_rows[some], beam_cols[some])
        yield
    order = np.argsort(-bounds.ravel(), kind="stable").astype(np.int64)
    found = kernels.Found(
        score=np.full(PARAMS.max_places, -1.0, np.float32),
        row=np.zeros(PARAMS.max_places, np.int32),
        col=np.zeros(PARAMS.max_places, np.int32),
        turn=np.zeros(PARAMS.max_places, np.int32),
    )
    apart = np.array(
        [
            round(PARAMS.apart_m / field.resolution),
            round(PARAMS.apart_rad / (2.0 * math.pi) * turns),
            turns,
        ],
        np.int64,
    )
    margin, lowest = 255.0 * PARAMS.score_margin, 255.0 * PARAMS.min_score
    limits = np.array([0.0, margin, lowest, PARAMS.slice_bounds])
    levels, beams = np.array([top, leaf]), (beam_rows, beam_cols)
    while order.size:
        yield
        done = kernels.search_blocks(found, pyramid, order, bounds, levels, beams, apart, limits)
        order = order[done:]
    return found


def _distinct(places: Sequence[Place], resolution: float) -> list[Place]:
    """Return the places best first, without those that alignment has moved onto a better one."""
    kept: list[Place] = []
    # By squares a little larger than the distance: who is nearer is in the same or beside it.
    edge = 1.001 * PARAMS.same_m / resolution
    squares: dict[tuple[int, int], list[NDArray[np.float64]]] = {}
    for place in sorted(places, key=lambda place: -place.support.value):
        col, row = math.floor(place.pose[0] / edge), math.floor(place.pose[1] / edge)
        beside = [(col + dx, row + dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)]
        rivals = (pose for square in beside for pose in squares.get(square, ()))
        if not any(is_near(place.pose, pose, resolution) for pose in rivals):
            kept.append(place)
            squares.setdefault((col, row), []).append(place.pose)
    return kept
