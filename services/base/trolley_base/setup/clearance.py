"""What is too near to the robot to drive on, with no more known than is measured so far."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Twist2D
from trolley_base.setup.record import SetupRefused

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ClearanceParams:
    """How near things may be; set by hand."""

    margin_m: float = 0.12
    """Least distance to anything while it drives [m]."""
    turn_margin_m: float = 0.05
    """Least distance to anything while it turns on the spot [m]."""
    beside_m: float = 0.05
    """What is nearer than this beside the way of a stroke is in it [m]."""
    straight: float = 1e-6
    """Curvature below which an arc is straight [1/m]."""
    braking_s: float = 0.5
    """Time for which the distance ahead must suffice, at half the speed, while nothing more is
    known [s]: delay and braking of slow boards."""


PARAMS = ClearanceParams()


@dataclass(slots=True)
class Mount:
    """What is known so far of how the lidar sits, in its own frame."""

    axle: Floats | None = None
    """(2,) the middle of the axle [m], once the robot has turned round."""
    ahead: Floats | None = None
    """(2,) where ahead is, of length 1, once it has driven."""
    sign: float = 1.0
    """-1 if the lidar turns the other way than its driver believes."""


class Body:
    """The outline of the robot.

    Args:
        footprint: (n, 2) corners [m] in `base_link`.
    """

    def __init__(self, footprint: Floats) -> None:
        self.radius_m = float(np.max(np.hypot(footprint[:, 0], footprint[:, 1])))
        self._front_m, self._back_m = float(footprint[:, 0].max()), float(footprint[:, 0].min())
        self._left_m, self._right_m = footprint[:, 1].max(), footprint[:, 1].min()

    def refuse_obstacle(
        self, points: Floats, mount: Mount, twist: Twist2D, stopping_m: float = 0.0
    ) -> None:
        """Refuse to come nearer to what the lidar sees.

        Args:
            points: (n, 2) echoes in frame `laser` [m], without those of the robot itself.
            mount: how the lidar sits.
            twist: that was commanded.
            stopping_m: way from a command to stop until it stands, as far as it is known [m].

        Raises:
            SetupRefused: something is too near.
        """
        if not len(points):
            return
        speed = twist.vx
        if speed == 0.0 or mount.axle is None or mount.ahead is None:
            centre = np.zeros(2) if mount.axle is None else mount.axle
            reach_m = self.radius_m * (2.0 if mount.axle is None else 1.0)
            away_m = _nearest(np.hypot(*(points - centre).T))
            least_m = reach_m + (PARAMS.turn_margin_m if speed == 0.0 else PARAMS.margin_m)
            if away_m < least_m:
                raise _too_near(away_m - reach_m)
            return
        away = points - mount.axle
        ahead_x, ahead_y = mount.ahead
        along = ahead_x * away[:, 0] + ahead_y * away[:, 1]
        aside = mount.sign * (ahead_x * away[:, 1] - ahead_y * away[:, 0])
        along, aside = _on_arc(along, aside, twist.wz / speed)
        in_way = (aside > self._right_m - PARAMS.beside_m) & (
            aside < self._left_m + PARAMS.beside_m
        )
        if speed > 0.0:
            gaps = along[in_way & (along > 0.0)] - self._front_m
        else:
            gaps = self._back_m - along[in_way & (along < 0.0)]
        gap_m = _nearest(gaps)
        if gap_m < max(stopping_m, 0.5 * abs(speed) * PARAMS.braking_s):
            raise _too_near(gap_m)


def _on_arc(along: Floats, aside: Floats, curvature: float) -> tuple[Floats, Floats]:
    """Return how far points are ahead along an arc, and to the left of it [m].

    Args:
        along: (n,) how far they are straight ahead [m].
        aside: (n,) and to the left of that [m].
        curvature: of the arc, to the left positive [1/m].
    """
    radius = 1.0 / math.copysign(max(abs(curvature), PARAMS.straight), curvature)
    left = math.copysign(1.0, radius)
    ahead = np.arctan2(along, left * (radius - aside)) * abs(radius)
    return ahead, radius - left * np.hypot(along, aside - radius)


def _nearest(away: Floats) -> float:
    """Return the least distance that two beams confirm; one alone may hang between two things."""
    return math.inf if len(away) < 2 else float(np.partition(away, 1)[1])


def _too_near(gap_m: float) -> SetupRefused:
    return SetupRefused(
        f"Something is {max(0.0, gap_m):.2f} m from the robot, nearer than it may be. Clear the "
        "floor, or give the robot more room."
    )
