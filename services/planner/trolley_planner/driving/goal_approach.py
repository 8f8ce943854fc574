"""The last metre to the goal: where exactly to stop, then onto it and to its heading."""

import math
from dataclasses import dataclass

import numpy as np

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D, wrap_angle
from trolley_planner.context.motion_state import ControlInput
from trolley_planner.context.planning_context import PlanningContext
from trolley_planner.control.controller import Motion, limited_change, safe_command
from trolley_planner.control.rollout import Limits, allowed_speed
from trolley_planner.goals import Tolerances, nearest_free_pose
from trolley_planner.paths.path import SPACING_M, PlannedPath, subdivide


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
        return Twist2D(0.0, 0.0, turn_rate(turn, limits))

    def _errors(self, motion: Motion, goal: Pose2D) -> tuple[float, float]:
        """Return the distance [m] and the turn that is left [rad]."""
        turn = 0.0 if self._tolerances.any_heading else wrap_angle(goal.yaw - motion.pose.yaw)
        return motion.pose.distance_to(goal), turn

    def _drive(self, motion: Motion, goal: Pose2D, distance: float, limits: Limits) -> Twist2D:
        """Return the velocity towards the goal's position."""
        ahead = motion.pose.inverse() @ goal
        bearing = math.atan2(ahead.y, ahead.x)
        direction = 1.0
        is_near = distance < ALIGNMENT.reverse_m and limits.max_reverse > 0.0
        if abs(bearing) > 0.5 * math.pi and (self._is_reverse or is_near):
            bearing, direction = wrap_angle(bearing + math.pi), -1.0
        # With some hysteresis, else it would keep switching between driving and turning.
        self._is_facing = abs(bearing) > (0.3 if self._is_facing else 1.0) * ALIGNMENT.face_rad
        if self._is_facing and distance > 0.01:
            return Twist2D(0.0, 0.0, turn_rate(bearing, limits))
        braking = math.sqrt(limits.deceleration * distance)
        highest = limits.max_speed if direction > 0.0 else limits.max_reverse
        speed = max(min(braking, 1.5 * distance + 0.02, highest), min(ALIGNMENT.least_mps, highest))
        # Very near, the bearing is mostly noise.
        steer = ALIGNMENT.turn_gain * bearing * min(1.0, distance / 0.08)
        return Twist2D(direction * speed, 0.0, _clipped(steer, limits.max_turn))


def turn_rate(turn: float, limits: Limits) -> float:
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


@dataclass(frozen=True, slots=True)
class ApproachParams:
    """Where to stop and where to turn near the goal; all by hand."""

    turn_as_m: float = 0.3
    """A turn by one radian that is left at the goal counts as this distance."""
    goal_clearance_m: float = 0.005
    """At a tight goal at least this clearance is left."""
    window_edge_m: float = 0.6
    """The goal is checked once it lies this far inside the local costmap."""
    turning_distances_m: tuple[float, ...] = (0.3, 0.45, 0.6, 0.8, 1.0, 1.2, 1.4)
    """Places to turn are looked for this far before and behind the goal."""
    step_m: float = 0.05
    """Straight lines are checked in steps of this length,"""
    turn_step_rad: float = 0.1
    """and turns in steps of this angle."""
    num_headings: int = 16
    """Headings at which a full turn is checked."""


APPROACH = ApproachParams()


class GoalApproach:
    """Drives near the goal.

    It aims at the goal, or beside it where something stands on it; where there is no room to turn
    on the goal it turns beside it and comes in straight. All poses are in `grid`.

    Args:
        context: costmaps and planner.
        config: of the planner.
        goal: where to.
        tolerances: how near is near enough.
    """

    def __init__(
        self, context: PlanningContext, config: PlannerConfig, goal: Pose2D, tolerances: Tolerances
    ) -> None:
        self._context = context
        self._config = config
        self._goal = goal
        self._tolerances = tolerances
        self._final: Pose2D = goal
        self._alignment: FinalAlignment | None = None
        self._turning_place: TurningPlace | None = None
        self._has_turned_elsewhere = False
        self._is_docking = False
        self.aim: Pose2D = goal
        """Where to drive now."""
        self.is_occupied = False
        """Whether something stands on the goal and on all places within its tolerance."""
        self.has_arrived = False
        self.detour: PlannedPath | None = None
        """A path to `aim` that must be followed first, as after deciding to turn elsewhere."""

    @property
    def is_active(self) -> bool:
        """Whether it drives now."""
        return self._alignment is not None

    def let_go(self) -> None:
        """Leave driving to the controller again."""
        self._alignment = None
        self._is_docking = False

    def left_m(self, pose: Pose2D) -> float:
        """Return what is left to do [m]: at the goal the turn counts, too."""
        distance = pose.distance_to(self.aim)
        if self._tolerances.any_heading:
            return distance
        return distance + APPROACH.turn_as_m * abs(wrap_angle(self.aim.yaw - pose.yaw))

    def update_aim(self, pose: Pose2D) -> bool:
        """Aim beside the goal where something stands on it; True if the aim was moved.

        Args:
            pose: of the robot; the local costmap must be centred on it.
        """
        is_far = pose.distance_to(self._goal) > self._context.half_m - APPROACH.window_edge_m
        if is_far or self._turning_place is not None or self._is_docking:
            return False
        enough = self._config.clearance_m + 0.01
        self.is_occupied = False
        if self._context.seen_clearance(self.aim, enough) >= APPROACH.goal_clearance_m + 0.01:
            return False
        found = nearest_free_pose(
            self._goal,
            self._tolerances,
            lambda candidate: self._context.seen_clearance(candidate, enough),
            enough,
        )
        if found is None:
            self.is_occupied = True
            return False
        if found == self.aim:
            return False
        self.aim = self._final = found
        self._alignment = None
        return True

    def takes_over(self, pose: Pose2D, remaining_m: float) -> bool:
        """Say whether the final approach drives: near, and nothing between.

        Args:
            pose: of the robot.
            remaining_m: what is left of the path.
        """
        distance = pose.distance_to(self.aim)
        if self._alignment is not None:
            stays = self._is_docking or distance < 2.0 * ALIGNMENT.start_m
            self._alignment = self._alignment if stays else None
            return stays
        if distance > ALIGNMENT.start_m or remaining_m > 2.0 * ALIGNMENT.start_m:
            return False
        bearing = math.atan2(self.aim.y - pose.y, self.aim.x - pose.x)
        for share in (0.25, 0.5, 0.75):
            x = pose.x + share * (self.aim.x - pose.x)
            y = pose.y + share * (self.aim.y - pose.y)
            clearance = self._context.seen_clearance(Pose2D(x, y, bearing), 0.1)
            if clearance < self._config.clearance_m and distance > 0.1:
                return False
        offset = self.aim.distance_to(self._goal)
        xy = self._tolerances.xy
        near = Tolerances(max(xy - offset, 0.3 * xy), self._tolerances.yaw)
        facing = wrap_angle(bearing - pose.yaw)
        is_behind = abs(facing) > 0.5 * math.pi
        clearance = self._config.clearance_m
        is_reverse = is_behind and not can_turn_by(self._context, pose, facing, clearance)
        self._alignment = FinalAlignment(near, is_reverse)
        return True

    def command(self, now: ControlInput) -> Twist2D:
        """Return the velocity of the final approach."""
        context, alignment = self._context, self._alignment
        if alignment is None:
            return Twist2D.zero()
        room = context.seen_clearance(self.aim, now.limits.caution_m)
        here = context.seen_clearance(now.motion.pose, now.limits.caution_m)
        place = now.motion.pose
        speed = allowed_speed(context.local_costmap.field, now.limits, place.x, place.y, here)
        # A goal that was taught beside a wall must be reachable, too.
        tight = min(now.limits.clearance_m, max(APPROACH.goal_clearance_m, room - 0.01))
        backwards = now.limits.max_reverse if context.local_costmap.sees_behind(place) else 0.0
        limits = now.limits._replace(
            max_speed=speed, max_reverse=min(backwards, speed), clearance_m=tight
        )
        was_turning = alignment.is_turning
        steady = Motion(now.steady, now.motion.twist)
        wanted = alignment.command(steady, self.aim, limits, now.elapsed_s)
        if wanted is None:
            self._finish()
            return Twist2D.zero()
        if alignment.is_turning and not was_turning:
            self._choose_turn(alignment, place, tight)
        wanted = limited_change(now.motion.twist, wanted, limits, now.elapsed_s)
        return safe_command(now.motion, wanted, context.local_costmap, limits)

    def turn_elsewhere(self, pose: Pose2D) -> bool:
        """Go to where there is room to turn, if the robot is on the goal and cannot turn.

        Args:
            pose: of the robot.

        Returns:
            Whether there is such a place; `detour` leads there.
        """
        alignment = self._alignment
        if alignment is None or not alignment.is_turning or self._has_turned_elsewhere:
            return False
        self._has_turned_elsewhere = True
        context, clearance = self._context, self._config.clearance_m
        room = context.seen_clearance(self.aim, clearance)
        turning_place = find_turning_place(context, self.aim, clearance + 0.01, room - 0.01)
        if turning_place is None:
            return False
        costmap = context.costmap
        place = (turning_place.pose.x, turning_place.pose.y)
        path = context.planner.plan((pose.x, pose.y), [place], costmap.weights, costmap.distance_m)
        if path is None:
            return False
        self._turning_place, self._final = turning_place, self.aim
        self.aim, self._alignment, self.detour = turning_place.pose, None, path
        return True

    def _choose_turn(self, alignment: FinalAlignment, pose: Pose2D, clearance_m: float) -> None:
        """Turn the longer way around where only that is free, or else somewhere else."""
        turn = wrap_angle(self.aim.yaw - pose.yaw)
        longer = turn - math.copysign(2.0 * math.pi, turn)
        if self._tolerances.any_heading or can_turn_by(self._context, pose, turn, clearance_m):
            return
        if can_turn_by(self._context, pose, longer, clearance_m):
            alignment.turn_longer_way(longer)
        else:
            self.turn_elsewhere(pose)

    def _finish(self) -> None:
        """Finish on the goal, or drive on to it from the turning place."""
        turning_place = self._turning_place
        if turning_place is None:
            self.has_arrived = True
            return
        line = np.array(
            [[turning_place.pose.x, turning_place.pose.y], [self._final.x, self._final.y]]
        )
        length = turning_place.pose.distance_to(self._final)
        self.detour = PlannedPath.join([subdivide(line, SPACING_M)], length)
        self.aim, self._turning_place, self._is_docking = self._final, None, True
        self._alignment = FinalAlignment(self._tolerances, turning_place.is_reverse)


@dataclass(frozen=True, slots=True)
class TurningPlace:
    """Where to turn, and how to go on from there to the goal."""

    pose: Pose2D
    """In `grid`, with the goal's heading."""
    is_reverse: bool
    """Whether the goal lies behind it."""


def find_turning_place(
    context: PlanningContext, goal: Pose2D, clearance_m: float, at_goal_m: float
) -> TurningPlace | None:
    """Return the nearest place before or behind the goal from which a straight line leads onto it.

    The local costmap must be centred near the goal.

    Args:
        context: costmaps and planner.
        goal: in `grid`.
        clearance_m: to keep while turning.
        at_goal_m: to keep on the straight line, at most what the goal itself has.
    """
    for distance in APPROACH.turning_distances_m:
        for is_reverse in (False, True):
            pose = goal @ Pose2D(distance if is_reverse else -distance, 0.0, 0.0)
            if _can_turn(context, pose, clearance_m) and _is_free(context, pose, goal, at_goal_m):
                return TurningPlace(pose, is_reverse)
    return None


def can_turn_by(context: PlanningContext, pose: Pose2D, turn: float, clearance_m: float) -> bool:
    """Say whether the robot can turn in place by an angle [rad], to the left if positive."""
    count = max(1, math.ceil(abs(turn) / APPROACH.turn_step_rad))
    return all(
        context.seen_clearance(Pose2D(pose.x, pose.y, pose.yaw + turn * index / count), clearance_m)
        >= clearance_m
        for index in range(1, count + 1)
    )


def _can_turn(context: PlanningContext, pose: Pose2D, clearance_m: float) -> bool:
    """Say whether the robot can make a full turn at a place."""
    if not context.costmap.contains(pose.x, pose.y):
        return False
    turns = (
        index * 2.0 * math.pi / APPROACH.num_headings for index in range(APPROACH.num_headings)
    )
    return all(
        context.seen_clearance(Pose2D(pose.x, pose.y, turn), clearance_m) >= clearance_m
        for turn in turns
    )


def _is_free(context: PlanningContext, start: Pose2D, goal: Pose2D, clearance_m: float) -> bool:
    """Say whether the straight line between two poses of one heading is free."""
    count = max(2, math.ceil(start.distance_to(goal) / APPROACH.step_m))
    for index in range(count + 1):
        share = index / count
        pose = Pose2D(
            start.x + share * (goal.x - start.x), start.y + share * (goal.y - start.y), goal.yaw
        )
        if context.seen_clearance(pose, clearance_m) < clearance_m:
            return False
    return True
