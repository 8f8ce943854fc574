"""Breaks everything of a robot that can break, one thing after the other, and prints a table.

    python bench/faults.py [--only killed frozen router] [--write]

The robot is the whole stack as real processes on an emulated board and lidar, and drives a tour
without an end. For each fault: what happened, how long until the robot stood, how long until it
drove again, and what was lost of what is saved, which must be nothing. Exits with 1 when something
is not as it must be; `--write` puts the table into docs/faults.md.
"""

import argparse
import sys
import tempfile
from pathlib import Path

from fault_cases import GROUPS, Fault, Outcome, disturb
from fault_rig import Rig
from figures import table

HEADS = ("fault", "what happens", "stands after", "drives again after", "lost", "verdict")


def run_group(faults: list[Fault]) -> list[Outcome]:
    """Break one thing after the other of one robot."""
    outcomes: list[Outcome] = []
    with tempfile.TemporaryDirectory() as folder, Rig(Path(folder)) as rig:
        rig.prepare()
        for fault in faults:
            outcomes.append(disturb(rig, fault))
            print(" | ".join(outcomes[-1].cells), flush=True)
    return outcomes


def main() -> int:
    """Break what is asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--only", nargs="+", choices=[*GROUPS], default=[*GROUPS])
    options = parser.parse_args()
    outcomes: list[Outcome] = []
    for name in options.only:
        outcomes += run_group(GROUPS[name]())
    table(HEADS, [one.cells for one in outcomes])
    return 1 if any(one.lost or one.wrong for one in outcomes) else 0


if __name__ == "__main__":
    sys.exit(main())
