"""Costmap and path follow what changes: another map, other zones, another footprint."""

from collections.abc import Sequence

from trolley import codes
from trolley.codes import Refused
from trolley.config import PlannerConfig
from trolley.geometry import Pose2D
from trolley_planner.context.planning_context import CostmapManager, PlanningContext
from trolley_planner.driving.goal_execution import GoalExecution
from trolley_planner.goals import validate
from trolley_planner.navigation.current_goal import CurrentGoal
from trolley_planner.navigation.yielding import Yielding
from trolley_planner.sensing.inputs import Inputs


class Replanner:
    """Rebuilds the costmap where it no longer fits, and drives on to the same goal on it.

    Args:
        config: of the planner.
        inputs: the newest messages.
        costmap_manager: owns the costmap.
        current: the goal.
        yielding: nobody is waited for on another costmap.
    """

    def __init__(
        self,
        config: PlannerConfig,
        inputs: Inputs,
        costmap_manager: CostmapManager,
        current: CurrentGoal,
        yielding: Yielding,
    ) -> None:
        self._config = config
        self._inputs = inputs
        self._costmap_manager = costmap_manager
        self._current = current
        self._yielding = yielding

    def set_config(self, config: PlannerConfig) -> None:
        """Apply other settings from now on."""
        self._config = config

    def rebuild(self, now_ns: int, goals: Sequence[Pose2D] = ()) -> None:
        """Rebuild the costmap if map, zones or robot changed, and replan on it.

        Args:
            now_ns: robot time.
            goals: poses that it has to hold besides the current goal's.
        """
        manager, execution = self._costmap_manager, self._current.execution
        left = None
        if execution is not None and self._current.board.is_active:
            left = execution.remaining_goal()
        if not manager.rebuild([*goals, *((*left.vias, left.pose) if left else ())]):
            return
        if execution is None or not self._current.board.is_active:
            self._current.drop_execution()
        elif manager.context is None:
            trouble = manager.trouble(now_ns) or Refused(codes.NOT_READY)
            self._current.end("failed", trouble.code, now_ns, trouble.message)
        elif manager.is_other_map:
            self._current.end("failed", codes.WRONG_MAP, now_ns, "The robot is on another map now.")
        else:
            self._plan_anew(execution, manager.context, now_ns)

    def context_for(self, goals: Sequence[Pose2D], now_ns: int) -> tuple[PlanningContext, Pose2D]:
        """Return the planning context for these goals, and the robot's pose.

        Raises:
            Refused: either is not known.
        """
        here = self._inputs.base_pose()
        if here is None:
            raise Refused(codes.NOT_LOCALIZED)
        self.rebuild(now_ns, goals)
        return self._costmap_manager.require_context(), here

    def _plan_anew(self, execution: GoalExecution, context: PlanningContext, now_ns: int) -> None:
        """Drive on to the same goal on a costmap that has changed; fail if that is not possible."""
        here = self._inputs.base_pose()
        if here is None:
            return
        try:
            validated = validate(execution.remaining_goal(), context, here, self._config)
        except Refused as refusal:
            blocked = refusal.details.get("blocked", [])
            self._current.end("failed", refusal.code, now_ns, refusal.message, blocked)
            return
        if context is execution.context:  # only zones have changed
            execution.route.replan_soon()
        else:
            self._yielding.forget()
            self._current.execute(validated, context, now_ns, execution)
