"""Driving to one goal: along the route, onto the goal, and free again where the path is blocked."""

import math
from dataclasses import dataclass, replace
from typing import Literal

from trolley import codes
from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D, wrap_angle
from trolley_planner.context.motion_state import ControlInput
from trolley_planner.context.planning_context import PlanningContext
from trolley_planner.control.controller import Motion, limited_change, safe_command
from trolley_planner.control.local_costmap import TIGHT_CLEARANCE_M
from trolley_planner.control.proximity import PROXIMITY
from trolley_planner.control.rollout import ROLLOUT, Limits, Target
from trolley_planner.driving.goal_approach import GoalApproach
from trolley_planner.driving.maneuvering import Maneuvering
from trolley_planner.driving.recovery import (
    RECOVERY,
    BackUp,
    Breadcrumbs,
    ContactHold,
    LookAgain,
    ProgressChecker,
    Recovery,
    RecoveryAction,
    Spin,
    Wait,
    free_turn,
)
from trolley_planner.driving.route import PASS_M, PathTimer, Route
from trolley_planner.goals import Goal, Tolerances
from trolley_planner.paths.path import PlannedPath


@dataclass(frozen=True, slots=True)
class ExecutionParams:
    """When the robot waits, tries to get free and gives up; all by hand."""

    no_path_s: float = 0.7
    """Recovery begins when the local costmap has held no path for this long."""
    standing_mps: float = 0.03
    """A robot slower than this,"""
    standing_radps: float = 0.1
    """and turning slower than this, counts as standing."""
    forget_radius_m: float = 1.5
    """What the lidar saw this near is forgotten when the robot looks again."""
    closed_radius_m: float = 0.2
    """Radius of the place on the path that is closed where the robot did not get through."""
    on_goal_m: float = 0.1
    """Nearer to an occupied goal than this the robot does not wait: it has only to turn."""
    wait_at_goal_m: float = 0.5
    """The robot waits this far before an occupied goal, measured from its outline."""
    goal_patience: float = 4.0
    """It waits there for this many times the usual patience."""
    yield_m: float = 0.8
    """Somebody moving this near to the outline may be why the robot stands."""


PARAMS = ExecutionParams()


class OccupiedGoal:
    """Waits before a goal that something stands on, for a limited time.

    Args:
        patience_s: how long in all.
    """

    def __init__(self, patience_s: float) -> None:
        self._patience_s = patience_s
        self._occupied_s = 0.0
        self.is_waiting = False
        """Whether the robot stands before the goal until it is free."""

    def update(self, is_waiting: bool, elapsed_s: float) -> bool:
        """Note whether the robot waits; False when it has waited long enough."""
        if is_waiting:
            self._occupied_s += elapsed_s
        else:
            self._occupied_s = max(0.0, self._occupied_s - 0.2 * elapsed_s)
        is_patient = self._occupied_s <= self._patience_s
        self.is_waiting = is_waiting or not is_patient
        return is_patient


class GoalExecution:
    """One goal while it is driven to.

    Args:
        goal: where to, in the frame of the goals.
        context: costmaps and planners.
        config: of the planner.
        path: the first plan, in `grid`.
        now_ns: robot time.
        hurries: it drives out of people's way, by a plan that knows when they come: it heeds them
            only where it would drive into them.
    """

    def __init__(
        self,
        goal: Goal,
        context: PlanningContext,
        config: PlannerConfig,
        path: PlannedPath,
        now_ns: int,
        hurries: bool = False,
    ) -> None:
        self.goal = goal
        self._hurries = hurries
        self.context = context
        self.goal_grid = context.costmap.to_grid(goal.pose)
        vias = [context.costmap.to_grid(via) for via in goal.vias]
        targets, any_heading = [*vias, self.goal_grid], goal.tolerances.any_heading
        self.route = Route(context, config, targets, path, any_heading)
        self.recovery = Recovery(config)
        self.outcome: Literal["arrived", "failed"] | None = None
        self.trouble = ""
        """Code of what is wrong during recovery, and of why it failed."""
        self._config = config
        self._started_ns = now_ns
        self._goal_approach = GoalApproach(context, config, self.goal_grid, goal.tolerances)
        self._maneuvering = Maneuvering(context, config, goal.tolerances)
        self._progress = ProgressChecker(config)
        self._trail = Breadcrumbs()
        self._contact_hold = ContactHold(context.footprint, config.patience_s)
        self._occupied_goal = OccupiedGoal(PARAMS.goal_patience * config.patience_s)
        self._timer = PathTimer()
        self._behavior: Wait | LookAgain | BackUp | Spin | None = None
        self._has_path = True
        self._no_path_s = 0.0
        self._held_s = 0.0
        self._must_replan = False
        context.controller.reset()

    # The cycle.

    def update(self, motion: Motion, now_ns: int) -> None:
        """Update the local costmap after a scan: distances, and the cost-to-go along the path."""
        pose, costmap = motion.pose, self.context.costmap
        local_costmap = self.context.local_costmap
        is_tight = self.route.is_tight_here or self._maneuvering.is_tight_ahead
        local_costmap.update(pose.x, pose.y, is_tight)
        self._contact_hold.update(now_ns, costmap.obstacle_layer.beams, costmap.moving.people, pose)
        self.route.update_position(pose)
        if not self.route.vias_left and self._goal_approach.update_aim(pose, self.route.is_blocked):
            self.route.retarget(self._goal_approach.aim)
            self._must_replan = True
        stretch = self.route.stretch(1.5 * self.context.half_m)
        path = self.route.path
        part = slice(stretch.first, stretch.last + 1)
        self._has_path = local_costmap.compute_cost_to_go(
            path.points[part], path.remaining_m[part] - path.remaining_m[stretch.last]
        )
        if self.recovery.current is None and not self._hurries:
            self._maneuvering.update(motion, self.route, self._goal_approach, now_ns)

    def command(self, now: ControlInput) -> Twist2D:
        """Return the velocity to drive now; sets `outcome` when it is over."""
        self.context.local_costmap.update_moving(now.now_ns)
        self.route.update_position(now.motion.pose)
        twist = self._follow_route(now) if self.recovery.current is None else self._recover(now)
        if self._contact_hold.must_stand(now.now_ns):
            self.context.controller.reset()
            twist = Twist2D.zero()
        self._excuse_while_held(twist, now)
        if isinstance(self._behavior, BackUp | Spin):
            self._behavior.update(twist, now.elapsed_s)
        return twist

    def replan_if_due(self, now: ControlInput) -> None:
        """Look for a better path, which takes longer and need not come before the command."""
        changes = self.route.changes
        self.route.replan_if_due(now.motion.pose, now.now_ns, self._must_replan)
        self._must_replan = False
        if self.route.changes != changes:
            self.recovery.update_path_length(self.route.remaining_m(now.motion.pose))

    def _follow_route(self, now: ControlInput) -> Twist2D:
        """Return the velocity along the route and onto the goal; may begin recovery."""
        self._trail.drop(now.odom_T_base)
        self.recovery.update_remaining(self.remaining_m(now.motion.pose))
        if self._waits_at_goal(now):
            return limited_change(now.motion.twist, Twist2D.zero(), now.limits, now.elapsed_s)
        approach, route = self._goal_approach, self.route
        if self._hurries:
            twist = self._hurry(now)
        elif self._maneuvering.is_active:
            twist = self._maneuver(now)
        elif not route.vias_left and approach.takes_over(now.steady, route.remaining_m(now.steady)):
            twist = self._approach_goal(now)
        else:
            twist = self._control(now)
        if self.outcome is not None:
            return Twist2D.zero()
        self._check_progress(now)
        return twist

    def _maneuver(self, now: ControlInput) -> Twist2D:
        """Return the velocity along a way with headings."""
        twist = self._maneuvering.command(now, self._goal_approach)
        if self._maneuvering.has_arrived:
            self.outcome = "arrived"
        elif not self._maneuvering.is_active:
            self.context.controller.reset()
        return twist

    def _hurry(self, now: ControlInput) -> Twist2D:
        """Return the velocity out of people's way: near the place is good enough."""
        if now.motion.pose.distance_to(self.goal_grid) < self.goal.tolerances.xy:
            self.outcome = "arrived"
        return self._control(now)

    def _approach_goal(self, now: ControlInput) -> Twist2D:
        """Return the velocity of the goal approach."""
        twist = self._goal_approach.command(now)
        if self._goal_approach.has_arrived:
            self.outcome = "arrived"
        return twist

    def _control(self, now: ControlInput) -> Twist2D:
        """Return the velocity of the controller, made safe."""
        context, limits = self.context, now.limits
        stretch = self.route.stretch(1.5 * context.half_m)
        target = Target(
            stretch.target.x,
            stretch.target.y,
            0.5 * self.goal.tolerances.xy if stretch.is_goal else PASS_M,
            not stretch.is_goal,
        )
        if self.route.is_tight_here:
            limits = limits._replace(clearance_m=min(TIGHT_CLEARANCE_M, limits.clearance_m))
        local_costmap = context.local_costmap
        if self._hurries:
            local_costmap.leave_people_out()
        found = context.controller.command(now.motion, local_costmap, limits, target, now.elapsed_s)
        local_costmap.update_moving(now.now_ns)
        if found is None:
            return Twist2D.zero()
        closer_m = ROLLOUT.same_clearance_m
        return safe_command(now.motion, found, local_costmap, limits, closer_m)

    # What is known of it.

    @property
    def is_waiting(self) -> bool:
        """Whether the robot stands before a goal that something stands on."""
        return self._occupied_goal.is_waiting

    @property
    def path_key(self) -> str:
        """What changes whenever the path does."""
        return f"{self.goal.id}/{self._started_ns}/{self.route.changes}"

    def remaining_goal(self) -> Goal:
        """Return the goal without the via points that were passed."""
        left = self.route.vias_left
        return replace(self.goal, vias=self.goal.vias[len(self.goal.vias) - left :])

    def remaining_m(self, pose: Pose2D) -> float:
        """Return the length of the path that is left [m]."""
        if self._maneuvering.is_active:
            return self._maneuvering.left_m
        if self._goal_approach.is_active:
            return pose.distance_to(self._goal_approach.aim)
        return self.route.remaining_m(pose)

    def eta_s(self, pose: Pose2D, limits: Limits) -> float:
        """Return how long the rest of the path will take [s]."""
        goal_yaw = None if self.goal.tolerances.any_heading else self.goal_grid.yaw
        path, index, costmap = self.route.path, self.route.index, self.context.costmap
        return self._timer.eta_s(self.path_key, path, index, pose, goal_yaw, costmap, limits)

    def point_ahead(self) -> tuple[float, float]:
        """Return the point of the path right before the robot, x, y in `grid` [m]."""
        path = self.route.path
        x, y = path.points[path.ahead(self.route.index, self._ahead_m)]
        return float(x), float(y)

    def replan(self) -> None:
        """Plan anew at the next opportunity, as after a jump of the pose."""
        self._must_replan = True

    def move_goal(self, goal: Goal) -> None:
        """Drive somewhere else from now on, as behind a person who walks on.

        Args:
            goal: in the frame of the goals, without via points.
        """
        self.goal, self.goal_grid = goal, self.context.costmap.to_grid(goal.pose)
        self._goal_approach = GoalApproach(
            self.context, self._config, self.goal_grid, goal.tolerances
        )
        self.route.retarget(self.goal_grid)
        self._progress.reset()
        self._must_replan = True
        self.outcome = None

    def stand(self) -> None:
        """Note that the robot stands on purpose, as near as it is to be to a person."""
        self.outcome = None
        self._progress.reset()
        self._goal_approach.let_go()
        self.context.controller.reset()

    def resume_after_wait(self, waited_ns: int) -> None:
        """Drive on after giving way: that time does not count, and another path may be better."""
        self.recovery.excuse(waited_ns)
        self._end_recovery_action()

    # What may go wrong.

    def _waits_at_goal(self, now: ControlInput) -> bool:
        """Say whether to stand before the goal because something is on it; fail if it stays."""
        remaining = self.remaining_m(now.motion.pose)
        reach_m = self.context.footprint.circumscribed_m + PARAMS.wait_at_goal_m
        is_near = PARAMS.on_goal_m < remaining < reach_m
        # Things are seen from one side only: if no path leads to the goal, it is occupied as well.
        is_occupied = self._goal_approach.is_occupied or self.route.is_blocked
        if not self._occupied_goal.update(is_occupied and is_near, now.elapsed_s):
            self.trouble = codes.BLOCKED
            self.outcome = "failed"
        elif self.is_waiting:
            self.trouble = codes.BLOCKED
            self._progress.reset()
        return self.is_waiting

    def _check_progress(self, now: ControlInput) -> None:
        """Begin recovery when there is no path, or the robot does not get nearer."""
        is_led = self._has_path or self._maneuvering.is_active
        self._no_path_s = 0.0 if is_led else self._no_path_s + now.elapsed_s
        pose, twist, approach = now.motion.pose, now.motion.twist, self._goal_approach
        left = approach.left_m(pose) if approach.is_active else self.remaining_m(pose)
        trouble = self._progress.check(now.now_ns, left, pose, now.odom_T_base)
        stands = abs(twist.vx) < PARAMS.standing_mps and abs(twist.wz) < PARAMS.standing_radps
        if trouble is None and self._no_path_s > PARAMS.no_path_s and stands:
            trouble = codes.BLOCKED
        if trouble is not None:
            self.trouble = trouble
            self._begin_recovery_action(now)

    def _excuse_while_held(self, twist: Twist2D, now: ControlInput) -> None:
        """Do not count time in which somebody holds the robot up, for as long as it is patient."""
        is_held = abs(twist.vx) < PROXIMITY.standing_mps and self._is_held(now)
        self._held_s = self._held_s + now.elapsed_s if is_held else 0.0
        if is_held and self.recovery.current is None and self._held_s < self._config.patience_s:
            self.recovery.excuse(round(now.elapsed_s * 1e9))

    def _is_path_free(self, now: ControlInput) -> bool:
        """Say whether nothing that is seen keeps the robot from driving on."""
        return self._has_path and not self.route.is_blocked and not self._is_held(now)

    def _is_held(self, now: ControlInput) -> bool:
        """Say whether somebody may be why the robot stands: they touch it, or move near it."""
        near_m = self.context.footprint.circumscribed_m + PARAMS.yield_m
        moves_near = self.context.local_costmap.is_anyone_near(now.motion.pose, near_m)
        return moves_near or self._contact_hold.must_stand(now.now_ns)

    # Recovery.

    def _recover(self, now: ControlInput) -> Twist2D:
        """Return the velocity of the present recovery behavior, and end it when it is over."""
        wanted: Twist2D | None = Twist2D.zero()
        has_settled = self.recovery.elapsed_s(now.now_ns) > RECOVERY.settle_s
        match self._behavior:
            case Wait(is_blocked):
                self._wait(is_blocked, has_settled, now)
            case LookAgain() if has_settled:
                self._end_recovery_action()
            case BackUp() as back_up:
                wanted = back_up.command(now.odom_T_base, self._trail, now.limits)
            case Spin() as spin:
                wanted = spin.command(now.odom_T_base, now.limits)
            case _:
                pass
        if wanted is None:
            self._end_recovery_action()
            wanted = Twist2D.zero()
        wanted = limited_change(now.motion.twist, wanted, now.limits, now.elapsed_s)
        return safe_command(now.motion, wanted, self.context.local_costmap, now.limits)

    def _wait(self, was_blocked: bool, has_settled: bool, now: ControlInput) -> None:
        """End a wait if the path is free, or begin the next action once patience ends."""
        if self._is_path_free(now) and has_settled:
            if was_blocked:
                self.recovery.forgive(now.now_ns)
            self._end_recovery_action()
        elif not self.recovery.is_patient(now.now_ns):
            self._begin_recovery_action(now)

    def _begin_recovery_action(self, now: ControlInput) -> None:
        """Begin the next recovery action, or give up."""
        self._behavior = None
        self._maneuvering.stop()
        is_blocked = not self._is_path_free(now)
        chosen = self.recovery.begin_next(now.now_ns, lambda action: self._prepare(action, now))
        if chosen is None:
            self.recovery.end()
            self.outcome = "failed"
        elif chosen in (RecoveryAction.WAIT, RecoveryAction.WAIT_LONGER):
            self._behavior = Wait(is_blocked)
        elif chosen in (RecoveryAction.CLEAR, RecoveryAction.REROUTE):
            self._behavior = LookAgain()
        if chosen is RecoveryAction.CLEAR:
            pose = now.motion.pose
            obstacles = self.context.costmap.obstacle_layer
            obstacles.forget_around(pose.x, pose.y, PARAMS.forget_radius_m)

    def _prepare(self, action: RecoveryAction, now: ControlInput) -> bool:
        """Get ready for an action that moves the robot; say whether there is room for it."""
        pose, context, clearance_m = now.motion.pose, self.context, now.limits.clearance_m
        if action is RecoveryAction.BACK_UP:
            self._behavior = BackUp(now.odom_T_base, self._config.back_up_m)
            first = self._trail.backtrack(now.odom_T_base, RECOVERY.lookback_m)
            if first is None or self._config.back_up_m == 0.0:
                return False
            place = pose @ now.odom_T_base.inverse() @ first
            least = min(clearance_m, context.seen_clearance(pose, clearance_m))
            return context.seen_clearance(place, clearance_m) >= least
        self._behavior = None
        if action is RecoveryAction.TURN:
            turn = free_turn(
                lambda angle: context.can_turn_by(pose, angle, clearance_m),
                self._bearing_of_path(pose),
            )
            self._behavior = None if turn is None else Spin(now.odom_T_base, turn)
            return turn is not None
        return self._close_path_ahead(now)

    def _close_path_ahead(self, now: ControlInput) -> bool:
        """Close the path right ahead if there is another one; say whether there is."""
        costmap, pose = self.context.costmap, now.motion.pose
        if self.remaining_m(pose) < self._ahead_m + 2.0 * PARAMS.closed_radius_m:
            return False
        x, y = self.point_ahead()
        costmap.close(x, y, PARAMS.closed_radius_m, now.now_ns)
        costmap.refresh()
        vias = [costmap.to_grid(via) for via in self.remaining_goal().vias]
        places = [(place.x, place.y) for place in (*vias, self.route.goal)]
        start, weights = (pose.x, pose.y), costmap.weights
        if self.context.planner.plan(start, places, weights, costmap.distance_m) is not None:
            return True
        costmap.reopen()
        return False

    def _end_recovery_action(self) -> None:
        self.recovery.end()
        self._behavior = None
        self._goal_approach.let_go()
        self._progress.reset()
        self._no_path_s = 0.0
        self._must_replan = True
        self.context.controller.reset()

    @property
    def _ahead_m(self) -> float:
        """How far ahead on the path a place is closed [m]."""
        return self.context.footprint.circumscribed_m + PARAMS.closed_radius_m + 0.1

    def _bearing_of_path(self, pose: Pose2D) -> float:
        """Return the bearing of the path ahead, from the robot's heading [rad]."""
        ahead = self.route.path.points[self.route.path.ahead(self.route.index, 0.5)]
        bearing = math.atan2(float(ahead[1]) - pose.y, float(ahead[0]) - pose.x)
        return wrap_angle(bearing - pose.yaw)


def execution_to(
    place: tuple[float, float], driven: GoalExecution, config: PlannerConfig, here: Pose2D,
    tolerances: Tolerances, now_ns: int, hurries: bool = False,
) -> GoalExecution | None:  # fmt: skip
    """Return how a place beside the way of a goal is driven to, None if no path leads there.

    Args:
        place: x, y in `grid` [m].
        driven: how the goal itself is driven to.
        config: of the planner.
        here: where the robot is, in `grid`.
        tolerances: how near is near enough.
        now_ns: robot time.
        hurries: see `GoalExecution`.
    """
    context = driven.context
    costmap = context.costmap
    costmap.refresh()
    start, weights = (here.x, here.y), costmap.weights
    path = context.planner.plan(start, [place], weights, costmap.distance_m)
    if path is None:
        return None
    pose = costmap.frame_T_grid @ Pose2D(*place, 0.0)
    goal = Goal(driven.goal.id, pose, (), tolerances, driven.goal.speed, now_ns)
    return GoalExecution(goal, context, config, path, now_ns, hurries)
