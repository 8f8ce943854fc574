"""The robot's outline as the planner uses it: radii for the path, points for exact checks."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry.footprint import (
    circumscribed_radius,
    footprint_from_polygon,
    inscribed_radius,
)
from trolley_planner.kernels.clearance import Body

EDGE_SPACING_M = 0.03
"""Distance of the points on the edge: an obstacle between two of them is seen 2 mm too far."""
FEW_SPACING_M = 0.12
"""The same for a first look: at 0.15 m an obstacle is seen 12 mm too far."""


@dataclass(frozen=True, slots=True, eq=False)
class Footprint:
    """The robot's outline in `base_link`.

    Attributes:
        polygon: (n, 2) corners, counter-clockwise [m].
        edge_points: (m, 2) points on the outline, at most `EDGE_SPACING_M` apart [m].
        few_points: (k, 2) the same, at most `FEW_SPACING_M` apart [m].
        inscribed_m: radius of the largest circle about the origin inside the outline.
        circumscribed_m: radius of the smallest circle about the origin around the outline.
    """

    polygon: NDArray[np.float64]
    edge_points: NDArray[np.float64]
    few_points: NDArray[np.float64]
    inscribed_m: float
    circumscribed_m: float

    @classmethod
    def from_polygon(cls, corners: Sequence[tuple[float, float]]) -> "Footprint":
        """Make a footprint of its corners [m], in either sense of rotation.

        Raises:
            ValueError: with a sentence for people, if it is no outline around `base_link`.
        """
        polygon = footprint_from_polygon(corners)
        return cls(
            polygon,
            _edge_points(polygon, EDGE_SPACING_M),
            _edge_points(polygon, FEW_SPACING_M),
            inscribed_radius(polygon),
            circumscribed_radius(polygon),
        )

    @property
    def body(self) -> Body:
        """The same as the kernels take it."""
        return Body(self.edge_points, self.few_points, self.inscribed_m, self.circumscribed_m)


def _edge_points(polygon: NDArray[np.float64], spacing_m: float) -> NDArray[np.float64]:
    """Return points along all edges, corners included."""
    parts: list[NDArray[np.float64]] = []
    for start, end in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        count = max(1, math.ceil(float(np.hypot(*(end - start))) / spacing_m))
        parts.append(start + (np.arange(count)[:, None] / count) * (end - start))
    return np.concatenate(parts)
