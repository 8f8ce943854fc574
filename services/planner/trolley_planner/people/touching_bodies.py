"""Bodies that touch, or pass before one another: told apart by where each must be."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel

Floats = NDArray[np.float64]


class TouchingParams(NamedTuple):
    """When a piece of a scan shows several bodies; by hand."""

    near_m: float = 0.15
    """Distance of a body's outline from a piece within which it may be part of it."""
    change_m: float = 0.2
    """By so much, in all, the echoes must lie nearer to the outlines for one more change from body
    to body."""
    least_points: int = 2
    """Number of echoes that each must show."""


TOUCHING = TouchingParams()


@kernel
def told_apart(
    ring: Floats, ends: NDArray[np.int64], bodies: Floats
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Cut the pieces that several round bodies share.

    Args:
        ring: (n, 2) points, piece after piece.
        ends: (m,) where each ends.
        bodies: (k, 3) x, y, radius [m] of those that are known, where they must be by now.

    Returns:
        (l,) where each piece ends, and whether it was cut there.
    """
    new_ends = np.empty(ring.shape[0], np.int64)
    is_cut = np.zeros(ring.shape[0], np.bool_)
    first, num = 0, 0
    for end in ends:
        whose = bodies_along(ring[first:end], bodies)
        begun = first
        for index in range(first + TOUCHING.least_points, end - TOUCHING.least_points + 1):
            has_changed = whose[index - first] != whose[index - first - 1]
            if has_changed and index - begun >= TOUCHING.least_points:
                new_ends[num], is_cut[num] = index, True
                begun, num = index, num + 1
        new_ends[num] = first = end
        num += 1
    return new_ends[:num].copy(), is_cut[:num].copy()


@kernel
def sides_cut(is_cut: NDArray[np.bool_], piece: int) -> tuple[bool, bool]:
    """Say whether a piece was cut off on its right and on its left; see `told_apart`."""
    return piece > 0 and is_cut[piece - 1], is_cut[piece]


@kernel
def bodies_along(points: Floats, bodies: Floats) -> NDArray[np.int64]:
    """Return on which of the bodies (k, 3) each of points (n, 2) lies, with few changes.

    Source:
        Viterbi, Error Bounds for Convolutional Codes and an Asymptotically Optimum Decoding
        Algorithm (1967).
    """
    count, num = points.shape[0], 0
    whose = np.zeros(count, np.int64)
    if bodies.shape[0] < 2:
        return whose
    off_m = np.empty((bodies.shape[0], count))
    for body in range(bodies.shape[0]):
        nearest = math.inf
        for index in range(count):
            dx, dy = points[index, 0] - bodies[body, 0], points[index, 1] - bodies[body, 1]
            off_m[num, index] = abs(math.hypot(dx, dy) - bodies[body, 2])
            nearest = min(nearest, off_m[num, index])
        num += 1 if nearest < TOUCHING.near_m else 0
    if num < 2:
        return whose
    total_m, before = off_m[:num, 0].copy(), np.empty((num, count), np.int64)
    for index in range(1, count):
        best = int(np.argmin(total_m))
        through = total_m[best] + TOUCHING.change_m
        for body in range(num):
            before[body, index] = body if total_m[body] <= through else best
            total_m[body] = min(total_m[body], through) + off_m[body, index]
    whose[-1] = np.argmin(total_m)
    for index in range(count - 1, 0, -1):
        whose[index - 1] = before[whose[index], index]
    return whose
