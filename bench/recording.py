"""Recorded drives through `base` and `localizer` in lock-step: error against the reference.

    TROLLEY_DATA=/path/to/recordings python bench/recording.py [--seeds 3]

Reads `<name>.npz` and its map from the folder named by TROLLEY_DATA. Peers on freiburg-079: ROS 1
AMCL 0.08 / 0.19 m (median / 95 %) and 1.5 % lost, Nav2's AMCL defaults 0.23 / 1.8 m and 23 %.
"""

import argparse
import math
import os
import sys
from pathlib import Path

import numpy as np
from drives import replay_errors

from trolley.geometry import Pose2D

RECORDINGS = {
    "freiburg-079": "freiburg-079.yaml",
    "create3-rplidar-mac": "mac_1st_floor_final.yaml",
}
OFFSET = Pose2D(0.3, 0.0, math.radians(10.0))


def main() -> None:
    """Replay each recording with each seed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    options = parser.parse_args()
    folder = os.environ.get("TROLLEY_DATA")
    if folder is None:
        sys.exit("TROLLEY_DATA does not name the folder of the recordings: nothing to measure")
    for name, map_name in RECORDINGS.items():
        for seed in range(options.seeds):
            recording = Path(folder) / f"{name}.npz"
            errors = replay_errors(recording, Path(folder) / map_name, OFFSET, seed)
            known = errors[np.isfinite(errors[:, 0])]
            lost = (known[:, 0] > 0.5) | (known[:, 1] > math.radians(20.0))
            print(
                f"{name} seed {seed}: a pose for {len(known)} of {len(errors)} scans,"
                f" median {np.median(known[:, 0]):.3f} m,"
                f" 95 % {np.quantile(known[:, 0], 0.95):.3f} m,"
                f" lost {100 * lost.mean():.2f} %, at the end {known[-1, 0]:.2f} m",
                flush=True,
            )


if __name__ == "__main__":
    main()
