"""The costmap layer of places that the robot found impassable."""

from dataclasses import dataclass

import numpy as np

from trolley_planner.costmap.static_layer import disc_mask


@dataclass(frozen=True, slots=True)
class ClosedParams:
    """How long a place stays closed; by hand."""

    closed_s: float = 60.0
    """A place where the robot did not get through is tried again after this time."""


CLOSED = ClosedParams()


class ClosedLayer:
    """Where the robot did not get through, though nothing is seen there.

    Args:
        shape: rows and columns.
        resolution_m: cell edge [m].
    """

    def __init__(self, shape: tuple[int, int], resolution_m: float) -> None:
        self._resolution_m = resolution_m
        self._until_ns: int | None = None
        self.mask = np.zeros(shape, dtype=np.uint8)
        """(rows, cols) 1 where it is closed."""

    def close(self, centre: tuple[float, float], radius_m: float, now_ns: int) -> None:
        """Close a circle [m] of `grid`; all that is closed stays so from now on for a while."""
        self.mask |= disc_mask(self.mask.shape, centre, radius_m, self._resolution_m)
        self._until_ns = now_ns + round(CLOSED.closed_s * 1e9)

    def is_over(self, now_ns: int) -> bool:
        """Say whether what is closed has been so for long enough."""
        return self._until_ns is not None and now_ns > self._until_ns

    def reopen(self) -> bool:
        """Reopen all closed places; True if there were any."""
        if self._until_ns is None:
            return False
        self._until_ns = None
        self.mask[:] = 0
        return True
