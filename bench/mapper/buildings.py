"""Large buildings, drawn at random, and drives through them with few scans, as in old public logs.

A building is blocks of rooms with corridors between and around them, so that each block is a loop.
A drive goes round blocks one after the other, into some rooms, and home. It is a `Recording`: what
judges recorded drives judges it, too.
"""

import math
from dataclasses import dataclass

import numpy as np
from bench.harness.recorded import Recording
from bench.mapper.house_tours import BASE_T_LASER, House, Roads, inhabited
from numpy.typing import NDArray

from trolley.geometry import Pose2D, wrap_angles
from trolley.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from trolley.jit import kernel
from trolley_base.world.rays import GLASS, Scene, beam_range
from trolley_base.world.spec import LidarSpec

# Walls are one cell thick, and a route is searched on every second one.
RESOLUTION = 0.1
MARGIN, CORRIDOR, DOOR = 10, 20, 10
"""Unknown round the building, width of corridors and of doors [cells]."""
POST_CELLS = 12
"""A glass front has a post each so many cells."""
PATH_M = 0.05
"""Distance of the points of a path [m]."""
SMOOTH_M = 0.5
"""Corners of a path are rounded over this length [m]."""
SPEED_MPS, TURN_RADPS = 0.5, 1.0
STAND_S = 15.0
"""A robot that stands does so for so long [s]."""
PERSON_MPS, PERSON_M, SHY_M = 0.9, 0.2, 0.7
"""People walk so fast, have this radius, and keep this far from the robot."""


@dataclass(frozen=True)
class Plan:
    """What a building is like."""

    blocks: tuple[int, int]
    """Blocks along x and y."""
    block_m: tuple[float, float] = (14.0, 10.0)
    """Size of each [m]."""
    room_m: tuple[float, float] = (3.0, 6.0)
    """Narrowest and widest room [m]."""
    is_alike: bool = False
    """All blocks have the same walls; what stands in them is their own."""
    is_identical: bool = False
    """All rooms are the same, and so is what stands in them."""
    is_solid: bool = False
    """There are no rooms: blocks are solid, such as the shelves of a store."""
    glass_share: float = 0.1
    """Share of the rooms with a glass front."""
    clutter_per_m2: float = 0.12
    """Pieces of furniture."""
    people: int = 3


@dataclass(frozen=True)
class Building:
    """A building, for a robot, for beams, and for those who plan a drive.

    Attributes:
        house: with panes as walls: what a robot can reach.
        solid: (rows, cols) 1 where beams end; panes are not solid.
        panes: (n, 4) ends of the panes x, y, x, y [m].
        crossings: (blocks along y + 1, blocks along x + 1, 2) of the corridors [m].
        rooms: (m, 2) middles of the rooms [m].
        people: of the plan.
    """

    house: House
    solid: NDArray[np.uint8]
    panes: NDArray[np.float64]
    crossings: NDArray[np.float64]
    rooms: NDArray[np.float64]
    people: int

    @property
    def grid(self) -> GridMap:
        """Walls, furniture and panes."""
        return self.house.grid


# Draw a building.


def draw_building(plan: Plan, seed: int) -> Building:
    """Draw a building; the same seed gives the same one."""
    rng = np.random.default_rng(seed)
    width, height = (round(edge / RESOLUTION) for edge in plan.block_m)
    cols = plan.blocks[0] * (width + CORRIDOR) + CORRIDOR
    rows = plan.blocks[1] * (height + CORRIDOR) + CORRIDOR
    outer = MARGIN + 1
    cells = np.full((rows + 2 * outer, cols + 2 * outer), UNKNOWN, np.int8)
    cells[MARGIN:-MARGIN, MARGIN:-MARGIN] = OCCUPIED
    cells[outer:-outer, outer:-outer] = FREE
    panes: list[tuple[float, float, float, float]] = []
    rooms: list[tuple[float, float]] = []
    walls_seed = int(rng.integers(1 << 31))
    for j in range(plan.blocks[1]):
        for i in range(plan.blocks[0]):
            row = outer + CORRIDOR + j * (height + CORRIDOR)
            col = outer + CORRIDOR + i * (width + CORRIDOR)
            own = np.random.default_rng(
                walls_seed if plan.is_alike or plan.is_identical else rng.integers(1 << 31)
            )
            block = cells[row : row + height, col : col + width]
            if plan.is_solid:
                block[:] = OCCUPIED
                continue
            _draw_block(
                block, plan, own, own if plan.is_identical else rng, (panes, rooms, row, col)
            )
    _furnish_corridors(cells, outer, plan, rng)
    solid = (cells == OCCUPIED).astype(np.uint8)
    segments = np.array(panes).reshape(-1, 4)
    for c0, r0, c1, _ in (segments / RESOLUTION).round().astype(int).tolist():
        cells[r0, c0:c1] = OCCUPIED
    grid = GridMap("building", RESOLUTION, Pose2D(0.0, 0.0, 0.0), cells)
    xs = outer + 0.5 * CORRIDOR + np.arange(plan.blocks[0] + 1) * (width + CORRIDOR)
    ys = outer + 0.5 * CORRIDOR + np.arange(plan.blocks[1] + 1) * (height + CORRIDOR)
    crossings = RESOLUTION * np.stack(np.meshgrid(xs, ys), axis=-1).astype(np.float64)
    start = Pose2D(float(crossings[0, 0, 0]), float(crossings[0, 0, 1]), 0.0)
    house = inhabited(grid, seed, LidarSpec(), 0.0, 0, start)
    # A pane lies in the middle of its cells.
    segments[:, [1, 3]] += 0.5 * RESOLUTION
    return Building(house, solid, segments, crossings, np.array(rooms).reshape(-1, 2), plan.people)


def _draw_block(
    block: NDArray[np.int8],
    plan: Plan,
    rng: np.random.Generator,
    clutter_rng: np.random.Generator,
    out: tuple[list[tuple[float, float, float, float]], list[tuple[float, float]], int, int],
) -> None:
    """Draw two rows of rooms back to back, each room with a door to its corridor.

    `out` takes panes and rooms [m]; its numbers are where the block lies [cells].
    """
    panes, rooms, row, col = out
    height, width = block.shape
    block[:] = OCCUPIED
    middle = height // 2
    fixed = round(plan.room_m[0] / RESOLUTION)
    for r0, r1, front in ((1, middle, 0), (middle + 1, height - 1, height - 1)):
        c0 = 1
        while c0 < width - 1:
            wide = round(rng.uniform(*plan.room_m) / RESOLUTION)
            c1 = c0 + (fixed if plan.is_identical else wide)
            if width - 1 - c1 < round(plan.room_m[0] / RESOLUTION):
                c1 = width - 1
            block[r0:r1, c0:c1] = FREE
            # The door leaves a cell of wall at both sides.
            at = (
                (c0 + c1 - DOOR) // 2 if plan.is_identical else int(rng.integers(c0 + 1, c1 - DOOR))
            )
            is_glass = rng.random() < plan.glass_share
            if is_glass:
                for a in range(c0, c1 - 1, POST_CELLS):
                    b = min(a + POST_CELLS - 1, c1 - 1)
                    for left, right in ((a, min(b, at - 1)), (max(a, at + DOOR + 1), b)):
                        if right - left >= 3:
                            block[front, left:right] = FREE
                            edge = RESOLUTION * np.array([col + left, row + front, col + right])
                            panes.append((edge[0], edge[1], edge[2], edge[1]))
            block[front, at : at + DOOR] = FREE
            rooms.append(
                (RESOLUTION * (col + 0.5 * (c0 + c1)), RESOLUTION * (row + 0.5 * (r0 + r1)))
            )
            _furnish(block[r0:r1, c0:c1], plan, clutter_rng, at - c0, is_low=front == 0)
            c0 = c1 + 1


def _furnish(
    room: NDArray[np.int8], plan: Plan, rng: np.random.Generator, door: int, *, is_low: bool
) -> None:
    """Put furniture into a room; the floor behind its door stays free."""
    height, width = room.shape
    for _ in range(rng.poisson(plan.clutter_per_m2 * height * width * RESOLUTION**2)):
        size = rng.integers(3, 16, 2)
        r = int(rng.integers(0, max(height - size[0], 1)))
        c = int(rng.integers(0, max(width - size[1], 1)))
        away = r if is_low else height - r - int(size[0])
        if away < 12 and c < door + DOOR + 4 and c + size[1] > door - 4:
            continue
        room[r : r + size[0], c : c + size[1]] = OCCUPIED


def _furnish_corridors(
    cells: NDArray[np.int8], outer: int, plan: Plan, rng: np.random.Generator
) -> None:
    """Put pillars and cupboards along the outer walls, about one in 6 m."""
    rows, cols = cells.shape
    for _ in range(round(2 * (rows + cols - 4 * outer) * RESOLUTION / 6.0)):
        deep, long = int(rng.integers(2, 5)), int(rng.integers(3, 15))
        at_row = int(rng.integers(outer, rows - outer - long))
        at_col = int(rng.integers(outer, cols - outer - long))
        side = int(rng.integers(4))
        if side == 0:
            cells[outer : outer + deep, at_col : at_col + long] = OCCUPIED
        elif side == 1:
            cells[rows - outer - deep : rows - outer, at_col : at_col + long] = OCCUPIED
        elif side == 2:
            cells[at_row : at_row + long, outer : outer + deep] = OCCUPIED
        else:
            cells[at_row : at_row + long, cols - outer - deep : cols - outer] = OCCUPIED


# Drive through it.


@dataclass(frozen=True)
class Drive:
    """How a robot is driven through a building, and how its wheels and its lidar err."""

    way_m: float = 400.0
    """Approximate distance after which it turns home [m]."""
    room_share: float = 0.3
    """Share of the rooms beside the way that it drives into."""
    step_m: float = 1.0
    """Distance after which a scan is taken [m]."""
    step_rad: float = 0.7
    """Turn after which a scan is taken [rad]."""
    field_rad: float = math.pi
    beams: int = 180
    reach_m: float = 8.0
    distance_error: float = 0.05
    """The wheels read this share too much or too little."""
    turn_error: float = 0.05
    """The same of turns."""
    noise: float = 0.02
    """Standard deviation of distance and heading per root of a metre [m, rad]."""
    missed_turns: int = 0
    """So many turns of 80° and more are driven on the way that the wheels do not see."""
    covered_s: float = 0.0
    """For so long in the middle of the drive the lidar is covered [s]."""
    stands: int = 0
    """So often it stands on the way, for `STAND_S`."""


@kernel
def cast_scan_into(
    out_ranges: NDArray[np.float32],
    scene: Scene,
    pose: NDArray[np.float64],
    angles: NDArray[np.float64],
    reach_m: float,
    draws: NDArray[np.float64],
) -> None:
    """Write the ranges (n,) [m] of a scan without errors from a pose (3,); +inf for no echo.

    Args:
        out_ranges: (n,), overwritten.
        scene: what beams meet.
        pose: (3,) map_T_laser.
        angles: (n,) of the beams in `laser` [rad].
        reach_m: of the lidar [m].
        draws: (n,) 0...1, decide what glass does to each beam.
    """
    ray = np.empty(4)
    for i in range(angles.shape[0]):
        ray[0], ray[1] = pose[0], pose[1]
        ray[2], ray[3] = math.cos(pose[2] + angles[i]), math.sin(pose[2] + angles[i])
        out_ranges[i] = beam_range(scene, ray, reach_m, draws[i])


def record(building: Building, drive: Drive, seed: int) -> Recording:
    """Drive through a building; the same seed gives the same drive."""
    rng = np.random.default_rng([seed, 1])
    return record_along(building, route(building, drive, rng), drive, seed, rng)


def record_along(
    building: Building,
    points: NDArray[np.float64],
    drive: Drive,
    seed: int,
    rng: np.random.Generator,
) -> Recording:
    """Drive along points (n, 2) [m]."""
    path = driven_path(points)
    odom = wheels(path, drive, rng)
    stamps = _stamps(path, drive.stands, np.random.default_rng([seed, 2]))
    kept = sampled(path, drive.step_m, drive.step_rad)
    ranges = _scans(building, path[kept], stamps[kept], drive, rng)
    middle_s = 0.5 * stamps[-1]
    covered = np.abs(stamps[kept] - middle_s) < 0.5 * drive.covered_s
    ranges[covered] = 0.1
    increment = drive.field_rad / drive.beams
    return Recording(
        stamps=stamps[kept],
        odom=odom[kept],
        reference=path[kept],
        ranges=ranges,
        angle_min=-0.5 * drive.field_rad + 0.5 * increment,
        angle_increment=increment,
        range_max=drive.reach_m,
        base_T_laser=BASE_T_LASER,
    )


def route(building: Building, drive: Drive, rng: np.random.Generator) -> NDArray[np.float64]:
    """Points (n, 2) [m] of a way round blocks, into rooms beside it, and home."""
    roads = Roads(building.house)
    high, wide = (n - 1 for n in building.crossings.shape[:2])
    blocks = [(j, i if j % 2 == 0 else wide - 1 - i) for j in range(high) for i in range(wide)]
    at = building.crossings[0, 0]
    home = at
    parts: list[NDArray[np.float64]] = []
    length_m, number = 0.0, 0
    while length_m < drive.way_m:
        j, i = blocks[number % len(blocks)]
        corners = [
            building.crossings[j + b, i + a] for a, b in ((0, 0), (1, 0), (1, 1), (0, 1), (0, 0))
        ]
        number += 1
        for corner in corners:
            middle = 0.5 * (at + corner)
            away = np.hypot(*(building.rooms - middle).T)
            near = np.flatnonzero(away < 8.0)
            stops = [corner]
            if len(near) and rng.random() < 2.0 * drive.room_share:
                stops = [building.rooms[int(rng.choice(near))], corner]
            for stop in stops:
                if np.array_equal(stop, at):
                    continue
                way = roads.way(_node(roads, at), _node(roads, stop))
                parts.append(way)
                length_m += float(np.hypot(*np.diff(way, axis=0).T).sum())
                at = way[-1]
            if length_m >= drive.way_m:
                break
    parts.append(roads.way(_node(roads, at), _node(roads, home)))
    return np.vstack(parts)


def _node(roads: Roads, place: NDArray[np.float64]) -> int:
    return roads.nearest(Pose2D(float(place[0]), float(place[1]), 0.0))


def driven_path(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Poses (n, 3) a few centimetres or 0.1 rad apart along points (m, 2), corners rounded."""
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    moved = np.concatenate([[True], np.diff(way) > 0.0])
    at = np.arange(0.0, way[-1], PATH_M)
    places = np.column_stack([np.interp(at, way[moved], points[moved, k]) for k in (0, 1)])
    span = round(SMOOTH_M / PATH_M)
    padded = np.pad(places, ((span, span), (0, 0)), mode="edge")
    box = np.ones(2 * span + 1) / (2 * span + 1)
    places = np.column_stack([np.convolve(padded[:, k], box, mode="valid") for k in (0, 1)])
    steps = np.diff(places, axis=0)
    kept = np.concatenate([np.hypot(*steps.T) > 0.2 * PATH_M, [False]])
    places, steps = places[kept], steps[kept[:-1]]
    headings = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    # Where the way turns back, the robot turns on the spot.
    turns = np.diff(headings, append=headings[-1])
    counts = np.maximum(np.ceil(np.abs(turns) / 0.1).astype(int), 1)
    rows = np.repeat(np.arange(len(places)), counts)
    share = np.concatenate([np.arange(count) / count for count in counts])
    return np.column_stack([places[rows], headings[rows] + share * turns[rows]])


def wheels(
    path: NDArray[np.float64], drive: Drive, rng: np.random.Generator
) -> NDArray[np.float64]:
    """What the wheels make of a path (n, 3): odom_T_base at each of its poses."""
    moved = np.hypot(*np.diff(path[:, :2], axis=0).T)
    turned = np.diff(path[:, 2])
    along = np.arctan2(*np.diff(path[:, :2], axis=0).T[::-1]) - path[:-1, 2]
    seen = turned.copy()
    for first, last in _missed(turned, moved, drive.missed_turns, rng):
        seen[first:last] = 0.0
    signs = rng.choice([-1.0, 1.0], 2)
    reported = moved * (1.0 + signs[0] * drive.distance_error)
    reported += drive.noise * np.sqrt(moved) * rng.standard_normal(len(moved))
    seen = seen * (1.0 + signs[1] * drive.turn_error)
    seen += drive.noise * np.sqrt(moved) * rng.standard_normal(len(moved))
    heading = np.concatenate([[0.0], np.cumsum(seen)])
    towards = heading[:-1] + along
    steps = reported[:, None] * np.column_stack([np.cos(towards), np.sin(towards)])
    places = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return np.column_stack([places, wrap_angles(heading)])


def _missed(
    turned: NDArray[np.float64], moved: NDArray[np.float64], count: int, rng: np.random.Generator
) -> list[tuple[int, int]]:
    """Choose turns of at least 80° within 1.5 m of way that the wheels do not see: their steps."""
    way = np.concatenate([[0.0], np.cumsum(moved)])
    last = np.minimum(np.searchsorted(way, way[:-1] + 1.5), len(turned))
    heading = np.concatenate([[0.0], np.cumsum(turned)])
    first = np.arange(len(turned))
    sharp = np.flatnonzero(np.abs(heading[last] - heading[first]) >= math.radians(80.0))
    chosen: list[tuple[int, int]] = []
    for row in rng.permutation(sharp).tolist():
        if len(chosen) == count:
            break
        if all(abs(way[row] - way[other]) > 30.0 for other, _ in chosen):
            chosen.append((row, int(last[row])))
    return chosen


def _stamps(
    path: NDArray[np.float64], stands: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """When the robot is at each pose (n,) [s]."""
    moved = np.hypot(*np.diff(path[:, :2], axis=0).T)
    spent = np.maximum(moved / SPEED_MPS, np.abs(np.diff(path[:, 2])) / TURN_RADPS)
    spent = np.maximum(spent, 1e-3)
    spent[rng.choice(len(spent), stands, replace=False)] += STAND_S
    return np.concatenate([[0.0], np.cumsum(spent)])


def sampled(path: NDArray[np.float64], step_m: float, step_rad: float) -> NDArray[np.int64]:
    """Rows of a path (n, 3) at which a scan is taken."""
    moved = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path[:, :2], axis=0).T))])
    kept = [0]
    for row in range(1, len(path)):
        last = kept[-1]
        turned = abs(math.remainder(path[row, 2] - path[last, 2], 2.0 * math.pi))
        if moved[row] - moved[last] >= step_m or turned >= step_rad:
            kept.append(row)
    return np.array(kept)


def _scans(
    building: Building,
    poses: NDArray[np.float64],
    stamps: NDArray[np.float64],
    drive: Drive,
    rng: np.random.Generator,
) -> NDArray[np.float32]:
    """What the lidar measures from poses (n, 3) of the base, (n, beams) [m]."""
    origin = building.grid.origin
    panes = building.panes
    scene = Scene(
        np.array([origin.x, origin.y, 1.0, 0.0, building.grid.resolution]),
        building.solid,
        panes,
        np.full(len(panes), GLASS, np.uint8),
        np.tile([0.1, 0.05], (len(panes), 1)),
        np.empty((0, 3)),
        np.empty((0, 2)),
    )
    increment = drive.field_rad / drive.beams
    angles = increment * (np.arange(drive.beams, dtype=np.float64) + 0.5) - 0.5 * drive.field_rad
    ranges = np.empty((len(poses), drive.beams), np.float32)
    walks = _walks(building, rng)
    for row, pose in enumerate(poses):
        circles = _people_at(walks, float(stamps[row]), pose)
        laser = (Pose2D.from_array(pose) @ BASE_T_LASER).as_array()
        draws = rng.random(drive.beams)
        cast_scan_into(
            ranges[row], scene._replace(circles=circles), laser, angles, drive.reach_m, draws
        )
    ranges += (0.01 + 0.003 * np.minimum(ranges, 1e3)) * rng.standard_normal(ranges.shape)
    ranges[(rng.random(ranges.shape) < 0.02) | (ranges > drive.reach_m)] = np.inf
    return ranges.astype(np.float32)


def _walks(building: Building, rng: np.random.Generator) -> list[NDArray[np.float64]]:
    """Ways (2, 2) in the corridors on which people walk to and fro [m]."""
    high, wide, _ = building.crossings.shape
    walks: list[NDArray[np.float64]] = []
    for _ in range(building.people):
        j, i = int(rng.integers(high)), int(rng.integers(wide))
        other = (j, (i + 1) % wide) if rng.random() < 0.5 else ((j + 1) % high, i)
        ends = np.array([building.crossings[j, i], building.crossings[other]])
        walks.append(ends + rng.uniform(-0.6, 0.6, 2))
    return walks


def _people_at(
    walks: list[NDArray[np.float64]], time_s: float, robot: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Where people are, (m, 3) x, y, radius [m]; who was in the robot's way has stepped aside."""
    circles: list[tuple[float, float, float]] = []
    for begin, end in walks:
        length = float(np.hypot(*(end - begin)))
        share = (PERSON_MPS * time_s / max(length, 1e-3)) % 2.0
        x, y = begin + min(share, 2.0 - share) * (end - begin)
        if math.hypot(x - robot[0], y - robot[1]) > SHY_M:
            circles.append((float(x), float(y), PERSON_M))
    return np.array(circles).reshape(-1, 3)
