"""Angles inside compiled loops (numba has no `math.remainder`)."""

import math

from trolley.jit import kernel


@kernel
def wrapped(angle: float) -> float:
    """Return the same direction within [-pi, pi)."""
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))
