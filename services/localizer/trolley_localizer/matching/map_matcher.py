"""The beams of a scan, and how well they and the map agree at a pose."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trolley.config.localizer import LocalizerConfig
from trolley.deskewing import deskew, is_too_little
from trolley.scanning import FrontEndParams, Points, ScanInput
from trolley_localizer.kernels import matching as kernels
from trolley_localizer.kernels.beams import mark_echoes, take_evenly
from trolley_localizer.kernels.layout import Lines
from trolley_localizer.kernels.matching import refine_pose, score_pose
from trolley_localizer.matching.likelihood_field import LikelihoodField

FRONT_END = FrontEndParams(
    # The nearest float32 above 0, so that "invalid" is below the limit.
    least_range_m=1e-6,
    usable_range_share=1.0,
    telling_range_m=0.5,
    min_telling_share=0.1,
)


FREE_INFORMATION = np.diag([1e-4, 1e-4, 1e-2])
"""What holds a pose back that only the scan is to place: next to nothing, along a bare corridor too
[1/cells^2, 1/rad^2]."""
ALL_ROUND_RAD = 1.7 * math.pi
"""Field of view from which on a lidar looks all round, but for a post or two (by hand)."""


@dataclass(frozen=True, slots=True, eq=False)
class BeamSet:
    """The beams of a scan in `base_link` at its stamp, corrected for the motion during the scan.

    Attributes:
        end: (n,) end points of all beams [cells].
        start: (n,) where the laser was for each [cells].
        classes: (n,) uint8: UNUSED where there is no echo, else NOT_ON_MAP until judged.
        used: (m,) int64, indices of beams that may be matched with the map.
        step_rad: angle from one beam to the next, 0 ... pi.
        view_rad: field of view without what is hidden by the robot's own body, as far as beams that
            end too near to be measured tell.
        is_blind: the scan holds too little to compare it with a map.
    """

    end: Points
    start: Points
    classes: NDArray[np.uint8]
    used: NDArray[np.int64]
    step_rad: float
    view_rad: float
    is_blind: bool

    def points(self, index: NDArray[np.int64]) -> Points:
        """Return the end points of some beams."""
        return Points(self.end.x[index], self.end.y[index])

    def starts(self, index: NDArray[np.int64]) -> Points:
        """Return where the laser was for some beams."""
        return Points(self.start.x[index], self.start.y[index])

    def spread(self, count: int, phase: float = 0.5) -> Points:
        """Return at most `count` used end points, evenly over the surface that was seen.

        Args:
            count: how many at most.
            phase: 0 ... 1, shifts the choice between neighbours.
        """
        if self.used.size == 0:
            return self.points(self.used)
        few = min(count, self.used.size)
        chosen = Points(np.empty(few), np.empty(few))
        take_evenly(chosen, self.end, self.start, self.used, phase)
        return chosen

    @property
    def looks_all_round(self) -> bool:
        """Whether the lidar sees the opposite of each wall that it sees."""
        return self.view_rad >= ALL_ROUND_RAD

    @property
    def laser(self) -> tuple[float, float]:
        """About where the laser was, x, y [cells]."""
        middle = self.classes.size // 2
        return float(self.start.x[middle]), float(self.start.y[middle])

    def only(self, classes: NDArray[np.uint8], used: NDArray[np.int64]) -> "BeamSet":
        """Return the same beams with other classes, fewer of them used."""
        return replace(self, classes=classes, used=used)


def read_beams(scan: ScanInput, resolution: float, max_range_m: float) -> BeamSet:
    """Deskew a scan into `base_link`, in cells of `resolution` [m]."""
    seen = deskew(scan, FRONT_END, max_range_m, resolution)
    classes = np.empty(scan.ranges.size, np.uint8)
    telling = mark_echoes(classes, scan.ranges, seen.echoes, FRONT_END.telling_range_m)
    blind = is_too_little(telling, seen.echoes.size, FRONT_END)
    step_rad = abs(math.remainder(scan.angle_increment, 2.0 * math.pi))
    view_rad = step_rad * int(np.count_nonzero(scan.ranges >= scan.range_min))
    return BeamSet(seen.ends, seen.starts, classes, seen.echoes, step_rad, view_rad, blind)


@dataclass(frozen=True, slots=True)
class MatchParams:
    """How beams speak for a pose, and how a rough pose is aligned."""

    wide_m: float = 0.3
    """Reach with which alignment starts [m] (by hand)."""
    narrow_m: float = 0.1
    """Reach with which alignment ends [m] (by hand)."""
    max_steps: int = 12
    """Gauss-Newton steps at each reach."""
    through_weight: float = 0.5
    """Weight against a pose of the share of beams that went through a wall of the map and end at
    another, as behind furniture that was taken away."""
    astray_weight: float = 3.0
    """Weight against a pose of the share of beams that went through a wall and end on free floor,
    which is next to impossible at the true place. Measured in rooms with a third of the furniture
    moved, and on recorded drives: that share is 0 ... 0.03 at true places, and 0.03 ... 0.14 at the
    wrong ones that explain as many ends."""
    mirror_depth_m: float = 0.1
    """Depth behind a wall's line from which on an end point is seen in a mirror: walls are thinner
    [m]."""
    shifts_m: tuple[float, ...] = (0.3, 0.5)
    """Distances at which the scan must not fit as well for a pose to be pinned [m]."""
    num_shifts: int = 8
    """Number of directions in which the pose is shifted."""
    num_cast: int = 180
    """Number of beams that are followed through the map, about; twice as many are scored."""


PARAMS = MatchParams()


@dataclass(frozen=True, slots=True, eq=False)
class MatchScore:
    """What speaks for a pose."""

    match: float
    """Share of beams that end at a wall of the map, 0 ... 1."""
    through: float
    """Share of beams that went through a wall of the map and end at another, 0 ... 1."""
    astray: float
    """Share of beams that went through a wall of the map and end on free floor, 0 ... 1."""
    beyond: float
    """Share of beams that went through a wall of the map and end where it knows nothing."""
    known: float
    """Share of beams that end where the map knows what is there, 0 ... 1."""
    beams: int
    """Number of beams that were compared."""
    score: float
    """Mean robust score of end points, 0 ... 1; finer than `match`."""
    known_score: float
    """Mean robust score of end points where the map knows what is there, 0 ... 1."""

    @property
    def value(self) -> float:
        """What speaks for the pose of a robot that may be anywhere, 0 ... 1.

        The score less the contradictions. The unknown proves nothing.
        """
        lost = PARAMS.astray_weight * (self.astray + self.beyond)
        return max(0.0, self.score - PARAMS.through_weight * self.through - lost)

    @property
    def tracked(self) -> float:
        """What speaks for a pose to which the odometry has led, 0 ... 1.

        The unknown counts neither for nor against it: a beam through a wall that ends there went
        through a door that was shut.
        """
        gone = PARAMS.through_weight * (self.through + self.beyond)
        return max(0.0, self.known_score - gone - PARAMS.astray_weight * self.astray)


class MapMatcher:
    """Compares scans with one map and its mirrors."""

    def __init__(self, field: LikelihoodField, mirrors: Lines, config: LocalizerConfig) -> None:
        self._field = field
        self.mirrors = mirrors
        """Mirrors and panes in cells of the grid."""
        self.suspects = mirrors._replace(**{name: np.empty(0) for name in mirrors._fields})
        """Suspected mirrors alike."""
        self._config = config

    def without_mirrored(self, pose: NDArray[np.float64], beams: BeamSet) -> BeamSet:
        """Leave out the beams that end behind a mirror, a suspected one, or glass."""
        lines = (
            (self.mirrors, kernels.BEHIND_MIRROR),
            (self.suspects, kernels.SUSPECTED),
        )
        if not any(one.ax.size for one, _ in lines):
            return beams
        classes = beams.classes.copy()
        depth = PARAMS.mirror_depth_m / self._field.resolution
        marked = sum(
            kernels.mark_crossing(classes, pose, beams.end, beams.start, one, depth, mark)
            for one, mark in lines
        )
        if marked == 0:
            return beams
        return beams.only(classes, beams.used[classes[beams.used] < kernels.BEHIND_MIRROR])

    def score(self, pose: NDArray[np.float64], beams: BeamSet) -> MatchScore:
        """Say how the scan speaks for a pose (3,) x, y [cells], yaw [rad]."""
        return self.classify(pose, beams)[0]

    def classify(
        self, pose: NDArray[np.float64], beams: BeamSet
    ) -> tuple[MatchScore, NDArray[np.uint8]]:
        """Return the support of a pose and the class of each beam (n,)."""
        seen = self.without_mirrored(pose, beams)
        classes = seen.classes.copy()
        cells = 1.0 / self._field.resolution
        explained, looked_at = kernels.explain_beams(
            classes, pose, seen.end, self._field.distance, self._config.explained_within_m * cells
        )
        if looked_at == 0:
            return MatchScore(0.0, 0.0, 0.0, 0.0, 0.0, 0, 0.0, 0.0), classes
        every = max(1, seen.used.size // PARAMS.num_cast)
        through, astray, beyond, cast = kernels.count_through(
            pose,
            seen.end,
            seen.start,
            classes,
            self._field.distance,
            self._field.known,
            self._config.through_margin_m * cells,
            every,
        )
        points = seen.spread(PARAMS.num_cast * 2)
        score = score_pose(self._field.distance, points, pose, PARAMS.narrow_m * cells)
        known_points = self._known(pose, points)
        known_score = score_pose(self._field.distance, known_points, pose, PARAMS.narrow_m * cells)
        cast = max(cast, 1)
        support = MatchScore(
            match=explained / looked_at,
            through=through / cast,
            astray=astray / cast,
            beyond=beyond / cast,
            known=known_points.x.size / max(points.x.size, 1),
            beams=looked_at,
            score=score,
            known_score=known_score,
        )
        return support, classes

    def _known(self, pose: NDArray[np.float64], points: Points) -> Points:
        """Return the end points at which the map knows what is there."""
        is_known = np.empty(points.x.size, np.uint8)
        if kernels.mark_known(is_known, self._field.known, points, pose) == is_known.size:
            return points
        chosen = is_known != 0
        return Points(points.x[chosen], points.y[chosen])

    def on_known(self, pose: NDArray[np.float64], beams: BeamSet) -> BeamSet:
        """Leave out the beams that end where the map knows nothing."""
        points = beams.points(beams.used)
        is_known = np.empty(points.x.size, np.uint8)
        if kernels.mark_known(is_known, self._field.known, points, pose) == is_known.size:
            return beams
        return beams.only(beams.classes, beams.used[is_known != 0])

    def known_share(self, pose: NDArray[np.float64], beams: BeamSet) -> float:
        """Return the share of beams that end where the map knows what is there, 0 ... 1."""
        points = beams.spread(PARAMS.num_cast)
        is_known = np.empty(points.x.size, np.uint8)
        count = kernels.mark_known(is_known, self._field.known, points, pose)
        return count / max(points.x.size, 1)

    def pinned(self, pose: NDArray[np.float64], beams: BeamSet) -> float:
        """Say how firmly a scan pins a pose: by how much its score falls a little beside, 0 ... 1.

        Along a bare corridor it does not fall at all. The unknown pins nothing.
        """
        points = self._known(pose, self.without_mirrored(pose, beams).spread(PARAMS.num_cast))
        cells = 1.0 / self._field.resolution
        width = PARAMS.narrow_m * cells
        beside = 0.0
        for away_m in PARAMS.shifts_m:
            for k in range(PARAMS.num_shifts):
                way = 2.0 * math.pi * k / PARAMS.num_shifts
                shift = np.array([math.cos(way), math.sin(way), 0.0]) * away_m * cells
                score = score_pose(self._field.distance, points, pose + shift, width)
                beside = max(beside, score)
        return max(0.0, score_pose(self._field.distance, points, pose, width) - beside)

    def align(
        self,
        pose: NDArray[np.float64],
        beams: BeamSet,
        reaches_m: Sequence[float] = (PARAMS.wide_m, PARAMS.narrow_m),
    ) -> NDArray[np.float64]:
        """Return the pose moved to where the scan fits best nearby.

        Args:
            pose: (3,) x, y [cells], yaw [rad] in `grid`.
            beams: of the scan.
            reaches_m: how far an end point may lie from its wall, step by step [m].
        """
        seen = self.without_mirrored(pose, beams)
        points = seen.spread(self._config.refine_beams)
        moved = pose.copy()
        information = np.empty((3, 3))
        for sigma_m in reaches_m:
            tuning = np.array([sigma_m / self._field.resolution, 1.0])
            refine_pose(
                moved,
                information,
                self._field.distance,
                points,
                pose,
                FREE_INFORMATION,
                tuning,
                PARAMS.max_steps,
            )
        return moved if np.isfinite(moved).all() else pose

    def settle(
        self, pose: NDArray[np.float64], beams: BeamSet
    ) -> list[tuple[NDArray[np.float64], MatchScore]]:
        """Align a rough pose in two ways and return both with their support, the better first.

        From afar a piece of furniture that was moved can pull the pose off its place; from near by
        it cannot, but then a rough pose may be out of reach of the walls.
        """
        poses = [self.align(pose, beams), self.align(pose, beams, (PARAMS.narrow_m,))]
        options = [(option, self.score(option, beams)) for option in poses]
        return sorted(options, key=lambda option: -option[1].value)

    def may_stand(self, pose: NDArray[np.float64]) -> bool:
        """Say whether the robot's centre may be at a pose: on the map and not in a wall."""
        grid = self._field.grid
        col, row = math.floor(pose[0]), math.floor(pose[1])
        if not (0 <= col < grid.cols and 0 <= row < grid.rows):
            return False
        return bool(self._field.distance[row + 1, col + 1] > 0.0)
