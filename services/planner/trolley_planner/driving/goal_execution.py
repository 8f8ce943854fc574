"""Driving to one goal: along the route, onto the goal, and free again from what is in the way."""

import math
from dataclasses import replace
from typing import Literal

import numpy as np

from trolley import codes
from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D, wrap_angle
from trolley_planner.context.motion_state import Situation
from trolley_planner.context.planning_context import Rig
from trolley_planner.control.controller import Motion, safe_command
from trolley_planner.control.local_costmap import TIGHT_M
from trolley_planner.control.path_timing import seconds_along
from trolley_planner.control.proximity import STANDS_MPS
from trolley_planner.control.rollout import GIVE_M, Limits, Target
from trolley_planner.driving.contact_hold import TouchWatch
from trolley_planner.driving.final_alignment import limited_change
from trolley_planner.driving.goal_approach import Arrival, can_turn_by
from trolley_planner.driving.progress_checker import ProgressChecker
from trolley_planner.driving.recovery import (
    LOOKBACK_M,
    BackUp,
    Recovery,
    Trail,
    Try,
    TurnRound,
    free_turn,
)
from trolley_planner.driving.route import PASS_M, Route
from trolley_planner.goals.goal import Goal
from trolley_planner.paths.path import PlannedPath

BLOCKED_S = 0.7
"""So long no way must be found before the robot begins to try things."""
FORGET_M = 1.5
"""How far around the robot what the lidar saw is forgotten in the try to look again."""
CLOSE_M = 0.2
"""Radius of the place on the path that is closed where the robot did not get through."""
ON_GOAL_M, TAKEN_M = 0.1, 0.5
"""The robot waits between these distances from a goal that something stands on,"""
TAKEN_PATIENCE = 4.0
"""for so many times the usual patience."""
YIELD_M = 0.8
"""Who walks this near to the robot may be why it stands."""


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
        vias = [rig.costmap.to_grid(via) for via in goal.vias]
        self.route = Route(rig, config, [*vias, self.goal_grid], path)
        self.recovery = Recovery(config)
        self._progress = ProgressChecker(config)
        self._trail = Trail()
        self._ahead_m = rig.footprint.circumscribed_m + CLOSE_M + 0.1
        self._touch = TouchWatch(rig.footprint, config.patience_s)
        self._maneuver: BackUp | TurnRound | None = None
        self._waits_for = False
        self._no_way_s = 0.0
        self._held_s = 0.0
        self._has_way = True
        self._taken_s = 0.0
        self._arrival = Arrival(rig, config, self.goal_grid, goal.tolerances)
        self._num_routes = 1
        self._replan_now = False
        self._timed: tuple[str, float] | None = None
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

    def go_on(self, waited_ns: int) -> None:
        """Drive on after the robot gave way: that time does not count, and the way may be new."""
        self.recovery.excuse(waited_ns)
        self._end_try()

    @property
    def path_key(self) -> str:
        """What changes whenever the path does."""
        return f"{self.goal.id}/{self.started_ns}/{self._num_routes}/{self.route.changes}"

    def seconds_left(self, pose: Pose2D, limits: Limits) -> float:
        """Return how long the way that is left will take [s]."""
        route = self.route
        key = (self.path_key, limits.max_speed)
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
        window.look(pose.x, pose.y, self.route.is_tight_here)
        costmap = self.rig.costmap
        self._touch.note(now_ns, costmap.echoes.beams, costmap.moving.movers, pose)
        self.route.follow(pose)
        if not self.route.vias_left and self._arrival.look(pose):
            self.route.retarget(self._arrival.aim)
            self._replan_now = True
        stretch = self.route.stretch(1.5 * self.rig.half_m)
        path = self.route.path
        part = slice(stretch.first, stretch.last + 1)
        self._has_way = window.lead(
            path.points[part], path.remaining_m[part] - path.remaining_m[stretch.last]
        )

    def maintain(self, now: Situation) -> None:
        """Do what takes longer and need not come before the command: look for a better path."""
        changes = self.route.changes
        self.route.maintain(now.motion.pose, now.now_ns, self._replan_now)
        self._replan_now = False
        if self.route.changes != changes:
            self.recovery.note_path(self.route.remaining_m(now.motion.pose))

    def command(self, now: Situation) -> Twist2D:
        """Return the velocity to drive now; sets `outcome` when the drive is over."""
        self.rig.window.watch(now.now_ns)
        self.route.follow(now.motion.pose)
        driven = self._drive_on(now)
        if self._touch.must_stand(now.now_ns):
            self.rig.controller.reset()
            driven = Twist2D.zero()
        is_held = abs(driven.vx) < STANDS_MPS and self._is_held(now)
        self._held_s = self._held_s + now.elapsed_s if is_held else 0.0
        # Where that lasts its time runs: who never gets on must give up.
        if is_held and self.recovery.current is None and self._held_s < self._config.patience_s:
            self.recovery.excuse(round(now.elapsed_s * 1e9))
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
        if self._arrival.is_active:
            return pose.distance_to(self._arrival.aim)
        return self.route.remaining_m(pose)

    def place_ahead(self) -> tuple[float, float]:
        """Return the place on the way that is right before the robot, x, y in `grid` [m]."""
        path = self.route.path
        x, y = path.points[path.ahead(self.route.index, self._ahead_m)]
        return float(x), float(y)

    def _wanted(self, now: Situation) -> Twist2D:
        """Return the velocity of the approach or of the controller, made safe."""
        arrival, route = self._arrival, self.route
        if not route.vias_left and arrival.takes_over(now.steady, route.remaining_m(now.steady)):
            twist = arrival.command(now)
            self._take_detour()
            if arrival.has_arrived:
                self.outcome = "arrived"
            return twist
        stretch = self.route.stretch(1.5 * self.rig.half_m)
        target = Target(
            stretch.target.x,
            stretch.target.y,
            0.5 * self.goal.tolerances.xy if stretch.is_goal else PASS_M,
            not stretch.is_goal,
        )
        controller, limits = self.rig.controller, now.limits
        if route.is_tight_here:
            limits = limits._replace(clearance_m=min(TIGHT_M, limits.clearance_m))
        found = controller.command(now.motion, self.rig.window, limits, target, now.elapsed_s)
        if found is None:
            return Twist2D.zero()
        return safe_command(now.motion, found, self.rig.window, limits, GIVE_M)

    def _take_detour(self) -> None:
        """Take over the path of an arrival that goes somewhere else first."""
        path, self._arrival.detour = self._arrival.detour, None
        if path is not None:
            self.route = Route(self.rig, self._config, [self._arrival.aim], path)
            self._num_routes += 1
            self._progress.reset()

    def _is_goal_taken(self, now: Situation) -> bool:
        """Say whether to stand before the goal because something stands on it; fail if it stays."""
        remaining = self.remaining_m(now.motion.pose)
        # Who is on the goal already has only to turn, or fails to.
        is_near = ON_GOAL_M < remaining < self.rig.footprint.circumscribed_m + TAKEN_M
        # A thing is seen from one side: where no way leads to the goal any more it stands there.
        is_taken = self._arrival.is_occupied or self.route.is_blocked
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
        pose = now.motion.pose
        left = self._arrival.left_m(pose) if self._arrival.is_active else self.remaining_m(pose)
        trouble = self._progress.check(now.now_ns, left, pose, now.odom_T_base)
        stands = abs(now.motion.twist.vx) < 0.03 and abs(now.motion.twist.wz) < 0.1
        if trouble is None and self._no_way_s > BLOCKED_S and stands:
            trouble = codes.BLOCKED
        if trouble is not None:
            self.trouble = trouble
            if self._arrival.turn_elsewhere(now.motion.pose):
                self._take_detour()
            else:
                self._begin_try(now)

    def _begin_try(self, now: Situation) -> None:
        """Begin the next try to get free, or give up."""
        self._maneuver = None
        self._waits_for = not self._is_way_free(now)
        chosen = self.recovery.begin(now.now_ns, lambda one: self._prepare(one, now))
        if chosen is None:
            self.recovery.end()
            self.outcome = "failed"
        elif chosen is Try.CLEAR:
            pose = now.motion.pose
            self.rig.costmap.echoes.forget_around(pose.x, pose.y, FORGET_M)

    def _is_way_free(self, now: Situation) -> bool:
        """Say whether nothing that is seen keeps the robot from driving on."""
        return self._has_way and not self.route.is_blocked and not self._is_held(now)

    def _is_held(self, now: Situation) -> bool:
        """Say whether somebody may be why the robot stands: they touch it, or walk near it."""
        near_m = self.rig.footprint.circumscribed_m + YIELD_M
        walks_near = self.rig.window.sees_somebody(now.motion.pose, near_m)
        return walks_near or self._touch.must_stand(now.now_ns)

    def _prepare(self, wanted: Try, now: Situation) -> bool:
        """Get ready for a try that moves the robot; say whether there is room for it."""
        pose, rig = now.motion.pose, self.rig
        if wanted is Try.BACK_UP:
            self._maneuver = BackUp(now.odom_T_base, self._config.back_up_m)
            first = self._trail.back(now.odom_T_base, LOOKBACK_M)
            if first is None or self._config.back_up_m == 0.0:
                return False
            place = pose @ now.odom_T_base.inverse() @ first
            least = min(now.limits.clearance_m, rig.seen_clearance(pose, now.limits.clearance_m))
            return rig.seen_clearance(place, now.limits.clearance_m) >= least
        if wanted is Try.TURN:
            turn = free_turn(
                lambda angle: can_turn_by(rig, pose, angle, now.limits.clearance_m),
                self._bearing_of_way(pose),
            )
            self._maneuver = None if turn is None else TurnRound(now.odom_T_base, turn)
            return turn is not None
        self._maneuver = None
        return self._close_way(now)

    def _close_way(self, now: Situation) -> bool:
        """Close the way right ahead; say whether there is another one, else it stays open."""
        costmap, pose = self.rig.costmap, now.motion.pose
        if self.remaining_m(pose) < self._ahead_m + 2.0 * CLOSE_M:
            return False
        x, y = self.place_ahead()
        costmap.close(x, y, CLOSE_M, now.now_ns)
        costmap.refresh()
        vias = [costmap.to_grid(via) for via in self.rest().vias]
        places = [(place.x, place.y) for place in (*vias, self.route.goal)]
        start, weights = (pose.x, pose.y), costmap.weights
        if self.rig.planner.plan(start, places, weights, costmap.distance_m) is not None:
            return True
        costmap.reopen()
        return False

    def _bearing_of_way(self, pose: Pose2D) -> float:
        """Return the bearing of the way that is left, from the robot's heading [rad]."""
        ahead = self.route.path.points[self.route.path.ahead(self.route.index, 0.5)]
        bearing = math.atan2(float(ahead[1]) - pose.y, float(ahead[0]) - pose.x)
        return wrap_angle(bearing - pose.yaw)

    def _get_free(self, now: Situation) -> Twist2D:
        """Return the velocity of the present try, and end it when it is over."""
        current = self.recovery.current
        lasted = self.recovery.elapsed_s(now.now_ns)
        wanted: Twist2D | None = Twist2D.zero()
        if current in (Try.WAIT, Try.WAIT_LONGER):
            if self._is_way_free(now) and lasted > 0.5:
                if self._waits_for:
                    self.recovery.forgive(now.now_ns)
                self._end_try()
            elif not self.recovery.is_patient(now.now_ns):
                self._begin_try(now)
        elif current in (Try.CLEAR, Try.REROUTE):
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
        self._arrival.let_go()
        self._progress.reset()
        self._no_way_s = 0.0
        self._replan_now = True
        self.rig.controller.reset()
