"""Angles in radians, counter-clockwise, wrapped to (-pi, pi] by one rule."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

TWO_PI = 2.0 * math.pi


def wrap_angle(angle: float) -> float:
    """Return the same direction within (-pi, pi].

    An angle that is already in range comes back unchanged, bit for bit.

    Args:
        angle: finite [rad].

    Raises:
        ValueError: the angle is infinite (NaN comes back as NaN).
    """
    if -math.pi < angle <= math.pi:
        return angle
    wrapped = math.remainder(angle, TWO_PI)
    return math.pi if wrapped <= -math.pi else wrapped


def angle_difference(to_angle: float, from_angle: float) -> float:
    """Return the shortest turn [rad] that leads from one direction to another.

    Positive is counter-clockwise; opposite directions give +pi.
    """
    return wrap_angle(to_angle - from_angle)


def wrap_angles(angles: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Wrap an array of any shape [rad] to (-pi, pi]; NaN stays NaN.

    float32 input is wrapped in float64, since float32 pi is larger than pi.
    """
    wide = np.asarray(angles, dtype=np.float64)
    wrapped = wide - TWO_PI * np.ceil((wide - math.pi) / TWO_PI)
    wrapped = np.where(wrapped <= -math.pi, math.pi, np.minimum(wrapped, math.pi))
    return np.where((wide > -math.pi) & (wide <= math.pi), wide, wrapped)
