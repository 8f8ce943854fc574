import numpy as np
import pytest

from trolley_planner.costmap.fine_grid import Box, open_walls
from trolley_planner.costmap.inflation import FREE, WALL


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_what_stands_in_a_wall_is_not_opened_by_a_beam_that_passes_it(
    order: tuple[int, int],
) -> None:
    # Such as a pole before a wall that is farther off than the map has it: one beam meets it, the
    # next passes through the same fine cell.
    kinds = np.full((20, 20), FREE, dtype=np.uint8)
    kinds[:, 10:] = WALL
    box = Box(0, 0, 4, 0.05)
    mask = np.repeat(np.repeat(kinds == WALL, 4, 0), 4, 1).astype(np.uint8)
    # From x = 0.2 to the wall at 0.5, cut there.
    beams = np.array([[0.2, y, 1.0, 0.0, 0.3, 0.0] for y in (0.506, 0.508)])
    echoes_m = np.array([0.33, 0.37])
    keepout = np.zeros_like(kinds)
    open_walls(mask, kinds, keepout, box, beams[list(order)], echoes_m[list(order)])
    assert np.flatnonzero(mask[40])[:4].tolist() == [42, 45, 46, 47]
