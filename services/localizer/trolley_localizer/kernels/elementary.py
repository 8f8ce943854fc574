"""Sine, cosine, exponential and the angle of a direction in plain arithmetic.

A loop with these becomes vector code. libm's functions take one number at a time: with them, sine
and cosine of each particle cost as much as the look-ups of its beams.
"""

import math

import numpy as np

from trolley.jit import kernel

_HALF_TURNS = 1.0 / math.pi
# Below this exponent the result is 0 (it would be 4e-18).
_LEAST_EXPONENT = -40.0


@kernel
def sin_cos(angle: float) -> tuple[float, float]:
    """Return sine and cosine of an angle [rad], with errors below 1e-11 up to 1000 rad.

    Whole half turns are subtracted; a Taylor series computes the rest, within a quarter turn.
    """
    half_turns = np.floor(angle * _HALF_TURNS + 0.5)
    rest = angle - half_turns * math.pi
    sign = 1.0 - 2.0 * (half_turns - 2.0 * np.floor(0.5 * half_turns))
    square = rest * rest
    sine = 1.0
    cosine = 1.0
    for n in (8, 7, 6, 5, 4, 3, 2, 1):
        sine = 1.0 - square * sine * (1.0 / (2 * n * (2 * n + 1)))
        cosine = 1.0 - square * cosine * (1.0 / ((2 * n - 1) * 2 * n))
    return sign * rest * sine, sign * cosine


@kernel
def exp_below_zero(exponent: float) -> float:
    """Return exp of a non-positive number, with a relative error below 1e-9; 0 below -40.

    A Taylor series computes exp of a 64th of the exponent; its result is squared six times.
    """
    part = max(exponent, _LEAST_EXPONENT) * (1.0 / 64.0)
    power = 1.0
    for n in (11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1):
        power = 1.0 + part * power * (1.0 / n)
    for _ in range(6):
        power *= power
    return power if exponent >= _LEAST_EXPONENT else 0.0


@kernel
def angle_of(x: float, y: float) -> float:
    """Return the angle of a direction [rad], as `math.atan2(y, x)`, with errors below 2e-8.

    The smaller share of the two is the tangent of an angle up to an eighth of a turn; from there
    half of it is taken, so that a short series does.
    """
    across = abs(x)
    up = abs(y)
    tangent = min(across, up) / max(across, up, 1e-300)
    # tan(a / 2) of an angle a up to 45 degrees, at most 0.4142.
    half = tangent / (1.0 + math.sqrt(1.0 + tangent * tangent))
    square = half * half
    series = 0.0
    for n in (17, 15, 13, 11, 9, 7, 5, 3, 1):
        series = 1.0 / n - square * series
    angle = 2.0 * half * series
    angle = 0.5 * math.pi - angle if up > across else angle
    angle = math.pi - angle if x < 0.0 else angle
    return -angle if y < 0.0 else angle
