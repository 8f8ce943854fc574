"""The planner's results as messages of the wire."""

from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.messages import GoalStatus, OccupancyGrid, Path
from trolley.messages.types import floats_to_bytes
from trolley_planner.context.planning_context import Rig
from trolley_planner.control.controller import DT_S, Motion
from trolley_planner.control.rollout import Limits
from trolley_planner.driving.goal_execution import Drive
from trolley_planner.driving.recovery import Try

Ending = Literal["arrived", "failed", "canceled"]

TAKEN = "Something stands on the goal."
SENTENCES_OF_TRIES = {
    Try.WAIT: "Something is in the way; the robot waits for it to go.",
    Try.CLEAR: "The robot looks again at what stands around it.",
    Try.BACK_UP: "The robot backs up the way it came.",
    Try.TURN: "The robot turns to look around.",
    Try.REROUTE: "The robot did not get through; it takes another way.",
    Try.WAIT_LONGER: "Something is still in the way; the robot goes on waiting.",
}


def path_message(
    poses_grid: NDArray[np.float64], frame_T_grid: Pose2D, frame: str, stamp_ns: int, dt: float
) -> Path:
    """Return poses (n, 3) of frame `grid` as a message."""
    poses = frame_T_grid.transform_poses(poses_grid)
    return Path(stamp_ns=stamp_ns, frame=frame, poses=floats_to_bytes(poses), dt=dt)


def route_message(drive: Drive, frame: str, stamp_ns: int) -> Path:
    """Return the path of a drive from where the robot is to the goal."""
    route = drive.route
    points = route.path.points
    poses = np.concatenate([points, route.path.headings(drive.goal_grid.yaw)[:, None]], axis=1)
    frame_T_grid = drive.rig.costmap.frame_T_grid
    return path_message(poses[route.index :], frame_T_grid, frame, stamp_ns, 0.0)


def trajectory_message(rig: Rig, frame: str, stamp_ns: int) -> Path | None:
    """Return what the controller's last command leads to, None if it has none."""
    poses = rig.controller.trajectory
    if len(poses) == 0:
        return None
    return path_message(poses.astype(np.float64), rig.costmap.frame_T_grid, frame, stamp_ns, DT_S)


def blocked_by(robot: str | None) -> str | None:
    """Return the sentence for a robot that stands in the way, None without one."""
    return None if robot is None else f"Robot {robot} stands in the way."


def trying(drive: Drive, robot: str | None = None) -> str:
    """Return the sentence of what the robot tries to get free, `robot` being in its way."""
    if drive.is_waiting:
        return f"{TAKEN} The robot waits for it to go."
    if robot is not None and drive.recovery.current in (Try.WAIT, Try.WAIT_LONGER):
        return f"{blocked_by(robot)} The robot waits for it to go."
    return "" if drive.recovery.current is None else SENTENCES_OF_TRIES[drive.recovery.current]


def details(drive: Drive, motion: Motion, limits: Limits) -> GoalStatus:
    """Return a status of which only distance, ETA, recoveries and obstacles count."""
    remaining = drive.remaining_m(motion.pose)
    blocked: list[tuple[float, float]] = []
    if drive.recovery.current is not None or drive.route.is_blocked:
        points = [*drive.route.blocked_points(), *drive.route.narrow] or [drive.place_ahead()]
        in_frame = drive.rig.costmap.frame_T_grid.transform_points(np.array(points))
        blocked = [(float(x), float(y)) for x, y in in_frame]
    return GoalStatus(
        stamp_ns=0,
        id=None,
        state="driving",
        distance_remaining=remaining,
        eta=drive.seconds_left(motion.pose, limits),
        recoveries=drive.recovery.count,
        blocked=blocked,
    )


def path_left(drive: Drive | None, frame: str, stamp_ns: int) -> Path:
    """Return the path that is left of a drive, an empty one without a drive."""
    if drive is None:
        return Path(stamp_ns=stamp_ns, frame=frame, poses=floats_to_bytes(np.empty(0)))
    return route_message(drive, frame, stamp_ns)


def costmap_messages(
    rig: Rig | None, here: Pose2D | None, frame: str, stamp_ns: int
) -> tuple[OccupancyGrid | None, OccupancyGrid | None]:
    """Return the whole costmap and the part around the robot, as far as they are known."""
    if rig is None:
        return None, None
    rig.costmap.refresh()
    whole = costmap_message(rig, frame, stamp_ns)
    if here is None:
        return whole, None
    return whole, window_message(whole, rig.costmap.to_grid(here), rig.half_m)


def costmap_message(rig: Rig, frame: str, stamp_ns: int) -> OccupancyGrid:
    """Return the whole costmap as a message."""
    costmap = rig.costmap
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
