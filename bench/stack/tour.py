"""The demo's tour in lock-step, many seeds: arrivals, times, collisions, closest approach.

    python -m bench.stack.tour [--seeds 40] [--without-mirror-zone]
    python -m bench.stack.tour --world worlds/real.toml [--random]

With `--random` each seed drives to four places of its own, in any room.
"""

import argparse
import math
import time
import tomllib
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
from bench.harness.drives import CORRIDOR, ENTRANCE, KITCHEN, Drive, drive_tour, simulated
from bench.harness.houses import free_poses
from bench.harness.paths import WORLDS

from trolley.geometry import Pose2D
from trolley.gridmap import load_map

START = Pose2D(0.549, 0.218, 0.2579)
MIRROR = "hall mirror"
MAP = WORLDS / "apartment.yaml"
FREE_M, NEAR_M, STOPS = 0.35, 0.6, 4
"""Random places are this far from what is on the map, and this far from what is not [m]."""


def random_stops(world: Path, seed: int) -> dict[str, Pose2D]:
    """Places in any room, none near a thing that the map does not show, or where somebody stops.

    Who stands on a goal and waits for the robot to go away lets it wait as long.
    """
    contents = tomllib.loads(world.read_text())
    things = [(one["x"], one["y"]) for kind in ("box", "circle") for one in contents[kind]]
    things += [tuple(point) for one in contents.get("person", []) for point in one["path"]]
    poses = free_poses(load_map(MAP), FREE_M, 10 * STOPS, np.random.default_rng(seed))
    free = [
        pose
        for pose in poses
        if all(math.dist((pose.x, pose.y), thing) > NEAR_M for thing in things)
    ]
    return {f"{pose.x:.1f}, {pose.y:.1f}": pose for pose in free[:STOPS]}


def drive(seed: int, world: Path, is_random: bool, without_mirror_zone: bool) -> Drive:
    """One tour of the apartment."""
    config = simulated(world, MAP, START, seed)
    stops = {"corridor": CORRIDOR, "entrance": ENTRANCE, "kitchen": KITCHEN}
    if is_random:
        stops = random_stops(world, seed)
    return drive_tour(config, seed, stops, without_zones=(MIRROR,) if without_mirror_zone else ())


def main() -> None:
    """Drive all seeds and print a line each and a summary."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--without-mirror-zone", action="store_true")
    parser.add_argument("--world", type=Path, default=WORLDS / "apartment.toml")
    parser.add_argument("--random", action="store_true")
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    started_s = time.monotonic()
    drives: list[Drive] = []
    seeds = range(options.first, options.first + options.seeds)
    with ProcessPoolExecutor(options.jobs) as pool:
        task = partial(
            drive,
            world=options.world.resolve(),
            is_random=options.random,
            without_mirror_zone=options.without_mirror_zone,
        )
        for one in pool.map(task, seeds):
            drives.append(one)
            print(
                f"seed {one.seed:3d}  {one.state:8s} {one.seconds:6.1f} s"
                f"  collisions {one.collisions}  closest {one.closest:.3f} m"
                f"  pose error median {np.median(one.position_errors):.3f} m,"
                f" largest {one.position_errors.max():.3f} m  {one.why}",
                flush=True,
            )
    arrived = [one for one in drives if one.arrived]
    print(
        f"{len(arrived)} of {len(drives)} arrived,"
        f" {sum(one.collisions for one in drives)} collisions,"
        f" {sum(one.state == 'hung' for one in drives)} hung;"
        f" median {np.median([one.seconds for one in arrived] or [np.nan]):.1f} s,"
        f" closest approach {min(one.closest for one in drives):.3f} m;"
        f" took {time.monotonic() - started_s:.0f} s"
    )


if __name__ == "__main__":
    main()
