"""Where the beams of a scan passed, and the echoes that are not of the map."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley_planner.sensing.beams import CLEAR, DX, DY, ECHO, X, Y


class FreeSpaceParams(NamedTuple):
    """What counts as free, and as an echo; found by hand in simulated drives among people."""

    sight_m: float = 6.0
    """Distance from the lidar within which echoes are tracked."""
    wall_m: float = 0.12
    """Distance from a wall of the map within which echoes are not tracked."""
    past_m: float = 0.15
    """Distance that a beam must go on behind a place to show that it is free."""
    beside_rad: float = 0.025
    """Angle to either side within which the neighbouring beams must show so, too: edges of objects
    jump from scan to scan."""
    before_m: float = 0.15
    """What is nearer than an echo by this hides what is beside the echo."""
    beside_beams: int = 2
    """Number of beams to either side that are looked at for that."""
    far_m: float = 5.7
    """Farther away what is beside an echo may be out of sight."""


FREE_SPACE = FreeSpaceParams()
Floats = NDArray[np.float64]


class View(NamedTuple):
    """What is kept of a scan."""

    stamp_ns: int
    origin: Floats
    """(2,) middle place of the lidar [m]."""
    angles: Floats
    """(n,) of the beams, rising [rad]."""
    clear_m: Floats
    """(n,) how far all beams about each saw that it was free."""

    def age_s(self, now_ns: int) -> float:
        """Return how long ago the scan was made [s]."""
        return (now_ns - self.stamp_ns) * 1e-9


def was_free(view: View, points: Floats) -> NDArray[np.bool_]:
    """Say for points (n, 2) whether beams of an earlier scan passed there."""
    return were_passed(np.ascontiguousarray(points), view.origin, view.angles, view.clear_m)


class Views(NamedTuple):
    """What is kept of some scans, one after the other."""

    origins: Floats
    """(n, 2) middle place of the lidar in each [m]."""
    ends: NDArray[np.int64]
    """(n,) where the beams of each end."""
    angles: Floats
    """(k,) of all beams, rising in each [rad]."""
    clear_m: Floats
    """(k,) how far all beams about each saw that it was free."""


def views_of(views: Sequence[View]) -> Views:
    """Return scans as arrays; at least one."""
    return Views(
        np.array([view.origin for view in views]),
        np.array([len(view.angles) for view in views]).cumsum(),
        np.concatenate([view.angles for view in views]),
        np.concatenate([view.clear_m for view in views]),
    )


@kernel
def was_free_in_any(views: Views, points: Floats, least: float) -> bool:
    """Say whether beams of any one of some scans passed so many of some points (n, 2)."""
    first = 0
    for index in range(views.ends.shape[0]):
        beams = slice(first, views.ends[index])
        first = views.ends[index]
        angles, clear_m = views.angles[beams], views.clear_m[beams]
        if np.sum(were_passed(points, views.origins[index], angles, clear_m)) >= least:
            return True
    return False


@kernel
def take_apart(
    beams: Floats, wall_distance_m: NDArray[np.float32], edge_m: float
) -> tuple[Floats, Floats, Floats, NDArray[np.bool_]]:
    """Return the angles of beams, how far all about each are free, and echoes not on the map.

    Args:
        beams: (n, 6) columns: sensing.beams.
        wall_distance_m: (rows, cols) distance of each cell to the nearest wall of the map.
        edge_m: edge of these cells.

    Returns:
        (n,) rising [rad], (n,) [m], (k, 2) [m], and (k, 2) whether something hides what is to the
        right and to the left of each echo.
    """
    count, (rows, cols) = beams.shape[0], wall_distance_m.shape
    angles, clear_m, loose = np.empty(count), np.empty(count), np.empty((count, 2))
    beams_of, turns, num_loose = np.empty(count, np.int64), 0.0, 0
    for beam in range(count):
        angle = math.atan2(beams[beam, DY], beams[beam, DX])
        if beam > 0:
            step = angle + turns - angles[beam - 1]
            turns -= 2.0 * math.pi * math.floor((step + math.pi) / (2.0 * math.pi))
        angles[beam] = angle + turns
        echo = beams[beam, ECHO]
        if not 0.0 < echo < FREE_SPACE.sight_m:
            continue
        x, y = beams[beam, X] + echo * beams[beam, DX], beams[beam, Y] + echo * beams[beam, DY]
        row, col = math.floor(y / edge_m), math.floor(x / edge_m)
        inside = 0 <= row < rows and 0 <= col < cols
        if inside and wall_distance_m[row, col] > FREE_SPACE.wall_m:
            loose[num_loose, 0], loose[num_loose, 1] = x, y
            beams_of[num_loose] = beam
            num_loose += 1
    spread = max(angles[-1] - angles[0], 1e-3)
    width = max(1, round(FREE_SPACE.beside_rad * (count - 1) / spread))
    for beam in range(count):
        least = beams[beam, CLEAR]
        for near in range(max(beam - width, 0), min(beam + width + 1, count)):
            least = min(least, beams[near, CLEAR])
        clear_m[beam] = least
    is_round = spread * count / (count - 1) > 2.0 * math.pi - FREE_SPACE.beside_rad
    is_hidden = np.empty((num_loose, 2), np.bool_)
    for index in range(num_loose):
        for side in range(2):
            toward = 2 * side - 1
            is_hidden[index, side] = is_hidden_beside(beams, beams_of[index], toward, is_round)
    return angles, clear_m, loose[:num_loose].copy(), is_hidden


@kernel
def is_hidden_beside(beams: Floats, beam: int, toward: int, is_round: bool) -> bool:
    """Say whether something nearer is right beside an echo, or nothing is in sight there.

    Args:
        beams: (n, 6) columns: sensing.beams.
        beam: of the echo.
        toward: 1 for the beams after it, -1 for those before it.
        is_round: whether the last beam is beside the first.
    """
    count = beams.shape[0]
    if beams[beam, ECHO] > FREE_SPACE.far_m:
        return True
    for steps in range(1, FREE_SPACE.beside_beams + 1):
        near = beam + toward * steps
        if not 0 <= near < count:
            if not is_round:
                return True
            near %= count
        if 0.0 < beams[near, ECHO] < beams[beam, ECHO] - FREE_SPACE.before_m:
            return True
    return False


@kernel
def were_passed(
    points: Floats, origin: Floats, angles: Floats, clear_m: Floats
) -> NDArray[np.bool_]:
    """Say for points (n, 2) whether beams from a place passed there.

    Args:
        points: [m].
        origin: (2,) of the beams [m].
        angles: (m,) of the beams, rising [rad].
        clear_m: (m,) how far all beams about each are free.
    """
    passed, last = np.empty(points.shape[0], np.bool_), angles.shape[0] - 1
    for index in range(points.shape[0]):
        dx, dy = points[index, 0] - origin[0], points[index, 1] - origin[1]
        turned = (math.atan2(dy, dx) - angles[0]) % (2.0 * math.pi)
        # The first beam at this angle or beyond.
        low, after = 0, last + 1
        while low < after:
            middle = (low + after) // 2
            if angles[middle] - angles[0] < turned:
                low = middle + 1
            else:
                after = middle
        is_between = 0 < after <= last
        if not is_between and turned <= 2.0 * math.pi - FREE_SPACE.beside_rad:
            passed[index] = False
            continue
        free_m = min(clear_m[min(after, last)], clear_m[after - 1 if after > 0 else last])
        passed[index] = free_m > math.hypot(dx, dy) + FREE_SPACE.past_m
    return passed
