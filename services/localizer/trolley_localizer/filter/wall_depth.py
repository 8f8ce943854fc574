"""How deep in the walls of the map beams end.

A lidar measures the faces of walls; a map has the cells that they are in. On a map made from scans
beams end in those cells. On one that was drawn walls are solid: a face lies before the centre of
its first cell, and the cells behind that are wall as well, so that alignment moves the robot on
until its beams end in their middle. Who looks all round stays where it is, between opposite walls;
who looks ahead only was told to be 6 cm farther ahead where walls are 10 cm thick.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from trolley.scanning import Points
from trolley_localizer.kernels.matching import gather_depth, refine_pose
from trolley_localizer.matching.likelihood_field import LikelihoodField, hollow
from trolley_localizer.matching.map_matcher import FREE_INFORMATION


@dataclass(frozen=True, slots=True)
class WallDepthParams:
    """How the depth is learned, and what of it is made up for; by hand."""

    width_m: float = 0.1
    """Width of Welsch's function: what lies farther from a wall says nothing of its depth [m]."""
    steps: int = 4
    """Gauss-Newton steps to the pose at which the scan says what it does."""
    first_information: float = 5.0
    """Information that a depth of 0 begins with [1/cells^2]; a scan in a room brings 3 or 4."""
    kept: float = 0.99
    """Share of the information of earlier scans that is kept with each scan."""
    most_m: float = 0.1
    """Greatest depth [m]: walls are hardly thicker than twice that."""
    rounded_cells: float = 0.5
    """Depth that is no sign of solid walls yet, since a face lies anywhere in its cell [cells]."""
    solid_cells: float = 1.0
    """Depth from which on walls are certainly solid [cells]."""


PARAMS = WallDepthParams()


class WallDepth:
    """Learns the depth: where walls at both sides are too far away, that is not the pose's fault.

    Source:
        Triggs et al., Bundle Adjustment - A Modern Synthesis (2000), section 6.1: the pose is taken
        out of the normal equations of pose and depth by Schur's complement.
    """

    def __init__(self, field: LikelihoodField) -> None:
        self._field = field
        self._information = 0.0
        self._learned = 0.0

    @cached_property
    def walls(self) -> NDArray[np.float32]:
        """(rows + 2, cols + 2) distance to where beams may end [cells]; 0.3 s for 4000 x 4000."""
        return hollow(self._field)

    @property
    def cells(self) -> float:
        """By how much beams are to be longer, so that they end in the middle of walls [cells]."""
        rounded, solid = PARAMS.rounded_cells, PARAMS.solid_cells
        share = (self._learned - rounded) / (solid - rounded)
        return self._learned * min(max(share, 0.0), 1.0)

    def update(
        self, points: Points, laser: tuple[float, float], pose: NDArray[np.float64], gain: float
    ) -> None:
        """Learn from a scan.

        Args:
            points: (n,) end points in `base_link` [cells].
            laser: x, y of the laser in `base_link` [cells].
            pose: (3,) x, y [cells], yaw [rad] in `grid`, near the true one.
            gain: information of one beam [1/cells^2].
        """
        field, sigma = self.walls, PARAMS.width_m / self._field.resolution
        deeper, tuning = lengthened(points, laser, self._learned), np.array([sigma, gain])
        there, of_pose = pose.copy(), np.empty((3, 3))
        refine_pose(there, of_pose, field, deeper, pose, FREE_INFORMATION, tuning, PARAMS.steps)
        hessian, gradient = np.zeros((4, 4)), np.zeros(4)
        gather_depth(hessian, gradient, field, deeper, laser, there, tuning)
        shared = np.linalg.solve(
            hessian[:3, :3] + FREE_INFORMATION,
            np.column_stack([hessian[:3, 3], gradient[:3]]),
        )
        information = float(hessian[3, 3] - hessian[:3, 3] @ shared[:, 0])
        slope = float(gradient[3] - hessian[:3, 3] @ shared[:, 1])
        self._information = PARAMS.kept * self._information + information
        learned = self._learned - slope / (self._information + PARAMS.first_information)
        self._learned = min(max(learned, 0.0), PARAMS.most_m / self._field.resolution)


def lengthened(points: Points, laser: tuple[float, float], cells: float) -> Points:
    """Return end points of beams that are so much longer [cells]."""
    if cells == 0.0:
        return points
    along_x, along_y = points.x - laser[0], points.y - laser[1]
    longer = cells / np.maximum(np.hypot(along_x, along_y), 1.0)
    return Points(points.x + longer * along_x, points.y + longer * along_y)
