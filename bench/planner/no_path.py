"""Does the planner ever say `no_path` where there is a way? Beside an exhaustive search over poses.

    python -m bench.planner.no_path [--homes 10] [--goals 6] [--corridors 40] [--each]

Random homes of 7 x 7 m, rooms with doors 0.5 to 0.9 m wide and furniture, and corridors with an L,
a Z or a door in their side, with the footprints of five robots (corridors: of two), on a map of
5 cm cells. Goals are random poses that the exhaustive search (`all_poses.py`) reaches with the
footprint 3 cm from everything; the planner is asked for its way to each from where the robot
stands, and must not refuse. How many refusals there are, of which kind, and where the first was.
"""

import argparse
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from bench.harness.figures import at_most, show, table
from bench.planner.all_poses import Box, Reach
from bench.planner.mazes import draw_maze, furnish
from bench.planner.situations import (
    ARM,
    HOBBY,
    PLANNED_M,
    REAR,
    SPEEDS,
    SQUARE,
    Body,
    Scene,
    bend,
    between,
    on_cells,
    room,
)
from bench.planner.visit import TruePose, config_of

from trolley import codes, requests
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.messages.request_params import SendGoal
from trolley.runtime.lockstep import Lockstep
from trolley_base.service import BaseService
from trolley_planner.service import PlannerService

HOME_M, ROOM_M, FURNITURE_PER_M2 = 7.0, 2.4, 0.06
DOORS_M = (0.5, 0.6, 0.7, 0.8, 0.9)
_ANGLES = np.arange(12) * (2.0 * np.pi / 12)
ROUND = Body(tuple((0.2 * float(np.cos(a)), 0.2 * float(np.sin(a))) for a in _ANGLES))
BODIES = {"0.35 x 0.30": HOBBY, "0.60 x 0.60": SQUARE, "rear axle": REAR, "round 0.40": ROUND,
          "arm": ARM}  # fmt: skip
CORRIDOR_GOALS = 5


@dataclass(frozen=True)
class Asked:
    """One goal: what the planner said, "" if it knows a way."""

    where: str
    body: str
    seed: int
    goal: Pose2D
    said: str


def boxes_of(grid: GridMap) -> tuple[Box, ...]:
    """The occupied cells of a map as few boxes [m]: runs of cells, as high as they stay so."""
    solid = grid.occupied_mask().astype(bool)
    edge, found = grid.resolution, []
    left = solid.copy()
    for row, col in np.argwhere(solid).tolist():
        if not left[row, col]:
            continue
        end = col
        while end < solid.shape[1] and left[row, end]:
            end += 1
        top = row
        while top < solid.shape[0] and left[top, col:end].all():
            left[top, col:end] = False
            top += 1
        low = (grid.origin.x + col * edge, grid.origin.y + row * edge)
        found.append(between(low, (grid.origin.x + end * edge, grid.origin.y + top * edge)))
    return tuple(found)


def home(seed: int) -> Scene:
    """A home of rooms and furniture; where the robot begins is for who has its reach."""
    rng = np.random.default_rng((80, seed))
    grid = draw_maze(HOME_M, ROOM_M, seed, float(rng.choice(DOORS_M)), open_share=0.2)
    return Scene("home", boxes_of(furnish(grid, FURNITURE_PER_M2, seed)), Pose2D(1.2, 1.2, 0.0), ())


def side_door(seed: int) -> Scene:
    """A corridor of 0.75 to 0.95 m with a door of 0.65 to 0.75 m in its side, to a small room."""
    rng = np.random.default_rng((81, seed))
    wide = float(rng.choice([0.75, 0.80, 0.85, 0.90, 0.95]))
    opening = float(rng.choice([0.65, 0.70, 0.75]))
    at = on_cells(float(rng.uniform(1.8, 2.6)))
    boxes = (
        *room((0.0, 0.0), (4.5, wide + 0.1 + 1.4)),
        between((0.0, wide), (at, wide + 0.1)),
        between((at + opening, wide), (4.5, wide + 0.1)),
    )
    return Scene("side door", boxes, Pose2D(0.7, 0.5 * wide, 0.0), ())


def situations(given: argparse.Namespace) -> Iterator[tuple[str, int, Scene, int]]:
    """Kind, seed, scene and how many goals."""
    for seed in range(given.homes):
        for body in BODIES.values():
            yield "home", seed, replace(home(seed), body=body), given.goals
    for seed in range(given.corridors):
        kind = ("L", "Z", "side door")[seed % 3]
        scene = side_door(seed) if kind == "side door" else bend(seed, is_z=kind == "Z")
        yield kind, seed, replace(scene, body=HOBBY if seed % 2 else REAR), CORRIDOR_GOALS


def ask(kind: str, seed: int, scene: Scene, count: int) -> list[Asked]:
    """Ask the planner for the way to each of some goals that the exhaustive search reaches."""
    rng = np.random.default_rng((82, seed))
    reach = Reach(scene.body.array, scene.boxes, PLANNED_M)
    goals = reach.random_poses(scene.start, count, SPEEDS, rng)
    name = next(name for name, body in BODIES.items() if body == scene.body)
    found: list[Asked] = []
    with tempfile.TemporaryDirectory() as folder, Lockstep("trolley", seed) as lockstep:
        config = config_of(scene, seed, "360", Path(folder))
        lockstep.add(BaseService(config))
        lockstep.add(TruePose(scene.map()))
        lockstep.add(PlannerService(config))
        lockstep.run(1.0)
        for goal, _ in goals:
            try:
                lockstep.ask(requests.GOAL_PREVIEW, SendGoal(pose=goal))
                said = ""
            except codes.Refused as refused:
                said = refused.code
            found.append(Asked(kind, name, seed, goal, said))
    return found


def main() -> None:
    """Ask, and print the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--homes", type=int, default=10)
    parser.add_argument("--goals", type=int, default=6, help="in each home, for each robot")
    parser.add_argument("--corridors", type=int, default=40)
    parser.add_argument("--each", action="store_true", help="a line for each refusal")
    given = parser.parse_args()
    asked: list[Asked] = []
    for kind, seed, scene, count in situations(given):
        found = ask(kind, seed, scene, count)
        asked += found
        for one in found if given.each else ():
            if one.said:
                print(f"{one.where} {one.seed}, {one.body}: {one.said} for {one.goal}", flush=True)
    rows: list[list[str]] = []
    for key in dict.fromkeys((one.where, one.body) for one in asked):
        mine = [one for one in asked if (one.where, one.body) == key]
        refused = Counter(one.said for one in mine if one.said)
        why = ", ".join(f"{count} {code}" for code, count in sorted(refused.items()))
        rows.append([f"{key[0]}, {key[1]}", str(len(mine)), str(sum(refused.values())), why])
    table(["", "goals", "refused", "of them"], rows)
    for what, is_home in (("homes", True), ("corridors", False)):
        mine = [one for one in asked if (one.where == "home") is is_home]
        wrong = sum(one.said != "" for one in mine)
        show([at_most(f"{what}: refused of {len(mine)}", float(wrong), 0.0, digits=0)])


if __name__ == "__main__":
    main()
