"""Where the robot can drive from where it is, by what is seen."""

import math

import numpy as np

from trolley.geometry import Pose2D
from trolley_planner.costmap.connected_components import cells_around, components_of
from trolley_planner.costmap.costmap import Costmap
from trolley_planner.costmap.inflation import LETHAL

ENCLOSED_M2 = 0.3
"""A part of the floor that no way leads to and that is smaller is the inside of something, and no
room behind a door [m^2]."""
UNKNOWN_PART, NOWHERE = -1, -2
"""Part of a place that is too far away, and of a robot around which nothing is free."""


class FloorAround:
    """The floor around the robot by what is seen, in parts between which no way leads.

    Args:
        costmap: with its weights up to date.
        pose_grid: of the robot.
        reach_m: from there along both axes.
    """

    def __init__(self, costmap: Costmap, pose_grid: Pose2D, reach_m: float) -> None:
        self._edge_m = costmap.resolution_m
        part = cells_around(costmap.shape, self._edge_m, pose_grid, reach_m)
        self._first = part[0].start, part[1].start
        self._labels = components_of(costmap.weights[part] != LETHAL)
        self._own = NOWHERE
        # Where the robot stands it may be nearer to something than it would come by itself.
        rows, cols = np.nonzero(self._labels)
        if len(rows) > 0:
            row, col = self._cell_of(pose_grid)
            nearest = int(np.argmin(np.hypot(rows - row, cols - col)))
            self._own = int(self._labels[rows[nearest], cols[nearest]])

    def leads_to(self, place: Pose2D) -> bool:
        """Say whether the robot can drive to a place in `grid`."""
        return self._label_of(place) == self._own

    def encloses(self, place: Pose2D) -> bool:
        """Say whether it cannot since something stands there, or closely around it."""
        label = self._label_of(place)
        if label in (self._own, UNKNOWN_PART):
            return False
        if label == 0:
            return True
        return int(np.count_nonzero(self._labels == label)) * self._edge_m**2 < ENCLOSED_M2

    def _cell_of(self, place: Pose2D) -> tuple[int, int]:
        row, col = (math.floor(at / self._edge_m) for at in (place.y, place.x))
        return row - self._first[0], col - self._first[1]

    def _label_of(self, place: Pose2D) -> int:
        """Return the part of the floor of a place: 0 where something stands."""
        (row, col), (rows, cols) = self._cell_of(place), self._labels.shape
        is_inside = 0 <= row < rows and 0 <= col < cols
        return int(self._labels[row, col]) if is_inside else UNKNOWN_PART
