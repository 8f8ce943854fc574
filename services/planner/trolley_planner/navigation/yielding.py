"""Who goes first: other robots are given way to, and people are yielded to in narrow places."""

from trolley import codes
from trolley.config import PlannerConfig
from trolley.geometry import Twist2D
from trolley_planner import wire
from trolley_planner.context.motion_state import ControlInput, MotionState
from trolley_planner.context.planning_context import CostmapManager
from trolley_planner.control.controller import Motion
from trolley_planner.driving.goal_execution import GoalExecution
from trolley_planner.fleet.giving_way import GivingWay
from trolley_planner.fleet.neighbours import Neighbours
from trolley_planner.fleet.stepping_aside import SENTENCE, SteppingAside
from trolley_planner.navigation.current_goal import CurrentGoal
from trolley_planner.sensing.inputs import Inputs


class Yielding:
    """Decides whether the robot waits for another robot or for people, and drives it meanwhile.

    Args:
        config: of the planner.
        inputs: the newest messages.
        costmap_manager: learns where the other robots will be.
        motion_state: the robot's limits.
        current: the goal, which waits.
    """

    def __init__(
        self,
        config: PlannerConfig,
        inputs: Inputs,
        costmap_manager: CostmapManager,
        motion_state: MotionState,
        current: CurrentGoal,
    ) -> None:
        self.neighbours = Neighbours()
        self._inputs = inputs
        self._costmap_manager = costmap_manager
        self._motion_state = motion_state
        self._current = current
        self._giving_way = GivingWay(config)
        self._stepping_aside = SteppingAside()

    def set_config(self, config: PlannerConfig) -> None:
        """Apply other settings from now on."""
        self._giving_way.set_config(config)

    def update_neighbours(self, now_ns: int, monotonic_ns: int) -> None:
        """Tell the costmap where the other robots of the house will be.

        Args:
            now_ns: robot time.
            monotonic_ns: local time, by which the age of their messages is measured.
        """
        context, grid = self._costmap_manager.context, self._inputs.map
        if context is not None and grid is not None:
            robots = self.neighbours.on_map(grid.name, monotonic_ns)
            self._giving_way.update_neighbours(context, robots, now_ns)

    def decide(self, execution: GoalExecution, motion: Motion, now_ns: int) -> None:
        """Decide whether to wait: for a robot first, else for people, unless it follows one."""
        self._giving_way.decide(self.neighbours.own_name, execution, motion, now_ns)
        if self._giving_way.wait is not None or self._current.following is not None:
            self._stepping_aside.forget()
            return
        speed = self._motion_state.limits(execution.goal.speed).max_speed
        self._stepping_aside.decide(execution, motion, speed, now_ns)

    def update(self, motion: Motion, now_ns: int) -> bool:
        """Take in a scan on the way to where it waits; False if it drives to its goal."""
        return self._giving_way.update(motion, now_ns) or self._stepping_aside.update(
            motion, now_ns
        )

    def command(self, execution: GoalExecution, now: ControlInput) -> Twist2D | None:
        """Return the velocity while it waits, None if it need not."""
        if self._giving_way.wait is not None:
            return self._give_way(now)
        if self._stepping_aside.is_active:
            trouble, why = codes.WAITING, SENTENCE
            if self._stepping_aside.waits_beside_way:
                robot = self.blocking_robot(execution)
                trouble, why = codes.BLOCKED, wire.recovery_sentence(execution, robot)
            self._current.report("recovering", trouble, now.now_ns, why)
            return self._stepping_aside.command(now)
        return None

    def maintain(self, execution: GoalExecution, now: ControlInput) -> bool:
        """Replan the way to where it waits; False if it drives to its goal."""
        if self._giving_way.wait is not None:
            self._giving_way.maintain(execution.context, now)
        elif self._stepping_aside.is_active:
            self._stepping_aside.maintain(now)
            if self._stepping_aside.waits_beside_way:
                execution.replan_if_due(now)  # another way may open, or a detour be worth it
        else:
            return False
        return True

    def forget(self) -> None:
        """Wait for nobody any more, as with a new goal."""
        self._giving_way.forget()
        self._stepping_aside.forget()

    def pop_waited_ns(self) -> int:
        """Return how long the last wait took, only once; 0 if there was none."""
        return self._giving_way.pop_waited_ns() + self._stepping_aside.pop_waited_ns()

    def blocking_robot(self, execution: GoalExecution) -> str | None:
        """Return the name of the robot that is in the way, if that is the trouble."""
        is_blocked = execution.trouble == codes.BLOCKED
        return self._giving_way.blocking_robot(execution) if is_blocked else None

    def _give_way(self, now: ControlInput) -> Twist2D:
        """Return the velocity while the robot waits for another; fail if that lasts too long."""
        wait, now_ns = self._giving_way.wait, now.now_ns
        if wait is None or self._giving_way.has_waited_enough(now_ns):
            name = "another" if wait is None else wait.name
            self._current.end("failed", codes.BLOCKED, now_ns, f"Robot {name} is not moving on.")
            return Twist2D.zero()
        self._current.report("recovering", codes.WAITING, now_ns, wait.sentence)
        return self._giving_way.command(now)
