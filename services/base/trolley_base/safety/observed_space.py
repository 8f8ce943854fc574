"""Which floor near the robot the lidar has seen to be free, remembered while the robot moves on.

A grid of small cells in frame `odom` around the robot. A cell is seen where beams passed it on both
sides; it is forgotten after a while, and soon where a beam should have seen it and did not. Where
the robot itself has been is free, too.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, circumscribed_radius, polygon_contains, wrap_angles
from trolley.sight import SIGHT
from trolley_base.drivers import LidarScan
from trolley_base.odometry.track import OdometryTrack
from trolley_base.safety.near_echoes import is_round, laser_poses


@dataclass(frozen=True, slots=True)
class ObservedSpaceParams:
    """What counts as seen; for how long it does is in `trolley.sight`. Set by hand."""

    cell_m: float = 0.05
    """Edge of a cell [m]."""
    dark_s: float = 0.5
    """A cell that a beam should see, and none has seen for this long, is forgotten [s]."""
    hidden_m: float = 0.05
    """Between two usable beams, with others that failed between them, nothing wider than this may
    go unseen: so far from the lidar the gap counts as seen [m]."""
    adjacent: float = 1.5
    """Beams that are at most so many increments apart are neighbours: no gap."""
    crowd_width: float = 0.7
    """A beam is believed if enough beams around it, over this angle, are usable, too [rad]."""
    crowd_share: float = 0.125
    """Share of those beams that must be usable: one of twenty that succeeds is luck, not sight; one
    of five, as towards the sun, is little, but soon there is another."""
    behind_echo_m: float = 0.15
    """What lies this much behind an echo is left to the stop field, which keeps the robot from the
    echo [m]."""
    bearings: int = 720
    """The view is looked up by bearings of half a degree: 1 cm at 1 m."""
    stored_m: float = 1.5
    """How far beyond what can matter at once the floor is remembered [m]: a dead end 1.2 m deep
    that the robot looked into from before it, and backs into."""
    shift_m: float = 0.25
    """What is stored moves along with the robot in steps of this [m]."""


PARAMS = ObservedSpaceParams()

TURN = 2.0 * math.pi
KNOTS = (np.arange(PARAMS.bearings) + 0.5) * (TURN / PARAMS.bearings) - math.pi
"""Bearings at which a view is looked up [rad]."""

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


class Unseen(NamedTuple):
    """Floor near the robot that the lidar has not seen, or not lately.

    Attributes:
        points: (n, 2) middles of cells x, y [m].
        may_creep: (n,) whether programs may creep there: it was seen to be free a while ago, and
            is out of view now; or no beam comes back from there, and the lidar's setting allows it.
        was_echo: (n,) whether something stood there, or just before it, when the lidar last looked.
    """

    points: Floats
    may_creep: Bools
    was_echo: Bools


ALL_SEEN = Unseen(np.empty((0, 2)), np.empty(0, np.bool_), np.empty(0, np.bool_))


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """How far a scan sees into each of `PARAMS.bearings` directions about where it was taken.

    Attributes:
        origin: (2,) x, y [m] in `odom` of the lidar in the middle of the revolution.
        free: (bearings,) free so far [m], counter-clockwise from -pi; 0 where it does not look.
        explained: (bearings,) an echo explains what lies up to here [m].
        dark: (bearings,) whether it looks there, and its beams failed beyond `free`.
        silent: (bearings,) whether nothing comes back from there, as in `LidarScan`.
    """

    origin: Floats
    free: Floats
    explained: Floats
    dark: Bools
    silent: Bools


def view_of(scan: LidarScan, odom_T_laser: Floats) -> View:
    """Return what a scan sees.

    Args:
        scan: of at least one beam.
        odom_T_laser: (beams, 3) x, y [m], yaw [rad] when each beam was measured.
    """
    count = len(scan.ranges)
    origin = odom_T_laser[count // 2, :2]
    ranges = scan.ranges.astype(np.float64)
    angles = odom_T_laser[:, 2] + scan.angle_min + np.arange(count) * scan.angle_increment
    usable = (ranges > 0.0) & _has_company(scan)
    finite = usable & (ranges < np.inf)
    # Seen from one place: the robot moves on while the lidar turns.
    shift = odom_T_laser[finite, :2] - origin
    x = shift[:, 0] + ranges[finite] * np.cos(angles[finite])
    y = shift[:, 1] + ranges[finite] * np.sin(angles[finite])
    bearings = angles.copy()
    bearings[finite] = np.arctan2(y, x)
    ranges[finite] = np.hypot(x, y)
    # A scan that is not round looks only between its first beam and its last.
    width = TURN if is_round(scan) else (count - 1) * scan.angle_increment
    looks = (KNOTS - angles[0]) % TURN <= width
    is_silent = _silent_bearings(scan, angles[0])
    if np.count_nonzero(usable) < 2:
        nothing = np.zeros(PARAMS.bearings)
        return View(origin, nothing, nothing, looks, looks & is_silent)
    bearings, ranges = wrap_angles(bearings[usable]), ranges[usable]
    order = np.argsort(bearings)
    bearings, ranges = bearings[order], ranges[order]
    gaps = np.append(bearings[1:], bearings[0] + TURN) - bearings
    nearer = np.minimum(ranges, np.append(ranges[1:], ranges[0]))
    is_gap = gaps > PARAMS.adjacent * scan.angle_increment
    free = np.where(is_gap, np.minimum(nearer, PARAMS.hidden_m / np.maximum(gaps, 1e-9)), nearer)
    explained = np.where(is_gap, 0.0, nearer + PARAMS.behind_echo_m)
    pair = np.searchsorted(bearings, KNOTS, side="right") - 1  # -1 is the last one, as it should be
    dark = looks & is_gap[pair]
    return View(origin, free[pair], explained[pair], dark, dark & is_silent)


def _silent_bearings(scan: LidarScan, first: float) -> Bools:
    """Return beside which bearings (bearings,) a beam measured that nothing comes back.

    Args:
        scan: the scan.
        first: direction of its first beam in `odom` [rad].
    """
    if not scan.silent.any():
        return np.zeros(PARAMS.bearings, np.bool_)
    count = len(scan.silent)
    before = np.floor(((KNOTS - first) % TURN) / scan.angle_increment).astype(np.int64)
    return scan.silent[before % count] | scan.silent[(before + 1) % count]


def _has_company(scan: LidarScan) -> Bools:
    """Return the beams (n,) with enough usable ones around them."""
    usable = (scan.ranges > 0.0).astype(np.float64)
    count = len(usable)
    half = min(count // 2, max(1, round(0.5 * PARAMS.crowd_width / scan.angle_increment)))
    # By hand: `np.pad` takes as long as everything else here.
    if is_round(scan):
        padded = np.concatenate([usable[count - half :], usable, usable[:half]])
    else:
        ends = np.full(half, usable[0]), np.full(half, usable[-1])
        padded = np.concatenate([ends[0], usable, ends[1]])
    sums = np.concatenate([[0.0], np.cumsum(padded)])
    return sums[2 * half + 1 :] - sums[: -2 * half - 1] >= PARAMS.crowd_share * (2 * half + 1)


class ObservedSpace:
    """Remembers which cells are free.

    Args:
        footprint: (n, 2) corners [m] in `base_link`, counter-clockwise.
        base_T_laser: where the lidar sits.
        reach: floor farther than this from `base_link` never matters at once [m].
    """

    def __init__(self, footprint: Floats, base_T_laser: Pose2D, reach: float) -> None:
        self._footprint = footprint
        self._radius = circumscribed_radius(footprint)
        self._base_T_laser = base_T_laser
        self._reach = reach
        self._half = math.ceil((reach + PARAMS.stored_m) / PARAMS.cell_m)
        self._zero_ns: int | None = None
        self._corner = np.zeros(2, dtype=np.int64)
        """Number of the first cell along x and y, from the origin of `odom`."""
        shape = (2 * self._half, 2 * self._half)
        # When each cell was seen free, lay under the robot, at an echo, or where nothing came back
        # from [s]: [row = y, col = x].
        self._seen_s = np.full(shape, -np.inf)
        self._trail_s = np.full(shape, -np.inf)
        self._echo_s = np.full(shape, -np.inf)
        self._silent_s = np.full(shape, -np.inf)
        self._unseen_odom = ALL_SEEN

    def update(self, scan: LidarScan, track: OdometryTrack) -> None:
        """Take a new scan, of at least one beam."""
        if self._zero_ns is None:
            self._zero_ns = scan.stamp_ns
        now_s = (scan.stamp_ns - self._zero_ns) * 1e-9
        base = track.odom_T_base
        self._follow(base)
        x = (self._corner[0] + np.arange(2 * self._half) + 0.5) * PARAMS.cell_m
        y = (self._corner[1] + np.arange(2 * self._half) + 0.5) * PARAMS.cell_m
        self._look(view_of(scan, laser_poses(scan, track, self._base_T_laser)), x, y, now_s)
        self._stand(base, x, y, now_s)
        self._unseen_odom = self._find_unseen(base, x, y, now_s)

    def unseen(self, odom_T_base: Pose2D) -> Unseen:
        """Return what was not seen, in `base_link` where it is now."""
        unseen = self._unseen_odom
        if len(unseen.points) == 0:
            return ALL_SEEN
        return unseen._replace(points=odom_T_base.inverse().transform_points(unseen.points))

    def _follow(self, base: Pose2D) -> None:
        """Move the grid along with the robot, so that what is near lies on it."""
        wanted = np.floor(np.array([base.x, base.y]) / PARAMS.cell_m).astype(np.int64) - self._half
        shift = wanted - self._corner
        if np.abs(shift).max() * PARAMS.cell_m <= PARAMS.shift_m:
            return
        self._corner = wanted
        for grid in (self._seen_s, self._trail_s, self._echo_s, self._silent_s):
            _shift(grid, int(shift[1]), int(shift[0]))

    def _look(self, view: View, x: Floats, y: Floats, now_s: float) -> None:
        dx, dy = x - view.origin[0], (y - view.origin[1])[:, None]
        distance = np.sqrt(dx * dx + dy * dy)
        scale = PARAMS.bearings / TURN
        bearing = ((np.arctan2(dy, dx) + math.pi) * scale).astype(np.int64)
        np.minimum(bearing, PARAMS.bearings - 1, out=bearing)
        seen = distance <= view.free[bearing]
        occupied = ~seen & (distance <= view.explained[bearing])
        dark = ~seen & view.dark[bearing] & (self._seen_s < now_s - PARAMS.dark_s)
        self._seen_s[seen] = now_s
        self._seen_s[dark | occupied] = -np.inf
        self._trail_s[occupied] = -np.inf
        self._echo_s[occupied] = now_s
        self._silent_s[~seen & view.silent[bearing]] = now_s

    def _stand(self, base: Pose2D, x: Floats, y: Floats, now_s: float) -> None:
        """Note that the floor under the robot is free."""
        near_x = np.flatnonzero(np.abs(x - base.x) <= self._radius)
        near_y = np.flatnonzero(np.abs(y - base.y) <= self._radius)
        points = np.empty((len(near_y), len(near_x), 2))
        points[:, :, 0] = x[near_x]
        points[:, :, 1] = y[near_y, None]
        flat = base.inverse().transform_points(points.reshape(-1, 2))
        under = polygon_contains(self._footprint, flat).reshape(points.shape[:2])
        row, col = np.nonzero(under)
        self._trail_s[near_y[row], near_x[col]] = now_s

    def _find_unseen(self, base: Pose2D, x: Floats, y: Floats, now_s: float) -> Unseen:
        fresh_s = now_s - SIGHT.fresh_s
        unseen = (self._seen_s < fresh_s) & (self._trail_s < fresh_s)
        unseen &= self._echo_s < now_s - PARAMS.dark_s
        row, col = np.nonzero(unseen)
        is_near = np.hypot(x[col] - base.x, y[row] - base.y) <= self._reach
        row, col = row[is_near], col[is_near]
        may_creep = self._seen_s[row, col] >= now_s - SIGHT.memory_s
        may_creep |= self._trail_s[row, col] >= now_s - SIGHT.trail_s
        may_creep |= self._silent_s[row, col] >= now_s - PARAMS.dark_s
        echo_s = self._echo_s[row, col]
        was_echo = (echo_s >= now_s - SIGHT.memory_s) & (echo_s > self._seen_s[row, col])
        was_echo &= echo_s > self._trail_s[row, col]
        return Unseen(np.stack([x[col], y[row]], axis=1), may_creep, was_echo)


def _shift(grid: Floats, rows: int, cols: int) -> None:
    """Move a grid's window by cells; what comes in has never been seen."""
    height, width = grid.shape
    moved = np.full_like(grid, -np.inf)
    if abs(rows) < height and abs(cols) < width:
        to = slice(max(0, -rows), height - max(0, rows)), slice(max(0, -cols), width - max(0, cols))
        since = (
            slice(max(0, rows), height - max(0, -rows)),
            slice(max(0, cols), width - max(0, -cols)),
        )
        moved[to] = grid[since]
    grid[:] = moved
