"""Exploring before a mirror that nobody marked, with all services in lock-step."""

from pathlib import Path

import numpy as np
from bench.mapper.exploring import explore

from trolley.geometry import Pose2D
from trolley.gridmap import FREE, OCCUPIED, GridMap, save_map


def test_the_robot_stays_away_from_a_mirror_in_which_it_sees_itself(tmp_path: Path) -> None:
    cells = np.full((44, 94), OCCUPIED, np.int8)
    cells[2:-2, 2:-2] = FREE
    cells[2:12, 30:44] = OCCUPIED
    save_map(GridMap("hall", 0.05, Pose2D.identity(), cells), tmp_path / "hall.yaml")
    world = tmp_path / "hall.toml"
    world.write_text(
        'map = "hall.yaml"\nstart = { x = 1.0, y = 1.1, yaw = 0.0 }\n'
        '[[mirror]]\nname = "end"\npoints = [[4.58, 0.12], [4.58, 2.08]]\nside = "left"\n'
    )
    outcome = explore(world, tmp_path / "hall.yaml", Pose2D(1.0, 1.1, 0.0), 1)
    assert outcome.state == "done"
    assert outcome.collisions == 0
