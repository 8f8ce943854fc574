"""The costmap and its planners, made of the messages that they need and kept up to date."""

import math
from collections.abc import Sequence

import numpy as np

from trolley import codes
from trolley.codes import Refused
from trolley.config import PlannerConfig
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.messages import OccupancyGrid, Odometry, Robot, Scan, Suspects, Zones
from trolley.messages.types import floats_from_bytes
from trolley_planner.context.planning_context import Rig, empty_grid
from trolley_planner.costmap.footprint import Footprint
from trolley_planner.sensing.beams import ScanShape, Sweep
from trolley_planner.sensing.inputs import Senses

FADE_S = 1.0
"""Time between two looks for what can be forgotten."""
EDGE_SHARE = 0.25
"""In frame `odom` the costmap moves when the robot comes this near to its edge, as a share."""


class Surroundings:
    """Owns the rig: costmap, global planner, window, controller.

    Args:
        config: of the planner.
        senses: where the messages are.
    """

    def __init__(self, config: PlannerConfig, senses: Senses) -> None:
        self._config = config
        self._senses = senses
        self.rig: Rig | None = None
        self.is_other_map = False
        """Whether the last rebuilding was for a map of another name."""
        self._robot: Robot | None = None
        self._map: OccupancyGrid | None = None
        self._zones: Zones | None = None
        self._footprint: Footprint | None = None
        self._footprint_problem = ""
        self._suspected: tuple[Rig, Suspects | None] | None = None
        self._faded_ns = 0
        self._num_jumps = 0

    def need_rig(self) -> Rig:
        """Return the rig.

        Raises:
            Refused: it cannot be made of what is known.
        """
        if self.rig is None:
            raise Refused(codes.NOT_READY, self._footprint_problem or None)
        return self.rig

    def trouble(self, now_ns: int) -> Refused | None:
        """Return why the robot must not drive: it is blind, does not know where it is, or what.

        What fell silent is named first: without it there is no new pose either.
        """
        senses, rig = self._senses, self.rig
        code = senses.silence(now_ns) or senses.pose_trouble(now_ns)
        if code is not None:
            return Refused(code)
        if rig is None:
            return Refused(codes.NOT_READY, self._footprint_problem or None)
        here = senses.base_pose()
        return None if here is None else place_trouble(rig, here)

    def rebuild(self) -> bool:
        """Make the rig anew where robot, map or zones changed; True if so."""
        senses = self._senses
        robot, grid, zones = senses.robot, senses.map, senses.zones
        if robot is None or (senses.frame == "map" and grid is None):
            return False
        is_new_robot = robot is not self._robot and self._take_robot(robot)
        if self._footprint is None:
            self.rig = None
            return is_new_robot
        if senses.frame == "odom":
            return self._rebuild_around(self._footprint, robot, is_new_robot)
        if is_new_robot or grid is not self._map or self.rig is None:
            self.is_other_map = (
                self._map is not None and grid is not None and grid.name != self._map.name
            )
            self._map, self._zones = grid, None
            self.rig = Rig(
                _grid_of(grid) if grid is not None else empty_grid(Pose2D.identity(), 1.0, 0.1),
                self._footprint,
                self._config,
                self._speed(robot),
            )
        elif zones is self._zones:
            return False
        if zones is not None:
            self._zones = zones
            fitting = zones.zones if self._map is None or zones.map == self._map.name else []
            self.rig.costmap.set_zones(fitting)
        return True

    def add_scan(self, scan: Scan, history: Sequence[Odometry], now_ns: int) -> bool:
        """Put a scan into the costmap; False if it cannot be placed."""
        senses, rig = self._senses, self.rig
        ranges = floats_from_bytes(scan.ranges).astype(np.float32)
        here = senses.base_pose()
        if rig is None or here is None or senses.pose_trouble(now_ns) is not None:
            return False
        if place_trouble(rig, here) is not None:
            return False
        poses = senses.sweep_poses(scan, len(ranges), history)
        if poses is None or senses.base_T_laser is None:
            return False
        if self._num_jumps != senses.num_jumps:
            # What was seen from a wrong place is in the wrong place.
            self._num_jumps = senses.num_jumps
            rig.costmap.forget_all()
        if self._suspected != (rig, senses.suspects):
            self._suspected = rig, senses.suspects
            lines = [] if senses.suspects is None else senses.suspects.lines
            rig.costmap.set_suspects([line.points for line in lines])
        shape = ScanShape(scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max)
        body = senses.base_T_laser.inverse().transform_points(rig.footprint.polygon)
        rig.costmap.add_scan(Sweep(ranges, shape, poses[0], poses[1], body), scan.stamp_ns)
        return True

    def maintain(self, now_ns: int) -> None:
        """Forget what has been out of sight for long."""
        if self.rig is not None and now_ns - self._faded_ns >= FADE_S * 1e9:
            self._faded_ns = now_ns
            self.rig.costmap.forget_old(now_ns)

    def note_position(self, here: Pose2D | None) -> None:
        """Take where the robot is: keep-out zones open for who must leave them."""
        if self.rig is not None and here is not None:
            self.rig.costmap.set_position(here.x, here.y)

    def forget(self) -> None:
        """Forget everything that the lidar has seen."""
        if self.rig is not None:
            self.rig.costmap.forget_all()

    def _take_robot(self, robot: Robot) -> bool:
        """Take over the robot's outline; True if it matters to the rig."""
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

    def _rebuild_around(self, footprint: Footprint, robot: Robot, is_new_robot: bool) -> bool:
        """Make an empty costmap around the robot, in frame `odom`, where the old one ends."""
        here = self._senses.base_pose()
        if here is None:
            return False
        rig = self.rig
        if rig is not None and not is_new_robot:
            width, height = rig.grid.size_m
            in_grid = rig.costmap.to_grid(here)
            edge = EDGE_SHARE * width
            if edge <= in_grid.x <= width - edge and edge <= in_grid.y <= height - edge:
                return False
        config = self._config
        grid = empty_grid(here, config.odom_size_m, config.odom_resolution_m)
        self.rig = Rig(grid, footprint, config, self._speed(robot))
        return True

    def _speed(self, robot: Robot) -> float:
        return min(robot.max_speed, self._config.max_speed_mps)


def _grid_of(message: OccupancyGrid) -> GridMap:
    """Return a map message as a grid."""
    cells = np.frombuffer(message.cells, dtype=np.int8).reshape(message.height, message.width)
    return GridMap(message.name, message.resolution, message.origin, cells.copy())


def place_trouble(rig: Rig, here: Pose2D) -> Refused | None:
    """Return why the robot cannot be where its pose says, None if it can."""
    costmap = rig.costmap
    in_grid = costmap.to_grid(here)
    if not costmap.contains(in_grid.x, in_grid.y):
        return Refused(codes.OUTSIDE_MAP, "By its pose the robot itself is outside the map.")
    if costmap.is_wall(in_grid.x, in_grid.y):
        return Refused(codes.LOST, "By its pose the robot is inside a wall; set its pose anew.")
    return None


def free_all_round(scan: Scan, base_T_laser: Pose2D, radius_m: float) -> bool:
    """Say whether a scan shows that nothing stands within a circle about the robot's centre.

    Args:
        scan: must look all round.
        base_T_laser: where the lidar sits.
        radius_m: of the circle.
    """
    ranges = floats_from_bytes(scan.ranges).astype(np.float64)
    covered = len(ranges) * scan.angle_increment
    if len(ranges) == 0 or covered < 1.95 * math.pi:
        return False
    angles = scan.angle_min + np.arange(len(ranges)) * scan.angle_increment
    is_echo = np.isfinite(ranges) & (ranges > max(scan.range_min, 0.0))
    points = (ranges[is_echo] * np.stack([np.cos(angles[is_echo]), np.sin(angles[is_echo])])).T
    distances = np.hypot(*base_T_laser.transform_points(points).T)
    return bool((distances > radius_m).all())
