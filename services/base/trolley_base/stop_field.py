"""The stop field: no command drives the footprint into what the lidar sees.

A command is scaled down, on its arc, to what can be braked before the first echo that the footprint
would meet. What leads away from an echo, or past it, is left as it is.
"""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Twist2D, circumscribed_radius, polygon_contains
from trolley_base.limits import MotionLimits
from trolley_base.sweep import closest_on_outline, contact_times, point_velocities, widened

# The footprint is taken wider by this to all sides, for what lidar and wheels measure wrongly [m].
SIDE_MARGIN_M = 0.01
# An echo farther inside of the outline than this is the robot's own body, a mast or a cable [m].
BODY_DEPTH_M = 0.02
# Time until a command acts: a period of base, the board's own, and the link to it [s].
REACTION_S = 0.06
# An echo at the outline: a motion is let pass if it leads away, or towards it at so flat an angle
# (sine) that the normal speed stays under what counts as driving into something.
GRAZING = 0.03

Floats = NDArray[np.float64]


class StopField:
    """Scales velocities by the echoes around a footprint.

    Args:
        footprint: (n, 2) corners [m] in `base_link`, counter-clockwise.
        limits: what the robot can brake with.
        margin: how far before an echo it stops, in the direction of motion [m].
    """

    def __init__(self, footprint: Floats, limits: MotionLimits, margin: float) -> None:
        side = min(SIDE_MARGIN_M, margin)
        self._footprint = footprint
        self._wide = widened(footprint, side)
        self._limits = limits
        self._ahead = margin - side
        self._radius = circumscribed_radius(self._wide)

    @property
    def reach(self) -> float:
        """How far from `base_link` an echo can matter at full speed [m]."""
        return self._reach_of(self._limits.speed)

    def scale(self, twist: Twist2D, points: Floats) -> float:
        """Return what part of a velocity, 0...1, may be driven.

        Args:
            twist: within the limits.
            points: (n, 2) echoes [m] in `base_link`.
        """
        if twist.is_zero or len(points) == 0:
            return 1.0
        distances = np.hypot(points[:, 0], points[:, 1])
        near = points[distances < self._reach_of(twist.speed)]
        if len(near) == 0:
            return 1.0
        inside = polygon_contains(self._wide, near)
        if inside.any() and self._is_blocked(near[inside], twist):
            return 0.0
        outside = near[~inside]
        times = contact_times(outside, self._wide, twist)
        met = np.isfinite(times)
        if not met.any():
            return 1.0
        speeds = np.hypot(*point_velocities(outside[met], twist).T)
        return self._braking_scale(twist, float(np.min(times[met] - self._ahead / speeds)))

    def _reach_of(self, speed: float) -> float:
        braking = 0.5 * speed * speed / self._limits.deceleration
        # A turn carries corners on, at most by their own circle; the rest is margin.
        return 2.0 * self._radius + braking + speed * REACTION_S + 2.0 * self._ahead

    def _is_blocked(self, points: Floats, twist: Twist2D) -> bool:
        """Say whether a motion leads on to one of the echoes (n, 2) that are at the outline."""
        gaps = points - closest_on_outline(points, self._footprint)
        depths = np.hypot(gaps[:, 0], gaps[:, 1])
        within = polygon_contains(self._footprint, points)
        outward = np.where(within, -1.0, 1.0)[:, None] * gaps
        velocities = point_velocities(points, twist)
        speeds = np.hypot(velocities[:, 0], velocities[:, 1])
        towards = -np.sum(outward * velocities, axis=1) > GRAZING * speeds * depths
        if np.any(towards & within & (depths <= BODY_DEPTH_M)):
            return True
        # Corners of an outline that is nearly round come nearer in a turn and never touch.
        outside = towards & ~within
        ways = contact_times(points[outside], self._footprint, twist) * speeds[outside]
        return bool(np.any(ways <= self._ahead + SIDE_MARGIN_M))

    def _braking_scale(self, twist: Twist2D, seconds: float) -> float:
        """Return the part of a velocity that comes to a stand within what it covers in a time.

        Args:
            twist: the whole velocity.
            seconds: after how long it would be at the echo, less the margin.
        """
        if seconds <= 0.0:
            return 0.0
        # Driving part s and braking evenly: s reaction + s^2 stopping / 2 <= seconds.
        stopping = self._limits.stopping_time(twist)
        root = math.sqrt(REACTION_S * REACTION_S + 2.0 * stopping * seconds)
        return min(1.0, 2.0 * seconds / (root + REACTION_S))
