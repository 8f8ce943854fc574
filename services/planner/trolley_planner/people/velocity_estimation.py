"""Velocity of a tracked object, from its positions in the scans of the last second."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley_planner.people.sights import HIDDEN, NUM_COLUMNS, middle_of, width_seen


class VelocityEstimationParams(NamedTuple):
    """How velocities are measured; found by hand in simulated drives among people."""

    kept_s: float = 1.2
    """Time for which past positions are remembered."""
    least_s: float = 0.08
    """Time between scans below which they say nothing about motion."""
    track_s: float = 0.6
    """Time over which a velocity is measured, since legs swing."""
    straight: float = 1.2
    """Factor on the scatter up to which the velocity is measured over all of `kept_s`."""
    track_noise_m: float = 0.03
    """Least error of a position of the track, whatever its own scatter says."""


TRACKS = VelocityEstimationParams()
Floats = NDArray[np.float64]


@kernel
def longer_track(track: Floats, elapsed_s: float, sight: Floats) -> Floats:
    """Return the recent part of a track (n, 8), with the present sight as its last row.

    Args:
        track: see `Trail.track`.
        elapsed_s: since its last row.
        sight: (7,) what is seen now.
    """
    first, count = 0, track.shape[0]
    while first < count and track[first, 0] - elapsed_s < -TRACKS.kept_s:
        first += 1
    longer = np.empty((count - first + 1, 1 + NUM_COLUMNS))
    longer[:-1] = track[first:]
    longer[:-1, 0] -= elapsed_s
    longer[-1, 0], longer[-1, 1:] = 0.0, sight
    return longer


@kernel
def whole_width(track: Floats, before_m: float) -> float:
    """Return how wide an object is: as its track (n, 8) shows where nothing hid it, else before."""
    whole_m = most_m = 0.0
    for index in range(track.shape[0]):
        seen_m = width_seen(track[index, 1:])
        most_m = max(most_m, seen_m)
        if track[index, 1 + HIDDEN] == 0.0:
            whole_m = max(whole_m, seen_m)
    return max(whole_m if whole_m > 0.0 else before_m, most_m)


@kernel
def track_on(
    track: Floats, elapsed_s: float, sight: Floats, width_m: float
) -> tuple[Floats, float, tuple[float, float], tuple[float, float], float]:
    """Return a track with its present sight, see `longer_track`, and the motion along it.

    A straight line is fitted, over a longer time where the track was straight for that long; what
    the track strays from it says how sure its slope is.

    Args:
        track: see `Trail.track`.
        elapsed_s: since its last row.
        sight: (7,) what is seen now.
        width_m: how wide it was so far.

    Returns:
        (m, 8), width [m], middle [m], velocity and its standard deviation [m/s], infinite if the
        track is too short.
    """
    longer = longer_track(track, elapsed_s, sight)
    width_m = whole_width(longer, width_m)
    here = middle_of(sight, width_m)
    if longer[0, 0] > -TRACKS.least_s:
        return longer, width_m, here, (0.0, 0.0), math.inf
    places = np.empty((longer.shape[0], 3))
    for index in range(longer.shape[0]):
        places[index, 0] = longer[index, 0]
        places[index, 1], places[index, 2] = middle_of(longer[index, 1:], width_m)
    vx, vy, std = fit_motion(places)
    return longer, width_m, here, (vx, vy), std


@kernel
def fit_motion(track: Floats) -> tuple[float, float, float]:
    """Return the velocity along a track (n, 3) of two rows and more, and its deviation."""
    count, lately = track.shape[0], 0
    while lately < count and track[lately, 0] < -TRACKS.track_s:
        lately += 1
    if count - lately < 2:
        lately = 0  # It was out of sight: what was seen before tells, too.
    vx, vy, noise_m, squares = fit_line(track[lately:])
    if lately > 0:
        longer = fit_line(track)
        if longer[2] < TRACKS.straight * max(noise_m, TRACKS.track_noise_m):
            vx, vy, noise_m, squares = longer
    return vx, vy, max(noise_m, TRACKS.track_noise_m) / math.sqrt(squares)


@kernel
def fit_line(track: Floats) -> tuple[float, float, float, float]:
    """Return slope, scatter [m] and the sum of squared times [s^2] of a line through a track."""
    count = track.shape[0]
    t, x, y = 0.0, 0.0, 0.0
    for index in range(count):
        t, x, y = t + track[index, 0], x + track[index, 1], y + track[index, 2]
    t, x, y = t / count, x / count, y / count
    squares, vx, vy = 0.0, 0.0, 0.0
    for index in range(count):
        since = track[index, 0] - t
        squares += since * since
        vx, vy = vx + since * track[index, 1], vy + since * track[index, 2]
    vx, vy = vx / squares, vy / squares
    astray = 0.0
    for index in range(count):
        since = track[index, 0] - t
        dx, dy = track[index, 1] - x - since * vx, track[index, 2] - y - since * vy
        astray += dx * dx + dy * dy
    return vx, vy, math.sqrt(astray / (2.0 * count)), squares
