"""The planner's cycle: a scan updates the costmap, the goal's execution answers with a velocity.

    scan      -> update_scan: costmap, neighbours, distances and cost-to-go around the robot
    odometry  -> command: what the robot may do, what the goal's execution wants, what is safe
    afterwards-> maintain: forget what is old, look for a better path

Requests enter by `requests`, statuses leave by `current`. Robot time is an argument everywhere;
nothing here knows of clocks or the wire.
"""

from collections.abc import Sequence

from trolley.config import PlannerConfig
from trolley.geometry import Twist2D
from trolley.messages import BaseState, OccupancyGrid, Odometry, Scan
from trolley_planner import wire
from trolley_planner.context.motion_state import MotionState
from trolley_planner.context.planning_context import CostmapManager
from trolley_planner.driving.following import tracks_seen
from trolley_planner.driving.spin_to_localize import SpinToLocalize
from trolley_planner.fleet.neighbours import Neighbours
from trolley_planner.navigation.current_goal import CurrentGoal
from trolley_planner.navigation.goal_driver import GoalDriver
from trolley_planner.navigation.goal_guard import GoalGuard
from trolley_planner.navigation.goal_requests import GoalRequests
from trolley_planner.navigation.replanner import Replanner
from trolley_planner.navigation.yielding import Yielding
from trolley_planner.sensing.inputs import Inputs

IDLE_SCAN_S = 0.2
"""Time between two scans that update the costmap while there is no goal."""


class Navigator:
    """Takes goals and drives to them.

    Args:
        config: of the planner.
    """

    def __init__(self, config: PlannerConfig) -> None:
        inputs = self.inputs = Inputs(config)
        costmaps = self.costmap_manager = CostmapManager(config, inputs)
        motion = self._motion_state = MotionState(config, inputs, costmaps)
        current = self.current = CurrentGoal(config, inputs, motion)
        spin = self._spin_to_localize = SpinToLocalize(config)
        guard = self._guard = GoalGuard(config, inputs, costmaps, current, spin)
        yielding = self._yielding = Yielding(config, inputs, costmaps, motion, current)
        driver = self._driver = GoalDriver(inputs, current, yielding)
        replanner = self._replanner = Replanner(config, inputs, costmaps, current, yielding)
        self.requests = GoalRequests(config, inputs, motion, current, replanner, driver, guard)
        self._scanned_ns = 0

    @property
    def neighbours(self) -> Neighbours:
        """The other robots of the house."""
        return self._yielding.neighbours

    def set_config(self, config: PlannerConfig) -> None:
        """Apply other settings from now on; the current goal stays."""
        for part in (
            self._motion_state,
            self.current,
            self._guard,
            self._yielding,
            self._replanner,
            self.requests,
            self._spin_to_localize,
            self.costmap_manager,
        ):
            part.set_config(config)

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
        self._yielding.update_neighbours(now_ns, monotonic_ns)
        if not self.inputs.update_scan(scan):
            return False
        self._replanner.rebuild(now_ns)
        if self.current.execution is None and now_ns - self._scanned_ns < IDLE_SCAN_S * 1e9:
            return False
        self._scanned_ns = now_ns
        if not self.costmap_manager.add_scan(scan, history, now_ns):
            return False
        following, execution = self.current.following, self.current.execution
        if following is not None:
            following.update(tracks_seen(self.costmap_manager.require_context()), now_ns)
        motion = self._motion_state.motion()
        if motion is None or execution is None:
            return False
        if self.current.is_driving:
            self._yielding.decide(execution, motion, now_ns)
        if not self._yielding.update(motion, now_ns):
            execution.update(motion, now_ns)
        return True

    def command(self, now_ns: int) -> Twist2D | None:
        """Return the velocity to command now, None for silence."""
        twist = self._choose_velocity(now_ns, self._motion_state.elapsed_s(now_ns))
        self._motion_state.record_command(twist, now_ns)
        return twist

    def _choose_velocity(self, now_ns: int, elapsed_s: float) -> Twist2D | None:
        """Return what to command: zero while the robot must not drive, None for silence."""
        spin = self._spin_to_localize.command(self.inputs, self._motion_state.turn_limits(), now_ns)
        if spin is not None:
            return spin
        execution = self.current.execution
        if execution is None or not self.current.is_driving:
            return Twist2D.zero() if self.current.is_stopping(now_ns) else None
        if self._guard.must_wait(now_ns):
            execution.progress.reset_progress()  # it waits for what it needs to drive
            return Twist2D.zero()
        speed = self._driver.speed(execution, now_ns)
        now = self._motion_state.control_input(speed, now_ns, elapsed_s)
        if now is None:
            return Twist2D.zero()
        yielding = self._yielding.command(execution, now)
        return self._driver.command(execution, now) if yielding is None else yielding

    def maintain(self, now_ns: int) -> None:
        """Do what may take longer, after the command is out: forget old obstacles, replan."""
        self.costmap_manager.maintain(now_ns)
        self._guard.pause_off_map(now_ns)
        if self._guard.is_back_on_map(now_ns):
            self.requests.resume_or_fail(now_ns)
        execution = self.current.execution
        if execution is None or not self.current.is_driving:
            return
        now = self._motion_state.control_input(execution.goal.speed, now_ns, 0.0)
        if now is None or self.costmap_manager.trouble(now_ns) is not None:
            return
        self._driver.notice_jumps(execution)
        self.costmap_manager.update_position(self.inputs.base_pose())
        if not self._yielding.maintain(execution, now):
            self._driver.maintain(execution, now)

    def notice_silence(self, now_ns: int) -> None:
        """Make the goal wait for its inputs, and fail, also where none comes to ask for a cycle."""
        if self.current.is_driving:
            self._guard.must_wait(now_ns)

    # What else is heard.

    def update_base(self, base: BaseState, now_ns: int) -> None:
        """Take in the base's state: a stop, or another source of commands, pauses the goal."""
        before, self.inputs.base = self.inputs.base, base
        self._driver.update_base(base, now_ns)
        self._guard.update_base(base, before, now_ns)

    def begin_epoch(self, now_ns: int) -> None:
        """Start over after a restart of base: earlier measurements do not count."""
        self._scanned_ns = 0
        self.inputs.begin_epoch()
        self.costmap_manager.forget()
        self._motion_state.record_command(None, now_ns)
        self._guard.begin_epoch(now_ns)

    # What is reported.

    def costmaps(self, now_ns: int) -> tuple[OccupancyGrid | None, OccupancyGrid | None]:
        """Return the whole costmap and the part around the robot, as far as they are known."""
        context, here = self.costmap_manager.context, self.inputs.base_pose()
        return wire.costmap_messages(context, here, self.inputs.frame, now_ns)
