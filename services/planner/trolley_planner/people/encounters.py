"""When people come upon each other: until then they walk straight on, later nobody can tell."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel


class EncounterParams(NamedTuple):
    """When two people change course for each other; by hand."""

    near_m: float = 1.0
    """Distance between their middles at which they do."""
    one_m: float = 0.5
    """Distance below which two are one person, seen as two legs, or walk together."""
    together_mps: float = 0.5
    """Difference of their velocities below which they walk together, or one behind the other."""
    crowd: int = 3
    """Number of people from which on each of them comes upon another, though perhaps unseen."""
    crowd_s: float = 60.0
    """Time within which they do, at the latest [s]."""


ENCOUNTER = EncounterParams()


@kernel
def times_of_encounters(walkers: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return when each first comes near somebody else [s], infinite where nobody is in the way.

    In a crowd nobody walks on for ever: there it is never infinite.

    Args:
        walkers: (n, 4 or more) x, y [m], velocity [m/s].

    Source:
        Moussaid, Helbing, Theraulaz, How simple rules determine pedestrian behavior and crowd
        disasters (2011): people look for the time at which they would collide as they walk now.
    """
    count = walkers.shape[0]
    times, num_people = np.full(count, np.inf), 0
    for one in range(count):
        is_another = True
        for other in range(one):
            x, y = walkers[other, 0] - walkers[one, 0], walkers[other, 1] - walkers[one, 1]
            vx, vy = walkers[other, 2] - walkers[one, 2], walkers[other, 3] - walkers[one, 3]
            squared, closing = vx * vx + vy * vy, -(x * vx + y * vy)
            apart = x * x + y * y
            is_one = apart < ENCOUNTER.one_m**2
            is_another &= not is_one
            if is_one or squared < ENCOUNTER.together_mps**2 or closing <= 0.0:
                continue
            root = closing * closing - squared * (apart - ENCOUNTER.near_m**2)
            if root < 0.0:
                continue
            seconds = max((closing - math.sqrt(root)) / squared, 0.0)
            times[one], times[other] = min(times[one], seconds), min(times[other], seconds)
        num_people += is_another
    if num_people >= ENCOUNTER.crowd:
        for one in range(count):
            times[one] = min(times[one], ENCOUNTER.crowd_s)
    return times
