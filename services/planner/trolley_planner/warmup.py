"""Compiles every kernel of the planner by driving a few steps through a small room."""

import functools
import math

import numpy as np

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D
from trolley.gridmap import GridMap
from trolley.gridmap.wire import map_message
from trolley.messages import (
    OccupancyGrid,
    Odometry,
    PoseEstimate,
    Robot,
    Scan,
    Transform,
    Zone,
    Zones,
)
from trolley.messages.request_params import SendGoal
from trolley.messages.types import floats_to_bytes
from trolley_planner.context.planning_context import PlanningContext
from trolley_planner.control.controller import Motion, limits_of
from trolley_planner.control.critics import Target
from trolley_planner.control.proximity import is_walked_into
from trolley_planner.control.pure_pursuit import PurePursuit
from trolley_planner.costmap.costmap import Costmap
from trolley_planner.costmap.footprint import Footprint
from trolley_planner.costmap.inflation import LETHAL, WEIGHT_UNIT
from trolley_planner.costmap.obstacle_grid import seen_lately
from trolley_planner.costmap.social_layer import SocialLayer
from trolley_planner.fleet.refuge import Surroundings
from trolley_planner.fleet.right_of_way import Passages
from trolley_planner.navigator import Navigator
from trolley_planner.paths.corridor import Terrain
from trolley_planner.paths.cost_to_go import CostToGo
from trolley_planner.paths.global_planner import GlobalPlanner
from trolley_planner.paths.hybrid_astar.pose_search import Task
from trolley_planner.paths.search import clear_queue, make_queue
from trolley_planner.people.encounters import times_of_encounters
from trolley_planner.people.free_space import were_passed
from trolley_planner.people.sights import NUM_COLUMNS, middle_of
from trolley_planner.people.tracker import PeopleTracker, TrackedPerson, person_discs
from trolley_planner.people.walls import walk_along_walls

CELLS = 60
EDGE_M = 0.05
STEP_NS = 100_000_000
STEPS = 30


@functools.cache
def warm_up() -> None:
    """Compile all, or load it where it was compiled before; once in a process."""
    navigator = _navigator()
    pose, now_ns = Pose2D(0.8, 0.8, 0.0), 0
    for step in range(STEPS):
        now_ns += STEP_NS
        odometry = _feel(navigator, pose, now_ns)
        navigator.update_scan(_scan(now_ns), [odometry], now_ns, now_ns)
        if step == 0:
            navigator.requests.preview(SendGoal(pose=Pose2D(2.0, 2.0, 1.0)), now_ns)
            navigator.requests.send(
                SendGoal(pose=Pose2D(1.3, 0.8, 1.0), via=[Pose2D(1.1, 0.8, 0.0)]), "warm", now_ns
            )
        twist = navigator.command(now_ns) or Twist2D.zero()
        navigator.maintain(now_ns)
        pose = Pose2D(
            pose.x + 0.1 * twist.vx * math.cos(pose.yaw),
            pose.y + 0.1 * twist.vx * math.sin(pose.yaw),
            pose.yaw + 0.1 * twist.wz,
        )
    navigator.costmaps(now_ns)
    context = navigator.costmap_manager.require_context()
    context.costmap.obstacle_layer.forget_around(1.0, 1.0, 0.5)
    walker = TrackedPerson(np.array([[1.0, 1.0], [1.1, 1.0]]), np.ones(2), np.array([0.5, 0.0]))
    discs = person_discs([walker])
    walk_along_walls(discs, np.ones(1), context.costmap.static.wall_distance_m, EDGE_M)
    times_of_encounters(discs)
    context.costmap.obstacle_layer.remove_people(discs)
    SocialLayer(context.costmap.shape, EDGE_M, 0.1).update(
        [walker], context.costmap.obstacle_layer.grid
    )
    context.costmap.set_costs({"warm": map_message(0, context.grid)})
    cell, since = np.zeros(1, dtype=np.int64), (1, 0.0)
    layer, walls = context.costmap.obstacle_layer, context.costmap.static.walls
    seen_lately(layer.grid, walls, cell, cell, since)
    were_passed(np.zeros((1, 2)), np.zeros(2), np.array([0.0, 1.0]), np.ones(2))
    context.planner.optimistic_weights()
    Passages(context.costmap.static.distance_m, EDGE_M, 0.4)
    is_walked_into(np.zeros(5), np.zeros((1, 7)), context.local_costmap.body)
    _squeeze()
    _detour()
    _pursue(context)
    _maneuver(context)
    _make_room(context)
    _watch()


def _squeeze() -> None:
    """Plan for a robot that is too long to get around a corner."""
    cells = np.full((CELLS, CELLS), 100, dtype=np.int8)
    for room in (np.s_[4:28, 4:24], np.s_[12:20, 24:56], np.s_[20:40, 48:56], np.s_[40:56, 32:56]):
        cells[room] = 0
    grid = GridMap("corner", EDGE_M, Pose2D.identity(), cells)
    footprint = Footprint.from_polygon([(0.3, 0.15), (-0.3, 0.15), (-0.3, -0.15), (0.3, -0.15)])
    costmap = Costmap(grid, footprint, PlannerConfig(), unknown_is_free=False)
    planner = GlobalPlanner(costmap)
    way = (0.5, 0.8), [(2.2, 2.4)], costmap.weights, costmap.distance_m
    if planner.plan(*way) is None:
        planner.too_narrow(*way)
    planner.plan((0.25, 0.8), [(1.0, 0.8)], costmap.weights, costmap.distance_m)  # at a wall


def _detour() -> None:
    """Search a path that costs more than the tiles that it passes promise."""
    weights = np.zeros((40, 40), dtype=np.uint8)
    weights[2:38, 10:18] = WEIGHT_UNIT
    for row in range(6, 34, 8):
        weights[row, 10:17] = weights[row + 4, 11:18] = LETHAL
    places = np.array([[13.5, 3.5, 0.0], [13.5, 36.5, 0.0]])
    distance_m = (weights != LETHAL).astype(np.float32)
    CostToGo(weights.shape).cheapest_path(3 * 40 + 13, Terrain(weights, distance_m, places, 240))
    clear_queue(make_queue(1))


def _maneuver(context: PlanningContext) -> None:
    """Search a maneuver to a place beside a wall, and for clearance along a path."""
    ends = Pose2D(0.8, 0.8, 0.0), Pose2D(0.3, 0.8, 0.0)
    context.find_maneuver(Task(*ends, False, 0.02, 0.03, 0.05), 0.9)
    context.tight_places(np.array([[0.8, 0.8], [0.9, 0.8]]), 0.08, 0.08)
    context.can_turn_by(ends[0], 1.0, 0.02)
    context.zone_speed(ends[0])


def _make_room(context: PlanningContext) -> None:
    """Search for a refuge from people."""
    pose = Pose2D(0.8, 0.8, 0.0)
    around = Surroundings(context, pose)
    around.arrivals(around.closes_s(0.2), pose, 0.5)


def _pursue(context: PlanningContext) -> None:
    """Run the other controller where the path is free, and where it is not."""
    limits = limits_of(PlannerConfig(), 0.5, 1.5, 1.0)
    pursuit, target = PurePursuit(PlannerConfig()), Target(2.0, 2.0, 0.1, goes_on=False)
    for place in (Pose2D(0.8, 0.8, 0.0), Pose2D(0.2, 0.2, 0.0)):
        motion, path = Motion(place, Twist2D.zero()), np.array([(0.8, 0.8), (2.0, 2.0)])
        pursuit.command(motion, context.local_costmap, limits, target, path, 0.05)


def _watch() -> None:
    """Track somebody with two legs who walks by."""
    tracker, no_walls = PeopleTracker(), np.full((CELLS, CELLS), 9.0, dtype=np.float32)
    angles = np.radians(np.arange(0.0, 90.0))
    for step in range(8):
        ranges = np.full(len(angles), 2.0)
        for first in (20 + 4 * step, 30 + 4 * step):
            ranges[first : first + 4] = 1.0
        corner = np.full(len(angles), 0.2)
        beams = [corner, corner, np.cos(angles), np.sin(angles), ranges, ranges]
        tracker.update(step * 100_000_000, np.column_stack(beams), no_walls, EDGE_M)
    tracker.tracks()
    middle_of(np.zeros(NUM_COLUMNS), 0.4)


def _navigator() -> Navigator:
    """Return a planner in a square room with a mirror and a speed zone."""
    navigator = Navigator(PlannerConfig())
    inputs = navigator.inputs
    cells = np.zeros((CELLS, CELLS), dtype=np.int8)
    cells[0] = cells[-1] = cells[:, 0] = cells[:, -1] = 100
    inputs.robot = Robot(
        stamp_ns=0,
        name="warm",
        title="",
        footprint=[(0.15, 0.12), (-0.15, 0.12), (-0.15, -0.12), (0.15, -0.12)],
        drive="differential",
        max_speed=0.5,
        max_wz=1.5,
        deceleration=1.0,
    )
    inputs.map = OccupancyGrid(
        stamp_ns=0,
        name="room",
        frame="map",
        resolution=EDGE_M,
        width=CELLS,
        height=CELLS,
        origin=Pose2D.identity(),
        cells=memoryview(cells.tobytes()),
    )
    corners = [(1.0, 1.0), (1.5, 1.0), (1.5, 1.5)]
    zones = [
        Zone(name="mirror", kind="mirror", points=[(2.9, 1.0), (2.9, 2.0)]),
        Zone(name="slow", kind="speed", points=corners, speed=0.3),
    ]
    inputs.zones = Zones(stamp_ns=0, map="room", zones=zones)
    inputs.base_T_laser = Pose2D.identity()
    return navigator


def _feel(navigator: Navigator, pose: Pose2D, now_ns: int) -> Odometry:
    """Give the planner pose, odometry and scan."""
    inputs = navigator.inputs
    odometry = Odometry(stamp_ns=now_ns, pose=pose, twist=Twist2D.zero())
    inputs.odometry = odometry
    inputs.update_correction(
        Transform(stamp_ns=now_ns, parent="map", child="odom", pose=Pose2D.identity())
    )
    inputs.pose = PoseEstimate(
        stamp_ns=now_ns,
        map="room",
        pose=pose,
        covariance=[0.0] * 9,
        state="localized",
        match=1.0,
        spread=0.0,
    )
    return odometry


def _scan(now_ns: int) -> Scan:
    """Return a scan with echoes near and far, and none."""
    ranges = np.full(360, 1.2, dtype=np.float32)
    ranges[90:180] = np.inf
    ranges[200] = 0.0
    return Scan(
        stamp_ns=now_ns,
        frame="laser",
        angle_min=0.0,
        angle_increment=math.pi / 180.0,
        time_increment=0.0,
        range_min=0.1,
        range_max=8.0,
        ranges=floats_to_bytes(ranges),
    )
