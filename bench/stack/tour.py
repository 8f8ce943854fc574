"""The demo's tour in lock-step, many seeds: arrivals, times, collisions, closest approach.

python -m bench.stack.tour [--seeds 40] [--without-mirror-zone] [--world worlds/apartment.toml]
"""

import argparse
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import numpy as np
from bench.harness.drives import CORRIDOR, ENTRANCE, KITCHEN, Drive, drive_tour, simulated
from bench.harness.paths import WORLDS

from trolley.geometry import Pose2D

START = Pose2D(0.549, 0.218, 0.2579)
MIRROR = "hall mirror"


def drive(seed: int, without_mirror_zone: bool) -> Drive:
    """One tour of the apartment."""
    config = simulated(WORLDS / "apartment.toml", WORLDS / "apartment.yaml", START, seed)
    stops = {"corridor": CORRIDOR, "entrance": ENTRANCE, "kitchen": KITCHEN}
    return drive_tour(config, seed, stops, without_zones=(MIRROR,) if without_mirror_zone else ())


def main() -> None:
    """Drive all seeds and print a line each and a summary."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--without-mirror-zone", action="store_true")
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    started_s = time.monotonic()
    drives: list[Drive] = []
    seeds = range(options.first, options.first + options.seeds)
    with ProcessPoolExecutor(options.jobs) as pool:
        task = partial(drive, without_mirror_zone=options.without_mirror_zone)
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
