"""What one robot plans with on one map: costmaps, global planner, controller, kept up to date."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from trolley import codes
from trolley.codes import Refused
from trolley.config import PlannerConfig
from trolley.geometry import Pose2D
from trolley.gridmap import UNKNOWN, GridMap
from trolley.messages import OccupancyGrid, Odometry, Robot, Scan, Suspects, Zones
from trolley.messages.types import floats_from_bytes
from trolley_planner.context.floor_around import FloorAround
from trolley_planner.control.controller import Controller
from trolley_planner.control.local_costmap import LocalCostmap
from trolley_planner.control.mppi import Mppi
from trolley_planner.control.pure_pursuit import PurePursuit
from trolley_planner.control.robot_motion import zone_speed
from trolley_planner.costmap.costmap import Costmap
from trolley_planner.costmap.fine_grid import FINE, FineGrid
from trolley_planner.costmap.footprint import NO_LIMITS, Field, Footprint, clearance_at
from trolley_planner.paths.footprint_check import least_clearance, tight_into
from trolley_planner.paths.global_planner import GlobalPlanner
from trolley_planner.paths.hybrid_astar.centering import centered
from trolley_planner.paths.hybrid_astar.motion_primitives import Maneuver
from trolley_planner.paths.hybrid_astar.pose_search import POSE_SEARCH, Task
from trolley_planner.paths.hybrid_astar.pull_out import pull_out
from trolley_planner.paths.hybrid_astar.search_space import NEVER_SEEN
from trolley_planner.sensing.beams import ScanShape, Sweep
from trolley_planner.sensing.inputs import Inputs

WINDOW_MARGIN_M = 0.4
SPEEDS = ("max_speed_mps", "max_turn_radps", "slow_speed_mps", "unsure_speed_mps")
"""Settings that are read for each command; a change of any other needs a new context."""
SEEN_M = 0.8
"""Distances to obstacles are computed up to this where maneuvers are searched [m]."""
SHRUNKEN = (0.85, 0.7, 0.5)
"""Sizes of the outlines within the robot's that are tried for what it would stand on, as shares."""
TURN_STEP_RAD = 0.1
"""Angle between the poses at which a turn is checked [rad]."""


class PlanningContext:
    """Costmaps and planners that are rebuilt together when the map or the robot changes.

    Args:
        grid: the map, or an empty one around the robot.
        footprint: of the robot.
        config: of the planner.
        max_speed: highest speed that the robot may have [m/s].
    """

    def __init__(
        self, grid: GridMap, footprint: Footprint, config: PlannerConfig, max_speed: float
    ) -> None:
        free = config.unknown_is_free or config.frame == "odom"
        self.grid = grid
        self.footprint = footprint
        self.costmap = Costmap(grid, footprint, config, free)
        self.planner = GlobalPlanner(self.costmap)
        half = half_window_m(footprint, config, max_speed)
        self.local_costmap = LocalCostmap(self.costmap, footprint, config, half)
        self._shrunken = [
            (footprint.body.scaled(share), (1.0 - share) * footprint.inscribed_m)
            for share in SHRUNKEN
        ]
        self.half_m = half
        self.pose_search = self.planner.pose_search
        self._fine_grid = FineGrid(self.costmap, FINE.finest_m, SEEN_M + footprint.circumscribed_m)
        self.controller: Controller = (
            PurePursuit(config) if config.controller == "pursuit" else Mppi(config)
        )

    def map_clearance(self, pose_grid: Pose2D, enough_m: float) -> float:
        """Return how far the footprint at a pose is from map and zones [m], at most `enough_m`.

        The end of the map is an obstacle, too, unless what nobody has seen is free.
        """
        costmap = self.costmap
        edge = costmap.resolution_m
        field = Field(costmap.static.distance_m, NO_LIMITS, NO_LIMITS, 0.0, 0.0, edge, edge, edge)
        found = clearance_at(
            field, self.local_costmap.body, pose_grid.x, pose_grid.y, pose_grid.yaw, enough_m
        )
        if costmap.unknown_is_free:
            return found
        corners = pose_grid.transform_points(self.footprint.polygon)
        rows, cols = costmap.shape
        inside = np.minimum(corners, edge * np.array([cols, rows]) - corners)
        return min(found, float(inside.min()))

    def seen_clearance(self, pose_grid: Pose2D, enough_m: float) -> float:
        """Return the clearance of a pose in the local costmap from all obstacles in it."""
        return clearance_at(
            self.local_costmap.field,
            self.local_costmap.body,
            pose_grid.x,
            pose_grid.y,
            pose_grid.yaw,
            enough_m,
        )

    def clearance_within(self, pose_grid: Pose2D, enough_m: float) -> float:
        """Return the same of a pose where the robot is not yet: what it would stand on counts, too.

        Of things only the side is known that the lidar sees, which may be thinner than the
        robot's edge is deep in them.
        """
        least_m = self.seen_clearance(pose_grid, enough_m)
        field, place = self.local_costmap.field, (pose_grid.x, pose_grid.y, pose_grid.yaw)
        for body, depth_m in self._shrunken:
            least_m = min(least_m, clearance_at(field, body, *place, enough_m + depth_m) - depth_m)
        return least_m

    def least_clearance(self, poses: NDArray[np.float64], enough_m: float) -> float:
        """Return the smallest of these at some poses (n, 3)."""
        local_costmap = self.local_costmap
        return least_clearance(local_costmap.field, local_costmap.body, poses, enough_m)

    def can_turn_by(self, pose_grid: Pose2D, turn: float, clearance_m: float) -> bool:
        """Say whether the robot can turn in place by an angle [rad], to the left if positive."""
        return self.turn_clearance(pose_grid, turn, clearance_m) >= clearance_m

    def turn_clearance(self, pose_grid: Pose2D, turn: float, enough_m: float) -> float:
        """Return the smallest clearance of such a turn [m], at most `enough_m`."""
        count = max(1, math.ceil(abs(turn) / TURN_STEP_RAD))
        poses = np.empty((count, 3))
        poses[:, 0], poses[:, 1] = pose_grid.x, pose_grid.y
        poses[:, 2] = pose_grid.yaw + turn * np.arange(1, count + 1) / count
        return self.least_clearance(poses, enough_m)

    def tight_places(
        self, points: NDArray[np.float64], room_m: float, aside_m: float
    ) -> NDArray[np.bool_]:
        """Say at which points (n, 2) of a path the footprint has little clearance.

        Args:
            points: in `grid` [m], in the local costmap.
            room_m: clearance with which there is enough,
            aside_m: or with which there is this far beside the path.
        """
        found = np.empty(len(points), dtype=np.bool_)
        local_costmap = self.local_costmap
        tight_into(found, local_costmap.field, local_costmap.body, points, (room_m, aside_m))
        return found

    def floor_around(self, pose_grid: Pose2D) -> FloorAround:
        """Return where the robot can drive from a pose within `half_m` of it."""
        return FloorAround(self.costmap, pose_grid, 2.0 * self.half_m)

    def zone_speed(self, pose_grid: Pose2D) -> float:
        """Return the limit of the speed zones at a place [m/s]."""
        return zone_speed(self.local_costmap.field, pose_grid.x, pose_grid.y)

    def find_maneuver(self, task: Task, half_m: float, *, may_back: bool = True) -> Maneuver | None:
        """Return a maneuver on the present costmap; it backs up only over known floor.

        Args:
            task: from where to where, in `grid`.
            half_m: from the start to the edges of the square in which it is searched.
            may_back: whether it may back up at all.
        """
        costmap, grid = self.costmap, self._fine_grid
        half = math.ceil(half_m / costmap.resolution_m)
        row, col = (
            math.floor(value / costmap.resolution_m) for value in (task.start.y, task.start.x)
        )
        first, size = (row - half, col - half), (2 * half, 2 * half)
        grid.update(first, size)
        if may_back:
            unseen = self.local_costmap.known_floor.in_fine_cells(grid, first, task.start)
        else:
            unseen = np.full_like(grid.mask, NEVER_SEEN)
        closed = np.zeros_like(unseen)
        body, most = self.footprint.body, POSE_SEARCH.driving_states
        lead = pull_out(task.start, grid, unseen, body)
        if lead is not None:
            task_out = task._replace(start=lead.end)
            found = self.pose_search.find(grid, unseen, closed, task_out, most)
            if found is not None:
                return centered(found, grid, unseen, body).after(lead)
        found = self.pose_search.find(grid, unseen, closed, task, most)
        return None if found is None else centered(found, grid, unseen, body)


def half_window_m(footprint: Footprint, config: PlannerConfig, max_speed: float) -> float:
    """Return how far the local costmap reaches from the robot [m] that drives so fast at most."""
    return max(1.5, max_speed * config.horizon_s + footprint.circumscribed_m + WINDOW_MARGIN_M)


def empty_grid(centre: Pose2D, size_m: float, resolution_m: float) -> GridMap:
    """Return a square map of which nothing is known, around a place.

    Its axes are those of the frame; its corner lies on a whole number of cells.
    """
    count = round(size_m / resolution_m)
    x = round(centre.x / resolution_m) - count // 2
    y = round(centre.y / resolution_m) - count // 2
    cells = np.full((count, count), UNKNOWN, dtype=np.int8)
    return GridMap("odom", resolution_m, Pose2D(x * resolution_m, y * resolution_m, 0.0), cells)


@dataclass(frozen=True, slots=True)
class CostmapManagerParams:
    """Upkeep of the costmap; by hand."""

    fade_s: float = 1.0
    """Time between two passes that forget old obstacles."""
    costs_s: float = 0.2
    """Time between two steps of taking over the costs that programs publish."""
    edge_share: float = 0.25
    """In frame `odom` the costmap moves when the robot comes this near to its edge, as a share
    of `odom_size_m`."""
    largest_m: float = 80.0
    """A goal in frame `odom` is refused if it takes a costmap larger than this: 2.6 million cells
    of 5 cm."""


MANAGER = CostmapManagerParams()


class CostmapManager:
    """Owns the planning context: costmaps, global planner, controller.

    Args:
        config: of the planner.
        inputs: where the messages are.
    """

    def __init__(self, config: PlannerConfig, inputs: Inputs) -> None:
        self._config = config
        self._is_outdated = False
        self._inputs = inputs
        self.context: PlanningContext | None = None
        self.is_other_map = False
        """Whether the last rebuild was for a map of another name."""
        self._robot: Robot | None = None
        self._map: OccupancyGrid | None = None
        self._zones: Zones | None = None
        self._footprint: Footprint | None = None
        self._footprint_problem = ""
        self._suspected: tuple[PlanningContext, Suspects | None] | None = None
        self._faded_ns = 0
        self._costs_ns = 0
        self._num_jumps = 0

    def set_config(self, config: PlannerConfig) -> None:
        """Apply other settings; keep costmaps that still fit where only speeds change."""
        before, self._config = self._config, config
        speeds = {name: getattr(config, name) for name in SPEEDS}
        has_changed = msgspec.structs.replace(before, **speeds) != config
        context, robot = self.context, self._robot
        if context is not None and robot is not None:
            needed_m = half_window_m(context.footprint, config, self._speed(robot))
            has_changed |= needed_m > context.half_m
        self._is_outdated |= has_changed

    def require_context(self) -> PlanningContext:
        """Return the planning context.

        Raises:
            Refused: it cannot be made of what is known.
        """
        if self.context is None:
            raise Refused(codes.NOT_READY, self._footprint_problem or None)
        return self.context

    def trouble(self, now_ns: int) -> Refused | None:
        """Return why the robot must not drive: it is blind, lost, or without a usable footprint.

        A silent sensor is named first: without it there is no new pose either.
        """
        inputs, context = self._inputs, self.context
        code = inputs.silence(now_ns) or inputs.pose_trouble(now_ns)
        if code is not None:
            return Refused(code)
        if context is None:
            return Refused(codes.NOT_READY, self._footprint_problem or None)
        here = inputs.base_pose()
        return None if here is None else position_trouble(context, here)

    def rebuild(self, goals: Sequence[Pose2D] = ()) -> bool:
        """Rebuild the context if robot, map or zones changed; True if so.

        What was seen stays, unless it is another map.

        Args:
            goals: in frame `odom` it is made so large that it holds these.
        """
        self.is_other_map = False
        inputs = self._inputs
        robot, grid, zones = inputs.robot, inputs.map, inputs.zones
        if robot is None or (inputs.frame == "map" and grid is None):
            return False
        # Until it is rebuilt: in frame `odom` that takes a pose.
        self._is_outdated |= robot is not self._robot and self._update_robot(robot)
        if self._footprint is None:
            before, self.context = self.context, None
            return before is not None
        if inputs.frame == "odom":
            return self._rebuild_around(self._footprint, robot, goals)
        if self._is_outdated or grid is not self._map or self.context is None:
            self.is_other_map = (
                self._map is not None and grid is not None and grid.name != self._map.name
            )
            self._map, self._zones, self._is_outdated = grid, None, False
            before = self.context
            self.context = PlanningContext(
                _grid_of(grid) if grid is not None else empty_grid(Pose2D.identity(), 1.0, 0.1),
                self._footprint,
                self._config,
                self._speed(robot),
            )
            if before is not None and not self.is_other_map:
                self.context.costmap.take_over(before.costmap)
        elif zones is self._zones:
            return False
        if zones is not None:
            self._zones = zones
            fitting = zones.zones if self._map is None or zones.map == self._map.name else []
            self.context.costmap.set_zones(fitting)
        return True

    def add_scan(self, scan: Scan, history: Sequence[Odometry], now_ns: int) -> bool:
        """Put a scan into the costmap; False if it cannot be placed."""
        inputs, context = self._inputs, self.context
        ranges = floats_from_bytes(scan.ranges).astype(np.float32)
        here = inputs.base_pose()
        if context is None or here is None or inputs.pose_trouble(now_ns) is not None:
            return False
        if position_trouble(context, here) is not None:
            return False
        poses = inputs.sweep_poses(scan, history)
        if poses is None or inputs.base_T_laser is None:
            return False
        if self._num_jumps != inputs.num_jumps:
            # What was seen from a wrong place is in the wrong place.
            self._num_jumps = inputs.num_jumps
            context.costmap.forget_all()
        if self._suspected != (context, inputs.suspects):
            self._suspected = context, inputs.suspects
            lines = [] if inputs.suspects is None else inputs.suspects.lines
            context.costmap.set_suspects([line.points for line in lines])
        shape = ScanShape(scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max)
        body = inputs.base_T_laser.inverse().transform_points(context.footprint.polygon)
        further = inputs.extra_sensors.points_odom(now_ns)
        if inputs.frame_T_odom is not None:
            further = inputs.frame_T_odom.transform_points(further)
        sweep = Sweep(ranges, shape, poses[0], poses[1], body)
        context.costmap.add_scan(sweep, scan.stamp_ns, further)
        return True

    def maintain(self, now_ns: int) -> None:
        """Forget what has been out of sight for long, and take over the costs of programs."""
        if self.context is None:
            return
        costmap = self.context.costmap
        if now_ns - self._faded_ns >= MANAGER.fade_s * 1e9:
            self._faded_ns = now_ns
            costmap.forget_old(now_ns)
        if self._map is not None and now_ns - self._costs_ns >= MANAGER.costs_s * 1e9:
            self._costs_ns = now_ns
            costmap.set_costs(self._inputs.costs.on_map(self._map.name, now_ns))

    def update_position(self, here: Pose2D | None) -> None:
        """Update the robot's position: it may cross keep-out zones that it must leave."""
        if self.context is not None and here is not None:
            self.context.costmap.set_position(here.x, here.y)

    def forget(self) -> None:
        """Forget everything that the lidar has seen, and when; robot time may begin anew."""
        self._faded_ns = self._costs_ns = 0
        if self.context is not None:
            self.context.costmap.forget_all()

    def _update_robot(self, robot: Robot) -> bool:
        """Apply the robot's outline; True if it matters to the context."""
        before, self._robot = self._robot, robot
        if before is not None and (before.footprint, before.max_speed) == (
            robot.footprint,
            robot.max_speed,
        ):
            return False
        try:
            self._footprint = Footprint.from_polygon(robot.footprint)
            self._footprint_problem = ""
        except ValueError as error:
            self._footprint = None
            self._footprint_problem = f"The robot's footprint cannot be used: {error}."
        return True

    def _rebuild_around(self, footprint: Footprint, robot: Robot, goals: Sequence[Pose2D]) -> bool:
        """Rebuild the costmap around robot and goals, in frame `odom`, where the old one ends."""
        here = self._inputs.base_pose()
        if here is None:
            return False
        config, before = self._config, self.context
        edge = MANAGER.edge_share * config.odom_size_m
        square = _square_around([here, *goals], edge, config)
        centre, size_m = square or (here, config.odom_size_m)
        if before is not None and not self._is_outdated:
            if square is None:
                return False
            is_needed = goals or before.grid.cols <= round(size_m / config.odom_resolution_m)
            if is_needed and all(_is_within(before, pose, edge) for pose in (here, *goals)):
                return False
        grid = empty_grid(centre, size_m, config.odom_resolution_m)
        self._is_outdated = False
        self.context = PlanningContext(grid, footprint, config, self._speed(robot))
        if before is not None:
            self.context.costmap.take_over(before.costmap)
        return True

    def _speed(self, robot: Robot) -> float:
        return min(robot.max_speed, self._config.max_speed_mps)


def _square_around(
    poses: Sequence[Pose2D], edge_m: float, config: PlannerConfig
) -> tuple[Pose2D, float] | None:
    """Return middle and size [m] of a square that holds poses, at least the usual one.

    None if it would be too large.
    """
    xs, ys = [pose.x for pose in poses], [pose.y for pose in poses]
    extent = max(max(xs) - min(xs), max(ys) - min(ys))
    size = max(config.odom_size_m, extent + 2.0 * edge_m + 1.0)
    if size > max(MANAGER.largest_m, config.odom_size_m):
        return None
    return Pose2D(0.5 * (min(xs) + max(xs)), 0.5 * (min(ys) + max(ys)), 0.0), size


def _is_within(context: PlanningContext, pose: Pose2D, edge_m: float) -> bool:
    """Say whether a pose lies on a costmap, and not near its edge."""
    width, height = context.grid.size_m
    at = context.costmap.to_grid(pose)
    return edge_m <= at.x <= width - edge_m and edge_m <= at.y <= height - edge_m


def _grid_of(message: OccupancyGrid) -> GridMap:
    """Return a map message as a grid."""
    cells = np.frombuffer(message.cells, dtype=np.int8).reshape(message.height, message.width)
    return GridMap(message.name, message.resolution, message.origin, cells.copy())


def position_trouble(context: PlanningContext, here: Pose2D) -> Refused | None:
    """Return why the robot cannot be where its pose says, None if it can."""
    costmap = context.costmap
    in_grid = costmap.to_grid(here)
    if not costmap.contains(in_grid.x, in_grid.y):
        return Refused(codes.OUTSIDE_MAP, "According to its pose, the robot is outside the map.")
    if costmap.static.is_wall(in_grid.x, in_grid.y):
        return Refused(
            codes.LOST, "According to its pose, the robot is inside a wall; set its pose again."
        )
    return None
