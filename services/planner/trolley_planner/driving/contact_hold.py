"""Standing still while a person who came to the robot touches it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.geometry.polygon import distance_to_outline
from trolley_planner.costmap.footprint import Footprint
from trolley_planner.people.tracker import TrackedPerson
from trolley_planner.sensing.beams import DX, DY, ECHO, X, Y


@dataclass(frozen=True, slots=True)
class ContactParams:
    """When the robot stands still because somebody touches it; by hand."""

    touch_m: float = 0.06
    """Distance from the outline below which an obstacle counts as touching; it includes the lidar's
    noise."""
    came_m: float = 0.4
    """Distance from the outline within which a moving person is remembered as close."""
    lately_s: float = 1.0
    """Time after which a person who came close is no longer taken for what touches the robot."""
    same_m: float = 0.3
    """Distance from where the person was within which an echo is theirs rather than a wall's."""


CONTACT = ContactParams()


class ContactHold:
    """Tells people who came to the robot from what the robot drove up to.

    People who walked into a robot step around it when it stands, and walk into it again when it
    moves: so it waits for them to leave. It does not wait for what it drove up to, nor forever.

    Args:
        footprint: of the robot.
        patience_s: how long it stands for the same touch at most.
    """

    def __init__(self, footprint: Footprint, patience_s: float) -> None:
        self._footprint = footprint
        self._patience_ns = round(patience_s * 1e9)
        self._came_ns: int | None = None
        self._came = np.empty((0, 2))
        self._since_ns: int | None = None
        self._is_touched = False

    def update(
        self, now_ns: int, beams: NDArray[np.float64], people: Sequence[TrackedPerson], pose: Pose2D
    ) -> None:
        """Take in a new scan.

        Args:
            now_ns: robot time.
            beams: (n, 6) of the scan in `grid` (columns: sensing.beams).
            people: who moves according to it, in `grid`.
            pose: of the robot, in `grid`.
        """
        came = [one.points for one in people if self._is_within(CONTACT.came_m, one.points, pose)]
        if came:
            self._came_ns, self._came = now_ns, np.concatenate(came)
        self._is_touched = False
        if len(self._came) > 0:
            seen = beams[beams[:, ECHO] > 0.0]
            points = seen[:, [X, Y]] + seen[:, ECHO, None] * seen[:, [DX, DY]]
            self._is_touched = self._is_within(CONTACT.touch_m, self._of_who_came(points), pose)
        if not self._is_touched:
            self._since_ns = None
        elif self._since_ns is None and self._has_come(now_ns):
            self._since_ns = now_ns

    def must_stand(self, now_ns: int) -> bool:
        """Say whether the robot should stand still."""
        since_ns = self._since_ns
        return since_ns is not None and now_ns - since_ns < self._patience_ns

    def _of_who_came(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return those of some points (n, 2) in `grid` where somebody came to the robot."""
        first, last = self._came.min(axis=0), self._came.max(axis=0)
        near = points >= first - CONTACT.same_m
        return points[(near & (points <= last + CONTACT.same_m)).all(axis=1)]

    def _has_come(self, now_ns: int) -> bool:
        return self._came_ns is not None and now_ns - self._came_ns < CONTACT.lately_s * 1e9

    def _is_within(self, reach_m: float, points: NDArray[np.float64], pose: Pose2D) -> bool:
        """Say whether one of some points (n, 2) in `grid` is so near to the outline."""
        around = self._footprint.circumscribed_m + reach_m
        near = points[np.hypot(points[:, 0] - pose.x, points[:, 1] - pose.y) < around]
        if len(near) == 0:
            return False
        local = pose.inverse().transform_points(near)
        return float(distance_to_outline(self._footprint.polygon, local).min()) < reach_m
