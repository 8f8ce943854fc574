"""What drives to the current goal: its execution, or the person that it follows."""

from trolley import codes
from trolley.geometry import Twist2D
from trolley.messages import BaseState
from trolley_planner import wire
from trolley_planner.context.motion_state import ControlInput
from trolley_planner.context.planning_context import PlanningContext
from trolley_planner.control.controller import limited_change, safe_command
from trolley_planner.driving.blindness import Blindness
from trolley_planner.driving.following import Following
from trolley_planner.driving.goal_execution import GoalExecution
from trolley_planner.goals import ValidatedGoal
from trolley_planner.navigation.current_goal import CurrentGoal
from trolley_planner.navigation.yielding import Yielding
from trolley_planner.sensing.inputs import Inputs


class GoalDriver:
    """Drives to the current goal, and reports how it goes.

    Args:
        inputs: the newest messages.
        current: the goal.
        yielding: who waited, and which robot is in the way.
    """

    def __init__(self, inputs: Inputs, current: CurrentGoal, yielding: Yielding) -> None:
        self._inputs = inputs
        self._current = current
        self._yielding = yielding
        self._blindness = Blindness(inputs)
        self._num_jumps = 0

    def set_off(self, validated: ValidatedGoal, context: PlanningContext, now_ns: int) -> None:
        """Start driving along a first path."""
        self._yielding.forget()
        self._current.execute(validated, context, now_ns)
        self._blindness.forget()
        self._current.set_off(now_ns)

    def update_base(self, base: BaseState, now_ns: int) -> None:
        """Take in the base's state, which is in the inputs already."""
        self._blindness.update_base(base, now_ns)

    def speed(self, execution: GoalExecution, now_ns: int) -> float | None:
        """Return the highest speed that the goal asks for [m/s], None for any."""
        here, following = self._inputs.base_pose(), self._current.following
        asked = execution.goal.speed
        if following is None or here is None:
            return asked
        wanted = following.speed(here, now_ns)
        return wanted if asked is None else asked if wanted is None else min(asked, wanted)

    def command(self, execution: GoalExecution, now: ControlInput) -> Twist2D:
        """Return the velocity to the goal, or behind the person."""
        if self._current.following is not None:
            return self._follow(self._current.following, execution, now)
        return self._execute(execution, now)

    def maintain(self, execution: GoalExecution, now: ControlInput) -> None:
        """Keep the goal behind the person, and look for a better path."""
        following = self._current.following
        goal = None if following is None else following.moved_goal(execution.goal, now.now_ns)
        if goal is not None:
            execution.move_goal(goal)
            self._current.board.move(goal)
        execution.replan_if_due(now)

    def notice_jumps(self, execution: GoalExecution) -> None:
        """Replan soon if the pose was corrected by more than noise."""
        if self._num_jumps != self._inputs.num_jumps:
            self._num_jumps = self._inputs.num_jumps
            execution.route.replan_soon()

    def _follow(self, following: Following, execution: GoalExecution, now: ControlInput) -> Twist2D:
        """Return the velocity behind a person; end the goal when they are lost."""
        here, now_ns = self._inputs.base_pose(), now.now_ns
        if following.is_lost(now_ns) or here is None:
            self._current.end("failed", codes.PERSON_LOST, now_ns)
            return Twist2D.zero()
        context = execution.context
        if following.must_stand(here, context.footprint.circumscribed_m, now_ns):
            execution.stand()
            self._current.report("driving", "", now_ns, wire.BEHIND_PERSON)
            wanted = following.turn_to(here, now.limits)
            wanted = limited_change(now.motion.twist, wanted, now.limits, now.elapsed_s)
            return safe_command(now.motion, wanted, context.local_costmap, now.limits)
        return self._execute(execution, now)

    def _execute(self, execution: GoalExecution, now: ControlInput) -> Twist2D:
        """Return the velocity of the goal's execution, and report how it goes."""
        waited_ns = self._yielding.pop_waited_ns()
        if waited_ns > 0:
            execution.resume_after_wait(waited_ns)
        following, twist = self._current.following, execution.command(now)
        trouble, blind = self._blindness.trouble(execution, now)
        if execution.outcome == "arrived" and following is not None:
            execution.stand()  # until the person walks on
        elif execution.outcome == "arrived":
            self._current.end("arrived", "", now.now_ns, "The robot has arrived.")
        elif execution.outcome == "failed":
            blocker = wire.blocked_by(self._yielding.blocking_robot(execution))
            why = wire.GOAL_OCCUPIED if execution.is_waiting_at_goal else blind or blocker
            self._current.end("failed", trouble, now.now_ns, why)
        elif execution.is_recovering or execution.is_waiting:
            why = wire.recovery_sentence(execution, self._yielding.blocking_robot(execution))
            self._current.report("recovering", trouble, now.now_ns, blind or why)
        elif self._blindness.is_held:
            self._current.report("driving", codes.BLIND, now.now_ns, blind)
        elif following is not None and not following.is_in_sight(now.now_ns):
            self._current.report("recovering", codes.PERSON_LOST, now.now_ns, wire.PERSON_UNSEEN)
        else:
            self._current.report("driving", "", now.now_ns)
        return twist
