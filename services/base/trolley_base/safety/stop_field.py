"""The stop field: no command drives the footprint into what the lidar sees.

A command is scaled down, on its arc, to what can be braked before the first echo that the footprint
would meet. What leads away from an echo, or past it, is left as it is.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Twist2D, circumscribed_radius, polygon_contains
from trolley_base.safety.motion_limits import MotionLimits
from trolley_base.safety.sweep import closest_on_outline, contact_times, point_velocities, widened

REACTION_S = 0.06
"""Time until a command acts: a period of base, the board's own, and the link to it [s]."""


@dataclass(frozen=True, slots=True)
class StopFieldParams:
    """What the stop field allows for; set by hand."""

    side_margin_m: float = 0.015
    """The footprint is widened by this to all sides, for errors of lidar and wheels [m]."""
    turning_margin_m: float = 0.003
    """The same where the robot turns in place, which wheels do exactly: one that was stopped
    before a wall must be able to turn away from it [m]."""
    body_depth_m: float = 0.02
    """An echo farther inside the outline is the robot's own body, a mast or a cable [m]."""
    grazing: float = 0.03
    """Motion along an echo that touches is allowed at so flat an angle (its sine) that the speed
    towards the echo stays below what counts as driving into something."""
    beside: float = 0.9
    """Where something is nearer than the side margin, the outline is widened by this share of the
    gap."""


PARAMS = StopFieldParams()

Floats = NDArray[np.float64]


class StopField:
    """Scales velocities by the echoes around a footprint.

    Args:
        footprint: (n, 2) corners [m] in `base_link`, counter-clockwise.
        limits: what the robot can brake with.
        margin: how far before an echo it stops, in the direction of motion [m].
        reaction_s: time until a command acts.
    """

    def __init__(
        self,
        footprint: Floats,
        limits: MotionLimits,
        margin: float,
        reaction_s: float = REACTION_S,
    ) -> None:
        self._footprint = footprint
        self._limits = limits
        self._margin = margin
        self._reaction_s = reaction_s
        self._driving = _outline(footprint, min(PARAMS.side_margin_m, margin))
        self._turning = _outline(footprint, min(PARAMS.turning_margin_m, margin))
        self._radius = circumscribed_radius(self._driving[0])

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
        inside = polygon_contains(self._footprint, near)
        if inside.any() and self._leads_on(near[inside], twist):
            return 0.0
        near = near[~inside]
        outline, side = self._outline_for(near, twist)
        times = contact_times(near, outline, twist)
        met = np.isfinite(times)
        if not met.any():
            return 1.0
        velocities = point_velocities(near[met], twist)
        speeds = np.hypot(velocities[:, 0], velocities[:, 1])
        return self._braking_scale(
            twist, float(np.min(times[met] - (self._margin - side) / speeds))
        )

    def _reach_of(self, speed: float) -> float:
        braking = 0.5 * speed * speed / self._limits.deceleration
        # A turn carries corners on, at most by their own circle; the rest is margin.
        return 2.0 * self._radius + braking + speed * self._reaction_s + 2.0 * self._margin

    def _outline_for(self, points: Floats, twist: Twist2D) -> tuple[Floats, float]:
        """Return the outline that must stay clear of points (n, 2) outside, and its margin [m].

        It is not so wide that it holds what stands beside the robot already: the robot must be
        able to drive out of a narrow place.
        """
        wide, side = self._turning if twist.speed == 0.0 else self._driving
        beside = points[polygon_contains(wide, points)]
        if len(beside) == 0:
            return wide, side
        gaps = beside - closest_on_outline(beside, self._footprint)
        return _outline(
            self._footprint, PARAMS.beside * float(np.min(np.hypot(gaps[:, 0], gaps[:, 1])))
        )

    def _leads_on(self, points: Floats, twist: Twist2D) -> bool:
        """Say whether a motion presses on against echoes (n, 2) just inside of the outline."""
        gaps = closest_on_outline(points, self._footprint) - points
        depths = np.hypot(gaps[:, 0], gaps[:, 1])
        velocities = point_velocities(points, twist)
        speeds = np.hypot(velocities[:, 0], velocities[:, 1])
        deeper = -np.sum(gaps * velocities, axis=1) > PARAMS.grazing * speeds * depths
        return bool(np.any(deeper & (depths <= PARAMS.body_depth_m)))

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
        root = math.sqrt(self._reaction_s * self._reaction_s + 2.0 * stopping * seconds)
        return min(1.0, 2.0 * seconds / (root + self._reaction_s))


def _outline(footprint: Floats, side: float) -> tuple[Floats, float]:
    """Return a footprint widened by a margin, and the margin [m]."""
    return widened(footprint, side), side
