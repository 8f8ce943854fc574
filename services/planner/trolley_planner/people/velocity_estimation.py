"""Position and velocity of a tracked object, from its positions in the scans of the last second."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley_planner.people.segments import centre_of, size_of


class VelocityEstimationParams(NamedTuple):
    """How velocities are measured; found by comparing tracks in simulated crowds with the truth."""

    kept_s: float = 1.2
    """Time for which past positions are remembered."""
    least_s: float = 0.08
    """Time between scans below which they say nothing about motion."""
    noise_m: float = 0.03
    """Standard deviation of a position where as much of the object is seen as ever."""
    narrower: float = 0.5
    """Share of what a sight is narrower than the widest one by which its middle may lie beside that
    of the object: the rest is hidden, or one leg hides the other."""
    acceleration_mps2: float = 2.0
    """Standard deviation of the acceleration, constant from scan to scan: people turn."""
    speed_mps: float = 1.2
    """Standard deviation of the velocity of what was not seen before."""


TRACKS = VelocityEstimationParams()
Floats = NDArray[np.float64]
TIME, X, Y, SEEN_X, SEEN_Y, SIZE = range(6)
"""Columns of a track; see `Trail.track`."""
NO_TRACK = np.empty((0, 6))


@kernel
def longer_track(track: Floats, elapsed_s: float, place: Floats, points: Floats) -> Floats:
    """Return the recent part of a track (n, 6), with the present position as its last row.

    Args:
        track: see `Trail.track`.
        elapsed_s: since its last row.
        place: (2,) the middle [m].
        points: (k, 2) what is seen [m].
    """
    first, count = 0, track.shape[0]
    while first < count and track[first, TIME] - elapsed_s < -TRACKS.kept_s:
        first += 1
    longer = np.empty((count - first + 1, 6))
    longer[:-1] = track[first:]
    longer[:-1, TIME] -= elapsed_s
    last = longer[-1]
    last[TIME], last[X], last[Y] = 0.0, place[0], place[1]
    last[SEEN_X], last[SEEN_Y] = centre_of(points)
    last[SIZE] = size_of(points)
    return longer


@kernel
def track_on(
    track: Floats, elapsed_s: float, place: Floats, points: Floats
) -> tuple[Floats, float, float, float, float, float]:
    """Return a track with its present position, see `longer_track`, and the motion along it.

    Returns:
        (m, 6), then x, y [m], velocity and its standard deviation [m/s], which is infinite if the
        track is too short.
    """
    longer = longer_track(track, elapsed_s, place, points)
    if longer[0, TIME] > -TRACKS.least_s:
        return longer, place[0], place[1], 0.0, 0.0, math.inf
    x, y, vx, vy, std = filtered(longer)
    return longer, x, y, vx, vy, std


@kernel
def filtered(track: Floats) -> tuple[float, float, float, float, float]:
    """Return position, velocity and its deviation at the end of a track (n, 6) by a Kalman filter.

    A position counts the less, the narrower the sight: what was half hidden for a scan would seem
    to have jumped aside. The widest sight may be the last one, so the filter begins anew each time.

    Source:
        Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation (2001),
        section 6.3.2: velocity changed by an acceleration that is constant between two scans.
    """
    widest = 0.0
    for index in range(track.shape[0]):
        widest = max(widest, track[index, SIZE])
    x, y, vx, vy = track[0, X], track[0, Y], 0.0, 0.0
    # Both axes have the same covariance: of place, of both, of velocity.
    places, both, speeds = noise_of(track[0], widest), 0.0, TRACKS.speed_mps**2
    for index in range(1, track.shape[0]):
        dt = track[index, TIME] - track[index - 1, TIME]
        x, y = x + dt * vx, y + dt * vy
        changed = (TRACKS.acceleration_mps2 * dt) ** 2
        places += 2.0 * dt * both + dt * dt * (speeds + 0.25 * changed)
        both += dt * (speeds + 0.5 * changed)
        speeds += changed
        unsure = places + noise_of(track[index], widest)
        gain, speed_gain = places / unsure, both / unsure
        off_x, off_y = track[index, X] - x, track[index, Y] - y
        x, y = x + gain * off_x, y + gain * off_y
        vx, vy = vx + speed_gain * off_x, vy + speed_gain * off_y
        speeds -= speed_gain * both
        both *= 1.0 - gain
        places *= 1.0 - gain
    return x, y, vx, vy, math.sqrt(speeds)


@kernel
def noise_of(sight: Floats, widest_m: float) -> float:
    """Return the variance of the position in a row of a track [m^2]."""
    beside_m = TRACKS.narrower * (widest_m - sight[SIZE])
    return TRACKS.noise_m**2 + beside_m * beside_m
