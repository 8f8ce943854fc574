"""What all controllers share, and the braking check that every command passes."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D
from trolley_planner.control.critics import Target
from trolley_planner.control.local_costmap import LocalCostmap
from trolley_planner.control.proximity import (
    is_walked_into,
    would_meet_people,
    would_meet_robots,
)
from trolley_planner.control.robot_motion import DT_S, ROBOT_MOTION, Limits, stopping_clearance
from trolley_planner.costmap.footprint import clearance_at

MAX_REVERSE = 0.25
"""Highest speed backwards [m/s]: few lidars look that way."""

STANDING_MPS, STANDING_RADPS = 0.03, 0.1
"""Speed and turn rate below which the robot may count as standing."""

HURRIED_REVERSE = 0.5
"""Highest speed backwards out of somebody's way, where the lidar looks that way [m/s]."""


@dataclass(frozen=True, slots=True)
class Motion:
    """Where the robot is in `grid` and how it moves when it obeys the next command.

    Attributes:
        pose: where it will be then.
        twist: with which velocity.
        here: where it is now, if it obeys so late that this is somewhere else.
    """

    pose: Pose2D
    twist: Twist2D
    here: Pose2D | None = None

    @property
    def is_standing(self) -> bool:
        """Whether it hardly moves."""
        return abs(self.twist.vx) < STANDING_MPS and abs(self.twist.wz) < STANDING_RADPS


def limits_of(config: PlannerConfig, speed: float, turn: float, deceleration: float) -> Limits:
    """Return the robot's present limits.

    Args:
        config: the planner's own limits.
        speed: highest speed now [m/s].
        turn: highest turn rate of the base [rad/s].
        deceleration: what the base brakes with [m/s^2].
    """
    return Limits(
        max_speed=speed,
        max_reverse=min(MAX_REVERSE, speed),
        max_turn=min(config.max_turn_radps, turn),
        acceleration=config.acceleration_mps2,
        deceleration=min(deceleration, 1.5 * config.acceleration_mps2),
        turn_acceleration=config.angular_acceleration_radps2,
        slow_speed=min(config.slow_speed_mps, speed),
        caution_m=config.caution_distance_m,
        clearance_m=config.clearance_m,
        dt=DT_S,
    )


class Controller(Protocol):
    """Chooses the velocity that leads best along the cost-to-go of the local costmap."""

    trajectory: NDArray[np.float32]
    """(n, 3) x, y, yaw in `grid`: what the last command leads to, `DT_S` apart."""

    def reset(self) -> None:
        """Start afresh, as after somebody else drove the robot."""

    def command(
        self,
        motion: Motion,
        local_costmap: LocalCostmap,
        limits: Limits,
        target: Target,
        path: NDArray[np.float64],
        elapsed_s: float,
    ) -> Twist2D | None:
        """Return the velocity to drive now, None if every motion would collide.

        Args:
            motion: of the robot, with the velocity that it has.
            local_costmap: around it, leading along the path.
            limits: of the robot.
            target: where the path leads next.
            path: (n, 2) the points of it ahead, in `grid` [m].
            elapsed_s: since the last command.
        """
        ...


def limits_here(limits: Limits, local_costmap: LocalCostmap, pose: Pose2D) -> Limits:
    """Return the limits at a place: no backing into floor that was never seen."""
    return (
        limits if local_costmap.known_floor.sees_behind(pose) else limits._replace(max_reverse=0.0)
    )


def safe_command(
    motion: Motion,
    wanted: Twist2D,
    local_costmap: LocalCostmap,
    limits: Limits,
    give_m: float = 0.0,
    may_back: bool | None = None,
) -> Twist2D:
    """Return the part of a velocity from which the robot can stop before it touches anything.

    A robot that stands too close already may still move away.

    Args:
        motion: of the robot.
        wanted: velocity about to be commanded.
        local_costmap: around it.
        limits: braking and clearance.
        give_m: how much closer it may come where it is too close already.
        may_back: whether it is known what it backs into; None: as far as it may brake.
    """
    start, field, body = state_of(motion), local_costmap.field, local_costmap.body
    now_m = None
    if motion.here is not None:
        x, y, yaw = motion.here.as_array().tolist()
        now_m = clearance_at(field, body, x, y, yaw, limits.clearance_m)
    if may_back is None:
        may_back = wanted.vx >= 0.0 or local_costmap.known_floor.sees_behind(motion.pose)
    if wanted.vx < 0.0 and not may_back:
        wanted = Twist2D(0.0, 0.0, wanted.wz)
    for share in (1.0, 0.75, 0.5, 0.25, 0.1):
        start[3], start[4] = share * wanted.vx, share * wanted.wz
        now, smallest = stopping_clearance(start, field, body, limits)
        late_s = ROBOT_MOTION.delay_s
        if would_meet_people(start, field.walkers, body, limits.deceleration, late_s):
            continue
        if would_meet_robots(start, field.robots, body, limits.deceleration, late_s):
            continue
        if smallest >= min(limits.clearance_m, (now if now_m is None else now_m) - give_m):
            return wanted.scaled(share)
    return Twist2D.zero()


def had_better_stand(motion: Motion, wanted: Twist2D, local_costmap: LocalCostmap) -> bool:
    """Say whether somebody walks into the robot soon, and the velocity hardly changes that.

    A robot that stands hurts nobody, and is easier to step around than one that turns.
    """
    walkers = local_costmap.field.walkers
    if len(walkers) == 0 or wanted.is_zero:
        return False
    start = state_of(motion)
    start[3], start[4] = wanted.vx, wanted.wz
    return is_walked_into(start, walkers, local_costmap.body)


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


def first_step(motion: Motion, controls: NDArray[np.float64], elapsed_s: float) -> Twist2D:
    """Return what to command now of a sequence (n, 2) of v, w, one for every `DT_S`.

    Only a part of the first step has passed until the next command.
    """
    share = min(max(elapsed_s / DT_S, 0.2), 1.0)
    v = motion.twist.vx + share * (float(controls[0, 0]) - motion.twist.vx)
    w = motion.twist.wz + share * (float(controls[0, 1]) - motion.twist.wz)
    return Twist2D(v, 0.0, w)


def state_of(motion: Motion) -> NDArray[np.float64]:
    """Return x, y, yaw, v, w as the kernels take them."""
    pose, twist = motion.pose, motion.twist
    return np.array([pose.x, pose.y, pose.yaw, twist.vx, twist.wz])
