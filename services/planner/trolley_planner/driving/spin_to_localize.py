"""One spin in place for a robot that has lost its pose."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.config import PlannerConfig
from trolley.geometry import (
    Pose2D,
    Twist2D,
    circumscribed_radius,
    footprint_from_polygon,
    polygon_contains,
)
from trolley.messages import Scan
from trolley.messages.types import floats_from_bytes
from trolley_planner.control.robot_motion import Limits
from trolley_planner.driving.recovery_driver import Spin
from trolley_planner.sensing.inputs import OWN_SOURCE, Inputs


@dataclass(frozen=True, slots=True)
class SpinParams:
    """The spin of a robot that has lost its pose; by hand."""

    room_m: float = 0.1
    """Free distance needed around the robot's circumscribed circle."""
    full_turn_rad: float = 6.4
    """Angle of the whole spin."""
    acceleration_radps2: float = 1.0
    """Angular acceleration of the spin, which begins gently."""
    longest_s: float = 60.0
    """Longest duration of the spin; a robot that does not turn at all stops much sooner."""


SPIN = SpinParams()


class SpinToLocalize:
    """Spins once if the localizer asks for it, the configuration allows it, and there is room.

    It turns at most once until the robot has found itself.

    Args:
        config: `turn_to_find`.
    """

    def __init__(self, config: PlannerConfig) -> None:
        self._is_allowed = config.turn_to_find
        self._turn: Spin | None = None
        self._is_spent = False
        self._rate = 0.0
        self._asked_ns = 0

    def set_config(self, config: PlannerConfig) -> None:
        """Apply the settings: whether a spin is allowed."""
        self._is_allowed = config.turn_to_find

    @property
    def is_turning(self) -> bool:
        """Whether it spins, or is about to."""
        return self._turn is not None

    def stop(self) -> None:
        """Stop spinning, as when somebody stops the robot."""
        if self._turn is not None:
            self._turn, self._is_spent, self._rate = None, True, 0.0

    def command(self, inputs: Inputs, limits: Limits | None, now_ns: int) -> Twist2D | None:
        """Return the velocity of the spin, None while none is needed."""
        elapsed_s, self._asked_ns = (now_ns - self._asked_ns) * 1e-9, now_ns
        pose = inputs.pose
        if not self._is_allowed or pose is None or limits is None:
            return None
        if pose.state not in ("lost", "searching") or not pose.wants_turn:
            if pose.state == "localized":
                self._is_spent = False
            had, self._turn, self._rate = self._turn, None, 0.0
            return None if had is None else Twist2D.zero()
        base, odometry = inputs.base, inputs.odometry
        may = base is not None and base.mode == "ok" and base.source in (None, OWN_SOURCE)
        if self._is_spent or odometry is None:
            return None
        if not may or inputs.silence(now_ns) is not None:
            self.stop()
            return None
        if not self._has_room(inputs):
            # A person walks by, or stands there: the spin waits until there is room.
            self._rate = 0.0
            return None if self._turn is None else Twist2D.zero()
        if self._turn is None:
            self._turn = Spin(odometry.pose, SPIN.full_turn_rad, SPIN.longest_s)
        elif self._rate > 0.0:
            self._turn.update(odometry.twist, elapsed_s)
        wanted = self._turn.command(odometry.pose, limits)
        if wanted is None:
            self.stop()
            return Twist2D.zero()
        self._rate = min(wanted.wz, self._rate + 0.05 * SPIN.acceleration_radps2)
        return Twist2D(0.0, 0.0, self._rate)

    def _has_room(self, inputs: Inputs) -> bool:
        """Say whether the circle that the robot turns in is free."""
        robot, scan, mounting = inputs.robot, inputs.scan, inputs.base_T_laser
        if robot is None or scan is None or mounting is None:
            return False
        footprint = footprint_from_polygon(robot.footprint)
        radius_m = circumscribed_radius(footprint) + SPIN.room_m
        return _is_free(scan, mounting, footprint, radius_m)


def _is_free(scan: Scan, base_T_laser: Pose2D, body: NDArray[np.float64], radius_m: float) -> bool:
    """Say whether nothing but the robot itself is seen within a circle about its centre.

    Where the lidar does not look, `base` keeps the robot from what it remembers, and lets it
    turn at a creep into what it has not seen.
    """
    ranges = floats_from_bytes(scan.ranges).astype(np.float64)
    angles = scan.angle_min + np.arange(len(ranges)) * scan.angle_increment
    is_echo = np.isfinite(ranges) & (ranges > max(scan.range_min, 0.0))
    points = (ranges[is_echo] * np.stack([np.cos(angles[is_echo]), np.sin(angles[is_echo])])).T
    points = base_T_laser.transform_points(points)
    near = points[np.hypot(*points.T) <= radius_m]
    return bool(polygon_contains(body, near).all())
