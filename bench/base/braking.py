"""Does the stop field hold on real brakes? Random robots, driven into things.

    python -m bench.base.braking [--runs 1500] [--first 0] [--jobs 1] [--each]

Each seed draws a robot of any shape, its limits (up to 2 m/s), brakes whose speed and turn rate
fall at rates of their own, a delay of 0.1 to 0.3 s, slip, a floor that slopes by up to 5 %, a lidar
of 5 to 15 Hz, a room, and somebody who drives at random and often straight at things. Prints the
contacts per 10,000 runs with the speed towards what was touched, and how much was driven: a robot
that is held all the time touches nothing, either. The plant is in `bench/harness/brakes.py`.
"""

import argparse
import time
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from bench.harness.brakes import Outcome, drive_case
from bench.harness.figures import Figure, at_most, show


def main() -> None:
    """Drive, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=1500)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--each", action="store_true", help="a line for each contact")
    given = parser.parse_args()
    began_s = time.monotonic()
    outcomes: list[Outcome] = []
    with ProcessPoolExecutor(given.jobs) as pool:
        seeds = range(given.first, given.first + given.runs)
        for one in pool.map(drive_case, seeds, chunksize=25):
            outcomes.append(one)
            if one.closing is not None and given.each:
                print(one, flush=True)
    closings = [one.closing for one in outcomes if one.closing is not None]
    show(
        [
            at_most("contacts per 10,000 runs", 1e4 * len(closings) / len(outcomes), 0.0, digits=1),
            Figure("contacts", f"{len(closings)} of {len(outcomes)}"),
            Figure("median speed towards it", f"{np.median(closings or [0.0]):.3f} m/s"),
            Figure("highest speed towards it", f"{max(closings, default=0.0):.3f} m/s"),
            Figure("driven per run", f"{np.mean([one.driven_m for one in outcomes]):.2f} m"),
            Figure("turned per run", f"{np.mean([one.turned_rad for one in outcomes]):.2f} rad"),
            Figure("took", f"{time.monotonic() - began_s:.0f} s"),
        ]
    )


if __name__ == "__main__":
    main()
