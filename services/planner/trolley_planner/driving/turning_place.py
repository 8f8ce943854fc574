"""A place beside a tight goal where the robot can turn, to come in with the right heading."""

import math
from dataclasses import dataclass

from trolley.geometry import Pose2D
from trolley_planner.context.planning_context import Rig

DISTANCES_M = (0.3, 0.45, 0.6, 0.8, 1.0, 1.2, 1.4)
STEP_M = 0.05
TURN_STEP = 0.1
NUM_HEADINGS = 16


@dataclass(frozen=True, slots=True)
class Stage:
    """Where to turn, and how to go on from there to the goal."""

    pose: Pose2D
    """In `grid`, with the goal's heading."""
    is_reverse: bool
    """Whether the goal lies behind it."""


def find_stage(rig: Rig, goal: Pose2D, clearance_m: float, at_goal_m: float) -> Stage | None:
    """Return the nearest place before or behind the goal from which a straight line leads onto it.

    The window must be centred near the goal.

    Args:
        rig: window and planner.
        goal: in `grid`.
        clearance_m: to keep while turning.
        at_goal_m: to keep on the straight line, at most what the goal itself has.
    """
    for distance in DISTANCES_M:
        for is_reverse in (False, True):
            pose = goal @ Pose2D(distance if is_reverse else -distance, 0.0, 0.0)
            if _can_turn(rig, pose, clearance_m) and _is_free(rig, pose, goal, at_goal_m):
                return Stage(pose, is_reverse)
    return None


def can_turn_by(rig: Rig, pose: Pose2D, turn: float, clearance_m: float) -> bool:
    """Say whether the robot can turn in place by an angle [rad], to the left if positive."""
    count = max(1, math.ceil(abs(turn) / TURN_STEP))
    return all(
        rig.seen_clearance(Pose2D(pose.x, pose.y, pose.yaw + turn * index / count), clearance_m)
        >= clearance_m
        for index in range(1, count + 1)
    )


def _can_turn(rig: Rig, pose: Pose2D, clearance_m: float) -> bool:
    """Say whether the robot can turn all round at a place."""
    if not rig.costmap.contains(pose.x, pose.y):
        return False
    turns = (index * 2.0 * math.pi / NUM_HEADINGS for index in range(NUM_HEADINGS))
    return all(
        rig.seen_clearance(Pose2D(pose.x, pose.y, turn), clearance_m) >= clearance_m
        for turn in turns
    )


def _is_free(rig: Rig, start: Pose2D, goal: Pose2D, clearance_m: float) -> bool:
    """Say whether the straight line between two poses of one heading is free."""
    count = max(2, math.ceil(start.distance_to(goal) / STEP_M))
    for index in range(count + 1):
        share = index / count
        pose = Pose2D(
            start.x + share * (goal.x - start.x), start.y + share * (goal.y - start.y), goal.yaw
        )
        if rig.seen_clearance(pose, clearance_m) < clearance_m:
            return False
    return True
