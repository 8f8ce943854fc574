"""Drives through simulated houses: all that can be reached is visited once, as by hand."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from bench.harness.houses import draw_house, free_poses
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse import csgraph

from trolley.geometry import Pose2D, Twist2D, interpolate
from trolley.gridmap import GridMap, distance_transform
from trolley.scanning import ScanInput
from trolley_base.drivers.interface import LidarScan
from trolley_base.world.simulation import RobotBody, Simulation
from trolley_base.world.spec import LidarSpec, Person, Wheels, WorldSpec

FOOTPRINT = np.array([[0.15, -0.12], [0.15, 0.12], [-0.15, 0.12], [-0.15, -0.12]])
BASE_T_LASER = Pose2D(0.05, 0.0, 0.0)
CLEARANCE_M = 0.22
# Places to visit lie on a grid of this spacing; one is visited when passed within that distance.
SPACING_M = 1.5
VISITED_M = 1.0
SPEED_MPS = 0.5
AHEAD_M = 0.35
STEPS_PER_COMMAND = 5


@dataclass(frozen=True)
class House:
    """A house, what the robot can reach of it, and how the robot and its lidar err."""

    grid: GridMap
    spec: WorldSpec
    start: Pose2D
    reachable: NDArray[np.bool_]
    """(rows, cols) where the robot's centre can be."""

    @property
    def area_m2(self) -> float:
        """Floor that is free [m^2]."""
        return float(self.grid.free_mask().sum()) * self.grid.resolution**2


def make_house(
    area_m2: float, seed: int, lidar: LidarSpec, odometry_error: float, num_people: int
) -> House:
    """Draw a house of about this area; the error is a share of distances and turns."""
    return inhabited(
        draw_house(math.sqrt(area_m2) + 1.4, seed), seed, lidar, odometry_error, num_people
    )


def inhabited(
    grid: GridMap,
    seed: int,
    lidar: LidarSpec,
    odometry_error: float,
    num_people: int,
    start: Pose2D | None = None,
) -> House:
    """Put a robot and people into a house; the robot begins where it is told, or anywhere."""
    rng = np.random.default_rng(seed)
    clearance = distance_transform(1 - grid.free_mask(), grid.resolution)
    regions, _ = ndimage.label(clearance > CLEARANCE_M)
    sizes = np.bincount(regions.ravel())
    sizes[0] = 0
    reachable = regions == int(np.argmax(sizes))
    free = GridMap(
        grid.name, grid.resolution, grid.origin, np.where(reachable, 0, 100).astype(np.int8)
    )
    start = start or free_poses(free, 0.05, 1, rng)[0]
    sign = 1.0 if seed % 2 else -1.0
    wheels = Wheels(
        left_scale=1.0 + odometry_error * sign,
        right_scale=1.0 + odometry_error * sign * 0.85,
        turn_scale=1.0 - odometry_error * sign,
        slip_per_m=0.03,
        yaw_slip_per_m=0.03,
        yaw_slip_per_rad=0.03,
    )
    house = House(
        grid,
        WorldSpec(map="house.yaml", start=_as_config(start), wheels=wheels, lidar=lidar),
        start,
        reachable,
    )
    people = [_walker(house, rng) for _ in range(num_people)]
    return replace(house, spec=_with_people(house.spec, people))


def _as_config(pose: Pose2D):  # noqa: ANN202
    from trolley.config.robot import PoseConfig

    return PoseConfig(x=pose.x, y=pose.y, yaw=pose.yaw)


def _with_people(spec: WorldSpec, people: list[Person]) -> WorldSpec:
    from msgspec.structs import replace as replaced

    return replaced(spec, person=people)


def _walker(house: House, rng: np.random.Generator) -> Person:
    """A person who walks to and fro between two places of the house."""
    roads = Roads(house)
    while True:
        a, b = (roads.nearest(p) for p in free_poses(_mask(house), 0.05, 2, rng))
        way = roads.way(a, b)
        if len(way) > 15:
            return Person(
                path=[(float(x), float(y)) for x, y in way[::5]], speed_mps=0.9, legs=True
            )


def _mask(house: House) -> GridMap:
    cells = np.where(house.reachable, 0, 100).astype(np.int8)
    return GridMap("mask", house.grid.resolution, house.grid.origin, cells)


class Roads:
    """Shortest paths over what can be reached, on every second cell."""

    def __init__(self, house: House) -> None:
        self._grid = house.grid
        coarse = house.reachable[::2, ::2]
        self._index = np.full(coarse.shape, -1, np.int64)
        self._rows, self._cols = np.nonzero(coarse)
        self._index[coarse] = np.arange(len(self._rows))
        clearance = distance_transform(1 - house.grid.free_mask(), 1.0)[::2, ::2]
        starts, ends, costs = [], [], []
        for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
            r, c = self._rows + dr, self._cols + dc
            inside = (r < coarse.shape[0]) & (c >= 0) & (c < coarse.shape[1])
            r, c = np.where(inside, r, 0), np.where(inside, c, 0)
            other = self._index[r, c]
            joined = inside & (other >= 0)
            starts.append(np.flatnonzero(joined))
            ends.append(other[joined])
            # Paths keep away from the walls, as a person drives.
            shy = 1.0 + 4.0 / clearance[self._rows, self._cols][joined]
            costs.append(math.hypot(dr, dc) * shy)
        size = len(self._rows)
        self._graph = sparse.csr_array(
            (np.concatenate(costs), (np.concatenate(starts), np.concatenate(ends))),
            shape=(size, size),
        )

    def point(self, node: int) -> NDArray[np.float64]:
        """Where a node lies, (2,) [m]."""
        cell = np.array([[2 * self._rows[node], 2 * self._cols[node]]])
        return self._grid.cell_to_world(cell)[0]

    def nearest(self, pose: Pose2D) -> int:
        """The node nearest to a pose."""
        row, col = self._grid.world_to_cell(np.array([[pose.x, pose.y]]))[0]
        return int(np.argmin((2 * self._rows - row) ** 2 + (2 * self._cols - col) ** 2))

    def way(self, start: int, end: int) -> NDArray[np.float64]:
        """Points (n, 2) from one node to another, each 0.1 to 0.14 m."""
        _, reached_from = csgraph.dijkstra(
            self._graph, directed=False, indices=[start], return_predecessors=True
        )
        before = reached_from[0]
        nodes = [end]
        while nodes[-1] != start and before[nodes[-1]] >= 0:
            nodes.append(int(before[nodes[-1]]))
        return np.array([self.point(node) for node in reversed(nodes)])

    def _distances(self, start: int) -> NDArray[np.float64]:
        """Cost of the path from one node to each (nodes,); infinite where none leads."""
        return csgraph.dijkstra(self._graph, directed=False, indices=[start])[0]

    def tour(self, start: Pose2D) -> NDArray[np.float64]:
        """Points (n, 2) of a path past everything that can be reached and back to the start."""
        every = round(SPACING_M / (2 * self._grid.resolution))
        targets = np.flatnonzero((self._rows % every == 0) & (self._cols % every == 0))
        places = np.array([self.point(int(node)) for node in targets]).reshape(-1, 2)
        at = home = self.nearest(start)
        # On every second cell the narrowest places may be cut: no path leads to what lies behind.
        left = np.isfinite(self._distances(home)[targets])
        parts: list[NDArray[np.float64]] = []
        while left.any():
            nearest = int(np.argmin(np.where(left, self._distances(at)[targets], np.inf)))
            way = self.way(at, int(targets[nearest]))
            parts.append(way)
            at = int(targets[nearest])
            left[nearest] = False
            for point in way[::3]:
                left &= np.hypot(*(places - point).T) > VISITED_M
        parts.append(self.way(at, home))
        return np.vstack(parts)

    def wander(
        self, start: Pose2D, length_m: float, rng: np.random.Generator
    ) -> NDArray[np.float64]:
        """Points (n, 2) of a path to places at random, at least so long."""
        at = self.nearest(start)
        reachable = np.flatnonzero(np.isfinite(self._distances(at)))
        parts, left_m = [np.empty((0, 2))], length_m
        while left_m > 0.0:
            to = int(rng.choice(reachable))
            parts.append(self.way(at, to))
            # At least one point: where nothing else can be reached the robot turns on the spot.
            left_m -= 0.1 * len(parts[-1])
            at = to
        return np.vstack(parts)


def drive(house: House, seed: int, longest_s: float = 0.0) -> Iterator[tuple[ScanInput, Pose2D]]:
    """Drive the tour; gives each scan as the mapper gets it, and the true map_T_base at it.

    Args:
        house: where.
        seed: of the robot's errors.
        longest_s: the drive goes on to places at random, and ends then [s]; 0: after the tour.
    """
    roads = Roads(house)
    way = roads.tour(house.start)
    if longest_s > 0.0:
        further_m = longest_s * SPEED_MPS
        further = roads.wander(house.start, further_m, np.random.default_rng(seed))
        way = np.vstack([way, further])
    simulation = Simulation(
        house.spec, house.grid, RobotBody(FOOTPRINT, BASE_T_LASER), seed, house.start
    )
    odom, truth = [Pose2D.identity()], [house.start]
    target, stuck = 0, 0
    while target < len(way):
        pose = truth[-1]
        while target < len(way) and math.hypot(*(way[target] - (pose.x, pose.y))) < AHEAD_M:
            target += 1
            stuck = 0
        if target == len(way):
            break
        stuck += 1
        command = _towards(pose, way[target], stuck)
        if stuck > 400:
            target += 1
            stuck = 0
        for _ in range(STEPS_PER_COMMAND):
            simulation.step(command)
            odom.append(odom[-1] @ simulation.take_motion().previous_T_base)
            truth.append(simulation.truth().pose)
        for scan in simulation.take_scans():
            if 0.0 < longest_s < scan.stamp_ns * 1e-9:
                return
            yield _scan_input(scan, odom), _at(truth, scan.stamp_ns)


def _towards(pose: Pose2D, point: NDArray[np.float64], stuck: int) -> Twist2D:
    """The command that leads to a point ahead; a robot that is blocked backs off."""
    if stuck > 100 and stuck % 100 < 30:
        return Twist2D(-0.1, 0.0, 0.3)
    bearing = math.remainder(
        math.atan2(point[1] - pose.y, point[0] - pose.x) - pose.yaw, 2 * math.pi
    )
    turn = max(-1.2, min(1.2, 2.5 * bearing))
    return Twist2D(SPEED_MPS * max(0.0, math.cos(bearing)) ** 2, 0.0, turn)


def _at(poses: list[Pose2D], stamp_ns: int) -> Pose2D:
    """The pose at a moment, of poses each 10 ms."""
    steps, share = divmod(stamp_ns / 1e7, 1.0)
    first = min(int(steps), len(poses) - 1)
    return interpolate(poses[first], poses[min(first + 1, len(poses) - 1)], share)


def _scan_input(scan: LidarScan, odom: list[Pose2D]) -> ScanInput:
    end_ns = scan.stamp_ns + round((len(scan.ranges) - 1) * scan.time_increment * 1e9)
    return ScanInput(
        stamp_ns=scan.stamp_ns + 1,
        ranges=scan.ranges,
        angle_min=scan.angle_min,
        angle_increment=scan.angle_increment,
        range_min=scan.range_min,
        range_max=scan.range_max,
        base_T_laser=BASE_T_LASER,
        odom_T_base=_at(odom, scan.stamp_ns),
        odom_T_base_end=_at(odom, end_ns),
    )
