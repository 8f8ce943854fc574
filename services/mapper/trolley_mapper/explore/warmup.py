"""Compile what exploring uses, before the robot waits for it."""

import numpy as np

from trolley.geometry import Pose2D
from trolley.geometry.footprint import footprint_from_box
from trolley.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from trolley_mapper.explore.exploration_goal import Limits, Scene, survey
from trolley_mapper.explore.frontiers import Clearance, path_length_to

_CELLS = 80


def warm_up() -> None:
    """Survey a small room that is half known, with as much room as is wanted and with the least."""
    cells = np.full((_CELLS, _CELLS), FREE, np.int8)
    cells[:2] = cells[-2:] = OCCUPIED
    cells[:, _CELLS // 2 :] = UNKNOWN
    grid = GridMap("room", 0.05, Pose2D.identity(), cells)
    here, clearance = Pose2D(1.0, 2.0, 0.0), Clearance(footprint_from_box(0.4, 0.3), 0.2, 0.3, 0.15)
    scene, limits = Scene(grid, here, False, False, (), here), Limits(30.0, 500.0)
    survey(scene, clearance.squeezed, limits)
    found = survey(scene, clearance, limits)
    path_length_to(found.area, here, here, clearance)
