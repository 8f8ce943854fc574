"""The goal's state machine: what is asked and sensed goes in, velocities and statuses come out."""

from collections.abc import Sequence

import msgspec

from trolley import codes
from trolley.codes import Refused
from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D
from trolley.messages import BaseState, GoalStatus, Odometry, Path, Scan
from trolley.messages.request_params import SendGoal, WhichGoal
from trolley_planner import wire
from trolley_planner.context.motion_state import Situation
from trolley_planner.context.planning_context import Rig
from trolley_planner.control.path_timing import seconds_along, timed_poses
from trolley_planner.driving.goal_execution import Drive
from trolley_planner.driving.spin_to_localize import LookRound
from trolley_planner.fleet.giving_way import GivingWay
from trolley_planner.fleet.neighbours import Others
from trolley_planner.goals.goal import Goal, Tolerances
from trolley_planner.goals.goal_validation import (
    Admitted,
    admit,
    check_ready,
    check_state,
    goal_pose,
)
from trolley_planner.report import Report

SETTLED_S = 1.5
"""A source that drove already when the goal came may fall silent within this time."""
STOPPING_S = 0.5
"""Zero is commanded for so long after a goal is over."""
IDLE_SCAN_S = 0.2
"""Without a goal one scan in so long keeps the costmap up to date."""
OWN_SOURCE = "planner"


class Navigator(Report):
    """Takes goals and drives to them.

    Robot time is an argument everywhere, and requests come in as messages; nothing here knows of
    clocks or the wire.

    Args:
        config: of the planner.
    """

    def __init__(self, config: PlannerConfig) -> None:
        super().__init__(config)
        self.others = Others()
        self._giving_way = GivingWay(config)
        self._look_round = LookRound(config)
        self._over_ns: int | None = None
        self._trouble_since_ns: int | None = None
        self._scanned_ns = 0
        self._set_off_ns = 0
        self._num_jumps = 0

    # What is sensed.

    def take_scan(self, scan: Scan, history: Sequence[Odometry], now_ns: int) -> bool:
        """Put a scan into the costmap; True if a command computed now would be based on it.

        Args:
            scan: the newest.
            history: odometry around its time, oldest first.
            now_ns: robot time.
        """
        if not self.senses.take_scan(scan):
            return False
        self._rebuild(now_ns)
        if self.drive is None and now_ns - self._scanned_ns < IDLE_SCAN_S * 1e9:
            return False
        self._scanned_ns = now_ns
        if not self.surroundings.add_scan(scan, history, now_ns):
            return False
        motion = self.helm.motion()
        if motion is None or self.drive is None:
            return False
        if self.board.state in ("driving", "recovering"):
            self._giving_way.decide(self.others.own_name, self.drive, motion, now_ns)
        if not self._giving_way.look(motion, now_ns):
            self.drive.look(motion, now_ns)
        return True

    def meet(self, now_ns: int, monotonic_ns: int) -> None:
        """Take where the other robots of the house are, before a scan is taken.

        Args:
            now_ns: robot time.
            monotonic_ns: local time, by which the others' messages are as old as they are.
        """
        rig, grid = self.surroundings.rig, self.senses.map
        if rig is not None and grid is not None:
            others = self.others.present(grid.name, monotonic_ns)
            self._giving_way.meet(rig, others, now_ns)

    def take_base(self, base: BaseState, now_ns: int) -> None:
        """Take what the base does: a stop or somebody else's hand pauses the goal."""
        before = self.senses.base
        self.senses.base = base
        goal = self.board.goal
        if not self.board.is_active or goal is None or self.board.state == "paused":
            return
        if base.is_from_before(self._set_off_ns):
            return
        if base.mode in ("stopped", "fault"):
            reason = codes.STOPPED if base.mode == "stopped" else base.reason
            self._pause(reason or codes.STOPPED, now_ns, base.message or None)
        elif base.source not in (None, OWN_SOURCE):
            is_old = before is not None and before.source == base.source
            if not is_old or now_ns - goal.sent_ns > SETTLED_S * 1e9:
                self._pause(
                    codes.TAKEN_OVER,
                    now_ns,
                    f"{base.source} drives the robot; resume the goal to go on.",
                )

    def begin_epoch(self, now_ns: int) -> None:
        """Take note that the base began anew: what was measured before counts no more."""
        self.senses.begin_epoch()
        self.surroundings.forget()
        self.helm.note_command(None, now_ns)
        if self.board.is_active and self.board.state != "paused":
            self._pause(
                codes.RESTARTED, now_ns, "The base was restarted; resume the goal to go on."
            )

    # What is asked.

    def send(self, params: SendGoal, new_id: str, now_ns: int | None) -> GoalStatus:
        """Take a goal, in place of the one before.

        Args:
            params: the request.
            new_id: for a goal that brings none.
            now_ns: robot time, None while unknown.

        Raises:
            Refused: the goal that was driven to is then untouched.
        """
        known = None if params.id is None else self.status_of(params.id, now_ns or 0)
        if known is not None:
            return known
        check_ready(self.senses, now_ns)
        now = now_ns or 0
        admitted, rig = self._admit(params, new_id, now)
        if self.board.is_active:
            self._end("canceled", codes.REPLACED, now)
        self.board.begin(admitted.goal)
        self.board.set("planning", "", now)
        self._set_off(admitted, rig, now)
        return self.status(now)

    def preview(self, params: SendGoal, now_ns: int | None) -> Path:
        """Return the way to a goal with its times, without driving.

        Raises:
            Refused: as `send`.
        """
        check_ready(self.senses, now_ns)
        now = now_ns or 0
        admitted, rig = self._admit(params, "preview", now)
        motion = self.helm.motion()
        if motion is None:
            raise Refused(codes.NOT_LOCALIZED)
        limits = self.helm.limits(admitted.goal.speed)
        points = admitted.path.points
        seconds = seconds_along(points, motion.pose.yaw, rig.costmap, limits)
        free = admitted.goal.tolerances.any_heading
        goal_yaw = None if free else rig.costmap.to_grid(admitted.goal.pose).yaw
        poses, dt = timed_poses(points, seconds, goal_yaw)
        return wire.path_message(poses, rig.costmap.frame_T_grid, self.senses.frame, now, dt)

    def cancel(self, params: WhichGoal, now_ns: int) -> GoalStatus:
        """End the current goal.

        Raises:
            Refused: `not_current`.
        """
        self.board.check_current(params.id)
        self._end("canceled", codes.CANCELED, now_ns)
        return self.status(now_ns)

    def pause(self, params: WhichGoal, now_ns: int) -> GoalStatus:
        """Stop, and keep the goal.

        Raises:
            Refused: `not_current`.
        """
        self.board.check_current(params.id)
        self._pause(codes.PAUSED, now_ns)
        return self.status(now_ns)

    def resume(self, params: WhichGoal, now_ns: int | None) -> GoalStatus:
        """Drive on to the goal that was paused.

        Raises:
            Refused: `not_current`, or whatever a new goal would be refused for.
        """
        self.board.check_current(params.id)
        goal, now = self.board.goal, now_ns or 0
        if goal is None or self.board.state != "paused":
            return self.status(now)
        check_ready(self.senses, now_ns)
        check_state(self.senses, now)
        rig, here = self._place(now)
        left = goal if self.drive is None else self.drive.rest()
        self._set_off(admit(left, rig, here, self.config), rig, now)
        return self.status(now)

    # What is driven.

    def command(self, now_ns: int) -> Twist2D | None:
        """Return the velocity to command now, None for silence."""
        twist = self._choose(now_ns, self.helm.elapsed_s(now_ns))
        self.helm.note_command(twist, now_ns)
        return twist

    def maintain(self, now_ns: int) -> None:
        """Do what may take longer, after the command is out: forget, look for a better path."""
        self.surroundings.maintain(now_ns)
        if self.drive is None or self.board.state not in ("driving", "recovering"):
            return
        now = self.helm.situation(self.drive.goal.speed, now_ns, 0.0)
        if now is None or self.surroundings.trouble(now_ns) is not None:
            return
        if self._num_jumps != self.senses.num_jumps:
            self._num_jumps = self.senses.num_jumps
            self.drive.replan()
        self.surroundings.note_position(self.senses.base_pose())
        if self._giving_way.wait is not None:
            self._giving_way.maintain(self.drive.rig, now)
        else:
            self.drive.maintain(now)

    # Inside.

    def _choose(self, now_ns: int, elapsed_s: float) -> Twist2D | None:
        """Return what to command: the drive's wish, zero while it may not, None for silence."""
        turn = self._look_round.command(self.senses, self.helm.turn_limits(), now_ns)
        if turn is not None:
            return turn
        drive = self.drive
        if drive is None or self.board.state not in ("driving", "recovering"):
            is_over = self._over_ns is not None and now_ns - self._over_ns < STOPPING_S * 1e9
            return Twist2D.zero() if is_over else None
        if self._must_wait(now_ns):
            return Twist2D.zero()
        now = self.helm.situation(drive.goal.speed, now_ns, elapsed_s)
        if now is None:
            return Twist2D.zero()
        if self._giving_way.wait is not None:
            return self._give_way(now)
        waited_ns = self._giving_way.take_waited_ns()
        if waited_ns > 0:
            drive.go_on(waited_ns)
        twist = drive.command(now)
        if drive.outcome == "arrived":
            self._end("arrived", "", now_ns, "The robot has arrived.")
        elif drive.outcome == "failed":
            why = wire.TAKEN if drive.is_waiting else wire.blocked_by(self._blocker(drive))
            self._end("failed", drive.trouble, now_ns, why)
        elif drive.recovery.current is not None or drive.is_waiting:
            why = wire.trying(drive, self._blocker(drive))
            self.board.set("recovering", drive.trouble, now_ns, why, self.details(now_ns))
        else:
            self.board.set("driving", "", now_ns, None, self.details(now_ns))
        return twist

    def _give_way(self, now: Situation) -> Twist2D:
        """Return the velocity while the robot waits for another; fail if that lasts too long."""
        wait, now_ns = self._giving_way.wait, now.now_ns
        if wait is None or self._giving_way.has_waited_enough(now_ns):
            name = "another" if wait is None else wait.name
            self._end("failed", codes.BLOCKED, now_ns, f"Robot {name} does not drive on.")
            return Twist2D.zero()
        details = self.details(now_ns)
        self.board.set("recovering", codes.WAITING, now_ns, wait.sentence, details)
        return self._giving_way.command(now)

    def _blocker(self, drive: Drive) -> str | None:
        """Return the name of a robot that stands in the way, where that is the trouble."""
        is_blocked = drive.trouble == codes.BLOCKED
        return self._giving_way.in_the_way(drive) if is_blocked else None

    def _must_wait(self, now_ns: int) -> bool:
        """Say whether the robot must stand because it does not know enough; fail if that lasts."""
        trouble = self.surroundings.trouble(now_ns)
        if trouble is None:
            self._trouble_since_ns = None
            return False
        if self._trouble_since_ns is None:
            self._trouble_since_ns = now_ns
        if now_ns - self._trouble_since_ns > self.config.give_up_s * 1e9:
            self._end("failed", trouble.code, now_ns, trouble.message)
        else:
            details = self.details(now_ns)
            self.board.set("recovering", trouble.code, now_ns, trouble.message, details)
        return True

    def _admit(self, params: SendGoal, new_id: str, now_ns: int) -> tuple[Admitted, Rig]:
        """Check a goal against everything that is known.

        Raises:
            Refused: see `admission`.
        """
        pose = goal_pose(params, self.senses)
        check_state(self.senses, now_ns)
        rig, here = self._place(now_ns)
        goal = Goal(
            params.id or new_id,
            pose,
            tuple(via.wrapped() for via in params.via),
            Tolerances(params.xy_tolerance, params.yaw_tolerance),
            params.speed,
            now_ns,
        )
        return admit(goal, rig, here, self.config), rig

    def _place(self, now_ns: int) -> tuple[Rig, Pose2D]:
        """Return the costmap and where the robot is.

        Raises:
            Refused: either is not known.
        """
        here = self.senses.base_pose()
        if here is None:
            raise Refused(codes.NOT_LOCALIZED)
        self._rebuild(now_ns)
        return self.surroundings.need_rig(), here

    def _set_off(self, admitted: Admitted, rig: Rig, now_ns: int) -> None:
        """Begin to drive along a first path."""
        self.drive = Drive(admitted.goal, rig, self.config, admitted.path, now_ns)
        self._set_off_ns = now_ns
        self._giving_way.forget()
        self._over_ns = None
        self._trouble_since_ns = None
        motion = self.helm.motion()
        if motion is not None:
            self.drive.look(motion, now_ns)
        self.board.set("driving", "", now_ns, None, self.details(now_ns))

    def _rebuild(self, now_ns: int) -> None:
        """Make the costmap anew if map, zones or robot changed, and plan on it."""
        if not self.surroundings.rebuild():
            return
        drive, rig = self.drive, self.surroundings.rig
        if drive is None or not self.board.is_active:
            self.drive = None
            return
        if rig is None:
            trouble = self.surroundings.trouble(now_ns) or Refused(codes.NOT_READY)
            self._end("failed", trouble.code, now_ns, trouble.message)
            return
        here = self.senses.base_pose()
        if self.surroundings.is_other_map:
            self._end("failed", codes.WRONG_MAP, now_ns, "Another map was loaded.")
        elif here is not None:
            try:
                admitted = admit(drive.rest(), rig, here, self.config)
            except Refused as refusal:
                places = refusal.details.get("blocked", [])
                self._end("failed", refusal.code, now_ns, refusal.message, places)
            else:
                self.drive = Drive(admitted.goal, rig, self.config, admitted.path, now_ns)
                self._giving_way.forget()

    def _pause(self, reason: str, now_ns: int, message: str | None = None) -> None:
        self._over_ns = now_ns
        self._look_round.stop()
        self.board.set("paused", reason, now_ns, message, self.details(now_ns))

    def _end(
        self,
        state: wire.Ending,
        reason: str,
        now_ns: int,
        message: str | None = None,
        blocked: Sequence[tuple[float, float]] = (),
    ) -> None:
        """Close the current goal; `blocked` are places that it ended for."""
        details = self.details(now_ns)
        if details is not None and blocked:
            details = msgspec.structs.replace(details, blocked=list(blocked))
        self.board.set(state, reason, now_ns, message, details)
        self._over_ns = now_ns
        self.drive = None
