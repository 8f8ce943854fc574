"""Driving to one goal: along the route, onto the goal, and free again from what is in the way."""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from trolley import codes
from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D, wrap_angle
from trolley_planner.approach import START_M, Approach, Tolerances, limited_change
from trolley_planner.closing import ClosingWatch
from trolley_planner.controller import Motion, safe_command
from trolley_planner.escape import BackUp, TurnRound
from trolley_planner.goal import Goal, free_pose_near
from trolley_planner.kernels.rollout import GIVE_M, Limits, Target, allowed_speed
from trolley_planner.movers import MoverWatch
from trolley_planner.path import SPACING_M, PlannedPath, resample
from trolley_planner.progress import ProgressChecker
from trolley_planner.recovery import Recovery, Trail, Try
from trolley_planner.rig import Rig
from trolley_planner.route import PASS_M, Route
from trolley_planner.staging import Stage, find_stage
from trolley_planner.timing import seconds_along

BLOCKED_S = 0.7
"""So long no way must be found before the robot begins to try things."""
FORGET_M = 1.5
"""How far around the robot what the lidar saw is forgotten in the try to look again."""
ON_GOAL_M, TAKEN_M = 0.1, 0.5
"""The robot waits between these distances from a goal that something stands on,"""
TAKEN_PATIENCE = 4.0
"""for so many times the usual patience."""
TURN_AS_WAY_M = 0.3
"""A radian that is left at the goal counts as this much of the way."""
GOAL_CLEARANCE_M = 0.005
"""More than this is left of the clearance at a tight goal."""


@dataclass(frozen=True, slots=True)
class Situation:
    """What a command is computed from.

    Attributes:
        now_ns: robot time.
        motion: in `grid`, with the velocity that was commanded last.
        steady: the pose in `grid` without the noise of the localizer, for the final approach.
        odom_T_base: by the wheels alone.
        limits: of the robot at the moment.
        elapsed_s: since the last command.
    """

    now_ns: int
    motion: Motion
    steady: Pose2D
    odom_T_base: Pose2D
    limits: Limits
    elapsed_s: float


class Drive:
    """One goal on its way.

    Args:
        goal: where to, in the frame of the goals.
        rig: costmap, planners.
        config: of the planner.
        path: the first plan, in `grid`.
        now_ns: robot time.
    """

    def __init__(
        self, goal: Goal, rig: Rig, config: PlannerConfig, path: PlannedPath, now_ns: int
    ) -> None:
        self.goal = goal
        self.started_ns = now_ns
        self.rig = rig
        self._config = config
        self.goal_grid = rig.costmap.to_grid(goal.pose)
        self._aim = self.goal_grid
        vias = [rig.costmap.to_grid(via) for via in goal.vias]
        self.route = Route(rig, config, [*vias, self.goal_grid], path)
        self.recovery = Recovery(config)
        self._progress = ProgressChecker(config)
        self._approach: Approach | None = None
        self._trail = Trail()
        self._movers = MoverWatch()
        self._closing = ClosingWatch(rig.footprint.circumscribed_m)
        self._maneuver: BackUp | TurnRound | None = None
        self._no_way_s = 0.0
        self._has_way = True
        self._is_occupied = False
        self._taken_s = 0.0
        self._stage: Stage | None = None
        self._final_aim = self._aim
        self._was_staged = False
        self._is_docking = False
        self._replan_now = False
        self._timed: tuple[int, float] | None = None
        self._seconds = np.zeros(1)
        self.outcome: Literal["arrived", "failed"] | None = None
        self.is_waiting = False
        """Whether it stands before a goal that something stands on."""
        self.trouble = ""
        """Code of what is wrong while it tries to get free, and of why it failed."""
        rig.controller.reset()

    def rest(self) -> Goal:
        """Return the goal without the via points that were passed."""
        left = self.route.vias_left
        return replace(self.goal, vias=self.goal.vias[len(self.goal.vias) - left :])

    def replan(self) -> None:
        """Plan anew at the next opportunity, as after a jump of the pose."""
        self._replan_now = True
        self._movers.reset()

    def seconds_left(self, pose: Pose2D, limits: Limits) -> float:
        """Return how long the way that is left will take [s]."""
        route = self.route
        key = (route.changes, limits.max_speed)
        if key != self._timed:
            self._timed = key
            self._seconds = seconds_along(route.path.points, pose.yaw, self.rig.costmap, limits)
        turn = 0.0
        if not self.goal.tolerances.any_heading:
            points = route.path.points
            arrival = points[-1] - points[route.path.ahead(0, max(route.path.length_m - 0.3, 0.0))]
            bearing = math.atan2(float(arrival[1]), float(arrival[0]))
            turn = abs(wrap_angle(self.goal_grid.yaw - bearing)) / limits.max_turn
        return float(self._seconds[-1] - self._seconds[route.index]) + turn

    def look(self, motion: Motion, now_ns: int) -> None:
        """Take in a new scan: distances in the window, and the way through it."""
        pose, window = motion.pose, self.rig.window
        window.look(pose.x, pose.y)
        self._watch_movers(motion, now_ns)
        self.route.follow(pose)
        self._adjust_aim(pose)
        stretch = self.route.stretch(1.5 * self.rig.half_m)
        path = self.route.path
        part = slice(stretch.first, stretch.last + 1)
        self._has_way = window.lead(
            path.points[part], path.remaining_m[part] - path.remaining_m[stretch.last]
        )

    def _watch_movers(self, motion: Motion, now_ns: int) -> None:
        """Look for who moves, and whether they come into the robot's way."""
        costmap = self.rig.costmap
        movers = self._movers.look(
            now_ns, costmap.echoes.beams, costmap.wall_distance_m, costmap.resolution_m
        )
        braking = 1.5 * self._config.acceleration_mps2
        self._closing.note(now_ns, movers, motion.pose, motion.twist, braking)

    def maintain(self, now: Situation) -> None:
        """Do what takes longer and need not come before the command: look for a better path."""
        changes = self.route.changes
        self.route.maintain(now.motion.pose, now.now_ns, self._replan_now)
        self._replan_now = False
        if self.route.changes != changes:
            self.recovery.note_path(self.route.remaining_m(now.motion.pose))

    def command(self, now: Situation) -> Twist2D:
        """Return the velocity to drive now; sets `outcome` when the drive is over."""
        self.route.follow(now.motion.pose)
        driven = self._drive_on(now)
        if self._closing.must_stand(now.now_ns):
            # What was wanted is dropped, but its time runs: who never gets on must give up.
            self.rig.controller.reset()
            driven = Twist2D.zero()
        if self._maneuver is not None:
            self._maneuver.note(driven, now.elapsed_s)
        return driven

    def _drive_on(self, now: Situation) -> Twist2D:
        """Return the velocity to drive now, whoever walks about."""
        if self.recovery.current is not None:
            return self._get_free(now)
        self._trail.drop(now.odom_T_base)
        remaining = self.remaining_m(now.motion.pose)
        self.recovery.note_remaining(remaining)
        if self._is_goal_taken(now):
            return limited_change(now.motion.twist, Twist2D.zero(), now.limits, now.elapsed_s)
        wanted = self._wanted(now)
        if self.outcome is not None:
            return Twist2D.zero()
        self._check(now)
        return wanted

    def remaining_m(self, pose: Pose2D) -> float:
        """Return the length of the way that is left [m]."""
        if self._approach is not None:
            return pose.distance_to(self._aim)
        return self.route.remaining_m(pose)

    def _left(self, pose: Pose2D) -> float:
        """Return what is left to do [m]: at the goal the turn counts, too."""
        if self._approach is None or self.goal.tolerances.any_heading:
            return self.remaining_m(pose)
        turn = abs(wrap_angle(self._aim.yaw - pose.yaw))
        return self.remaining_m(pose) + TURN_AS_WAY_M * turn

    def _wanted(self, now: Situation) -> Twist2D:
        """Return the velocity of the approach or of the controller, made safe."""
        steady = Motion(now.steady, now.motion.twist)
        if self._is_near(steady.pose):
            if self._approach is None:
                offset = self._aim.distance_to(self.goal_grid)
                tolerances = self.goal.tolerances
                self._approach = Approach(
                    Tolerances(max(tolerances.xy - offset, 0.3 * tolerances.xy), tolerances.yaw)
                )
            return self._come_near(now, steady, self._approach)
        self._approach = None
        stretch = self.route.stretch(1.5 * self.rig.half_m)
        target = Target(
            stretch.target.x,
            stretch.target.y,
            0.5 * self.goal.tolerances.xy if stretch.is_goal else PASS_M,
            not stretch.is_goal,
        )
        controller = self.rig.controller
        found = controller.command(now.motion, self.rig.window, now.limits, target, now.elapsed_s)
        if found is None:
            return Twist2D.zero()
        return safe_command(now.motion, found, self.rig.window, now.limits, GIVE_M)

    def _come_near(self, now: Situation, steady: Motion, approach: Approach) -> Twist2D:
        """Return the velocity of the final approach."""
        room = self.rig.seen_clearance(self._aim, now.limits.caution_m)
        here = self.rig.seen_clearance(now.motion.pose, now.limits.caution_m)
        field = self.rig.window.field
        speed = allowed_speed(field, now.limits, now.motion.pose.x, now.motion.pose.y, here)
        # A goal that was taught beside a wall must be reachable, too.
        tight = min(now.limits.clearance_m, max(GOAL_CLEARANCE_M, room - 0.01))
        limits = now.limits._replace(
            max_speed=speed, max_reverse=min(now.limits.max_reverse, speed), clearance_m=tight
        )
        wanted = approach.command(steady, self._aim, limits, now.elapsed_s)
        if wanted is None:
            if self._stage is None:
                self.outcome = "arrived"
            else:
                self._leave_stage(self._stage)
            return Twist2D.zero()
        wanted = limited_change(now.motion.twist, wanted, limits, now.elapsed_s)
        return safe_command(now.motion, wanted, self.rig.window, limits)

    def _is_near(self, pose: Pose2D) -> bool:
        """Say whether the final approach drives: near, and nothing between."""
        if self.route.vias_left:
            return False
        distance = pose.distance_to(self._aim)
        if self._approach is not None:
            return self._is_docking or distance < 2.0 * START_M
        if distance > START_M or self.route.remaining_m(pose) > 2.0 * START_M:
            return False
        bearing = math.atan2(self._aim.y - pose.y, self._aim.x - pose.x)
        for share in (0.25, 0.5, 0.75):
            x = pose.x + share * (self._aim.x - pose.x)
            y = pose.y + share * (self._aim.y - pose.y)
            clearance = self.rig.seen_clearance(Pose2D(x, y, bearing), 0.1)
            if clearance < self._config.clearance_m and distance > 0.1:
                return False
        return True

    def _adjust_aim(self, pose: Pose2D) -> None:
        """Aim beside the goal, within its tolerance, where something stands on it."""
        is_far = pose.distance_to(self.goal_grid) > self.rig.half_m - 0.6
        if self.route.vias_left or is_far or self._stage is not None or self._is_docking:
            return
        enough = self._config.clearance_m + 0.01
        clearance = self.rig.seen_clearance(self._aim, enough)
        if clearance >= GOAL_CLEARANCE_M + 0.01:
            self._is_occupied = False
            return
        found = free_pose_near(
            self.goal_grid,
            self.goal.tolerances,
            lambda candidate: self.rig.seen_clearance(candidate, enough),
            enough,
        )
        if found is None:
            self._is_occupied = True
            return
        self._is_occupied = False
        if found != self._aim:
            self._aim = found
            self._approach = None
            self.route.retarget(found)
            self._replan_now = True

    def _is_goal_taken(self, now: Situation) -> bool:
        """Say whether to stand before the goal because something stands on it; fail if it stays."""
        remaining = self.remaining_m(now.motion.pose)
        # Who is on the goal already has only to turn, or fails to.
        is_near = ON_GOAL_M < remaining < self.rig.footprint.circumscribed_m + TAKEN_M
        # A thing is seen from one side: where no way leads to the goal any more it stands there.
        is_taken = self._is_occupied or self.route.is_blocked
        if is_taken and is_near:
            self._taken_s += now.elapsed_s
        else:
            self._taken_s = max(0.0, self._taken_s - 0.2 * now.elapsed_s)
        self.is_waiting = is_taken and is_near
        if self._taken_s > TAKEN_PATIENCE * self._config.patience_s:
            self.trouble = codes.BLOCKED
            self.is_waiting = True
            self.outcome = "failed"
        elif self.is_waiting:
            self.trouble = codes.BLOCKED
            self._progress.reset()
        return self.is_waiting

    def _check(self, now: Situation) -> None:
        """Begin to try things when there is no way, or the robot does not get nearer."""
        self._no_way_s = 0.0 if self._has_way else self._no_way_s + now.elapsed_s
        trouble = self._progress.check(
            now.now_ns, self._left(now.motion.pose), now.motion.pose, now.odom_T_base
        )
        stands = abs(now.motion.twist.vx) < 0.03 and abs(now.motion.twist.wz) < 0.1
        if trouble is None and self._no_way_s > BLOCKED_S and stands:
            trouble = codes.BLOCKED
        if trouble is not None:
            self.trouble = trouble
            if not self._go_to_stage(now):
                self._begin_try(now)

    def _go_to_stage(self, now: Situation) -> bool:
        """Where there is no room to turn on the goal, turn beside it and come in straight."""
        approach = self._approach
        if approach is None or not approach.is_turning or self._was_staged:
            return False
        self._was_staged = True
        room = self.rig.seen_clearance(self._aim, self._config.clearance_m)
        stage = find_stage(self.rig, self._aim, now.limits.clearance_m + 0.01, room - 0.01)
        if stage is None:
            return False
        rig, here = self.rig, now.motion.pose
        path = rig.planner.plan(
            (here.x, here.y),
            [(stage.pose.x, stage.pose.y)],
            rig.costmap.weights,
            rig.costmap.distance_m,
        )
        if path is None:
            return False
        self._stage, self._final_aim = stage, self._aim
        self._aim, self._approach = stage.pose, None
        self.route = Route(rig, self._config, [stage.pose], path)
        self._progress.reset()
        return True

    def _leave_stage(self, stage: Stage) -> None:
        """Come in straight from beside the goal."""
        line = np.array([[stage.pose.x, stage.pose.y], [self._final_aim.x, self._final_aim.y]])
        self._aim, self._stage, self._is_docking = self._final_aim, None, True
        path = PlannedPath.join([resample(line, SPACING_M)], stage.pose.distance_to(self._aim))
        self.route = Route(self.rig, self._config, [self._aim], path)
        self._approach = Approach(self.goal.tolerances, stage.is_reverse)
        self._progress.reset()

    def _begin_try(self, now: Situation) -> None:
        """Begin the next try to get free, or give up."""
        self._maneuver = None
        chosen = self.recovery.begin(now.now_ns)
        if chosen is None:
            self.recovery.end()
            self.outcome = "failed"
        elif chosen is Try.CLEAR:
            pose = now.motion.pose
            self.rig.costmap.echoes.forget_around(pose.x, pose.y, FORGET_M)
        elif chosen is Try.BACK_UP:
            self._maneuver = BackUp(now.odom_T_base, self._config.back_up_m)
        elif chosen is Try.TURN:
            self._maneuver = TurnRound(now.odom_T_base, self._turn_to_way(now.motion.pose))

    def _turn_to_way(self, pose: Pose2D) -> float:
        """Return a full turn, begun towards the way that is left."""
        ahead = self.route.path.points[self.route.path.ahead(self.route.index, 0.5)]
        bearing = math.atan2(float(ahead[1]) - pose.y, float(ahead[0]) - pose.x)
        return math.copysign(2.0 * math.pi, wrap_angle(bearing - pose.yaw))

    def _get_free(self, now: Situation) -> Twist2D:
        """Return the velocity of the present try, and end it when it is over."""
        current = self.recovery.current
        lasted = self.recovery.elapsed_s(now.now_ns)
        wanted: Twist2D | None = Twist2D.zero()
        if current in (Try.WAIT, Try.WAIT_LONGER):
            is_free = self._has_way and not self.route.is_blocked and lasted > 0.5
            if is_free:
                self._end_try()
            elif not self.recovery.is_patient(now.now_ns):
                self._begin_try(now)
        elif current is Try.CLEAR:
            # Two scans or so show again what is really there.
            if lasted > 0.5:
                self._end_try()
        elif isinstance(self._maneuver, BackUp):
            wanted = self._maneuver.command(now.odom_T_base, self._trail, now.limits)
        elif isinstance(self._maneuver, TurnRound):
            wanted = self._maneuver.command(now.odom_T_base, now.limits)
        if wanted is None:
            self._end_try()
            wanted = Twist2D.zero()
        wanted = limited_change(now.motion.twist, wanted, now.limits, now.elapsed_s)
        return safe_command(now.motion, wanted, self.rig.window, now.limits)

    def _end_try(self) -> None:
        self.recovery.end()
        self._maneuver = None
        self._approach = None
        self._is_docking = False
        self._progress.reset()
        self._no_way_s = 0.0
        self._replan_now = True
        self.rig.controller.reset()
