"""Second visits: houses mapped on one drive and changed before the next, and what they judge.

The map of the first drive is made by the project's mapper from a simulated robot's scans; the
second drive is another robot's in a house of which the map does not know all any more. No wire and
no clock: the localizer's core gets one scan after the other.
"""

import hashlib
import math
import tempfile
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from bench.harness.houses import RESOLUTION, WALL_CELLS, Plan, Rect, plan_house
from bench.harness.mapping import map_drive
from bench.harness.odd_houses import plan_odd_house
from bench.mapper.house_tours import BASE_T_LASER, House, drive, inhabited
from bench.mapper.simulated_houses import fitted
from numpy.typing import NDArray

from trolley.config.localizer import LocalizerConfig
from trolley.config.mapper import MapperConfig
from trolley.geometry import Pose2D, angle_difference
from trolley.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from trolley.scanning import ScanInput
from trolley_base.world.spec import LidarSpec
from trolley_localizer.core import Localizer
from trolley_localizer.estimate import Estimate
from trolley_localizer.matching.global_search import SearchJob
from trolley_mapper.slam.mapper import Mapper

FAR_M, FAR_RAD = 0.5, math.radians(20.0)
"""An estimate further off than this is wrong [m, rad]."""
MAPPED_SHARE = 0.5
"""Where a smaller share of the beams ends on what the map knows, the robot is off the map."""
LONGEST_S = 600.0
"""A drive that has seen all of the house goes on to places at random until then [s]."""
HOUSES = {"square": plan_house, "odd": plan_odd_house}
"""What draws houses: those of `houses`, and those of `odd_houses`."""
AWAY_S = 2.0
"""Shorter excursions off the map do not count [s]."""

WIDE = LidarSpec()
NARROW = LidarSpec(beams=180, field_of_view=math.pi, range_max_m=5.5)
SLOW = LidarSpec(rate_hz=5.0)
LIDARS = {"360": WIDE, "180": NARROW, "5hz": SLOW}


@dataclass(frozen=True)
class Case:
    """What is different on the second visit."""

    name: str
    is_moved: bool = True
    """A third of the furniture has been moved by 0.3 to 1 m."""
    opens_doors: bool = False
    """Doors that were shut on the first visit are open: the rooms behind them are not mapped."""
    is_extended: bool = False
    """A corridor has been built on."""
    is_cropped: bool = False
    """The map ends in the middle of the house."""
    lidar: LidarSpec = WIDE
    odometry_error: float = 0.02
    """Share of distances and turns."""


MOVED = Case("furniture moved")
CASES = (
    Case("nothing changed", is_moved=False),
    MOVED,
    Case("doors opened", opens_doors=True),
    Case("corridor built on", is_extended=True),
    Case("map cropped", is_cropped=True),
    Case("180°, 5.5 m; doors", opens_doors=True, lidar=NARROW),
    Case("8 m, 5 Hz; doors", opens_doors=True, lidar=SLOW),
    Case("odometry 5 % off; cropped", is_cropped=True, odometry_error=0.05),
    Case("180°, 5 % off; built on", is_extended=True, lidar=NARROW, odometry_error=0.05),
)


NOWHERE = Pose2D(1e5, 1e5, 0.0)
"""The truth on the map of another house: no estimate is right."""


def told_at(start: Pose2D) -> Pose2D:
    """A pose as somebody sets it who looks at the map."""
    return start @ Pose2D(0.2, -0.1, math.radians(8.0))


@dataclass(frozen=True)
class Visit:
    """A map, and a drive on which it is used.

    Attributes:
        grid: the map.
        scans: of the drive.
        truths: map_T_base at each of them; `NOWHERE` where the map does not show the place.
        told: the pose that the localizer is given at the start; None: it searches.
    """

    grid: GridMap
    scans: list[ScanInput]
    truths: list[Pose2D]
    told: Pose2D | None

    def mapped_shares(self) -> NDArray[np.float64]:
        """Share of the beams of each scan (n,) that truly end on what the map knows."""
        known = self.grid.cells != UNKNOWN
        shares = np.ones(len(self.scans))
        for k, (scan, truth) in enumerate(zip(self.scans, self.truths, strict=True)):
            seen = (scan.ranges > scan.range_min) & (scan.ranges < scan.range_max)
            if np.count_nonzero(seen):
                shares[k] = float(known_at(self.grid, known, ends_of(scan, truth, seen)).mean())
        return shares


def ends_of(scan: ScanInput, pose: Pose2D, seen: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Where beams end (m, 2) [m] in the map frame."""
    angles = scan.angle_min + np.flatnonzero(seen) * scan.angle_increment
    ranges = scan.ranges[seen]
    ends = np.column_stack([ranges * np.cos(angles), ranges * np.sin(angles)])
    return (pose @ scan.base_T_laser).transform_points(ends)


def known_at(
    grid: GridMap, known: NDArray[np.bool_], points: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Whether a cell that the map knows lies under or beside points (n, 2) of the map frame."""
    found = np.zeros(len(points), bool)
    for dx in (-1, 0, 1):
        for dy in (-1, 0, 1):
            cells = grid.world_to_cell(points + grid.resolution * np.array([dx, dy]))
            inside = grid.contains_cell(cells)
            found[inside] |= known[cells[inside, 0], cells[inside, 1]]
    return found


class Visits:
    """Makes visits and keeps them: a drive takes longer to simulate than to follow.

    Args:
        area_m2: floor of the houses, about.
        keep: a folder for what was made; None: nothing is kept.
        houses: which kind of houses, one of `HOUSES`.
        longest_s: a drive goes on to places at random, and ends then [s].
    """

    def __init__(
        self,
        area_m2: float,
        keep: Path | None,
        houses: str = "square",
        longest_s: float = LONGEST_S,
    ) -> None:
        self.area_m2 = area_m2
        self._keep = keep
        self._draw = HOUSES[houses]
        self._longest_s = longest_s
        self._seeds: list[int] = []

    def seed_of(self, number: int) -> int:
        """The seed of a house, counting those that have rooms to shut off."""
        seed = self._seeds[-1] if self._seeds else -1
        while len(self._seeds) <= number:
            seed += 1
            plan = self.plan(seed)
            if plan.doors and doors_to_close(plan, seed):
                self._seeds.append(seed)
        return self._seeds[number]

    def plan(self, seed: int) -> Plan:
        """The house of a seed."""
        return self._draw(math.sqrt(self.area_m2) + 1.4, seed)

    def mapped(self, number: int) -> GridMap:
        """The map that the mapper makes of a house."""
        seed = self.seed_of(number)
        return self._map_of(inhabited(self.plan(seed).built(), seed, WIDE, 0.02, 0), seed)

    def make(self, case: Case, number: int) -> Visit:
        """The second visit of one of the houses."""
        seed = self.seed_of(number)
        plan = self.plan(seed)
        if case.is_extended:
            plan = built_on(plan, np.random.default_rng(seed))
        closed = doors_to_close(plan, seed) if case.opens_doors else ()
        if case.is_extended:
            closed = (*closed, plan.doors[-1])
        first = inhabited(plan.built(closed), seed, WIDE, 0.02, 0)
        grid = self._map_of(first, seed)
        if case.is_moved:
            plan = moved(plan, first.start, np.random.default_rng(seed + 1000))
        scans, truths = self._drive_again(case, plan, first.start, seed)
        if case.is_cropped:
            grid = cropped(grid, first.start)
        return Visit(grid, scans, truths, told_at(truths[0]))

    def on_map(self, grid: GridMap, number: int, lidar: LidarSpec = WIDE) -> Visit:
        """A drive in a house where furniture has been moved, on a map of another house."""
        seed = self.seed_of(number)
        plan = self.plan(seed)
        start = inhabited(plan.built(), seed, WIDE, 0.02, 0).start
        plan = moved(plan, start, np.random.default_rng(seed + 1000))
        scans, truths = self._drive_again(replace(MOVED, lidar=lidar), plan, start, seed)
        return Visit(grid, scans, truths, None)

    def _drive_again(
        self, case: Case, plan: Plan, start: Pose2D, seed: int
    ) -> tuple[list[ScanInput], list[Pose2D]]:
        """Drive through a house with other people and other wheels than on the first visit."""
        house = inhabited(plan.built(), seed + 1, case.lidar, case.odometry_error, 2, start)
        return self._drive(house, seed + 1)

    def _map_of(self, house: House, seed: int) -> GridMap:
        """What the mapper makes of a house, its frame fitted to the house's."""

        def make() -> dict[str, NDArray]:
            mapper = Mapper(MapperConfig(), house.start)
            scans = list(drive(house, seed))
            mapped = map_drive(mapper, (scan for scan, _ in scans))
            fit, _ = fitted(mapped.poses, [truth for _, truth in scans])
            grid = mapper.grid()
            return {"cells": grid.cells, "origin": (fit @ grid.origin).as_array()}

        found = self._kept(f"map-{digest(house, seed)}", make)
        return GridMap("first", RESOLUTION, Pose2D.from_array(found["origin"]), found["cells"])

    def _drive(self, house: House, seed: int) -> tuple[list[ScanInput], list[Pose2D]]:
        def make() -> dict[str, NDArray]:
            made = list(drive(house, seed, self._longest_s))
            return {
                "stamps": np.array([scan.stamp_ns for scan, _ in made]),
                "ranges": np.stack([scan.ranges for scan, _ in made]),
                "odom": np.stack([scan.odom_T_base.as_array() for scan, _ in made]),
                "ends": np.stack([scan.odom_T_base_end.as_array() for scan, _ in made]),
                "truths": np.stack([truth.as_array() for _, truth in made]),
                "angles": np.array([made[0][0].angle_min, made[0][0].angle_increment]),
            }

        found = self._kept(f"drive-{digest(house, seed)}-{self._longest_s:g}", make)
        lidar = house.spec.lidar
        scans = [
            ScanInput(
                stamp_ns=int(stamp_ns),
                ranges=ranges,
                angle_min=float(found["angles"][0]),
                angle_increment=float(found["angles"][1]),
                range_min=lidar.range_min_m,
                range_max=lidar.range_max_m,
                base_T_laser=BASE_T_LASER,
                odom_T_base=Pose2D.from_array(odom),
                odom_T_base_end=Pose2D.from_array(end),
            )
            for stamp_ns, ranges, odom, end in zip(
                found["stamps"], found["ranges"], found["odom"], found["ends"], strict=True
            )
        ]
        return scans, [Pose2D.from_array(truth) for truth in found["truths"]]

    def _kept(self, name: str, make) -> dict[str, NDArray]:  # noqa: ANN001
        if self._keep is None:
            return make()
        self._keep.mkdir(parents=True, exist_ok=True)
        file = self._keep / f"{name}.npz"
        if not file.exists():
            with tempfile.NamedTemporaryFile(dir=self._keep, suffix=".npz", delete=False) as aside:
                np.savez_compressed(aside, **make())
            Path(aside.name).rename(file)
        with np.load(file) as data:
            return dict(data)


def digest(house: House, seed: int) -> str:
    """A name for a drive: the same for the same house, robot and seed."""
    parts = (house.grid.cells.tobytes(), repr(house.spec), repr(house.start), seed)
    return hashlib.sha1(repr(parts).encode()).hexdigest()[:16]


def doors_to_close(plan: Plan, seed: int) -> tuple[Rect, ...]:
    """Doors that shut off between a sixth and a half of the house, at most two of them."""
    whole = reach(plan.built(), seed)
    best: tuple[Rect, ...] = ()
    for door in plan.doors:
        tried = (*best, door)
        off = 1.0 - reach(plan.built(tried), seed) / whole
        if off <= 0.5 and off > 1.0 - reach(plan.built(best), seed) / whole + 0.02:
            best = tried
        if len(best) == 2 or (best and off >= 1.0 / 3.0):
            break
    return best


def reach(grid: GridMap, seed: int) -> float:
    """Floor that a robot can reach in a house [cells]."""
    return float(inhabited(grid, seed, WIDE, 0.0, 0).reachable.sum())


CORRIDOR_M, CORRIDOR_WIDTH_M = 9.0, 1.3


def built_on(plan: Plan, rng: np.random.Generator) -> Plan:
    """Build a corridor on to the right, with a niche; its door is the plan's last."""
    length, width = round(CORRIDOR_M / RESOLUTION), round(CORRIDOR_WIDTH_M / RESOLUTION)
    rows, cols = plan.walls.shape
    cells = np.full((rows, cols + length + 10), UNKNOWN, np.int8)
    cells[:, :cols] = plan.walls
    floor = plan.built().cells
    inside = cols - 10 - WALL_CELLS
    open_rows = [
        r for r in range(12, rows - 12 - width)
        if np.all(floor[r : r + width, inside - 16 : inside] == FREE)
    ]  # fmt: skip
    assert open_rows, "another seed: nowhere to build on"
    r = int(rng.choice(open_rows))
    cells[r - 2 : r + width + 2, inside : inside + length] = OCCUPIED
    cells[r : r + width, inside + WALL_CELLS : inside + length - 2] = FREE
    niche = inside + length // 2
    cells[r + width : r + width + 12, niche - 2 : niche + 22] = OCCUPIED
    cells[r + width : r + width + 10, niche : niche + 20] = FREE
    cells[r : r + width, inside : inside + WALL_CELLS] = FREE
    door = (r, r + width, inside, inside + WALL_CELLS)
    return replace(plan, walls=cells, doors=(*plan.doors, door))


def moved(plan: Plan, start: Pose2D, rng: np.random.Generator) -> Plan:
    """Move a third of the furniture by 0.3 to 1 m, away from a start."""
    pieces = list(plan.furniture)
    robot = np.array([start.y, start.x]) / RESOLUTION
    left = round(len(pieces) / 3)
    for k in rng.permutation(len(pieces)):
        for _ in range(50):
            way, size = rng.uniform(-math.pi, math.pi), rng.uniform(0.3, 1.0) / RESOLUTION
            dr, dc = round(size * math.sin(way)), round(size * math.cos(way))
            r0, r1, c0, c1 = pieces[k]
            shifted = (r0 + dr, r1 + dr, c0 + dc, c1 + dc)
            middle = np.array([r0 + r1 + 2 * dr, c0 + c1 + 2 * dc]) / 2
            half = np.array([r1 - r0, c1 - c0]) / 2
            is_clear = bool((np.abs(middle - robot) > half + 10).any())
            if left > 0 and is_clear and _stands_free(plan, shifted):
                pieces[k] = shifted
                left -= 1
                break
    return replace(plan, furniture=tuple(pieces))


def _stands_free(plan: Plan, piece: Rect) -> bool:
    """Whether a piece stands on the floor of a room and in front of no door."""
    r0, r1, c0, c1 = piece
    rows, cols = plan.walls.shape
    if min(r0, c0) < 0 or r1 > rows or c1 > cols:
        return False
    in_doorway = any(
        r0 < d1 + 12 and r1 > d0 - 12 and c0 < e1 + 12 and c1 > e0 - 12
        for d0, d1, e0, e1 in plan.doors
    )
    return not in_doorway and bool(np.all(plan.walls[r0:r1, c0:c1] == FREE))


def cropped(grid: GridMap, start: Pose2D) -> GridMap:
    """The half of a map, and a little more, in which the robot starts."""
    col = int(grid.world_to_cell(np.array([[start.x, start.y]]))[0, 1])
    part = round(0.6 * grid.cols)
    first = 0 if col < grid.cols // 2 else grid.cols - part
    origin = grid.origin @ Pose2D(first * grid.resolution, 0.0, 0.0)
    cells = np.ascontiguousarray(grid.cells[:, first : first + part])
    return GridMap(grid.name, grid.resolution, origin, cells)


# Following.


@dataclass(frozen=True)
class Track:
    """What the localizer said on a visit, one entry per scan.

    Attributes:
        stamps_s: robot time [s].
        error_m: [m], infinite without a pose.
        error_rad: [rad].
        states: what it said.
        messages: why.
        mapped: share of beams that truly end on what the map knows.
    """

    stamps_s: NDArray[np.float64]
    error_m: NDArray[np.float64]
    error_rad: NDArray[np.float64]
    states: NDArray[np.str_]
    messages: list[str]
    mapped: NDArray[np.float64]

    @property
    def is_right(self) -> NDArray[np.bool_]:
        """Where the estimate is near the truth."""
        return (self.error_m <= FAR_M) & (self.error_rad <= FAR_RAD)

    @property
    def is_sure(self) -> NDArray[np.bool_]:
        """Where it said that it knew."""
        return self.states == "localized"

    @property
    def is_on_map(self) -> NDArray[np.bool_]:
        """Where the map knows what the robot sees."""
        return self.mapped >= MAPPED_SHARE

    def wrongs(self) -> list[dict[str, float]]:
        """When it was sure and wrong: from when, for how long [s], and how far off at most [m]."""
        wrong = np.concatenate([[0], self.is_sure & ~self.is_right, [0]]).astype(np.int8)
        edges = np.flatnonzero(np.diff(wrong))
        return [
            {
                "at_s": round(float(self.stamps_s[first]), 1),
                "for_s": round(float(self.stamps_s[last - 1] - self.stamps_s[first]), 1),
                "off_m": round(min(float(self.error_m[first:last].max()), 1e5), 2),
                "turned_deg": round(math.degrees(float(self.error_rad[first:last].max())), 1),
            }
            for first, last in zip(edges[0::2], edges[1::2], strict=True)
        ]

    def returns_s(self) -> list[float]:
        """Time from each return to the map until it was right and said so [s].

        A return that ends before, and within 5 s, does not count.
        """
        found: list[float] = []
        edges = np.flatnonzero(np.diff(self.is_on_map.astype(np.int8), prepend=1))
        good = self.is_right & self.is_sure
        for away, back in zip(edges[0::2], edges[1::2], strict=False):
            if self.stamps_s[back] - self.stamps_s[away] < AWAY_S:
                continue
            later = edges[edges > back]
            end = int(later[0]) if later.size else len(good)
            known = np.flatnonzero(good[back:end])
            stay_s = self.stamps_s[end - 1] - self.stamps_s[back]
            if known.size:
                found.append(float(self.stamps_s[back + known[0]] - self.stamps_s[back]))
            elif stay_s > 5.0:
                found.append(math.inf)
        return found


def estimates(localizer: Localizer, scans: list[ScanInput], late: int) -> Iterator[Estimate]:
    """Give the estimate after each scan; searches deliver so many scans late."""
    running: deque[tuple[int, SearchJob]] = deque()
    for k, scan in enumerate(scans):
        while running and running[0][0] <= k:
            localizer.finish(running.popleft()[1])
        estimate = localizer.step(scan)
        assert isinstance(estimate, Estimate)
        job = localizer.take_job()
        if job is not None:
            job.run()
            running.append((k + late, job))
            if late == 0:
                localizer.finish(running.popleft()[1])
        yield estimate


def follow(visit: Visit, seed: int, late: int = 0) -> Track:
    """Let a localizer follow a visit, from the pose that it is told or from nothing."""
    localizer = Localizer(visit.grid, [], LocalizerConfig(), seed)
    if visit.told is not None and localizer.pose_problem(visit.told) is None:
        localizer.set_pose(visit.told)
    count = len(visit.scans)
    error_m, error_rad = np.full(count, np.inf), np.full(count, np.inf)
    states: list[str] = []
    messages: list[str] = []
    for k, estimate in enumerate(estimates(localizer, visit.scans, late)):
        states.append(estimate.state)
        messages.append(estimate.message)
        if estimate.map_T_base is not None:
            error_m[k] = estimate.map_T_base.distance_to(visit.truths[k])
            turned = angle_difference(estimate.map_T_base.yaw, visit.truths[k].yaw)
            error_rad[k] = abs(turned)
    stamps_s = np.array([scan.stamp_ns for scan in visit.scans]) * 1e-9
    return Track(stamps_s, error_m, error_rad, np.array(states), messages, visit.mapped_shares())


def way_m(truths: list[Pose2D]) -> NDArray[np.float64]:
    """Distance driven until each of them (n,) [m]."""
    points = np.array([(pose.x, pose.y) for pose in truths])
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])


def sure_on(visit: Visit, first: int, reach_m: float, late: int) -> dict[str, float | None]:
    """How far a robot that searches itself on a foreign map drives until it is sure, and how long.

    Args:
        visit: on a map of another house.
        first: the scan at which the search begins.
        reach_m: distance that is driven [m].
        late: results of searches arrive so many scans late.
    """
    way = way_m(visit.truths[first:])
    last = int(np.searchsorted(way, reach_m))
    localizer = Localizer(visit.grid, [], LocalizerConfig(), 0)
    sure = [
        one.state == "localized"
        for one in estimates(localizer, visit.scans[first : first + last], late)
    ]
    since_m = float(way[sure.index(True)]) if any(sure) else None
    period_s = (visit.scans[1].stamp_ns - visit.scans[0].stamp_ns) * 1e-9
    return {
        "sure_m": None if since_m is None else round(since_m, 2),
        "sure_s": round(sum(sure) * period_s, 1),
    }
