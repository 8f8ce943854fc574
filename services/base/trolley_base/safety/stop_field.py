"""The stop field: no command drives the footprint into what the lidar sees.

A command is scaled down to what can be braked before the first echo that the footprint would meet,
on any of the paths that the brakes may choose. What leads away from an echo, or past it, is left as
it is.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Twist2D, inscribed_radius
from trolley_base.safety.braking import PARAMS as BRAKING
from trolley_base.safety.braking import CommandsUnderWay, along, braking_steps
from trolley_base.safety.footprint_distance import FootprintDistance
from trolley_base.safety.motion_limits import MotionLimits
from trolley_base.safety.touching import closest_on_outline, point_velocities


@dataclass(frozen=True, slots=True)
class StopFieldParams:
    """What the stop field allows for; set by hand, and judged by bench/base/braking.py."""

    side_margin_m: float = 0.015
    """Distance by which the footprint is widened to all sides, for errors of lidar and wheels [m].
    """
    turning_margin_m: float = 0.007
    """Distance by which it is widened where the robot turns in place, which wheels do exactly: one
    that was stopped before a wall must be able to turn away from it [m]."""
    per_metre: float = 0.05
    """Share of the distance to each place by which it is widened, for slip and the odometry's
    errors."""
    body_depth_m: float = 0.02
    """An echo farther inside the outline is the robot's own body, a mast or a cable [m]."""
    grazing: float = 0.03
    """Motion along an echo that touches is allowed at so flat an angle (its sine) that the speed
    towards the echo stays below what counts as driving into something."""
    beside: float = 0.5
    """Where something is nearer than that, the outline is widened by this share of the gap: the
    robot must be able to drive out of a narrow place, slowly."""
    lag_s: float = 0.06
    """A period of base and the age of what the odometry says, which come on top of the delay of
    the wheels [s]."""
    parts: int = 8
    """Number of parts of a command that are judged at once, then as many between the last possible
    one and the next."""
    least: float = 0.02
    """Least part of a command that is driven; with less, none is."""


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
        self._distance = FootprintDistance(footprint, self._widest())
        self._radius = self._distance.radius
        self._spacing = BRAKING.of_radius * inscribed_radius(footprint)

    @property
    def reach(self) -> float:
        """How far from `base_link` an echo can matter at full speed, also a moment later [m]."""
        return self._radius + self._reach_of(self._limits.speed)

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
        near = self._near(twist, points)
        if len(near) == 0:
            return 1.0
        gaps = self._gaps(near)
        inside = gaps < 0.0
        if inside.any() and self._leads_on(near[inside], twist):
            return 0.0
        near = near[~inside]
        if len(near) == 0:
            return 1.0
        turns = twist.speed == 0.0 and self._under_way.speed == 0.0
        side = min(PARAMS.turning_margin_m if turns else PARAMS.side_margin_m, self._margin)
        side = min(side, PARAMS.beside * float(np.min(gaps[~inside])))
        before, slowest = self._under_way.paths(self._spacing)
        if self._hits(before, near, side).any():
            return 0.0
        wanted = np.array([[twist.vx, twist.vy, twist.wz]])
        blocked = self._hits(self._stopping(wanted, before[:, -1], slowest, side), near, side)[0]
        if not blocked.any():
            return 1.0
        near = near[blocked]  # what does not block the whole blocks no part of it

        def num_free(parts: Floats) -> int:
            """Return how many parts are free before the first that is not."""
            poses = self._stopping(parts[:, None] * wanted, before[:, -1], slowest, side)
            hit = self._hits(poses, near, side).any(axis=1)
            return int(np.argmax(hit)) if hit.any() else len(parts)

        parts = np.append(PARAMS.least, np.linspace(0.0, 1.0, PARAMS.parts + 2)[1:])
        # The slower ones first: their ways are short.
        slower, faster = parts[: len(parts) // 2], parts[len(parts) // 2 : -1]
        first = num_free(slower)
        if first == 0:
            return 0.0
        if first == len(slower):
            first += num_free(faster)
        low, high = float(parts[first - 1]), float(parts[first])
        parts = np.linspace(low, high, PARAMS.parts + 2)[:-1]
        return float(parts[num_free(parts[1:])])

    def _box(self, twist: Twist2D) -> tuple[float, float, float]:
        """Return how far back, ahead and to the sides anything can matter while it stops [m].

        Without sideways motion a way of some length that turns by some angle at most leads to the
        side by no more than the length times that angle's sine. Most ways lead past most walls.
        """
        least, greatest = self._under_way.range_with(twist)
        slow, fast = float(least[0]), float(greatest[0])
        sideways = max(-float(least[1]), float(greatest[1]))
        turning = max(-float(least[2]), float(greatest[2]))
        speed = math.hypot(max(-slow, fast), sideways)
        way = self._way_of(speed) + self._margin
        seconds = self._reaction_s + BRAKING.period_s
        turn = turning * seconds + 0.5 * turning * turning / self._limits.angular_acceleration
        pace = max(twist.speed, abs(twist.wz) * self._radius)
        turn += self._margin * abs(twist.wz) / pace if pace > 0.0 else 0.0
        # A gap counts for the width as long as its share is less than the whole.
        around = self._radius + PARAMS.side_margin_m / PARAMS.beside + PARAMS.per_metre * way
        is_straight = sideways == 0.0 and turn < 0.5 * math.pi
        back = way if slow < 0.0 or not is_straight else 0.0
        ahead = way if fast > 0.0 or not is_straight else 0.0
        side = way * math.sin(turn) if is_straight else way
        return around + back, around + ahead, around + side

    def _near(self, twist: Twist2D, points: Floats) -> Floats:
        """Return those of the points (n, 2) that can matter."""
        speed = max(twist.speed, self._under_way.speed)
        near = points[np.hypot(points[:, 0], points[:, 1]) < self._reach_of(speed)]
        if len(near) == 0:
            return near
        back, ahead, side = self._box(twist)
        x, y = near[:, 0], near[:, 1]
        return near[(x > -back) & (x < ahead) & (np.abs(y) < side)]

    def _reach_of(self, speed: float) -> float:
        """Return how far from `base_link` an echo can be met while the robot stops [m]."""
        way = (1.0 + PARAMS.per_metre) * self._way_of(speed)
        return self._radius + way + self._margin + PARAMS.side_margin_m

    def _widest(self) -> float:
        """Return the most that the footprint is ever widened by [m]."""
        return PARAMS.side_margin_m + PARAMS.per_metre * self._way_of(self._limits.speed)

    def _way_of(self, speed: float) -> float:
        """Return how far the robot comes before it stands [m]."""
        braking = 0.5 * speed * speed / self._limits.downhill_deceleration
        return speed * (self._reaction_s + BRAKING.period_s) + braking

    def _gaps(self, points: Floats) -> Floats:
        """Return how far points (n, 2) are from the footprint where it stands [m], some at least.

        Those farther than it is ever widened by are as far as that.
        """
        gaps = np.full(len(points), self._widest())
        near = np.flatnonzero(np.hypot(points[:, 0], points[:, 1]) < self._radius + gaps[:1])
        gaps[near] = np.minimum(gaps[near], self._distance.at(points[near, 0], points[near, 1]))
        return gaps

    def _stopping(
        self, velocities: Floats, starts: Floats, slowest: NDArray[np.bool_], side: float
    ) -> Floats:
        """Return the poses (n, m, 4) on all ways to standing.

        Args:
            velocities: (n, 3) what may be commanded.
            starts: (k, 4) where that begins to act.
            slowest: (k,) whether with the slowest brakes.
            side: by how much the footprint is widened [m].
        """
        count = len(velocities)
        slow = self._under_way.at_slowest(velocities, BRAKING.period_s)
        begin = np.concatenate([slow if one else velocities for one in slowest])
        steps = braking_steps(begin, self._limits, self._spacing)
        paths = steps.shape[1]
        starts = np.repeat(starts, count * paths, axis=0)
        poses = along(starts, steps.reshape(len(starts), -1, 3))
        poses = poses.reshape(-1, count, paths, poses.shape[1], 4)
        # On the arc itself the robot stops short by the margin.
        ahead = self._margin - side
        speeds = np.hypot(velocities[:, 0], velocities[:, 1])
        pace = (
            np.maximum(speeds, np.abs(velocities[:, 2]) * self._radius) + np.finfo(np.float64).eps
        )
        number = 1 + int(ahead / self._spacing)
        further = velocities * (ahead / number / pace)[:, None]
        nominal = int(np.argmin(slowest))  # prompt brakes, where those differ
        short = along(poses[nominal, :, 0, -1], np.repeat(further[:, None], number, axis=1))
        short[..., 3] = poses[nominal, :, 0, -1:, 3]
        return np.concatenate([*poses.reshape(-1, count, paths * poses.shape[3], 4), short], axis=1)

    def _hits(self, poses: Floats, points: Floats, side: float) -> NDArray[np.bool_]:
        """Say which points (m,) the footprint meets at any pose of each set, (n, m).

        Args:
            poses: (n, k, 4) x, y, yaw, way.
            points: (m, 2) outside the footprint.
            side: by how much it is widened where it stands [m].
        """
        flat = poses.reshape(-1, 4)
        margins = side + PARAMS.per_metre * flat[:, 3]
        hits = np.zeros((len(poses), len(points)), dtype=np.bool_)
        reach = self._radius + float(margins.max())
        low, high = flat[:, :2].min(axis=0) - reach, flat[:, :2].max(axis=0) + reach
        possible = np.flatnonzero(np.all((points > low) & (points < high), axis=1))
        x, y = points[possible].T
        # Within a circle around each pose, as one product of matrices: 2 p t - p p > t t - r r.
        around = np.column_stack(
            [2.0 * flat[:, :2], np.full(len(flat), -1.0), (self._radius + margins) ** 2]
        )
        around[:, 3] -= np.sum(flat[:, :2] ** 2, axis=1)
        beyond = np.stack([x, y, x * x + y * y, np.ones(len(x))])
        near = np.flatnonzero(around @ beyond > 0.0)
        pose, point = np.divmod(near, max(1, len(possible)))
        dx, dy = x[point] - flat[pose, 0], y[point] - flat[pose, 1]
        cos, sin = np.cos(flat[:, 2])[pose], np.sin(flat[:, 2])[pose]
        met = self._distance.at(cos * dx + sin * dy, cos * dy - sin * dx) < margins[pose]
        hits[pose[met] // poses.shape[1], possible[point[met]]] = True
        return hits

    def _leads_on(self, points: Floats, twist: Twist2D) -> bool:
        """Say whether a motion presses on against echoes (n, 2) just inside of the outline."""
        gaps = closest_on_outline(points, self._footprint) - points
        depths = np.hypot(gaps[:, 0], gaps[:, 1])
        velocities = point_velocities(points, twist)
        speeds = np.hypot(velocities[:, 0], velocities[:, 1])
        deeper = -np.sum(gaps * velocities, axis=1) > PARAMS.grazing * speeds * depths
        return bool(np.any(deeper & (depths <= PARAMS.body_depth_m)))
