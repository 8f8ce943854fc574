"""Exploring by itself: how much of a house is found, how far the robot drives, and what it hits.

    python -m bench.mapper.exploring [--house SIZE:SEED ...] [--apartment] [--mirror] [--office]
                                     [--perfect] [--view DEGREES] [--masked DEGREES]

In lock-step: simulated base (odometry 1-2 % wrong, a noisy lidar of 8 m), mapper and planner in
generated houses of SIZE x SIZE m, and with --apartment in the demo's; with --mirror its mirror
hangs there too, which no new map shows; with --office in offices along a corridor, at whose end
hangs a mirror as wide as it. With --view the lidar looks ahead only, so many degrees wide; with
--masked it looks all round, but for so many degrees behind, where it sees the robot itself. Judged
by the truth: the share of the floor that the map knows (where the robot can get, and 1 m around),
the distance, the time, and collisions.

For comparison: the distance of a robot that knows where it is, sees without errors and obeys at
once, and the tour of one that knows the house beforehand: the fewest places from which all floor
is seen, in the shortest order found. With --perfect only these two, in more houses.
"""

import argparse
import itertools
import math
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from bench.harness.drives import make_config
from bench.harness.figures import table
from bench.harness.houses import draw_house, free_poses
from bench.harness.wandering import APARTMENT, START, write_world
from bench.mapper.perfect_robot import (
    CLEARANCE,
    LIMITS,
    REACH_M,
    PerfectRobot,
    wanted_floor,
    way_from,
)
from numpy.typing import NDArray

from trolley import requests, topics
from trolley.geometry import Pose2D
from trolley.gridmap import FREE, OCCUPIED, GridMap, cast_rays, distance_transform, save_map
from trolley.gridmap.wire import grid_of
from trolley.messages import MappingStatus, OccupancyGrid, Truth
from trolley.messages.request_params import MapNamed
from trolley.runtime.lockstep import Lockstep
from trolley_base.drivers.interface import LidarScan
from trolley_base.service import BaseService
from trolley_base.simulation.simulated_hardware import SimulatedHardware
from trolley_base.world.world_file import load_world
from trolley_mapper.explore.explorer import Explorer
from trolley_mapper.kernels.frontiers import STRAIGHT, UNREACHED
from trolley_mapper.service import MapperService
from trolley_planner.service import PlannerService

HOUSES = ("6:1", "8:2", "10:3")
PERFECT = ("6:1", "8:2", "10:3", "10:6", "12:4", "12:7", "15:5")
LIMIT_S = 1500.0
NUM_PLACES = 60
"""This many places are candidates for the tour of a robot that knows the house."""


@dataclass(frozen=True)
class Outcome:
    """The outcome of a run."""

    state: str
    message: str
    share: float
    way_m: float
    seconds: float
    home_m: float
    """Distance from the end to the start."""
    collisions: int
    cpu_s: float


def share_known(found: GridMap, true_T_map: Pose2D, truth: GridMap, start: Pose2D) -> float:
    """Share of the wanted floor that a map knows."""
    points = truth.cell_to_world(np.argwhere(wanted_floor(truth, start)))
    known = found.values_at(true_T_map.inverse().transform_points(points)) >= 0
    return float(np.count_nonzero(known)) / len(known)


def mask(base: BaseService, masked_rad: float) -> None:
    """Take the beams behind the robot from its lidar, so wide, as `masks_deg` does."""
    hardware = base.hardware
    assert isinstance(hardware, SimulatedHardware)
    store = hardware.lidar.store

    def store_masked(scan: LidarScan) -> None:
        angles = scan.angle_min + np.arange(len(scan.ranges)) * scan.angle_increment
        scan.ranges[np.cos(angles) < -math.cos(0.5 * masked_rad)] = 0.0
        store(scan)

    hardware.lidar.store = store_masked


def explore(
    world: Path, map_file: Path, start: Pose2D, seed: int, masked_rad: float = 0.0
) -> Outcome:
    """Let the services explore a world."""
    rest = f'[base.simulated]\nworld = "{world}"\nseed = {seed}\n'
    config = make_config(map_file, start, rest)
    began_s = time.process_time()
    with Lockstep(config.robot.name, seed) as bus:
        truths, said = bus.record(topics.SIM_TRUTH), bus.record(topics.MAPPING)
        maps = bus.record(topics.MAP)
        mask(bus.add(BaseService(config)), masked_rad)
        for service in (PlannerService, MapperService):
            bus.add(service(config))
        bus.run(2.0)
        home = truths[-1].pose
        bus.ask(requests.MAP_NEW, MapNamed(name="new", explore=True))
        bus.run_until(lambda: said[-1].exploring in ("done", "paused"), LIMIT_S)
        bus.run(2.0)
        cpu_s = time.process_time() - began_s
        return judged(said[-1], truths, maps[-1], load_world(world).grid, (home, bus.now_s, cpu_s))


def judged(
    status: MappingStatus,
    truths: list[Truth],
    found: OccupancyGrid,
    truth: GridMap,
    run: tuple[Pose2D, float, float],
) -> Outcome:
    """The outcome; `run` holds the start, the seconds that it took, and the CPU seconds."""
    home, seconds, cpu_s = run
    poses = [one.pose for one in truths]
    return Outcome(
        status.exploring,
        status.message,
        share_known(grid_of(found), home, truth, home),
        sum(a.distance_to(b) for a, b in itertools.pairwise(poses)),
        seconds,
        poses[-1].distance_to(home),
        truths[-1].collisions,
        cpu_s,
    )


def perfect(house: GridMap, start: Pose2D) -> Outcome:
    """Let the perfect robot explore a house."""
    robot, explorer = PerfectRobot(house, start), Explorer("perfect", CLEARANCE, LIMITS)
    began_s = time.process_time()
    robot.explore(explorer)
    return Outcome(
        explorer.state,
        explorer.message,
        robot.share_found(),
        robot.way_m,
        robot.now_s,
        robot.pose.distance_to(start),
        0,
        time.process_time() - began_s,
    )


def scripted_way(house: GridMap, start: Pose2D, seed: int) -> float:
    """Length of a short tour from which all floor is seen, if the house is known [m]."""
    wanted, edge = wanted_floor(house, start), house.resolution
    passable = (distance_transform(1 - house.free_mask(), edge) >= CLEARANCE.passing_m).astype(
        np.uint8
    )
    within = (way_from(house, passable, start) != UNREACHED) & (passable != 0)
    cells = np.argwhere(within)
    rng = np.random.default_rng(seed)
    chosen = cells[rng.choice(len(cells), NUM_PLACES, replace=False)]
    places = [start, *(Pose2D(x, y, 0.0) for x, y in house.cell_to_world(chosen).tolist())]
    seen = [seen_cells(house, place) & wanted for place in places]
    left, stops = wanted & ~seen[0], [0]
    while left.any():
        gains = [int(np.count_nonzero(one & left)) for one in seen]
        best = int(np.argmax(gains))
        if gains[best] < 0.002 * np.count_nonzero(wanted):
            break
        stops.append(best)
        left &= ~seen[best]
    costs = [way_from(house, passable, places[stop]) for stop in stops]
    rows_cols = house.world_to_cell(np.array([(places[k].x, places[k].y) for k in stops]))
    ways = np.array([cost[rows_cols[:, 0], rows_cols[:, 1]] for cost in costs])
    return shortest_tour(ways.astype(np.float64) * edge / STRAIGHT)


def seen_cells(house: GridMap, place: Pose2D) -> NDArray[np.bool_]:
    """The cells that a lidar sees from a place, (rows, cols)."""
    at = house.origin.inverse() @ place
    angles = np.linspace(-math.pi, math.pi, 720, endpoint=False)
    ranges = cast_rays(house.occupied_mask(), house.resolution, (at.x, at.y), angles, REACH_M)
    away = np.arange(0.0, REACH_M, 0.5 * house.resolution)
    ray, step = np.nonzero(away[None, :] < np.minimum(ranges, REACH_M)[:, None])
    cols = np.floor((at.x + away[step] * np.cos(angles[ray])) / house.resolution).astype(int)
    rows = np.floor((at.y + away[step] * np.sin(angles[ray])) / house.resolution).astype(int)
    inside = (rows >= 0) & (rows < house.rows) & (cols >= 0) & (cols < house.cols)
    seen = np.zeros(house.cells.shape, np.bool_)
    seen[rows[inside], cols[inside]] = True
    return seen


def shortest_tour(ways: NDArray[np.float64]) -> float:
    """Length of a round trip over all places, by reversing pieces of it (Croes 1958)."""
    order = list(range(len(ways)))

    def length(tour: list[int]) -> float:
        return float(sum(ways[a, b] for a, b in zip(tour, [*tour[1:], tour[0]], strict=True)))

    best, improves = length(order), True
    while improves:
        improves = False
        for i in range(1, len(order) - 1):
            for j in range(i + 1, len(order)):
                turned = [*order[:i], *reversed(order[i : j + 1]), *order[j + 1 :]]
                if length(turned) < best - 1e-9:
                    order, best, improves = turned, length(turned), True
    return best


def row(name: str, outcome: Outcome, scripted_m: float | None) -> list[str]:
    """One line of the table."""
    return [
        name,
        outcome.state,
        f"{100.0 * outcome.share:.1f} %",
        f"{outcome.way_m:.0f} m",
        "" if scripted_m is None else f"{scripted_m:.0f} m",
        f"{outcome.seconds:.0f} s",
        f"{outcome.home_m:.2f} m",
        str(outcome.collisions),
        f"{outcome.cpu_s:.0f} s",
        outcome.message,
    ]


HEADS = ("", "ends", "found", "driven", "scripted", "time", "to home", "collisions", "CPU", "says")


OFFICE_M = (12.0, 11.0)
"""Length and width of the office [m]."""


def draw_office() -> GridMap:
    """Three offices along each side of a corridor of 2 m; its far end is the mirror's place."""
    per_m = 20
    cells = np.full([round(per_m * edge) + 4 for edge in OFFICE_M[::-1]], OCCUPIED, np.int8)
    cells[92:132, 2:-2] = FREE
    for left in (2, 82, 162):
        for low, high, door in ((2, 90, slice(90, 92)), (134, -2, slice(132, 134))):
            cells[low:high, left : left + 78] = FREE
            cells[door, left + 20 : left + 40] = FREE
            cells[low + 30 : low + 44, left + 50 : left + 66] = OCCUPIED
    return GridMap("office", 1.0 / per_m, Pose2D.identity(), cells)


def in_office(folder: Path, masked_rad: float) -> list[str]:
    """Explore the office with its mirror by all services."""
    house, start = draw_office(), Pose2D(1.5, 5.6, 0.0)
    save_map(house, folder / "office.yaml")
    world = folder / "office.toml"
    end_m, low_m, high_m = OFFICE_M[0] - 0.02, 4.62, 6.58
    world.write_text(
        f'map = "office.yaml"\nstart = {{ x = {start.x}, y = {start.y}, yaw = 0.0 }}\n'
        f'[[mirror]]\nname = "end"\npoints = [[{end_m}, {low_m}], [{end_m}, {high_m}]]\n'
        'side = "left"\n'
    )
    outcome = explore(world, folder / "office.yaml", start, 1, masked_rad)
    return row("office with mirror", outcome, None)


def house_of(named: str) -> tuple[GridMap, Pose2D, int]:
    """A house, where the robot starts in it, and its seed, from SIZE:SEED."""
    size, seed = named.split(":")
    house = draw_house(float(size), int(seed))
    start = free_poses(house, 0.35, 1, np.random.default_rng(int(seed)))[0]
    return house, start, int(seed)


def in_house(named: str, folder: Path, view_rad: float | None, masked_rad: float) -> list[str]:
    """Explore a generated house by all services."""
    house, start, seed = house_of(named)
    save_map(house, folder / "house.yaml")
    world = folder / "house.toml"
    pose = f"{{ x = {start.x}, y = {start.y}, yaw = {start.yaw} }}"
    lidar = "" if view_rad is None else f"[lidar]\nfield_of_view = {view_rad}\n"
    world.write_text(f'map = "house.yaml"\nstart = {pose}\n{lidar}')
    outcome = explore(world, folder / "house.yaml", start, seed, masked_rad)
    return row(f"house {named}", outcome, scripted_way(house, start, seed))


def main() -> None:
    """Explore and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--house", action="append", metavar="SIZE:SEED")
    parser.add_argument("--apartment", action="store_true")
    parser.add_argument("--mirror", action="store_true")
    parser.add_argument("--office", action="store_true")
    parser.add_argument("--perfect", action="store_true")
    parser.add_argument("--view", type=float, metavar="DEGREES")
    parser.add_argument("--masked", type=float, default=0.0, metavar="DEGREES")
    asked = parser.parse_args()
    masked_rad = math.radians(asked.masked)
    view_rad = None if asked.view is None else math.radians(asked.view)
    lines: list[list[str]] = []
    if asked.perfect:
        for named in PERFECT:
            house, start, seed = house_of(named)
            scripted_m = scripted_way(house, start, seed)
            lines.append(row(f"perfect {named}", perfect(house, start), scripted_m))
        table(HEADS, lines)
        return
    is_apartment = asked.apartment or asked.mirror
    for named in asked.house or ([] if is_apartment or asked.office else HOUSES):
        with tempfile.TemporaryDirectory() as folder:
            lines.append(in_house(named, Path(folder), view_rad, masked_rad))
            table(HEADS, lines[-1:])
    if is_apartment:
        with tempfile.TemporaryDirectory() as folder:
            world = write_world(Path(folder), mirror=asked.mirror, field_of_view=view_rad)
            name = "apartment with mirror" if asked.mirror else "apartment"
            outcome = explore(world, APARTMENT, START, 1, masked_rad)
            lines.append(row(name, outcome, None))
    if asked.office:
        with tempfile.TemporaryDirectory() as folder:
            lines.append(in_office(Path(folder), masked_rad))
    table(HEADS, lines)


if __name__ == "__main__":
    main()
