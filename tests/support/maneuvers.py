"""Maneuvers of any kind, and a robot that is led along one."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, Twist2D, integrate_twist
from trolley_planner.control.controller import Motion, limited_change
from trolley_planner.control.robot_motion import Limits
from trolley_planner.driving.maneuver_follower import ManeuverFollower
from trolley_planner.paths.hybrid_astar.motion_primitives import (
    BACKWARDS,
    FORWARDS,
    TURNING,
    Maneuver,
)

DT_S = 0.05
"""From command to command."""
SHORT_M = 0.23
"""How far a hobby robot reaches."""


def any_maneuver(rng: np.random.Generator, num_runs: int) -> Maneuver:
    """Lines, arcs, and turns on the spot, steps as long and bends as tight as the search's."""
    poses, motions = [np.array([3.0, 2.0, rng.uniform(-7.0, 7.0)])], []
    motion, others = None, (FORWARDS, BACKWARDS, TURNING)
    for _ in range(num_runs):
        motion = int(rng.choice([other for other in others if other != motion]))
        step_m, bend = rng.uniform(0.012, 0.0375), rng.uniform(-2.6, 2.6)
        turn = rng.uniform(-0.098, 0.098) if motion == TURNING else step_m * bend
        for _ in range(int(rng.integers(1, 25))):
            x, y, yaw = poses[-1]
            by_m, facing = abs(motion) * motion * step_m, yaw + 0.5 * turn
            step = by_m * math.cos(facing), by_m * math.sin(facing), turn
            poses.append(np.array([x, y, yaw]) + step)
            motions.append(motion)
    return Maneuver(np.array(poses), np.array([motions[0], *motions], dtype=np.int8))


def near(pose: NDArray[np.float64], rng: np.random.Generator, off_m: float, off: float) -> Pose2D:
    """A pose as far from another (3,) along each axis, and as far turned, at most."""
    return Pose2D(*(pose + rng.uniform(-1.0, 1.0, 3) * (off_m, off_m, off)).tolist())


def led_by(
    follower: ManeuverFollower,
    start: Pose2D,
    limits: Limits,
    before: Twist2D | None = None,
    delay: int = 0,
    num_steps: int = 600,
) -> list[tuple[Pose2D, Twist2D]]:
    """What is wanted 20 times a second, and the pose of a robot that obeys so many steps later."""
    commands = [before or Twist2D.zero()] * (delay + 1)
    pose, led = start, [(start, commands[0])]
    for _ in range(num_steps):
        wanted = follower.command(Motion(pose, commands[-1]), limits)
        if wanted is None:
            break
        commands.append(limited_change(commands[-1], wanted, limits, DT_S))
        pose = integrate_twist(pose, commands[-1 - delay], DT_S)
        led.append((pose, wanted))
    return led
