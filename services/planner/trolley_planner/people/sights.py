"""What one scan shows of an object, and where its middle lies, be it seen in part or whole."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel

Floats = NDArray[np.float64]
SEEN_X, SEEN_Y, AWAY_X, AWAY_Y, RIGHT, LEFT, HIDDEN = range(7)
"""Columns of a sight: the mean of its echoes [m], the direction there from the lidar, how far the
echoes reach to the right (negative) and left of their mean [m], and a sum of the next two."""
RIGHT_IS_HIDDEN, LEFT_IS_HIDDEN = 1, 2
NUM_COLUMNS = 7


class SightParams(NamedTuple):
    """How wide objects are and where their middle lies."""

    depth: float = 0.4
    """The lidar sees one side of a body or a leg: the middle lies this share of its width behind
    the middle of what is seen (pi / 8 for a round one)."""
    width_m: float = 0.4
    """Width of who has never been seen whole: a person's [m]."""
    sliver: float = 0.3
    """Share of the width below which what is seen in part does not show how it moves: it comes and
    goes with what hides it, and with the edge of a lidar's view."""


SIGHTS = SightParams()


@kernel
def width_seen(sight: Floats) -> float:
    """Return how wide the part is that is seen [m]."""
    return sight[LEFT] - sight[RIGHT]


@kernel
def is_sliver(sight: Floats, width_m: float) -> bool:
    """Say whether hardly anything is seen of an object that is so wide."""
    return sight[HIDDEN] > 0 and width_seen(sight) < SIGHTS.sliver * width_m


@kernel
def middle_of(sight: Floats, width_m: float) -> tuple[float, float]:
    """Return the middle of an object that is so wide [m].

    Of one that is seen in part the middle lies half of its width from the side that is not hidden,
    and behind the echoes as that of a round one does.

    Args:
        sight: (7,) columns as above.
        width_m: of the whole object.
    """
    seen_m, radius_m = width_seen(sight), 0.5 * width_m
    left_m, behind_m = 0.0, SIGHTS.depth * seen_m
    if sight[HIDDEN] > 0 and seen_m < width_m:
        if sight[HIDDEN] == RIGHT_IS_HIDDEN:
            left_m = sight[LEFT] - radius_m
        elif sight[HIDDEN] == LEFT_IS_HIDDEN:
            left_m = sight[RIGHT] + radius_m
        else:
            left_m = 0.5 * (sight[LEFT] + sight[RIGHT])
        first_m = max(sight[RIGHT] - left_m, -radius_m)
        last_m = min(sight[LEFT] - left_m, radius_m)
        area = _under_circle(last_m, radius_m) - _under_circle(first_m, radius_m)
        behind_m = math.sqrt(max(radius_m**2 - last_m**2, 0.0))  # of a single echo
        if last_m - first_m > 1e-6:
            behind_m = area / (last_m - first_m)
    x = sight[SEEN_X] + behind_m * sight[AWAY_X] - left_m * sight[AWAY_Y]
    y = sight[SEEN_Y] + behind_m * sight[AWAY_Y] + left_m * sight[AWAY_X]
    return x, y


@kernel
def _under_circle(x: float, radius: float) -> float:
    """Return the area under a half circle around 0 from there to `x`."""
    height = math.sqrt(max(radius * radius - x * x, 0.0))
    return 0.5 * (x * height + radius * radius * math.asin(min(max(x / radius, -1.0), 1.0)))
