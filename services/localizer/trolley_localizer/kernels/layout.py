"""Bundles of arrays that the kernels share."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Points(NamedTuple):
    """Beam end points in `base_link` at the scan's stamp, in cells.

    Attributes:
        x: (n,) float32, forward.
        y: (n,) float32, to the left.
    """

    x: NDArray[np.float32]
    y: NDArray[np.float32]


class Cloud(NamedTuple):
    """Particles in frame `grid`.

    Attributes:
        x: (n,) float32, columns [cells].
        y: (n,) float32, rows [cells].
        yaw: (n,) float32 [rad], not wrapped.
    """

    x: NDArray[np.float32]
    y: NDArray[np.float32]
    yaw: NDArray[np.float32]


class Lines(NamedTuple):
    """Straight segments in frame `grid`, in cells.

    Attributes:
        ax: (n,) float64, x of one end; `ay`, `bx`, `by` alike.
    """

    ax: NDArray[np.float64]
    ay: NDArray[np.float64]
    bx: NDArray[np.float64]
    by: NDArray[np.float64]
