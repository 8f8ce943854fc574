"""Stands still while somebody who came to the robot touches it."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.geometry.polygon import distance_to_outline
from trolley_planner.costmap.footprint import Footprint
from trolley_planner.people.people_tracker import Mover
from trolley_planner.sensing.beams import DX, DY, ECHO, X, Y

TOUCH_M = 0.06
"""Nearer to the outline than this something counts as touching: the lidar's noise is part of it."""
CAME_M = 0.4
"""Who moved this near to the outline"""
LATELY_S = 1.0
"""within this time is taken to be who touches it now."""


class TouchWatch:
    """Tells who came to the robot from what the robot drove up to.

    Whoever walked into a robot goes round it when it stands, and walks into it again when it
    moves: it waits for them to go. It does not wait for what it touches by itself, nor for ever.

    Args:
        footprint: of the robot.
        patience_s: how long it stands for the same touch at most.
    """

    def __init__(self, footprint: Footprint, patience_s: float) -> None:
        self._footprint = footprint
        self._patience_ns = round(patience_s * 1e9)
        self._came_ns: int | None = None
        self._since_ns: int | None = None
        self._is_touched = False

    def note(
        self, now_ns: int, beams: NDArray[np.float64], movers: Sequence[Mover], pose: Pose2D
    ) -> None:
        """Take a new scan.

        Args:
            now_ns: robot time.
            beams: (n, 6) of the scan in `grid` (columns: kernels.beams).
            movers: who moves by it, in `grid`.
            pose: of the robot, in `grid`.
        """
        if any(self._is_within(CAME_M, mover.points, pose) for mover in movers):
            self._came_ns = now_ns
        seen = beams[beams[:, ECHO] > 0.0]
        points = seen[:, [X, Y]] + seen[:, ECHO, None] * seen[:, [DX, DY]]
        self._is_touched = self._is_within(TOUCH_M, points, pose)
        if not self._is_touched:
            self._since_ns = None
        elif self._since_ns is None and self._has_come(now_ns):
            self._since_ns = now_ns

    def must_stand(self, now_ns: int) -> bool:
        """Say whether the robot had better stand."""
        since_ns = self._since_ns
        return since_ns is not None and now_ns - since_ns < self._patience_ns

    def _has_come(self, now_ns: int) -> bool:
        return self._came_ns is not None and now_ns - self._came_ns < LATELY_S * 1e9

    def _is_within(self, reach_m: float, points: NDArray[np.float64], pose: Pose2D) -> bool:
        """Say whether one of some points (n, 2) in `grid` is so near to the outline."""
        around = self._footprint.circumscribed_m + reach_m
        near = points[np.hypot(points[:, 0] - pose.x, points[:, 1] - pose.y) < around]
        if len(near) == 0:
            return False
        local = pose.inverse().transform_points(near)
        return float(distance_to_outline(self._footprint.polygon, local).min()) < reach_m
