"""The sight distance: no command drives the footprint faster than what was seen lets it stop.

Floor that the lidar has not seen is treated as the stop field treats an echo, but more gently:
driven by hand, the robot creeps on into it; driven by a program, it stops in front of it. Where the
lidar saw the floor free, but not lately, a program creeps, too: somebody may have stepped there. So
it does where a lidar of short reach gets nothing back, as `[base.lidar] no_echo` says.
Corners and sides that swing out while the robot turns in place may creep, since turning is how a
lidar that looks ahead only comes to see the rest. Driven by a program, they move so slowly towards
where something stood that nothing is pushed, and while the robot also drives on, so they do towards
what was never seen.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Twist2D, circumscribed_radius, polygon_contains, radius_of_gyration
from trolley.sight import SIGHT
from trolley_base.safety.motion_limits import MotionLimits
from trolley_base.safety.observed_space import Unseen
from trolley_base.safety.sweep import contact_times
from trolley_base.safety.touching import closest_on_outline, point_velocities


@dataclass(frozen=True, slots=True)
class SightDistanceParams:
    """How fast the robot may drive into what was not seen; set by hand."""

    slack: float = 0.05
    """A velocity faster than a creep by this share is a creep, too."""
    margin_m: float = 0.05
    """A place that was not seen is met this much before its middle: it is a cell wide [m]."""
    soft: float = 0.01
    """Sides come no faster to where something stood, driven by a program, nor to what was never
    seen unless it turns in place: half of what counts as driving into something, as speeds are held
    by a half [m/s]."""
    soft_m: float = 0.08
    """Distance from the middle of such a place at which `soft` holds: it is a cell wide, and the
    cells around it are some centimetres off after half a minute [m]."""
    ahead_m: float = 0.01
    """What lies this much before the footprint's foremost point, as it drives, lies ahead [m]."""


PARAMS = SightDistanceParams()

Floats = NDArray[np.float64]


class Sight(NamedTuple):
    """What is seen on the way of a motion.

    Attributes:
        scale: what part of the velocity, 0...1, may be driven.
        where: what was not seen, as it stands in a sentence; "" where all that matters was.
    """

    scale: float
    where: str


CLEAR = Sight(1.0, "")
WAYS = ("ahead", "to the left", "behind", "to the right")
BESIDE = "beside the robot"


class SightDistance:
    """Scales velocities by what was not seen.

    Args:
        footprint: (n, 2) corners [m] in `base_link`, counter-clockwise.
        limits: what the robot can brake with.
        delay_s: longest time from a command until odometry shows that the wheels follow it.
    """

    def __init__(self, footprint: Floats, limits: MotionLimits, delay_s: float) -> None:
        self._footprint = footprint
        self._limits = limits
        self._delay_s = delay_s
        self._radius = circumscribed_radius(footprint)
        self._gyration = radius_of_gyration(footprint)
        self.reach = self._reach_of(limits.speed) + 0.5 * limits.speed
        """How far from `base_link` what was not seen can matter within half a second [m]."""

    def look(self, twist: Twist2D, unseen: Unseen, *, by_hand: bool) -> Sight:
        """Return which share of a velocity may be driven.

        Args:
            twist: within the limits.
            unseen: what was not seen, in `base_link`.
            by_hand: whether a person drives, who looks where the robot does not.
        """
        points, may_creep, was_echo = unseen
        if twist.is_zero or len(points) == 0:
            return CLEAR
        reach = self._reach_of(twist.speed)
        is_near = np.einsum("ij,ij->i", points, points) < reach * reach
        near, may_creep, was_echo = points[is_near], may_creep[is_near], was_echo[is_near]
        if len(near) == 0:
            return CLEAR
        is_ahead = self._lies_ahead(near, twist)
        matters = (is_ahead | ~may_creep) & ~polygon_contains(self._footprint, near)
        near, is_ahead = near[matters], is_ahead[matters]
        may_creep, was_echo = may_creep[matters], was_echo[matters]
        times = contact_times(near, self._footprint, twist)
        met = np.isfinite(times)
        if not met.any():
            return CLEAR
        near, times, is_ahead = near[met], times[met], is_ahead[met]
        velocities = point_velocities(near, twist)
        times -= PARAMS.margin_m / np.hypot(velocities[:, 0], velocities[:, 1])
        creep = min(1.0, SIGHT.creep_mps / self._impact_speed(twist))
        is_held = is_ahead & ~may_creep[met] & (not by_hand)
        scale = min(
            max(creep, self._scale_before(times[~is_held], twist)),
            self._scale_before(times[is_held], twist),
        )
        if not by_hand:
            # While a ramp ends in turning in place, a little speed is left that fades.
            soft = ~is_ahead & (was_echo[met] | (twist.speed > PARAMS.soft))
            scale = min(scale, self._soft_scale(near[soft], velocities[soft]))
        if scale == 1.0:
            return CLEAR
        way = WAYS[round(math.atan2(twist.vy, twist.vx) / (0.5 * math.pi)) % len(WAYS)]
        return Sight(scale, way if is_ahead[int(np.argmin(times))] else BESIDE)

    def _soft_scale(self, beside: Floats, velocities: Floats) -> float:
        """Return what part of a motion lets the sides come softly to places (n, 2) beside.

        Args:
            beside: the places [m].
            velocities: (n, 2) theirs as seen from the robot [m/s].
        """
        gaps = beside - closest_on_outline(beside, self._footprint)
        distances = np.hypot(gaps[:, 0], gaps[:, 1])
        closing = -np.sum(velocities * gaps, axis=1)
        closing = (closing / np.maximum(distances, 1e-9))[distances < PARAMS.soft_m]
        return PARAMS.soft / max(PARAMS.soft, float(np.max(closing, initial=0.0)))

    def is_creeping(self, twist: Twist2D) -> bool:
        """Say whether a velocity is no faster than what is driven where nothing was seen."""
        return self._impact_speed(twist) <= (1.0 + PARAMS.slack) * SIGHT.creep_mps

    def is_coming_softly(self, twist: Twist2D) -> bool:
        """Say whether a velocity still brings sides to what was not seen, as slowly as they may."""
        return self._fastest(twist) >= 0.5 * PARAMS.soft

    def _impact_speed(self, twist: Twist2D) -> float:
        """Return the speed at which the robot has the same energy driving straight on [m/s]."""
        return math.hypot(twist.speed, twist.wz * self._gyration)

    def _fastest(self, twist: Twist2D) -> float:
        """Return a speed that no point of the footprint exceeds [m/s]."""
        return twist.speed + abs(twist.wz) * self._radius

    def _lies_ahead(self, points: Floats, twist: Twist2D) -> NDArray[np.bool_]:
        """Say of points (n, 2) whether it is by driving on that the footprint comes there."""
        if twist.speed == 0.0:
            return np.zeros(len(points), np.bool_)
        heading = np.array([twist.vx, twist.vy]) / twist.speed
        return points @ heading > float((self._footprint @ heading).max()) - PARAMS.ahead_m

    def _scale_before(self, times: Floats, twist: Twist2D) -> float:
        """Return what part of a velocity stops before the first of some contacts (n,) [s]."""
        seconds = float(np.min(times, initial=math.inf))
        if math.isinf(seconds):
            return 1.0
        if seconds <= 0.0:
            return 0.0
        # Driving part s and braking evenly: s delay + s^2 stopping / 2 <= seconds.
        limits = self._limits
        stopping = max(
            twist.speed / limits.downhill_deceleration, abs(twist.wz) / limits.angular_acceleration
        )
        root = math.sqrt(self._delay_s * self._delay_s + 2.0 * stopping * seconds)
        return min(1.0, 2.0 * seconds / (root + self._delay_s))

    def _reach_of(self, speed: float) -> float:
        """Return how far from `base_link` the stopping distance may lead [m]."""
        way = 0.5 * speed * speed / self._limits.downhill_deceleration + speed * self._delay_s
        return self._radius + way + PARAMS.margin_m
