import numpy as np
import pytest

from trolley.geometry import (
    distance_to_outline,
    footprint_from_box,
    footprint_from_radius,
    polygon_contains,
)
from trolley_base.safety.footprint_distance import FootprintDistance

ARROW = np.array([[0.3, 0.0], [-0.2, 0.2], [-0.1, 0.0], [-0.2, -0.2]])


@pytest.mark.parametrize(
    "outline", [footprint_from_box(0.4, 0.2), footprint_from_radius(0.2), ARROW]
)
def test_the_table_says_what_the_outline_says(outline: np.ndarray) -> None:
    table = FootprintDistance(outline, 0.2)
    rng = np.random.default_rng(0)
    angle, radius = rng.uniform(-3.1, 3.1, 2000), rng.uniform(0.0, table.radius + 0.2, 2000)
    points = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    exact = distance_to_outline(outline, points)
    exact[polygon_contains(outline, points)] *= -1.0
    assert table.at(points[:, 0], points[:, 1]) == pytest.approx(exact, abs=0.0015)
