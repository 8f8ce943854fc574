"""The last metre: where exactly to stop, and how to get there with the right heading."""

import math
from dataclasses import dataclass

import numpy as np

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D, wrap_angle
from trolley_planner.context.motion_state import Situation
from trolley_planner.context.planning_context import Rig
from trolley_planner.control.controller import Motion, safe_command
from trolley_planner.control.rollout import allowed_speed
from trolley_planner.driving.final_alignment import START_M, Approach, limited_change
from trolley_planner.goals.goal import Tolerances, free_pose_near
from trolley_planner.paths.lines import subdivide
from trolley_planner.paths.path import SPACING_M, PlannedPath

TURN_AS_WAY_M = 0.3
"""A radian that is left at the goal counts as this much of the way."""


GOAL_CLEARANCE_M = 0.005
"""More than this is left of the clearance at a tight goal."""


WINDOW_EDGE_M = 0.6
"""The goal is looked at when it lies this far inside the window."""


DISTANCES_M = (0.3, 0.45, 0.6, 0.8, 1.0, 1.2, 1.4)


STEP_M = 0.05


TURN_STEP = 0.1


NUM_HEADINGS = 16


class Arrival:
    """Takes over near the goal.

    It aims at the goal, or beside it where something stands on it; where there is no room to turn
    on the goal it turns beside it and comes in straight. All poses are in `grid`.

    Args:
        rig: window and planner.
        config: of the planner.
        goal: where to.
        tolerances: how near is near enough.
    """

    def __init__(
        self, rig: Rig, config: PlannerConfig, goal: Pose2D, tolerances: Tolerances
    ) -> None:
        self._rig = rig
        self._config = config
        self._goal = goal
        self._tolerances = tolerances
        self._final: Pose2D = goal
        self._approach: Approach | None = None
        self._stage: Stage | None = None
        self._was_staged = False
        self._is_docking = False
        self.aim: Pose2D = goal
        """Where to drive now."""
        self.is_occupied = False
        """Whether something stands on the goal and on all places within its tolerance."""
        self.has_arrived = False
        self.detour: PlannedPath | None = None
        """A path to `aim` that the drive must take over, as after deciding to turn elsewhere."""

    @property
    def is_active(self) -> bool:
        """Whether it has taken over."""
        return self._approach is not None

    def let_go(self) -> None:
        """Leave the driving to the controller again."""
        self._approach = None
        self._is_docking = False

    def left_m(self, pose: Pose2D) -> float:
        """Return what is left to do [m]: at the goal the turn counts, too."""
        distance = pose.distance_to(self.aim)
        if self._tolerances.any_heading:
            return distance
        return distance + TURN_AS_WAY_M * abs(wrap_angle(self.aim.yaw - pose.yaw))

    def look(self, pose: Pose2D) -> bool:
        """Aim beside the goal where something stands on it; True if the aim was moved.

        Args:
            pose: of the robot; the window must be centred on it.
        """
        is_far = pose.distance_to(self._goal) > self._rig.half_m - WINDOW_EDGE_M
        if is_far or self._stage is not None or self._is_docking:
            return False
        enough = self._config.clearance_m + 0.01
        self.is_occupied = False
        if self._rig.seen_clearance(self.aim, enough) >= GOAL_CLEARANCE_M + 0.01:
            return False
        found = free_pose_near(
            self._goal,
            self._tolerances,
            lambda candidate: self._rig.seen_clearance(candidate, enough),
            enough,
        )
        if found is None:
            self.is_occupied = True
            return False
        if found == self.aim:
            return False
        self.aim = self._final = found
        self._approach = None
        return True

    def takes_over(self, pose: Pose2D, remaining_m: float) -> bool:
        """Say whether the final approach drives: near, and nothing between.

        Args:
            pose: of the robot.
            remaining_m: what is left of the path.
        """
        distance = pose.distance_to(self.aim)
        if self._approach is not None:
            stays = self._is_docking or distance < 2.0 * START_M
            self._approach = self._approach if stays else None
            return stays
        if distance > START_M or remaining_m > 2.0 * START_M:
            return False
        bearing = math.atan2(self.aim.y - pose.y, self.aim.x - pose.x)
        for share in (0.25, 0.5, 0.75):
            x = pose.x + share * (self.aim.x - pose.x)
            y = pose.y + share * (self.aim.y - pose.y)
            clearance = self._rig.seen_clearance(Pose2D(x, y, bearing), 0.1)
            if clearance < self._config.clearance_m and distance > 0.1:
                return False
        offset = self.aim.distance_to(self._goal)
        xy = self._tolerances.xy
        near = Tolerances(max(xy - offset, 0.3 * xy), self._tolerances.yaw)
        facing = wrap_angle(bearing - pose.yaw)
        is_behind = abs(facing) > 0.5 * math.pi
        clearance = self._config.clearance_m
        is_reverse = is_behind and not can_turn_by(self._rig, pose, facing, clearance)
        self._approach = Approach(near, is_reverse)
        return True

    def command(self, now: Situation) -> Twist2D:
        """Return the velocity of the final approach."""
        rig, approach = self._rig, self._approach
        if approach is None:
            return Twist2D.zero()
        room = rig.seen_clearance(self.aim, now.limits.caution_m)
        here = rig.seen_clearance(now.motion.pose, now.limits.caution_m)
        place = now.motion.pose
        speed = allowed_speed(rig.window.field, now.limits, place.x, place.y, here)
        # A goal that was taught beside a wall must be reachable, too.
        tight = min(now.limits.clearance_m, max(GOAL_CLEARANCE_M, room - 0.01))
        limits = now.limits._replace(
            max_speed=speed, max_reverse=min(now.limits.max_reverse, speed), clearance_m=tight
        )
        was_turning = approach.is_turning
        steady = Motion(now.steady, now.motion.twist)
        wanted = approach.command(steady, self.aim, limits, now.elapsed_s)
        if wanted is None:
            self._finish()
            return Twist2D.zero()
        if approach.is_turning and not was_turning:
            self._choose_turn(approach, place, tight)
        wanted = limited_change(now.motion.twist, wanted, limits, now.elapsed_s)
        return safe_command(now.motion, wanted, rig.window, limits)

    def turn_elsewhere(self, pose: Pose2D) -> bool:
        """Go to where there is room to turn, if the robot is on the goal and cannot turn.

        Args:
            pose: of the robot.

        Returns:
            Whether there is such a place; `detour` leads there.
        """
        approach = self._approach
        if approach is None or not approach.is_turning or self._was_staged:
            return False
        self._was_staged = True
        rig, clearance = self._rig, self._config.clearance_m
        room = rig.seen_clearance(self.aim, clearance)
        stage = find_stage(rig, self.aim, clearance + 0.01, room - 0.01)
        if stage is None:
            return False
        costmap = rig.costmap
        place = (stage.pose.x, stage.pose.y)
        path = rig.planner.plan((pose.x, pose.y), [place], costmap.weights, costmap.distance_m)
        if path is None:
            return False
        self._stage, self._final = stage, self.aim
        self.aim, self._approach, self.detour = stage.pose, None, path
        return True

    def _choose_turn(self, approach: Approach, pose: Pose2D, clearance_m: float) -> None:
        """Turn the longer way round where only that is free, or else somewhere else."""
        turn = wrap_angle(self.aim.yaw - pose.yaw)
        longer = turn - math.copysign(2.0 * math.pi, turn)
        if self._tolerances.any_heading or can_turn_by(self._rig, pose, turn, clearance_m):
            return
        if can_turn_by(self._rig, pose, longer, clearance_m):
            approach.turn_longer_way(longer)
        else:
            self.turn_elsewhere(pose)

    def _finish(self) -> None:
        """The robot is on its aim: that was the goal, or it comes in from there."""
        stage = self._stage
        if stage is None:
            self.has_arrived = True
            return
        line = np.array([[stage.pose.x, stage.pose.y], [self._final.x, self._final.y]])
        length = stage.pose.distance_to(self._final)
        self.detour = PlannedPath.join([subdivide(line, SPACING_M)], length)
        self.aim, self._stage, self._is_docking = self._final, None, True
        self._approach = Approach(self._tolerances, stage.is_reverse)


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
