"""How often a large building is mapped right: no two of its kind, and none that was tuned on.

    python -m bench.mapper.random_buildings FILE [--seeds 1 100] [--hard] [--pictures FOLDER]

Each seed draws a plan (blocks of rooms or of shelves, glass, furniture, people, wings or rooms
alike) and a drive (direction, length, scans per metre, field and reach of the lidar, errors of the
wheels, turns missed) within the ranges of `draw_case`, and judges the map as `sparse_drives` does.
Results are appended to FILE, a line of JSON for each seed; seeds that are in it already are not
driven again. Two programs must not write to one file.
"""

import argparse
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from bench.harness.figures import at_least, at_most, show, table
from bench.mapper.buildings import Drive, Plan, draw_building, record
from bench.mapper.sparse_drives import HEADS, Result, draw, follow, row

from trolley.geometry import Pose2D
from trolley_mapper.warmup import warm_up

MAX_METRES = 600.0
"""Drives end about there: longer ones take minutes of CPU each [m]."""


def draw_case(seed: int) -> tuple[Plan, Drive]:
    """Draw a building and a drive; the same seed gives the same ones."""
    rng = np.random.default_rng([seed, 7])
    blocks = (int(rng.integers(1, 5)), int(rng.integers(1, 4)))
    block_m = (float(rng.uniform(10.0, 24.0)), float(rng.uniform(7.0, 14.0)))
    narrow_m = float(rng.uniform(2.6, 4.0))
    kind = rng.choice(["rooms", "alike", "identical", "shelves"], p=[0.5, 0.2, 0.15, 0.15])
    if kind == "shelves":
        block_m = (block_m[0], float(rng.uniform(0.8, 3.0)))
    plan = Plan(
        blocks,
        block_m,
        (narrow_m, narrow_m + float(rng.uniform(0.2, 4.0))),
        is_alike=kind == "alike",
        is_identical=kind == "identical",
        is_solid=kind == "shelves",
        glass_share=float(rng.choice([0.0, 0.1, 0.3, 0.6])),
        clutter_per_m2=float(rng.uniform(0.03, 0.22)),
        people=int(rng.integers(0, 7)),
    )
    around_m = 2.0 * (block_m[0] + block_m[1] + 8.0) * blocks[0] * blocks[1]
    drive = Drive(
        way_m=min(max(1.2 * around_m, 150.0), MAX_METRES),
        room_share=float(rng.uniform(0.0, 0.6)),
        step_m=float(rng.choice([0.3, 0.5, 0.7, 1.0])),
        step_rad=float(rng.uniform(0.3, 0.8)),
        field_rad=math.radians(float(rng.choice([180.0, 180.0, 270.0, 360.0]))),
        beams=int(rng.choice([180, 360])),
        reach_m=float(rng.choice([5.0, 8.0, 8.0, 12.0, 25.0])),
        distance_error=float(rng.uniform(0.0, 0.06)),
        turn_error=float(rng.uniform(0.0, 0.06)),
        noise=float(rng.uniform(0.005, 0.03)),
        missed_turns=int(rng.choice([0, 0, 0, 1])),
        stands=int(rng.integers(0, 8)),
    )
    return plan, drive


def is_hard(drive: Drive) -> bool:
    """Say whether the robot sees little: seldom, not behind itself, and not far."""
    return drive.step_m >= 0.7 and drive.field_rad < 3.2 and drive.reach_m <= 8.0


def through(seed: int) -> Result:
    """Draw a building and map a drive through it."""
    plan, drive = draw_case(seed)
    recording = record(draw_building(plan, seed), drive, seed)
    # The map lies askew to the walls, as most do.
    turned = Pose2D(0.0, 0.0, float(np.random.default_rng([seed, 8]).uniform(-math.pi, math.pi)))
    return follow(f"random {seed}", recording, start=turned)


def line(seed: int, one: Result) -> dict[str, Any]:
    """What is kept of a drive."""
    revisits = one.revisits
    return {
        "seed": seed,
        "wrong": revisits.wrong_share,
        "unsaid": one.unsaid_share,
        "doubtful": one.num_doubtful,
        "worst_m": float(revisits.error_m.max()) if len(revisits.scans) else 0.0,
        "row": row(one),
    }


def summary(lines: Sequence[dict[str, Any]]) -> None:
    """Print the table and the figures that have targets."""
    table(HEADS, [one["row"] for one in lines])
    right = 100.0 * sum(one["wrong"] == 0.0 for one in lines) / len(lines)
    unsaid = 100.0 * sum(one["unsaid"] > 0.0 for one in lines) / len(lines)
    show(
        [
            at_least(f"{len(lines)} buildings, no revisit wrong", right, 95.0, "%", 0),
            at_most("buildings with one wrong and unsaid", unsaid, 0.0, "%", 0),
            at_most(
                "right maps that are doubted",
                sum(one["doubtful"] > 0 and one["wrong"] == 0.0 for one in lines),
                0.0,
                "",
                0,
            ),
        ]
    )


def main() -> None:
    """Map the buildings one after the other and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path, help="results, appended to")
    parser.add_argument("--seeds", nargs=2, type=int, default=(1, 100), help="first and last")
    parser.add_argument(
        "--hard",
        action="store_true",
        help="only seeds with a scan each 0.7 m or more, half a view and 8 m of reach at most",
    )
    parser.add_argument("--pictures", type=Path, help="folder for pictures of wrong maps")
    options = parser.parse_args()
    lines: list[dict[str, Any]] = []
    if options.file.exists():
        lines = [json.loads(text) for text in options.file.read_text().splitlines()]
    done = {one["seed"] for one in lines}
    warm_up()
    for seed in range(options.seeds[0], options.seeds[1] + 1):
        if seed in done or (options.hard and not is_hard(draw_case(seed)[1])):
            continue
        one = through(seed)
        lines.append(line(seed, one))
        with options.file.open("a") as file:
            file.write(json.dumps(lines[-1]) + "\n")
        print("  ".join(row(one)), flush=True)
        if options.pictures and one.revisits.is_wrong.any():
            draw(one, options.pictures / f"random-{seed}.png")
    print()
    summary(sorted(lines, key=lambda one: one["seed"]))


if __name__ == "__main__":
    main()
