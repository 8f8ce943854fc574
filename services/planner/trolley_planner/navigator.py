"""The planner's cycle: a scan updates the costmap, the goal's execution answers with a velocity.

    scan      -> update_scan: costmap, neighbours, distances and cost-to-go around the robot
    odometry  -> command: what the robot may do, what the goal's execution wants, what is safe
    afterwards-> maintain: forget what is old, look for a better path

Requests enter as messages (`send`, `cancel`, `pause`, `resume`, `preview`), statuses leave by
`current`. Robot time is an argument everywhere; nothing here knows of clocks or the wire.
"""

from collections.abc import Sequence

from trolley import codes
from trolley.codes import Refused
from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D
from trolley.messages import BaseState, GoalStatus, OccupancyGrid, Odometry, Path, Scan
from trolley.messages.request_params import FollowPerson, SendGoal, WhichGoal
from trolley_planner import wire
from trolley_planner.context.motion_state import ControlInput, MotionState
from trolley_planner.context.planning_context import CostmapManager, PlanningContext
from trolley_planner.control.controller import Motion, limited_change, safe_command
from trolley_planner.current_goal import CurrentGoal
from trolley_planner.driving.following import BEHIND, Following, pick_person, tracks_in_frame
from trolley_planner.driving.goal_execution import GoalExecution
from trolley_planner.driving.route import seconds_along, timed_poses
from trolley_planner.driving.spin_to_localize import SpinToLocalize
from trolley_planner.fleet.giving_way import GivingWay
from trolley_planner.fleet.neighbours import Neighbours
from trolley_planner.fleet.stepping_aside import SENTENCE, SteppingAside
from trolley_planner.goals import (
    Goal,
    Tolerances,
    ValidatedGoal,
    check_frame,
    check_ready,
    check_state,
    goal_pose,
    validate,
)
from trolley_planner.people.tracker import Track
from trolley_planner.sensing.inputs import Inputs

SETTLED_S = 1.5
"""A source that drove already when the goal came may fall silent within this time."""
IDLE_SCAN_S = 0.2
"""Time between two scans that update the costmap while there is no goal."""
BLIND_S = 30.0
"""A goal that is blocked so soon after base was held because the lidar sees nothing is blind."""
OWN_SOURCE = "planner"
"""The name under which base hears this service's commands."""


class Navigator:
    """Takes goals and drives to them.

    Args:
        config: of the planner.
    """

    def __init__(self, config: PlannerConfig) -> None:
        self._config = config
        self.inputs = Inputs(config)
        self.costmap_manager = CostmapManager(config, self.inputs)
        self.neighbours = Neighbours()
        self._motion_state = MotionState(config, self.inputs, self.costmap_manager)
        self.current = CurrentGoal(config, self.inputs, self._motion_state)
        self._giving_way = GivingWay(config)
        self._stepping_aside = SteppingAside()
        self._spin_to_localize = SpinToLocalize(config)
        self._set_off_ns = 0
        self._trouble_since_ns: int | None = None
        self._blind: tuple[int, str] | None = None
        """When base last held the robot because the lidar sees nothing, and what it said."""
        self._scanned_ns = 0
        self._num_jumps = 0

    def set_config(self, config: PlannerConfig) -> None:
        """Apply other settings from now on; the current goal stays."""
        self._config = config
        self._motion_state.set_config(config)
        self.current.set_config(config)
        self._giving_way.set_config(config)
        self._spin_to_localize.set_config(config)
        self.costmap_manager.set_config(config)

    # The cycle.

    def update_scan(
        self, scan: Scan, history: Sequence[Odometry], now_ns: int, monotonic_ns: int
    ) -> bool:
        """Put a scan into the costmap; True if a command computed now would be based on it.

        Args:
            scan: the newest.
            history: odometry around its time, oldest first.
            now_ns: robot time.
            monotonic_ns: local time, by which the age of the neighbours' messages is measured.
        """
        self._update_neighbours(now_ns, monotonic_ns)
        if not self.inputs.update_scan(scan):
            return False
        self._rebuild_costmap(now_ns)
        if self.current.execution is None and now_ns - self._scanned_ns < IDLE_SCAN_S * 1e9:
            return False
        self._scanned_ns = now_ns
        if not self.costmap_manager.add_scan(scan, history, now_ns):
            return False
        following, execution = self.current.following, self.current.execution
        if following is not None:
            following.update(self._tracks(self.costmap_manager.require_context()), now_ns)
        motion = self._motion_state.motion()
        if motion is None or execution is None:
            return False
        if self.current.is_driving:
            self._giving_way.decide(self.neighbours.own_name, execution, motion, now_ns)
            self._yield_to_people(execution, motion, now_ns)
        if self._giving_way.update(motion, now_ns) or self._stepping_aside.update(motion, now_ns):
            return True
        execution.update(motion, now_ns)
        return True

    def _yield_to_people(self, execution: GoalExecution, motion: Motion, now_ns: int) -> None:
        """Decide whether to yield to people, unless it follows one."""
        if self._giving_way.wait is not None or self.current.following is not None:
            self._stepping_aside.forget()
            return
        speed = self._motion_state.limits(execution.goal.speed).max_speed
        self._stepping_aside.decide(execution, motion, speed, now_ns)

    def command(self, now_ns: int) -> Twist2D | None:
        """Return the velocity to command now, None for silence."""
        twist = self._choose_velocity(now_ns, self._motion_state.elapsed_s(now_ns))
        self._motion_state.record_command(twist, now_ns)
        return twist

    def maintain(self, now_ns: int) -> None:
        """Do what may take longer, after the command is out: forget old obstacles, replan."""
        self.costmap_manager.maintain(now_ns)
        self._keep_to_the_map(now_ns)
        execution = self.current.execution
        if execution is None or not self.current.is_driving:
            return
        now = self._motion_state.control_input(execution.goal.speed, now_ns, 0.0)
        if now is None or self.costmap_manager.trouble(now_ns) is not None:
            return
        if self._num_jumps != self.inputs.num_jumps:
            self._num_jumps = self.inputs.num_jumps
            execution.route.must_replan = True
        self.costmap_manager.update_position(self.inputs.base_pose())
        if self._giving_way.wait is not None:
            self._giving_way.maintain(execution.context, now)
        elif self._stepping_aside.is_active:
            self._stepping_aside.maintain(now)
        else:
            self._keep_behind(execution, now_ns)
            execution.replan_if_due(now)

    def _keep_to_the_map(self, now_ns: int) -> None:
        """Pause a goal whose path leads further off the map; resume when back on the map."""
        execution, board, off_m = self.current.execution, self.current.board, self.inputs.off_map_m
        goal = board.goal
        if execution is None or goal is None:
            return
        if off_m is not None:
            if self.current.is_driving and execution.route.leads_off_map(off_m):
                self._pause(codes.OFF_MAP, now_ns)
            return
        base, pose = self.inputs.base, self.inputs.pose
        is_ours = base is None or (base.source in (None, OWN_SOURCE) and not base.is_halted)
        is_back = pose is not None and pose.state == "localized"
        if (board.state, board.reason) != ("paused", codes.OFF_MAP) or not is_back:
            return
        if is_ours and self.costmap_manager.trouble(now_ns) is None:
            try:
                self.resume(WhichGoal(id=goal.id), now_ns)
            except Refused as refusal:
                self.current.end("failed", refusal.code, now_ns, refusal.message)

    def _keep_behind(self, execution: GoalExecution, now_ns: int) -> None:
        """Move the goal on behind a person who is followed."""
        following = self.current.following
        goal = None if following is None else following.moved_goal(execution.goal, now_ns)
        if goal is not None:
            execution.move_goal(goal)
            self.current.board.move(goal)

    @staticmethod
    def _tracks(context: PlanningContext) -> list[Track]:
        """Return the tracked objects of a person's size, in the frame of the goals."""
        costmap = context.costmap
        return tracks_in_frame(costmap.moving.tracks, costmap.frame_T_grid)

    def _update_neighbours(self, now_ns: int, monotonic_ns: int) -> None:
        """Tell the costmap where the other robots of the house will be."""
        context, grid = self.costmap_manager.context, self.inputs.map
        if context is not None and grid is not None:
            robots = self.neighbours.on_map(grid.name, monotonic_ns)
            self._giving_way.update_neighbours(context, robots, now_ns)

    def _choose_velocity(self, now_ns: int, elapsed_s: float) -> Twist2D | None:
        """Return what to command: zero while the robot must not drive, None for silence."""
        spin = self._spin_to_localize.command(self.inputs, self._motion_state.turn_limits(), now_ns)
        if spin is not None:
            return spin
        execution = self.current.execution
        if execution is None or not self.current.is_driving:
            return Twist2D.zero() if self.current.is_stopping(now_ns) else None
        if self._must_wait(now_ns):
            return Twist2D.zero()
        now = self._motion_state.control_input(self._speed(execution, now_ns), now_ns, elapsed_s)
        if now is None:
            return Twist2D.zero()
        if self._giving_way.wait is not None:
            return self._give_way(now)
        if self._stepping_aside.is_active:
            self.current.report("recovering", codes.WAITING, now_ns, SENTENCE)
            return self._stepping_aside.command(now)
        if self.current.following is not None:
            return self._follow(self.current.following, execution, now)
        return self._execute(execution, now)

    def _speed(self, execution: GoalExecution, now_ns: int) -> float | None:
        """Return the highest speed that the goal asks for [m/s], None for any."""
        here, following = self.inputs.base_pose(), self.current.following
        asked = execution.goal.speed
        if following is None or here is None:
            return asked
        wanted = following.speed(here, now_ns)
        return wanted if asked is None else asked if wanted is None else min(asked, wanted)

    def _follow(self, following: Following, execution: GoalExecution, now: ControlInput) -> Twist2D:
        """Return the velocity behind a person; end the goal when they are lost."""
        here, now_ns = self.inputs.base_pose(), now.now_ns
        if following.is_lost(now_ns) or here is None:
            self.current.end("failed", codes.PERSON_LOST, now_ns)
            return Twist2D.zero()
        context = execution.context
        if following.must_stand(here, context.footprint.circumscribed_m, now_ns):
            execution.stand()
            self.current.report("driving", "", now_ns, wire.BEHIND_PERSON)
            wanted = following.turn_to(here, now.limits)
            wanted = limited_change(now.motion.twist, wanted, now.limits, now.elapsed_s)
            return safe_command(now.motion, wanted, context.local_costmap, now.limits)
        return self._execute(execution, now)

    def _execute(self, execution: GoalExecution, now: ControlInput) -> Twist2D:
        """Return the velocity of the goal's execution, and report how it goes."""
        waited_ns = self._giving_way.pop_waited_ns() + self._stepping_aside.pop_waited_ns()
        if waited_ns > 0:
            execution.resume_after_wait(waited_ns)
        following, twist = self.current.following, execution.command(now)
        trouble, blind = self._trouble(execution, now.now_ns)
        if execution.outcome == "arrived" and following is not None:
            execution.stand()  # until the person walks on
        elif execution.outcome == "arrived":
            self.current.end("arrived", "", now.now_ns, "The robot has arrived.")
        elif execution.outcome == "failed":
            blocker = wire.blocked_by(self._blocking_robot(execution))
            why = wire.GOAL_OCCUPIED if execution.is_waiting else blind or blocker
            self.current.end("failed", trouble, now.now_ns, why)
        elif execution.is_recovering or execution.is_waiting:
            why = wire.recovery_sentence(execution, self._blocking_robot(execution))
            self.current.report("recovering", trouble, now.now_ns, blind or why)
        elif self._is_held_blind:
            self.current.report("driving", codes.BLIND, now.now_ns, blind)
        elif following is not None and not following.is_in_sight(now.now_ns):
            self.current.report("recovering", codes.PERSON_LOST, now.now_ns, wire.PERSON_UNSEEN)
        else:
            self.current.report("driving", "", now.now_ns)
        return twist

    @property
    def _is_held_blind(self) -> bool:
        """Whether base does not drive as commanded because the lidar sees nothing there."""
        base = self.inputs.base
        return base is not None and (base.mode, base.reason) == ("held", codes.BLIND)

    def _trouble(self, execution: GoalExecution, now_ns: int) -> tuple[str, str | None]:
        """Return the code of what keeps the robot from its goal, and base's sentence if blind."""
        if self._blind is None or now_ns - self._blind[0] > BLIND_S * 1e9:
            return execution.trouble, None
        is_blocked = execution.trouble in ("", codes.BLOCKED)
        return (codes.BLIND, self._blind[1]) if is_blocked else (execution.trouble, None)

    def _give_way(self, now: ControlInput) -> Twist2D:
        """Return the velocity while the robot waits for another; fail if that lasts too long."""
        wait, now_ns = self._giving_way.wait, now.now_ns
        if wait is None or self._giving_way.has_waited_enough(now_ns):
            name = "another" if wait is None else wait.name
            self.current.end("failed", codes.BLOCKED, now_ns, f"Robot {name} is not moving on.")
            return Twist2D.zero()
        self.current.report("recovering", codes.WAITING, now_ns, wait.sentence)
        return self._giving_way.command(now)

    def _must_wait(self, now_ns: int) -> bool:
        """Say whether the robot must stand for want of inputs; fail if that lasts."""
        trouble = self.costmap_manager.trouble(now_ns)
        if trouble is None:
            self._trouble_since_ns = None
            return False
        if self._trouble_since_ns is None:
            self._trouble_since_ns = now_ns
        if now_ns - self._trouble_since_ns > self._config.give_up_s * 1e9:
            self.current.end("failed", trouble.code, now_ns, trouble.message)
        else:
            self.current.report("recovering", trouble.code, now_ns, trouble.message)
        return True

    def _blocking_robot(self, execution: GoalExecution) -> str | None:
        """Return the name of the robot that is in the way, if that is the trouble."""
        is_blocked = execution.trouble == codes.BLOCKED
        return self._giving_way.blocking_robot(execution) if is_blocked else None

    # What else is heard.

    def update_base(self, base: BaseState, now_ns: int) -> None:
        """Take in the base's state: a stop, or another source of commands, pauses the goal."""
        before = self.inputs.base
        self.inputs.base = base
        if self._is_held_blind and base.source == OWN_SOURCE:
            self._blind = now_ns, base.message
        board, goal = self.current.board, self.current.board.goal
        if not board.is_active or goal is None or board.state == "paused":
            return
        if base.is_from_before(self._set_off_ns):
            return
        if base.mode in ("stopped", "fault"):
            reason = codes.STOPPED if base.mode == "stopped" else base.reason
            # What it does just now is for base to say; the goal says why it is paused.
            message = None if base.reason == codes.DOES_NOT_OBEY else base.message or None
            self._pause(reason or codes.STOPPED, now_ns, message)
        elif base.source not in (None, OWN_SOURCE):
            drove_before = before is not None and before.source == base.source
            if not drove_before or now_ns - goal.sent_ns > SETTLED_S * 1e9:
                why = f"{base.source} drives the robot; resume the goal to go on."
                self._pause(codes.TAKEN_OVER, now_ns, why)

    def begin_epoch(self, now_ns: int) -> None:
        """Start over after a restart of base: earlier measurements do not count."""
        self.inputs.begin_epoch()
        self.costmap_manager.forget()
        self._motion_state.record_command(None, now_ns)
        if self.current.board.is_active and self.current.board.state != "paused":
            why = "The base was restarted; resume the goal to go on."
            self._pause(codes.RESTARTED, now_ns, why)

    # Requests.

    def send(self, params: SendGoal, new_id: str, now_ns: int | None) -> GoalStatus:
        """Take a goal, in place of the one before.

        Args:
            params: the request.
            new_id: for a goal that brings none.
            now_ns: robot time, None while unknown.

        Raises:
            Refused: the goal that was driven to is then untouched.
        """
        known = None if params.id is None else self.current.status_of(params.id, now_ns or 0)
        if known is not None:
            return known
        check_ready(self.inputs, now_ns)
        now = now_ns or 0
        return self._take(*self._validate(params, new_id, now), None, now)

    def follow(self, params: FollowPerson, new_id: str, now_ns: int | None) -> GoalStatus:
        """Begin to follow a person, in place of the goal before.

        Args:
            params: the request.
            new_id: for a goal that brings none.
            now_ns: robot time, None while unknown.

        Raises:
            Refused: the goal that was driven to is then untouched.
        """
        known = None if params.id is None else self.current.status_of(params.id, now_ns or 0)
        if known is not None:
            return known
        check_ready(self.inputs, now_ns)
        now = now_ns or 0
        check_frame(params.frame, self.inputs)
        check_state(self.inputs, now)
        context, here = self._context_and_pose(now, ())
        person = pick_person(self._tracks(context), here, params.point)
        if person is None:
            raise Refused(codes.NOBODY)
        following = Following(person, here, params.distance, now)
        place = following.place_behind(now)
        goal = Goal(params.id or new_id, place, (), BEHIND, params.speed, now)
        return self._take(validate(goal, context, here, self._config), context, following, now)

    def preview(self, params: SendGoal, now_ns: int | None) -> Path:
        """Return the path to a goal with its times, without driving.

        Raises:
            Refused: as `send`.
        """
        check_ready(self.inputs, now_ns)
        now = now_ns or 0
        validated, context = self._validate(params, "preview", now)
        motion = self._motion_state.motion()
        if motion is None:
            raise Refused(codes.NOT_LOCALIZED)
        goal, points, costmap = validated.goal, validated.path.points, context.costmap
        limits = self._motion_state.limits(goal.speed)
        seconds = seconds_along(points, motion.pose.yaw, costmap, limits)
        goal_yaw = None if goal.tolerances.any_heading else costmap.to_grid(goal.pose).yaw
        poses, dt = timed_poses(points, seconds, goal_yaw)
        return wire.path_message(poses, costmap.frame_T_grid, self.inputs.frame, now, dt)

    def cancel(self, params: WhichGoal, now_ns: int) -> GoalStatus:
        """End the current goal.

        Raises:
            Refused: `not_current`.
        """
        self.current.board.check_current(params.id)
        self.current.end("canceled", codes.CANCELED, now_ns)
        return self.current.status(now_ns)

    def pause(self, params: WhichGoal, now_ns: int) -> GoalStatus:
        """Stop, and keep the goal.

        Raises:
            Refused: `not_current`.
        """
        self.current.board.check_current(params.id)
        self._pause(codes.PAUSED, now_ns)
        return self.current.status(now_ns)

    def resume(self, params: WhichGoal, now_ns: int | None) -> GoalStatus:
        """Drive on to the goal that was paused.

        Raises:
            Refused: `not_current`, or whatever a new goal would be refused for.
        """
        self.current.board.check_current(params.id)
        goal, now = self.current.board.goal, now_ns or 0
        if goal is None or self.current.board.state != "paused":
            return self.current.status(now)
        check_ready(self.inputs, now_ns)
        check_state(self.inputs, now)
        if self.current.following is not None and self.current.following.is_lost(now):
            raise Refused(codes.PERSON_LOST)
        left = goal if self.current.execution is None else self.current.execution.remaining_goal()
        context, here = self._context_and_pose(now, (*left.vias, left.pose))
        self._set_off(validate(left, context, here, self._config), context, now)
        return self.current.status(now)

    def _validate(
        self, params: SendGoal, new_id: str, now_ns: int
    ) -> tuple[ValidatedGoal, PlanningContext]:
        """Validate a goal by map, zones and costmap.

        Raises:
            Refused: see `goals`.
        """
        pose = goal_pose(params, self.inputs)
        check_state(self.inputs, now_ns)
        vias = tuple(via.wrapped() for via in params.via)
        context, here = self._context_and_pose(now_ns, (*vias, pose))
        goal = Goal(
            params.id or new_id,
            pose,
            vias,
            Tolerances(params.xy_tolerance, params.yaw_tolerance),
            params.speed,
            now_ns,
        )
        return validate(goal, context, here, self._config), context

    def _context_and_pose(
        self, now_ns: int, goals: Sequence[Pose2D]
    ) -> tuple[PlanningContext, Pose2D]:
        """Return the planning context for these goals, and the robot's pose.

        Raises:
            Refused: either is not known.
        """
        here = self.inputs.base_pose()
        if here is None:
            raise Refused(codes.NOT_LOCALIZED)
        self._rebuild_costmap(now_ns, goals)
        return self.costmap_manager.require_context(), here

    def _take(
        self,
        validated: ValidatedGoal,
        context: PlanningContext,
        following: Following | None,
        now_ns: int,
    ) -> GoalStatus:
        """Drive to a goal in place of the one before, behind a person if one is followed."""
        self.current.take(validated.goal, following, now_ns)
        self._set_off(validated, context, now_ns)
        return self.current.status(now_ns)

    def _set_off(self, validated: ValidatedGoal, context: PlanningContext, now_ns: int) -> None:
        """Start driving along a first path."""
        self._begin(validated, context, now_ns)
        self._set_off_ns = now_ns
        self._blind = None
        self._trouble_since_ns = None
        self.current.set_off(now_ns)

    def _begin(self, validated: ValidatedGoal, context: PlanningContext, now_ns: int) -> None:
        """Begin to execute a goal; nobody is waited for any more."""
        self._giving_way.forget()
        self._stepping_aside.forget()
        self.current.execute(validated, context, now_ns)

    def _rebuild_costmap(self, now_ns: int, goals: Sequence[Pose2D] = ()) -> None:
        """Rebuild the costmap if map, zones or robot changed, and replan on it."""
        manager, execution = self.costmap_manager, self.current.execution
        left = None
        if execution is not None and self.current.board.is_active:
            left = execution.remaining_goal()
        if not manager.rebuild([*goals, *((*left.vias, left.pose) if left else ())]):
            return
        if execution is None or not self.current.board.is_active:
            self.current.execution = None
        elif manager.context is None:
            trouble = manager.trouble(now_ns) or Refused(codes.NOT_READY)
            self.current.end("failed", trouble.code, now_ns, trouble.message)
        elif manager.is_other_map:
            self.current.end("failed", codes.WRONG_MAP, now_ns, "Another map was loaded.")
        else:
            self._plan_anew(execution, manager.context, now_ns)

    def _plan_anew(self, execution: GoalExecution, context: PlanningContext, now_ns: int) -> None:
        """Drive to the same goal on another costmap, or fail if that is not possible."""
        here = self.inputs.base_pose()
        if here is None:
            return
        try:
            validated = validate(execution.remaining_goal(), context, here, self._config)
        except Refused as refusal:
            blocked = refusal.details.get("blocked", [])
            self.current.end("failed", refusal.code, now_ns, refusal.message, blocked)
        else:
            self._begin(validated, context, now_ns)

    def _pause(self, reason: str, now_ns: int, message: str | None = None) -> None:
        self._spin_to_localize.stop()
        self.current.pause(reason, now_ns, message)

    # What is reported.

    def costmaps(self, now_ns: int) -> tuple[OccupancyGrid | None, OccupancyGrid | None]:
        """Return the whole costmap and the part around the robot, as far as they are known."""
        context, here = self.costmap_manager.context, self.inputs.base_pose()
        return wire.costmap_messages(context, here, self.inputs.frame, now_ns)
