"""Bundles of arrays that the kernels share."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Cloud(NamedTuple):
    """Particles in frame `grid`.

    float32 would do for the poses, but not for deciding on which side of a cell's border a
    beam ends: of the 120 000 beams of 2000 particles two or three would count in the wrong cell.

    Attributes:
        x: (n,) float64, columns [cells].
        y: (n,) float64, rows [cells].
        yaw: (n,) float64 [rad], not wrapped.
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    yaw: NDArray[np.float64]


class Lines(NamedTuple):
    """Straight segments in frame `grid`, in cells.

    Attributes:
        ax: (n,) float64, x of one end; `ay`, `bx`, `by` alike.
    """

    ax: NDArray[np.float64]
    ay: NDArray[np.float64]
    bx: NDArray[np.float64]
    by: NDArray[np.float64]
