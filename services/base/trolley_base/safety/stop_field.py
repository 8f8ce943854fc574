"""The stop field: no command drives the footprint into what the lidar sees.

A command is scaled down to what can be braked before the first echo that the footprint would meet,
on any of the paths that the brakes may choose. What leads away from an echo, or past it, is left as
it is.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import (
    Twist2D,
    circumscribed_radius,
    distance_to_outline,
    inscribed_radius,
    polygon_contains,
)
from trolley_base.safety.braking import PARAMS as BRAKING
from trolley_base.safety.braking import CommandsUnderWay, along, braking_steps
from trolley_base.safety.motion_limits import MotionLimits
from trolley_base.safety.sweep import closest_on_outline, point_velocities


@dataclass(frozen=True, slots=True)
class StopFieldParams:
    """What the stop field allows for; set by hand, and judged by bench/base/braking.py."""

    side_margin_m: float = 0.015
    """The footprint is widened by this to all sides, for errors of lidar and wheels [m]."""
    turning_margin_m: float = 0.003
    """The same where the robot turns in place, which wheels do exactly: one that was stopped
    before a wall must be able to turn away from it [m]."""
    per_metre: float = 0.05
    """It is widened by this share of the way to each place, for slip and the odometry's errors."""
    body_depth_m: float = 0.02
    """An echo farther inside the outline is the robot's own body, a mast or a cable [m]."""
    grazing: float = 0.03
    """Motion along an echo that touches is allowed at so flat an angle (its sine) that the speed
    towards the echo stays below what counts as driving into something."""
    beside: float = 0.9
    """Where something is nearer than that, the outline is widened by this share of the gap: the
    robot must be able to drive out of a narrow place."""
    lag_s: float = 0.06
    """A period of base and the age of what the odometry says, which come on top of the delay of
    the wheels [s]."""
    scales: int = 8
    """So many parts of a command are judged at once ..."""
    rounds: int = 3
    """... and so often, between the last one that was possible and the next."""


PARAMS = StopFieldParams()

Floats = NDArray[np.float64]


class StopField:
    """Scales velocities by the echoes around a footprint.

    Args:
        footprint: (n, 2) corners [m] in `base_link`, counter-clockwise.
        limits: what the robot can brake with.
        margin: how far before an echo it stops, in the direction of motion [m].
        delay_s: longest time from a command until odometry shows that the wheels follow it.
    """

    def __init__(
        self, footprint: Floats, limits: MotionLimits, margin: float, delay_s: float = 0.0
    ) -> None:
        self._footprint = footprint
        self._limits = limits
        self._margin = margin
        self._reaction_s = delay_s + PARAMS.lag_s
        self._under_way = CommandsUnderWay(self._reaction_s, limits)
        self._radius = circumscribed_radius(footprint)
        self._spacing = BRAKING.of_radius * inscribed_radius(footprint)

    @property
    def reach(self) -> float:
        """How far from `base_link` an echo can matter at full speed [m]."""
        return self._reach_of(self._limits.speed)

    def follow(self, twist: Twist2D, seconds: float) -> None:
        """Take note of what is commanded now, after `seconds` of the command before."""
        self._under_way.add(twist, seconds)

    def scale(self, twist: Twist2D, points: Floats) -> float:
        """Return what part of a velocity, 0...1, may be driven.

        Args:
            twist: within the limits.
            points: (n, 2) echoes [m] in `base_link`.
        """
        if twist.is_zero or len(points) == 0:
            return 1.0
        distances = np.hypot(points[:, 0], points[:, 1])
        speed = max(twist.speed, float(np.hypot(*self._under_way.velocity[:2])))
        near = points[distances < self._reach_of(speed)]
        inside = polygon_contains(self._footprint, near)
        if inside.any() and self._leads_on(near[inside], twist):
            return 0.0
        near = near[~inside]
        if len(near) == 0:
            return 1.0
        cap = PARAMS.beside * float(np.min(distance_to_outline(self._footprint, near)))
        turns = twist.speed == 0.0 and not self._under_way.velocity[:2].any()
        side = min(PARAMS.turning_margin_m if turns else PARAMS.side_margin_m, self._margin)
        before = self._under_way.poses()
        if self._hits(before[None], near, side, cap).any():
            return 0.0
        low, high = 0.0, 1.0
        wanted = np.array([[twist.vx, twist.vy, twist.wz]])
        parts = np.ones(1)
        for _ in range(PARAMS.rounds + 1):
            hit = self._hits(
                self._stopping(parts[:, None] * wanted, before[-1:], side), near, side, cap
            )
            blocked = np.flatnonzero(hit.any(axis=1))
            if len(blocked) == 0:
                low = float(parts[-1])
            else:
                high = float(parts[blocked[0]])
                low = float(parts[blocked[0] - 1]) if blocked[0] > 0 else low
                # What blocks the whole blocks its parts; the rest is of no interest.
                near = near[hit.any(axis=0)] if len(parts) == 1 else near
            if high == 1.0 and low == 1.0:
                return 1.0
            parts = np.linspace(low, high, PARAMS.scales + 2)[1:-1]
        return low

    def _reach_of(self, speed: float) -> float:
        way = speed * self._reaction_s + 0.5 * speed * speed / self._limits.downhill_deceleration
        # A turn carries corners on, at most by their own circle; the rest is margin.
        return 2.0 * self._radius + (1.0 + PARAMS.per_metre) * way + 2.0 * self._margin

    def _stopping(self, velocities: Floats, start: Floats, side: float) -> Floats:
        """Return the poses (n, m, 4) on all ways to standing from velocities (n, 3)."""
        begin = self._under_way.following(velocities, BRAKING.period_s)
        steps = braking_steps(begin, self._limits, self._spacing)
        count, paths = steps.shape[:2]
        poses = along(start, steps.reshape(count * paths, -1, 3)).reshape(count, paths, -1, 4)
        # On the arc itself the robot stops short by the margin.
        ahead = self._margin - side
        speeds = np.hypot(velocities[:, 0], velocities[:, 1])
        pace = np.maximum(speeds, np.abs(velocities[:, 2]) * self._radius)
        number = 1 + int(ahead / self._spacing)
        further = velocities * (ahead / number / pace)[:, None]
        short = along(poses[:, 0, -1], np.repeat(further[:, None], number, axis=1))
        short[..., 3] = poses[:, 0, -1:, 3]
        return np.concatenate([poses.reshape(count, -1, 4), short], axis=1)

    def _hits(self, poses: Floats, points: Floats, side: float, cap: float) -> NDArray[np.bool_]:
        """Say which points (m,) the footprint meets at any pose of each set, (n, m).

        Args:
            poses: (n, k, 4) x, y, yaw, way.
            points: (m, 2) outside of the footprint.
            side: by how much it is widened where it stands [m].
            cap: and at most [m].
        """
        flat = poses.reshape(-1, 4)
        margins = np.minimum(side + PARAMS.per_metre * flat[:, 3], cap)
        dx = points[:, 0] - flat[:, 0, None]
        dy = points[:, 1] - flat[:, 1, None]
        near = dx * dx + dy * dy < ((self._radius + margins) ** 2)[:, None]
        hits = np.zeros((len(poses), len(points)), dtype=np.bool_)
        pose, point = np.nonzero(near)
        if len(pose) == 0:
            return hits
        dx, dy = dx[pose, point], dy[pose, point]
        cos, sin = np.cos(flat[pose, 2]), np.sin(flat[pose, 2])
        at = np.stack([cos * dx + sin * dy, cos * dy - sin * dx], axis=1)
        met = distance_to_outline(self._footprint, at) < margins[pose]
        met |= polygon_contains(self._footprint, at)
        hits[pose[met] // poses.shape[1], point[met]] = True
        return hits

    def _leads_on(self, points: Floats, twist: Twist2D) -> bool:
        """Say whether a motion presses on against echoes (n, 2) just inside of the outline."""
        gaps = closest_on_outline(points, self._footprint) - points
        depths = np.hypot(gaps[:, 0], gaps[:, 1])
        velocities = point_velocities(points, twist)
        speeds = np.hypot(velocities[:, 0], velocities[:, 1])
        deeper = -np.sum(gaps * velocities, axis=1) > PARAMS.grazing * speeds * depths
        return bool(np.any(deeper & (depths <= PARAMS.body_depth_m)))
