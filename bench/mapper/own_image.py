"""Mirrors known by the robot's own image, and people who are taken for it.

    python -m bench.mapper.own_image [--houses N] [--seeds N] [--mirrors]

A perfect robot explores generated houses, offices along a corridor, and bare corridors. What its
lidar sees of people is made scan by scan: beside those who walk anyhow, some do what an image
does: they come towards the robot as fast as it drives, stop when it stops, or move exactly as if a
mirror hung halfway. Each meeting that ends in a mirror is a false one. With --mirrors nobody
walks, mirrors hang on the walls, and those are counted that are found.
"""

import argparse
import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from bench.harness.figures import table
from bench.harness.houses import draw_house, free_poses
from bench.mapper.exploring import draw_office
from bench.mapper.perfect_robot import CLEARANCE, LIMITS, PerfectRobot
from numpy.typing import NDArray

from trolley.geometry import Pose2D, angle_difference
from trolley.gridmap import FREE, OCCUPIED, GridMap, cast_rays, distance_transform
from trolley_base.world.rays import MIRROR_LEFT, Scene
from trolley_base.world.scanner import Shots, cast_shots_into
from trolley_mapper.explore.explorer import Explorer
from trolley_mapper.explore.own_image import OwnImage

Floats = NDArray[np.float64]

BEAMS, REACH_M = 360, 8.0
NOISE_M, NOISE_SHARE, DROP_OUT = 0.008, 0.003, 0.01
POSE_NOISE_M, POSE_NOISE_RAD = 0.006, math.radians(0.2)
SPEED_MPS, RATE_HZ, TURN_RADPS = 0.4, 10.0, 1.5
FOOTPRINT = np.array([[0.15, 0.12], [-0.15, 0.12], [-0.15, -0.12], [0.15, -0.12]])
MEETING_S = 15.0
KEEPS_M = 0.45
"""Nearer to each other than this neither robot nor person goes on [m]."""


@dataclass
class Place:
    """A building and where a robot drives in it, a pose for each scan."""

    name: str
    grid: GridMap
    track: list[Pose2D]
    room_m: NDArray[np.float32] = field(init=False)

    def __post_init__(self) -> None:
        """Note how far everything is from the floor."""
        self.room_m = distance_transform(1 - self.grid.free_mask(), self.grid.resolution)

    def has_room(self, x: float, y: float) -> bool:
        """Whether a person may stand there."""
        cell = self.grid.world_to_cell(np.array([[x, y]]))
        inside = bool(self.grid.contains_cell(cell)[0])
        return inside and float(self.room_m[tuple(cell[0])]) > 0.15

    def sight_m(self, pose: Pose2D, yaw: float) -> float:
        """How far one sees from a pose in a direction."""
        at = self.grid.origin.inverse() @ pose
        mask = self.grid.occupied_mask()
        angles = np.array([yaw])
        ray = cast_rays(mask, self.grid.resolution, (at.x, at.y), angles, REACH_M)
        return min(float(ray[0]), REACH_M)


def draw_corridor(width_m: float, length_m: float = 24.0) -> GridMap:
    """A corridor without anything in it."""
    cells = np.full((round(width_m * 20) + 4, round(length_m * 20) + 4), OCCUPIED, np.int8)
    cells[2:-2, 2:-2] = FREE
    return GridMap("corridor", 0.05, Pose2D.identity(), cells)


def explored(name: str, grid: GridMap, start: Pose2D) -> Place:
    """A building and how a perfect robot explores it."""
    robot = PerfectRobot(grid, start)
    robot.explore(Explorer("own", CLEARANCE, LIMITS))
    return Place(name, grid, list(scan_poses(robot.track)))


def scan_poses(track: list[Pose2D]) -> Iterator[Pose2D]:
    """Where the robot is at each scan, if it turns on the spot where the track turns."""
    here = track[0]
    for there in track[1:]:
        away = here.distance_to(there)
        if away > 1e-6:
            heading = math.atan2(there.y - here.y, there.x - here.x)
            yield from _turned(here, heading)
            for part in np.arange(0.0, away, SPEED_MPS / RATE_HZ) / away:
                x, y = here.x + part * (there.x - here.x), here.y + part * (there.y - here.y)
                yield Pose2D(x, y, heading)
            here = Pose2D(there.x, there.y, heading)
        yield from _turned(here, there.yaw)
        here = there


def _turned(here: Pose2D, yaw: float) -> Iterator[Pose2D]:
    turn = angle_difference(yaw, here.yaw)
    count = round(abs(turn) / (TURN_RADPS / RATE_HZ))
    for k in range(1, count):
        yield Pose2D(here.x, here.y, here.yaw + turn * k / count)


def places(num_houses: int) -> Iterator[Place]:
    """All buildings."""
    for seed in range(1, num_houses + 1):
        size = (8.0, 10.0, 12.0)[seed % 3]
        grid = draw_house(size, seed)
        start = free_poses(grid, 0.35, 1, np.random.default_rng(seed))[0]
        yield explored(f"house {size:.0f}:{seed}", grid, start)
    yield explored("office", draw_office(), Pose2D(1.5, 5.6, 0.0))
    for width_m in (1.2, 1.6, 2.0):
        grid = draw_corridor(width_m)
        ways = [Pose2D(1.0, 0.1 + 0.5 * width_m, 0.0), Pose2D(23.0, 0.1 + 0.5 * width_m, 0.0)]
        yield Place(f"corridor {width_m} m", grid, list(scan_poses([*ways, ways[0]])))


class Lidar:
    """Measures in a building."""

    def __init__(self, grid: GridMap, mirrors: Floats, rng: np.random.Generator) -> None:
        self._rng, self._mirrors = rng, mirrors
        origin = grid.origin
        self._frame = np.array(
            [origin.x, origin.y, math.cos(origin.yaw), math.sin(origin.yaw), grid.resolution]
        )
        self._solid = grid.occupied_mask()
        self.angles = np.linspace(-math.pi, math.pi, BEAMS, endpoint=False, dtype=np.float64)

    def measure(self, before: Pose2D, now: Pose2D, circles: Floats) -> Floats:
        """Return the ranges (beams,) of a revolution that began at one pose and ends at another."""
        rng, count = self._rng, len(self._mirrors)
        scene = Scene(
            self._frame,
            self._solid,
            self._mirrors,
            np.full(count, MIRROR_LEFT, np.uint8),
            np.zeros((count, 2)),
            circles,
            now.transform_points(FOOTPRINT),
        )
        ranges = np.empty(BEAMS)
        poses = np.array([before.as_array(), now.as_array()])
        parts = np.linspace(0.0, 1.0, BEAMS)
        cast_shots_into(ranges, Shots(parts, self.angles, rng.random(BEAMS), REACH_M), poses, scene)
        ranges[(ranges > REACH_M) | (rng.random(BEAMS) < DROP_OUT)] = math.inf
        seen = np.isfinite(ranges)
        noise = rng.standard_normal(BEAMS)[seen]
        ranges[seen] += noise * (NOISE_M + NOISE_SHARE * ranges[seen])
        return ranges

    def believed(self, pose: Pose2D) -> Pose2D:
        """Where the mapper takes the robot to be."""
        dx, dy, turn = self._rng.standard_normal(3).tolist()
        return Pose2D(
            pose.x + POSE_NOISE_M * dx, pose.y + POSE_NOISE_M * dy, pose.yaw + POSE_NOISE_RAD * turn
        )


@dataclass
class Meeting:
    """A person, and how they move.

    Attributes:
        kind: what they do.
        x: where they are [m].
        y: the same.
        legs: whether the lidar sees legs rather than a body.
        speed_mps: at which they walk by themselves.
        factor: how much faster than the robot those are who walk as it does.
        yaw: where those who pass go.
        mirror: halfway between both at first, x pointing to the person.
    """

    kind: str
    x: float
    y: float
    legs: bool
    speed_mps: float
    factor: float
    yaw: float
    mirror: Pose2D
    walked_m: float = 0.0

    def step(self, before: Pose2D, now: Pose2D, place: Place) -> None:
        """Move on while the robot drives from one pose to another."""
        x, y = MOVES[self.kind](self, before, now)
        apart_m, apart_before_m = (math.hypot(b - now.x, c - now.y) for b, c in ((x, y), self.at))
        comes_too_near = apart_m < KEEPS_M and apart_m < apart_before_m
        if place.has_room(x, y) and not comes_too_near:
            self.walked_m += math.hypot(x - self.x, y - self.y)
            self.x, self.y = x, y

    @property
    def at(self) -> tuple[float, float]:
        """Where they are."""
        return self.x, self.y

    def toward(self, robot: Pose2D, distance_m: float) -> tuple[float, float]:
        """Where they are after walking towards the robot."""
        dx, dy = robot.x - self.x, robot.y - self.y
        away = max(math.hypot(dx, dy), 1e-6)
        return self.x + distance_m * dx / away, self.y + distance_m * dy / away

    def circles(self) -> Floats:
        """What the lidar meets of them (n, 3)."""
        if not self.legs:
            return np.array([[self.x, self.y, 0.2]])
        swing = 0.15 * math.sin(2.0 * math.pi * self.walked_m / 1.2)
        c, s = math.cos(self.mirror.yaw), math.sin(self.mirror.yaw)
        return np.array(
            [
                [self.x + swing * c - 0.1 * s, self.y + swing * s + 0.1 * c, 0.06],
                [self.x - swing * c + 0.1 * s, self.y - swing * s - 0.1 * c, 0.06],
            ]
        )


Move = Callable[[Meeting, Pose2D, Pose2D], tuple[float, float]]


def _as_image(one: Meeting, _: Pose2D, now: Pose2D) -> tuple[float, float]:
    seen = one.mirror.inverse() @ now
    image = one.mirror @ Pose2D(-seen.x, seen.y, 0.0)
    return image.x, image.y


MOVES: dict[str, Move] = {
    "stands": lambda one, _, __: one.at,
    "comes steadily": lambda one, _, now: one.toward(now, one.speed_mps / RATE_HZ),
    "comes as fast": lambda one, before, now: one.toward(now, before.distance_to(now)),
    "comes about as fast": lambda one, before, now: one.toward(
        now, one.factor * before.distance_to(now)
    ),
    "does as an image": _as_image,
    "walks with it": lambda one, before, now: (
        one.x + now.x - before.x,
        one.y + now.y - before.y,
    ),
    "follows": lambda one, before, now: one.toward(now, before.distance_to(now)),
    "passes": lambda one, _, __: (
        one.x + one.speed_mps / RATE_HZ * math.cos(one.yaw),
        one.y + one.speed_mps / RATE_HZ * math.sin(one.yaw),
    ),
}


def meet(kind: str, robot: Pose2D, place: Place, rng: np.random.Generator) -> Meeting | None:
    """Somebody who comes into view; None where there is no room."""
    side = math.pi if kind == "follows" else float(rng.uniform(-0.5, 0.5))
    if kind == "walks with it":
        side = float(rng.uniform(-2.0, 2.0))
    yaw = robot.yaw + side
    sight_m = place.sight_m(robot, yaw) - 0.3
    away_m = float(rng.uniform(1.2, 7.0 if side != math.pi else 2.0))
    x, y = robot.x + away_m * math.cos(yaw), robot.y + away_m * math.sin(yaw)
    if away_m > sight_m or not place.has_room(x, y):
        return None
    middle = Pose2D(0.5 * (robot.x + x), 0.5 * (robot.y + y), yaw)
    legs, speed_mps = bool(rng.random() < 0.5), float(rng.uniform(0.15, 1.2))
    factor, walks = float(rng.uniform(0.8, 1.25)), float(rng.uniform(-math.pi, math.pi))
    return Meeting(kind, x, y, legs, speed_mps, factor, walks, middle)


def meet_people(place: Place, seed: int) -> tuple[Counter[str], Counter[str]]:
    """Drive through a building, one meeting after another: all of them, and false mirrors."""
    rng = np.random.default_rng(seed)
    lidar, own = Lidar(place.grid, np.empty((0, 4)), rng), OwnImage()
    met, false = Counter[str](), Counter[str]()
    one: Meeting | None = None
    left = 0
    poses = iter(place.track)
    before = now = next(poses)
    none = np.empty((0, 4))
    while True:
        if one is None:
            # The rarest kind so far: there is not room for each everywhere.
            kinds = sorted(MOVES, key=lambda kind: met[kind] + 0.5 * float(rng.random()))
            tried = (meet(kind, now, place, rng) for kind in kinds)
            one = next((each for each in tried if each is not None), None)
            left = round(MEETING_S * RATE_HZ)
            if one is not None:
                met[one.kind] += 1
        is_blocked = one is not None and _is_ahead(now, one)
        if not is_blocked:
            there = next(poses, None)
            if there is None:
                return met, false
            before, now = now, there
        else:
            before = now
        if one is not None:
            one.step(before, now, place)
        circles = np.empty((0, 3)) if one is None else one.circles()
        ranges = lidar.measure(before, now, circles)
        found = own.update(lidar.believed(before), ranges, lidar.angles, none)
        if found is not None:
            false["nobody" if one is None else one.kind] += 1
        left -= 1
        if left <= 0 or found is not None:
            one = None


def _is_ahead(robot: Pose2D, one: Meeting) -> bool:
    at = robot.inverse() @ Pose2D(one.x, one.y, 0.0)
    return 0.0 < at.x < KEEPS_M + 0.1 and abs(at.y) < 0.4


def hang_mirrors(grid: GridMap, rng: np.random.Generator, count: int = 6) -> Floats:
    """Mirrors (n, 4) on straight pieces of wall, their left side to the room."""
    hung: list[list[float]] = []
    mask, edge = grid.occupied_mask(), grid.resolution
    for pose in free_poses(grid, 0.3, 400, rng):
        yaw = 0.5 * math.pi * float(rng.integers(4))
        width_m = float(rng.uniform(0.8, 1.8))
        aside = np.linspace(-0.5 * width_m, 0.5 * width_m, 24)
        view = Pose2D(pose.x, pose.y, yaw)
        ways: list[float] = []
        for y in aside.tolist():
            at = grid.origin.inverse() @ view @ Pose2D(0.0, y, 0.0)
            ways.append(float(cast_rays(mask, edge, (at.x, at.y), np.array([yaw]), 12.0)[0]))
        if max(ways) - min(ways) > 0.01 or max(ways) > 6.0:
            continue
        # Left of who walks from the first end to the second is the room.
        ends = [view @ Pose2D(ways[0] - 0.01, side * 0.5 * width_m, 0.0) for side in (-1.0, 1.0)]
        line = [ends[0].x, ends[0].y, ends[1].x, ends[1].y]
        middle = np.array([0.5 * (line[0] + line[2]), 0.5 * (line[1] + line[3])])
        if all(math.dist(middle, (0.5 * (m[0] + m[2]), 0.5 * (m[1] + m[3]))) > 2.5 for m in hung):
            hung.append(line)
        if len(hung) == count:
            break
    return np.array(hung).reshape(-1, 4)


@dataclass
class Hung:
    """A mirror: how the robot has driven before it, and whether it was found."""

    frame: Pose2D
    """Its middle, x pointing into it."""
    half_m: float
    found_at_m: float | None = None
    error_m: float = 0.0
    toward: list[float] = field(default_factory=list[float])

    @property
    def is_due(self) -> bool:
        """Whether the robot has driven towards it for more than 1 m with its image in view."""
        return bool(self.toward) and max(self.toward) - min(self.toward) > 1.0


def find_mirrors(place: Place, seed: int) -> tuple[list[Hung], int]:
    """Drive past mirrors; return them, and the number of those found where none is."""
    rng = np.random.default_rng(seed)
    lines = hang_mirrors(place.grid, rng)
    lidar, own = Lidar(place.grid, lines, rng), OwnImage()
    hung: list[Hung] = []
    for x0, y0, x1, y1 in lines.tolist():
        along = math.atan2(y1 - y0, x1 - x0)
        frame = Pose2D(0.5 * (x0 + x1), 0.5 * (y0 + y1), along - 0.5 * math.pi)
        hung.append(Hung(frame, 0.5 * math.hypot(x1 - x0, y1 - y0)))
    false, before = 0, place.track[0]
    known = np.empty((0, 4))
    for now in place.track:
        for one in hung:
            at = one.frame.inverse() @ now
            if -3.5 < at.x < 0.0 and abs(at.y) < one.half_m - 0.15:
                yaw = one.frame.yaw
                if place.sight_m(now, yaw) > -at.x - 0.1:
                    one.toward.append(at.x)
        ranges = lidar.measure(before, now, np.empty((0, 3)))
        found = own.update(lidar.believed(before), ranges, lidar.angles, known)
        if found is not None:
            near = [
                one
                for one in hung
                if abs((one.frame.inverse() @ found).x) < 0.25
                and abs((one.frame.inverse() @ found).y) < one.half_m + 0.3
            ]
            ends = [found @ Pose2D(0.0, side * 0.9, 0.0) for side in (-1, 1)]
            known = np.vstack([known, [[ends[0].x, ends[0].y, ends[1].x, ends[1].y]]])
            false += not near
            for one in near:
                if one.found_at_m is None:
                    one.found_at_m = -(one.frame.inverse() @ now).x
                    one.error_m = (one.frame.inverse() @ found).x
        before = now
    return hung, false


def main() -> None:
    """Drive and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--houses", type=int, default=6)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--mirrors", action="store_true")
    asked = parser.parse_args()
    lines: list[list[str]] = []
    all_met, all_false = Counter[str](), Counter[str]()
    for place in places(asked.houses):
        if asked.mirrors:
            hung: list[Hung] = []
            false = 0
            for seed in range(asked.seeds):
                more, wrong = find_mirrors(place, seed)
                hung, false = hung + more, false + wrong
            due = [one for one in hung if one.is_due]
            seen = [one.found_at_m for one in due if one.found_at_m is not None]
            found_at = f"{np.median(seen):.1f} m" if seen else ""
            lines.append([place.name, f"{len(seen)}/{len(due)}", found_at, str(false)])
            continue
        met, wrongs = Counter[str](), Counter[str]()
        for seed in range(asked.seeds):
            more_met, more_false = meet_people(place, seed)
            met, wrongs = met + more_met, wrongs + more_false
        all_met, all_false = all_met + met, all_false + wrongs
        lines.append([place.name, *(f"{wrongs[kind]}/{met[kind]}" for kind in (*MOVES, "nobody"))])
    if asked.mirrors:
        table(("", "found", "from", "false"), lines)
        return
    lines.append(["all", *(f"{all_false[kind]}/{all_met[kind]}" for kind in (*MOVES, "nobody"))])
    table(("", *MOVES, "nobody"), lines)


if __name__ == "__main__":
    main()
