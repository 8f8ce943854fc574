"""Driving to one goal: along the route, onto the goal, with recovery where the path is blocked."""

import math
from dataclasses import dataclass, replace
from typing import Literal

from trolley import codes
from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D, wrap_angle
from trolley_planner.context.motion_state import ControlInput
from trolley_planner.context.planning_context import PlanningContext
from trolley_planner.control.controller import (
    HURRIED_REVERSE,
    Motion,
    had_better_stand,
    limited_change,
    safe_command,
)
from trolley_planner.control.critics import Target
from trolley_planner.control.local_costmap import TIGHT_CLEARANCE_M
from trolley_planner.control.robot_motion import Limits
from trolley_planner.control.rollout import ROLLOUT
from trolley_planner.driving.goal_approach import GoalApproach
from trolley_planner.driving.maneuvering import Maneuvering
from trolley_planner.driving.progress_monitor import ProgressMonitor
from trolley_planner.driving.recovery_driver import RecoveryDriver
from trolley_planner.driving.route import PASS_M, Blockage, Route
from trolley_planner.goals import Goal, Tolerances
from trolley_planner.paths.path import PlannedPath

BESIDE_ROUTE = Tolerances(0.12, math.pi)
"""How near to a place beside the route is near enough."""
LOOKS_RAD = 0.5
"""The same of the direction in which it has to look there."""
OUT_OF_THE_WAY = Tolerances(0.06, math.pi)
"""The same where people pass within centimetres of it."""


@dataclass(frozen=True, slots=True)
class SpotParams:
    """What counts as a turn on the spot; by hand."""

    steps: int = 10
    """Number of steps of the controller's trajectory that are looked at: 1 s."""
    least_rad: float = 0.4
    """Angle that it turns by at least."""
    most_m: float = 0.1
    """Distance that it drives at most."""


SPOT = SpotParams()


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
        *,
        hurries: bool = False,
    ) -> None:
        self.goal = goal
        self.context = context
        targets = [context.costmap.to_grid(pose) for pose in (*goal.vias, goal.pose)]
        self.route = Route(context, config, targets, path, goal.tolerances.any_heading)
        self.recovery = RecoveryDriver(context, config, self.route)
        self.outcome: Literal["arrived", "failed"] | None = None
        self.trouble = ""
        """Code of what is wrong during recovery, and of why it failed."""
        self._config = config
        self._hurries = hurries
        self._started_ns = now_ns
        self._approach = GoalApproach(context, config, self.goal_grid, goal.tolerances)
        self._maneuvering = Maneuvering(context, config)
        self.progress = ProgressMonitor(context, config)
        self._has_path = True
        context.controller.reset()

    # The cycle.

    def update(self, motion: Motion, now_ns: int) -> None:
        """Update the local costmap after a scan: distances, and the cost-to-go along the path."""
        pose, local_costmap = motion.pose, self.context.local_costmap
        is_tight = self.route.is_tight_here or self._maneuvering.is_tight_ahead
        local_costmap.update(pose.x, pose.y, is_tight)
        self.progress.update(now_ns, pose)
        self.route.update_position(pose)
        if not self.route.vias_left and self._approach.update_aim(pose, self.route.is_blocked):
            self.route.retarget(self._approach.aim)
            self.route.replan_soon()
        stretch = self.route.stretch(1.5 * self.context.half_m)
        path = self.route.path
        part = slice(stretch.first, stretch.last + 1)
        self._has_path = local_costmap.compute_cost_to_go(
            path.points[part], path.remaining_m[part] - path.remaining_m[stretch.last]
        )
        if not self.is_recovering and not self._hurries:
            self._maneuvering.update(motion, self.route, self._approach, now_ns)

    def command(self, now: ControlInput) -> Twist2D:
        """Return the velocity to drive now; sets `outcome` when it is over."""
        self.context.local_costmap.update_moving(now.obeyed_ns)
        self.route.update_position(now.motion.pose)
        twist = self._recover(now) if self.is_recovering else self._follow_route(now)
        if self.progress.must_stand(now.now_ns):
            self.context.controller.reset()
            twist = Twist2D.zero()
        elif had_better_stand(now.motion, twist, self.context.local_costmap):
            self.context.controller.reset()
            twist = limited_change(now.motion.twist, Twist2D.zero(), now.limits, now.elapsed_s)
        if self.progress.is_excused(twist, now) and not self.is_recovering:
            self.recovery.sequence.excuse(round(now.elapsed_s * 1e9))
        self.recovery.update(twist, now.elapsed_s)
        return twist

    def replan_if_due(self, now: ControlInput) -> None:
        """Replan if due; this takes longer and follows the command."""
        changes = self.route.changes
        self.route.replan_if_due(now.motion.pose, now.now_ns)
        if self.route.changes != changes:
            self.recovery.sequence.update_path_length(self.route.remaining_m(now.motion.pose))

    def _follow_route(self, now: ControlInput) -> Twist2D:
        """Return the velocity along the route and onto the goal; may begin recovery."""
        self.recovery.drop_crumb(now.odom_T_base)
        self.recovery.sequence.update_remaining(self.remaining_m(now.motion.pose))
        if self._waits_at_goal(now) or self._waits_on_way(now):
            return limited_change(now.motion.twist, Twist2D.zero(), now.limits, now.elapsed_s)
        approach, route = self._approach, self.route
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
        """Return the velocity along a maneuver."""
        twist = self._maneuvering.command(now, self._approach)
        if self._maneuvering.has_arrived:
            self.outcome = "arrived"
        elif not self._maneuvering.is_active:
            self.context.controller.reset()
        return twist

    def _hurry(self, now: ControlInput) -> Twist2D:
        """Return the velocity out of people's way, in whatever heading it comes there."""
        if now.motion.pose.distance_to(self.goal_grid) < self.goal.tolerances.xy:
            self.outcome = "arrived"
        return self._control(now)

    def _approach_goal(self, now: ControlInput) -> Twist2D:
        """Return the velocity of the goal approach."""
        twist = self._approach.command(now)
        if self._approach.has_arrived:
            self.outcome = "arrived"
        return twist

    def _control(self, now: ControlInput) -> Twist2D:
        """Return the velocity of the controller, made safe."""
        context, limits = self.context, now.limits
        stretch = self.route.stretch(1.5 * context.half_m)
        target = Target(
            stretch.target.x,
            stretch.target.y,
            min(0.5 * self.goal.tolerances.xy, PASS_M) if stretch.is_goal else PASS_M,
            not stretch.is_goal,
        )
        if self.route.is_tight_here:
            limits = limits._replace(clearance_m=min(TIGHT_CLEARANCE_M, limits.clearance_m))
        local_costmap = context.local_costmap
        if self._hurries:
            local_costmap.leave_people_out()
            if local_costmap.known_floor.looks_behind(now.motion.pose):
                limits = limits._replace(max_reverse=min(HURRIED_REVERSE, limits.max_speed))
        path = self.route.path.points[stretch.first : stretch.last + 1]
        found = context.controller.command(
            now.motion, local_costmap, limits, target, path, now.elapsed_s
        )
        local_costmap.update_moving(now.obeyed_ns)
        if found is None:
            return Twist2D.zero()
        if not context.costmap.obstacle_layer.looks_all_round and self._turns_on_the_spot():
            # `base` lets the sides turn over floor that was not seen, but hardly drive over it.
            found = Twist2D(0.0, 0.0, found.wz)
        closer_m = ROLLOUT.same_clearance_m
        return safe_command(now.motion, found, local_costmap, limits, closer_m)

    def _turns_on_the_spot(self) -> bool:
        """Say whether the controller turns within the next second, and hardly drives."""
        ahead = self.context.controller.trajectory[: SPOT.steps + 1]
        if len(ahead) < 2:
            return False
        turn = abs(wrap_angle(float(ahead[-1, 2]) - float(ahead[0, 2])))
        return turn > SPOT.least_rad and math.dist(ahead[-1, :2], ahead[0, :2]) < SPOT.most_m

    # What is known of it.

    @property
    def goal_grid(self) -> Pose2D:
        """The goal in `grid`."""
        return self.context.costmap.to_grid(self.goal.pose)

    @property
    def is_recovering(self) -> bool:
        """Whether a recovery behaviour is active."""
        return self.recovery.sequence.current is not None

    @property
    def is_waiting_at_goal(self) -> bool:
        """Whether the robot waits before an occupied goal."""
        return self.progress.is_waiting_at_goal

    @property
    def is_waiting(self) -> bool:
        """Whether it waits there, or for what stands on the only path."""
        return self.progress.is_waiting_at_goal or self.progress.is_waiting_on_way

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
        if self._approach.is_active:
            return pose.distance_to(self._approach.aim)
        return self.route.remaining_m(pose)

    def eta_s(self, pose: Pose2D, limits: Limits) -> float:
        """Return how long the rest of the path will take [s]."""
        goal_yaw = None if self.goal.tolerances.any_heading else self.goal_grid.yaw
        return self.route.eta_s(pose, goal_yaw, limits)

    # What others decide.

    def move_goal(self, goal: Goal) -> None:
        """Drive to another pose from now on, as behind a person who walks on.

        Args:
            goal: in the frame of the goals, without via points.
        """
        self.goal = goal
        self._approach = GoalApproach(self.context, self._config, self.goal_grid, goal.tolerances)
        self.route.retarget(self.goal_grid)
        self.progress.reset_progress()
        self.recovery.sequence.move_goal()
        self.route.replan_soon()
        self.outcome = None

    def continue_from(self, before: "GoalExecution", here: Pose2D) -> None:
        """Count on from the same goal on another costmap: it has been held up for as long.

        Args:
            before: which is over.
            here: where the robot is, in `grid`.
        """
        sequence = self.recovery.sequence = before.recovery.sequence
        sequence.set_config(self._config)
        sequence.end()
        sequence.update_path_length(self.route.remaining_m(here))
        progress = before.progress
        self.progress.at_goal, self.progress.on_way = progress.at_goal, progress.on_way

    def stand(self) -> None:
        """Note that the robot stands on purpose, as behind a person."""
        self.outcome = None
        self.progress.reset_progress()
        self._maneuvering.stop()
        self._approach.let_go()
        self.context.controller.reset()

    def wait_on_way(self, blockage: Blockage | None, pose: Pose2D, elapsed_s: float) -> bool:
        """Say whether to wait for what stands on the only path; fail if somebody stays there.

        Args:
            blockage: what does; None where the path is free.
            pose: of the robot in `grid`.
            elapsed_s: since the last time.
        """
        if not self.progress.wait_on_way(blockage, pose, elapsed_s):
            self.outcome = "failed"
        if self.progress.is_waiting_on_way or self.outcome == "failed":
            self.trouble = codes.BLOCKED
        return self.progress.is_waiting_on_way

    def resume_after_wait(self, waited_ns: int) -> None:
        """Continue after giving way: that time does not count, and another path may be better."""
        self.recovery.sequence.excuse(waited_ns)
        self.recovery.end()
        self._drive_on()

    def to_place_beside(
        self,
        place: tuple[float, float],
        here: Pose2D,
        now_ns: int,
        *,
        hurries: bool = False,
        looks_at: tuple[float, float] | None = None,
    ) -> "GoalExecution | None":
        """Return how a place beside the route is driven to, None if no path leads there.

        Args:
            place: x, y in `grid` [m].
            here: where the robot is, in `grid`.
            now_ns: robot time.
            hurries: see above.
            looks_at: where to look there, x, y in `grid` [m]; None: anywhere.
        """
        context, costmap = self.context, self.context.costmap
        costmap.refresh()
        start, weights = (here.x, here.y), costmap.weights
        path = context.planner.plan(start, [place], weights, costmap.distance_m)
        if path is None:
            return None
        near, yaw = OUT_OF_THE_WAY if hurries else BESIDE_ROUTE, 0.0
        if looks_at is not None:
            yaw = math.atan2(looks_at[1] - place[1], looks_at[0] - place[0])
            near = replace(near, yaw=LOOKS_RAD)
        pose = costmap.frame_T_grid @ Pose2D(*place, yaw)
        goal = Goal(self.goal.id, pose, (), near, self.goal.speed, now_ns)
        return GoalExecution(goal, context, self._config, path, now_ns, hurries=hurries)

    # What may go wrong.

    def _waits_at_goal(self, now: ControlInput) -> bool:
        """Say whether to wait before an occupied goal; fail if it stays occupied."""
        # Things are seen from one side only: if no path leads to the goal, it is occupied as well.
        is_occupied = self._approach.is_occupied or self.route.is_blocked
        left_m = self.remaining_m(now.motion.pose)
        is_near = self.progress.is_near_goal(left_m)
        waits = (is_occupied and is_near) or self._approach.is_enclosed
        if not self.progress.wait_at_goal(now.elapsed_s, waits=waits):
            self.outcome = "failed"
        if self.is_waiting_at_goal:
            self.trouble = codes.BLOCKED
        return self.is_waiting_at_goal

    def _waits_on_way(self, now: ControlInput) -> bool:
        """Say whether to wait, at a distance, for what stands on the only path."""
        is_led = self._hurries or self._maneuvering.is_active
        blockage = None if is_led else self.route.blockage
        return self.wait_on_way(blockage, now.motion.pose, now.elapsed_s)

    def _check_progress(self, now: ControlInput) -> None:
        """Begin recovery when there is no path, or the robot does not get nearer."""
        is_led = self._has_path or self._maneuvering.is_active
        pose, approach = now.motion.pose, self._approach
        left_m = approach.left_m(pose) if approach.is_active else self.remaining_m(pose)
        trouble = self.progress.check(now, left_m, is_led=is_led)
        if trouble is not None:
            self.trouble = trouble
            self._begin_recovery_action(now)

    def _is_path_free(self, now: ControlInput) -> bool:
        """Say whether the path ahead is free of obstacles."""
        return self._has_path and not self.route.is_blocked and not self.progress.is_held(now)

    def _recover(self, now: ControlInput) -> Twist2D:
        """Return the velocity of the current recovery behaviour, and end it when it is done."""
        is_free = self._is_path_free(now)
        if self.recovery.has_lost_patience(now.now_ns, is_path_free=is_free):
            self._begin_recovery_action(now)
            return self.recovery.stand(now)
        twist = self.recovery.command(now)
        if not self.is_recovering:
            self._drive_on()
        return twist

    def _begin_recovery_action(self, now: ControlInput) -> None:
        """Begin the next recovery behaviour, or give up."""
        self._maneuvering.stop()
        is_blocked, left_m = not self._is_path_free(now), self.remaining_m(now.motion.pose)
        if not self.recovery.begin_next(now, is_blocked=is_blocked, left_m=left_m):
            self.outcome = "failed"

    def _drive_on(self) -> None:
        """Continue after a recovery behaviour or a wait, from wherever that has led."""
        self._maneuvering.stop()
        self._approach.let_go()
        self.progress.reset()
        self.route.replan_soon()
        self.context.controller.reset()
