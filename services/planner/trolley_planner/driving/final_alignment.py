"""The final approach: onto the goal's position, then turn to its heading."""

import math
from dataclasses import dataclass

from trolley.geometry import Pose2D, Twist2D, wrap_angle
from trolley_planner.control.controller import Motion
from trolley_planner.control.rollout import Limits
from trolley_planner.goals.goal import Tolerances


@dataclass(frozen=True, slots=True)
class AlignmentParams:
    """How the robot drives the last decimetres; all by hand."""

    start_m: float = 0.3
    """The alignment takes over this near to the goal."""
    least_mps: float = 0.03
    """Slower commands than this"""
    least_radps: float = 0.12
    """or this do not move a real robot."""
    turn_gain: float = 3.0
    """Turn rate per heading error [1/s]."""
    face_rad: float = 0.35
    """The robot faces the goal first if it looks farther past it than this."""
    reverse_m: float = 0.25
    """A goal behind the robot and nearer than this is reached backwards."""
    settle_s: float = 6.0
    """After this time a place within the full tolerances is good enough."""


ALIGNMENT = AlignmentParams()


class FinalAlignment:
    """Brings the robot from a few decimetres away onto the goal.

    Position first, then heading; aims at half the tolerances, so that noise of the pose does not
    undo what was reached, and is content with the full ones once `ALIGNMENT.settle_s` have passed.

    Args:
        tolerances: how near is near enough.
        is_reverse: drive onto the goal backwards from any distance.
    """

    def __init__(self, tolerances: Tolerances, is_reverse: bool = False) -> None:
        self._tolerances = tolerances
        self._is_reverse = is_reverse
        self._is_turning = False
        self._is_facing = False
        self._sense = 0.0
        self._elapsed_s = 0.0

    @property
    def is_turning(self) -> bool:
        """Whether it is on the spot and has only to turn."""
        return self._is_turning

    def turn_longer_way(self, sense: float) -> None:
        """Turn to the goal's heading the longer way around.

        Args:
            sense: sign of that turn, positive to the left.
        """
        self._sense = sense

    def command(
        self, motion: Motion, goal: Pose2D, limits: Limits, elapsed_s: float
    ) -> Twist2D | None:
        """Return the velocity to drive now, None once the robot has arrived and stands still.

        Args:
            motion: of the robot, in the frame of `goal`.
            goal: the pose to reach.
            limits: of the robot.
            elapsed_s: since the last command.
        """
        self._elapsed_s += elapsed_s
        distance, turn = self._errors(motion, goal)
        aim = 1.0 if self._elapsed_s > ALIGNMENT.settle_s else 0.5
        near = aim * min(self._tolerances.xy, 0.1)
        turned = abs(turn) <= aim * min(self._tolerances.yaw, 0.3) or self._tolerances.any_heading
        if self._is_turning:
            # Noise of the pose must not send it back to driving.
            self._is_turning = distance <= max(0.9 * self._tolerances.xy, near)
        else:
            self._is_turning = distance <= near
        if not self._is_turning:
            return self._drive(motion, goal, distance, limits)
        if turned:
            stands = abs(motion.twist.vx) < 0.02 and abs(motion.twist.wz) < 0.05
            return None if stands else Twist2D.zero()
        if turn * self._sense > 0.0:
            self._sense = 0.0  # Past the far side: from here on it is the shorter way.
        elif self._sense != 0.0:
            turn += math.copysign(2.0 * math.pi, self._sense)
        return Twist2D(0.0, 0.0, _turn_rate(turn, limits))

    def _errors(self, motion: Motion, goal: Pose2D) -> tuple[float, float]:
        """Return the distance [m] and the turn that is left [rad]."""
        turn = 0.0 if self._tolerances.any_heading else wrap_angle(goal.yaw - motion.pose.yaw)
        return motion.pose.distance_to(goal), turn

    def _drive(self, motion: Motion, goal: Pose2D, distance: float, limits: Limits) -> Twist2D:
        """Return the velocity towards the goal's position."""
        ahead = motion.pose.inverse() @ goal
        bearing = math.atan2(ahead.y, ahead.x)
        direction = 1.0
        if abs(bearing) > 0.5 * math.pi and (self._is_reverse or distance < ALIGNMENT.reverse_m):
            bearing, direction = wrap_angle(bearing + math.pi), -1.0
        # With some hysteresis, else it would keep switching between driving and turning.
        self._is_facing = abs(bearing) > (0.3 if self._is_facing else 1.0) * ALIGNMENT.face_rad
        if self._is_facing and distance > 0.01:
            return Twist2D(0.0, 0.0, _turn_rate(bearing, limits))
        braking = math.sqrt(limits.deceleration * distance)
        highest = limits.max_speed if direction > 0.0 else limits.max_reverse
        speed = max(min(braking, 1.5 * distance + 0.02, highest), min(ALIGNMENT.least_mps, highest))
        # Very near, the bearing is mostly noise.
        steer = ALIGNMENT.turn_gain * bearing * min(1.0, distance / 0.08)
        return Twist2D(direction * speed, 0.0, _clipped(steer, limits.max_turn))


def _turn_rate(turn: float, limits: Limits) -> float:
    """Return the turn rate that ends after `turn` [rad] without overshooting."""
    size = abs(turn)
    braking = math.sqrt(0.8 * limits.turn_acceleration * size)
    rate = max(
        min(braking, ALIGNMENT.turn_gain * size, limits.max_turn),
        min(ALIGNMENT.least_radps, limits.max_turn),
    )
    return math.copysign(rate, turn)


def _clipped(value: float, size: float) -> float:
    return min(max(value, -size), size)


def limited_change(before: Twist2D, wanted: Twist2D, limits: Limits, elapsed_s: float) -> Twist2D:
    """Return the velocity nearest to `wanted` that the robot can have after `elapsed_s`."""
    faster = limits.acceleration * elapsed_s
    slower = limits.deceleration * elapsed_s
    down = slower if before.vx > 0.0 else faster
    up = slower if before.vx < 0.0 else faster
    turn = limits.turn_acceleration * elapsed_s
    return Twist2D(
        min(max(wanted.vx, before.vx - down), before.vx + up),
        0.0,
        min(max(wanted.wz, before.wz - turn), before.wz + turn),
    )
