"""How far off a pose was that somebody showed, and how long the robot took to correct it."""

import math
from dataclasses import dataclass

from trolley import topics
from trolley.geometry import Pose2D
from trolley_viz.robots.view import View
from trolley_viz.words.sentences import Tell

PATIENCE_NS = 60_000_000_000
"""Whoever showed it the pose does not wait longer for the robot to be sure."""


@dataclass(frozen=True)
class Shown:
    """A pose that the robot was shown.

    Attributes:
        map_T_odom: where that puts its odometry.
        stamp_ns: of the estimate that took it [ns of the robot's time].
        at_ns: when [ns of the viewer's clock].
    """

    map_T_odom: Pose2D
    stamp_ns: int
    at_ns: int


class Correction:
    """Tells once how a pose that somebody showed was corrected."""

    def __init__(self, tell: Tell) -> None:
        self._tell = tell
        self._shown: Shown | None = None

    def begin(self, shown: Pose2D, stamp_ns: int, view: View) -> None:
        """Note that the robot took this pose; `stamp_ns` is that of its first estimate there."""
        odometry = view.streams.latest(topics.ODOM)
        if odometry is not None:
            self._shown = Shown(shown @ odometry.pose.inverse(), stamp_ns, view.now_ns)

    def update(self, view: View) -> None:
        """Tell what became of it, as soon as the robot is sure."""
        shown, estimate = self._shown, view.streams.latest(topics.POSE)
        odometry = view.streams.latest(topics.ODOM)
        if shown is None or estimate is None or odometry is None:
            return
        waited_ns = view.now_ns - shown.at_ns
        if waited_ns > PATIENCE_NS:
            self._shown = None
        elif estimate.state == "localized" and estimate.stamp_ns > shown.stamp_ns:
            self._shown = None
            if estimate.pose is not None:
                off = (shown.map_T_odom @ odometry.pose).inverse() @ estimate.pose
                took_s = (estimate.stamp_ns - shown.stamp_ns) * 1e-9
                far_cm = 100.0 * math.hypot(off.x, off.y)
                turned = abs(math.degrees(off.yaw))
                self._tell(
                    "It knows where it is",
                    f"It took {took_s:.1f} s. It is {far_cm:.0f} cm and {turned:.0f}° from where"
                    " you set it.",
                    "good",
                )
