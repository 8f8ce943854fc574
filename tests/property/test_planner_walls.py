"""People who walk beside a wall, in corridors of any direction."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from trolley_planner.people.walls import WALLS, walk_along_walls

EDGE_M = 0.05
CELLS = 120
MIDDLE_M = 0.5 * CELLS * EDGE_M


def corridor(yaw: float, half_m: float) -> np.ndarray:
    """How far the walls of a corridor through the middle are, up to its reach."""
    y, x = (np.indices((CELLS, CELLS)) + 0.5) * EDGE_M - MIDDLE_M
    beside = -math.sin(yaw) * x + math.cos(yaw) * y
    return np.clip(half_m - np.abs(beside), 0.0, 0.7).astype(np.float32)


@given(
    yaw=st.floats(-math.pi, math.pi),
    beside_m=st.floats(0.15, 0.35),
    ahead_mps=st.floats(0.3, 1.5),
    across_mps=st.floats(-0.4, 0.4),
    deviation_mps=st.floats(0.02, 0.3),
)
def test_who_walks_beside_a_wall_walks_along_it_unless_the_track_says_otherwise(
    yaw: float, beside_m: float, ahead_mps: float, across_mps: float, deviation_mps: float
) -> None:
    ahead, left = (np.array([math.cos(a), math.sin(a)]) for a in (yaw, yaw + 0.5 * math.pi))
    place = MIDDLE_M + beside_m * left
    velocity = ahead_mps * ahead + across_mps * left
    walkers = np.array([[*place, *velocity, 0.25]])
    walk_along_walls(walkers, np.array([deviation_mps]), corridor(yaw, 0.6), EDGE_M)
    most = min(
        WALLS.deviations * deviation_mps, WALLS.most_share * math.hypot(ahead_mps, across_mps)
    )
    off = abs(across_mps) - most
    if off < -0.05:
        # The wall's direction is read from cells.
        assert abs(walkers[0, 2:4] @ left) < 0.1 * ahead_mps
        assert abs(walkers[0, 2:4] @ ahead - ahead_mps) < 0.1 * ahead_mps
    elif off > 0.05 + 0.1 * ahead_mps:
        assert walkers[0, 2:4].tolist() == velocity.tolist()
    assert walkers[0, :2].tolist() == place.tolist()


def test_in_the_open_in_the_middle_and_at_the_edge_of_the_map_a_velocity_is_believed() -> None:
    velocity = [0.8, 0.02]
    open_floor = np.full((CELLS, CELLS), 0.7, np.float32)
    for place, walls in (
        ((MIDDLE_M, MIDDLE_M), open_floor),
        ((MIDDLE_M, MIDDLE_M), corridor(0.0, 0.6)),
        ((0.01, MIDDLE_M), corridor(0.0, 0.6)),
        ((-1.0, 2.0 * MIDDLE_M + 1.0), open_floor),
    ):
        walkers = np.array([[*place, *velocity, 0.25]])
        walk_along_walls(walkers, np.array([0.1]), walls, EDGE_M)
        assert walkers[0, 2:4].tolist() == velocity
