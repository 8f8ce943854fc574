"""Look-ups of the distance to obstacles, for many places at once.

One look-up takes some seventy instructions. All but the reading itself can be done for several
places by one instruction, if it is left to the compiler in loops that do nothing else: so each
step of `interpolate` is a loop here, and the whole takes less than half the time.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel


class LookUps(NamedTuple):
    """Scratch for look-ups at up to n places."""

    x: NDArray[np.float64]
    """(n,) the places, from the centre of the first column [cells]."""
    y: NDArray[np.float64]
    """(n,) from the centre of the first row [cells]."""
    cols: NDArray[np.int32]
    """(n,) the cell to the left and below of each."""
    rows: NDArray[np.int32]
    west: NDArray[np.float32]
    """(n,) value of that cell, and of the three others around the place."""
    east: NDArray[np.float32]
    north_west: NDArray[np.float32]
    north_east: NDArray[np.float32]


@kernel
def make_look_ups(count: int) -> LookUps:
    """Return scratch for this many places."""
    return LookUps(
        np.empty(count, np.float64),
        np.empty(count, np.float64),
        np.empty(count, np.int32),
        np.empty(count, np.int32),
        np.empty(count, np.float32),
        np.empty(count, np.float32),
        np.empty(count, np.float32),
        np.empty(count, np.float32),
    )


@kernel
def look_up(look_ups: LookUps, values: NDArray[np.float32], count: int) -> None:
    """Put what a grid holds at each place in the place of its `x`.

    Args:
        look_ups: changed.
        values: (rows, cols), at least two of each; as `interpolate` reads it.
        count: the first so many places.
    """
    x, y, cols, rows = look_ups.x, look_ups.y, look_ups.cols, look_ups.rows
    most_col, most_row = values.shape[1] - 1.001, values.shape[0] - 1.001
    for at in range(count):
        x[at] = min(max(x[at], 0.0), most_col)
        cols[at] = np.int32(x[at])
        x[at] -= cols[at]
    for at in range(count):
        y[at] = min(max(y[at], 0.0), most_row)
        rows[at] = np.int32(y[at])
        y[at] -= rows[at]
    west, east = look_ups.west, look_ups.east
    north_west, north_east = look_ups.north_west, look_ups.north_east
    one = np.uint64(1)
    for at in range(count):
        # Without a sign nobody has to ask whether an index counts from the end.
        row, col = np.uint64(rows[at]), np.uint64(cols[at])
        west[at], east[at] = values[row, col], values[row, col + one]
        north_west[at], north_east[at] = values[row + one, col], values[row + one, col + one]
    for at in range(count):
        east[at] -= west[at]
        north_east[at] -= north_west[at]
    for at in range(count):
        low = west[at] + x[at] * east[at]
        high = north_west[at] + x[at] * north_east[at]
        x[at] = low + y[at] * (high - low)
