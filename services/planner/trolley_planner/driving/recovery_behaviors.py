"""How the robot moves while it tries to get free: back along its trail, and round in place."""

import math
from collections.abc import Callable

from trolley.geometry import Pose2D, Twist2D, wrap_angle
from trolley_planner.driving.recovery import Trail
from trolley_planner.kernels.rollout import Limits

BACK_SPEED = 0.12
TURN_RATE = 0.7
LOOKBACK_M = 0.12
STUCK_S = 1.0
"""A try that was held up for this long is over,"""
MAX_S = 12.0
"""and each is after this long."""
STANDING_SPEED, STANDING_TURN = 0.02, 0.1


class Hold:
    """Notices that a try does not get on."""

    def __init__(self) -> None:
        self._held_s = 0.0
        self._elapsed_s = 0.0

    def note(self, driven: Twist2D, elapsed_s: float) -> None:
        """Take what of a command was safe to drive."""
        stands = abs(driven.vx) < STANDING_SPEED and abs(driven.wz) < STANDING_TURN
        self._held_s = self._held_s + elapsed_s if stands else 0.0
        self._elapsed_s += elapsed_s

    @property
    def is_over(self) -> bool:
        """Whether it was held up for too long, or takes too long."""
        return self._held_s > STUCK_S or self._elapsed_s > MAX_S


def free_turn(can_turn: Callable[[float], bool], bearing: float) -> float | None:
    """Return by how much to turn to look round [rad], begun towards a bearing; None for no room.

    Args:
        can_turn: says whether there is room for a turn by an angle [rad].
        bearing: of the way that is left, from the robot's heading [rad].
    """
    for size in (2.0 * math.pi, math.pi, 0.5 * math.pi):
        for turn in (math.copysign(size, bearing), -math.copysign(size, bearing)):
            if can_turn(turn):
                return turn
    return None


class BackUp:
    """Drives backwards the way the robot came.

    Args:
        start: odom_T_base at the beginning.
        length_m: how far at most.
    """

    def __init__(self, start: Pose2D, length_m: float) -> None:
        self._start = start
        self._length_m = length_m
        self._hold = Hold()

    def command(self, odom_T_base: Pose2D, trail: Trail, limits: Limits) -> Twist2D | None:
        """Return the velocity to drive now, None when it is over."""
        if odom_T_base.distance_to(self._start) >= self._length_m or self._hold.is_over:
            return None
        crumb = trail.back(odom_T_base, LOOKBACK_M)
        if crumb is None:
            return None
        behind = odom_T_base.inverse() @ crumb
        bearing = wrap_angle(math.atan2(behind.y, behind.x) + math.pi)
        if abs(bearing) > 0.5 * math.pi:
            return None  # The trail lies ahead: there is no way back along it.
        turn = min(max(1.5 * bearing, -0.5), 0.5)
        return Twist2D(-min(BACK_SPEED, limits.max_reverse), 0.0, turn)

    def note(self, driven: Twist2D, elapsed_s: float) -> None:
        """Take what of the command was safe to drive."""
        self._hold.note(driven, elapsed_s)


class TurnRound:
    """Turns in place by a given angle.

    Args:
        start: odom_T_base at the beginning.
        angle: to turn by [rad], positive to the left.
    """

    def __init__(self, start: Pose2D, angle: float) -> None:
        self._last_yaw = start.yaw
        self._angle = angle
        self._turned = 0.0
        self._hold = Hold()

    def command(self, odom_T_base: Pose2D, limits: Limits) -> Twist2D | None:
        """Return the velocity to drive now, None when it is over."""
        self._turned += wrap_angle(odom_T_base.yaw - self._last_yaw)
        self._last_yaw = odom_T_base.yaw
        left = abs(self._angle) - math.copysign(1.0, self._angle) * self._turned
        if left <= 0.05 or self._hold.is_over:
            return None
        rate = min(TURN_RATE, limits.max_turn, max(0.15, 1.5 * left))
        return Twist2D(0.0, 0.0, math.copysign(rate, self._angle))

    def note(self, driven: Twist2D, elapsed_s: float) -> None:
        """Take what of the command was safe to drive."""
        self._hold.note(driven, elapsed_s)
