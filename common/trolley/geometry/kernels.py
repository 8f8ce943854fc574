"""Compiled algebra of poses."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel


@kernel
def solve_spd(a: NDArray[np.float64], b: NDArray[np.float64], out_x: NDArray[np.float64]) -> bool:
    """Solve a 3 x 3 symmetric positive definite system by Cholesky; False if it is not.

    Args:
        a: (3, 3).
        b: (3,).
        out_x: (3,), overwritten if it can be solved.
    """
    l00 = a[0, 0]
    if not l00 > 1e-12:
        return False
    l00 = math.sqrt(l00)
    l10 = a[1, 0] / l00
    l20 = a[2, 0] / l00
    l11 = a[1, 1] - l10 * l10
    if not l11 > 1e-12:
        return False
    l11 = math.sqrt(l11)
    l21 = (a[2, 1] - l20 * l10) / l11
    l22 = a[2, 2] - l20 * l20 - l21 * l21
    if not l22 > 1e-12:
        return False
    l22 = math.sqrt(l22)
    y0 = b[0] / l00
    y1 = (b[1] - l10 * y0) / l11
    y2 = (b[2] - l20 * y0 - l21 * y1) / l22
    out_x[2] = y2 / l22
    out_x[1] = (y1 - l21 * out_x[2]) / l11
    out_x[0] = (y0 - l10 * out_x[1] - l20 * out_x[2]) / l00
    return True
