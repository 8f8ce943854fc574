"""The planner's results as messages of the wire."""

import msgspec
import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.messages import GoalStatus, OccupancyGrid, Path
from trolley.messages.types import floats_to_bytes
from trolley_planner.context.planning_context import PlanningContext
from trolley_planner.control.controller import Motion
from trolley_planner.control.robot_motion import DT_S, Limits
from trolley_planner.driving.goal_execution import GoalExecution
from trolley_planner.driving.recovery import RecoveryAction

GOAL_OCCUPIED = "Something is on the goal."
BEHIND_PERSON = "The robot is waiting behind the person."
PERSON_UNSEEN = "The person is out of sight; the robot is driving to where it last saw them."
RECOVERY_SENTENCES = {
    RecoveryAction.WAIT: "Something is in the way; the robot waits for it to go.",
    RecoveryAction.CLEAR: "The robot is checking its surroundings again.",
    RecoveryAction.BACK_UP: "The robot is backing up the way it came.",
    RecoveryAction.TURN: "The robot turns to look around.",
    RecoveryAction.REROUTE: "The robot did not get through; it takes another route.",
    RecoveryAction.WAIT_LONGER: "Something is still in the way; the robot keeps waiting.",
}


def path_message(
    poses_grid: NDArray[np.float64], frame_T_grid: Pose2D, frame: str, stamp_ns: int, dt: float
) -> Path:
    """Return poses (n, 3) of frame `grid` as a message."""
    poses = frame_T_grid.transform_poses(poses_grid)
    return Path(stamp_ns=stamp_ns, frame=frame, poses=floats_to_bytes(poses), dt=dt)


def route_message(execution: GoalExecution, frame: str, stamp_ns: int) -> Path:
    """Return the path from where the robot is to the goal."""
    route = execution.route
    points = route.path.points
    poses = np.concatenate([points, route.path.headings(execution.goal_grid.yaw)[:, None]], axis=1)
    frame_T_grid = execution.context.costmap.frame_T_grid
    return path_message(poses[route.index :], frame_T_grid, frame, stamp_ns, 0.0)


def trajectory_message(context: PlanningContext, frame: str, stamp_ns: int) -> Path | None:
    """Return what the controller's last command leads to, None if it has none."""
    poses = context.controller.trajectory
    if len(poses) == 0:
        return None
    return path_message(
        poses.astype(np.float64), context.costmap.frame_T_grid, frame, stamp_ns, DT_S
    )


def blocked_by(robot: str | None) -> str | None:
    """Return the sentence for a robot that is in the way, None without one."""
    return None if robot is None else f"Robot {robot} is in the way."


def recovery_sentence(execution: GoalExecution, robot: str | None = None) -> str:
    """Return the sentence for the current recovery behaviour; `robot` is in the way."""
    if execution.is_waiting_at_goal:
        return f"{GOAL_OCCUPIED} The robot waits for it to go."
    action = RecoveryAction.WAIT if execution.is_waiting else execution.recovery.sequence.current
    if robot is not None and action in (RecoveryAction.WAIT, RecoveryAction.WAIT_LONGER):
        return f"{blocked_by(robot)} The robot waits for it to go."
    return "" if action is None else RECOVERY_SENTENCES[action]


def status_details(execution: GoalExecution, motion: Motion, limits: Limits) -> GoalStatus:
    """Return a status of which only distance, ETA, recoveries and obstacles count."""
    remaining = execution.remaining_m(motion.pose)
    blocked: list[tuple[float, float]] = []
    if execution.is_recovering or execution.route.is_blocked:
        points = [*execution.route.blocked_points(), *execution.route.narrow] or [
            execution.recovery.point_ahead()
        ]
        in_frame = execution.context.costmap.frame_T_grid.transform_points(np.array(points))
        blocked = [(float(x), float(y)) for x, y in in_frame]
    return GoalStatus(
        stamp_ns=0,
        id=None,
        state="driving",
        distance_remaining=remaining,
        eta=execution.eta_s(motion.pose, limits),
        recoveries=execution.recovery.sequence.count,
        blocked=blocked,
    )


def remaining_path_message(execution: GoalExecution | None, frame: str, stamp_ns: int) -> Path:
    """Return the path that is left to the goal, an empty one without a goal."""
    if execution is None:
        return Path(stamp_ns=stamp_ns, frame=frame, poses=floats_to_bytes(np.empty(0)))
    return route_message(execution, frame, stamp_ns)


def costmap_messages(
    context: PlanningContext | None, here: Pose2D | None, frame: str, stamp_ns: int
) -> tuple[OccupancyGrid | None, OccupancyGrid | None]:
    """Return the whole costmap and the part around the robot, as far as they are known."""
    if context is None:
        return None, None
    context.costmap.refresh()
    whole = costmap_message(context, frame, stamp_ns)
    if here is None:
        return whole, None
    return whole, window_message(whole, context.costmap.to_grid(here), context.half_m)


def costmap_message(context: PlanningContext, frame: str, stamp_ns: int) -> OccupancyGrid:
    """Return the whole costmap as a message."""
    costmap = context.costmap
    rows, cols = costmap.shape
    return OccupancyGrid(
        stamp_ns=stamp_ns,
        name="costmap",
        frame=frame,
        resolution=costmap.resolution_m,
        width=cols,
        height=rows,
        origin=costmap.frame_T_grid,
        cells=memoryview(np.ascontiguousarray(costmap.costs()).tobytes()),
    )


def window_message(whole: OccupancyGrid, here_grid: Pose2D, half_m: float) -> OccupancyGrid:
    """Return the part of a costmap message around the robot."""
    edge = whole.resolution
    rows, cols = whole.height, whole.width
    reach = round(half_m / edge)
    row, col = int(here_grid.y / edge), int(here_grid.x / edge)
    first_row, last_row = (min(max(row + by, 0), rows) for by in (-reach, reach))
    first_col, last_col = (min(max(col + by, 0), cols) for by in (-reach, reach))
    cells = np.frombuffer(whole.cells, dtype=np.int8).reshape(rows, cols)
    part = np.ascontiguousarray(cells[first_row:last_row, first_col:last_col])
    corner = whole.origin @ Pose2D(first_col * edge, first_row * edge, 0.0)
    return msgspec.structs.replace(
        whole,
        width=part.shape[1],
        height=part.shape[0],
        origin=corner,
        cells=memoryview(part.tobytes()),
    )
