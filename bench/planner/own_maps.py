"""The whole way of a new robot: it explores a home with tight doors, saves the map, and drives.

    python -m bench.planner.own_maps [--row doors] [--seeds 3] [--first-seed 0] [--lidar 360]
        [--stop-field]

The homes of `bench.planner.home`, but the map is the one that the robot's own mapper makes while it
explores; base, mapper, localizer and planner run in lock-step. Printed are what exploring says and
how long it takes, whether all goals of the row are reached on that map, in how many times their
ideal time, and what was touched on the way. Exploring is always driven with base's stop field, the
goals without it, unless `--stop-field` is given.
"""

import argparse
import tempfile
from pathlib import Path
from typing import NamedTuple

from bench.harness.figures import table
from bench.planner.crossing import take_stop_field_away
from bench.planner.home import STATIC, scene_of
from bench.planner.situations import Scene
from bench.planner.visit import LIDARS, config_of, drive_to, world_of

from trolley import requests, topics
from trolley.codes import Refused
from trolley.config import load_config
from trolley.messages.request_params import MapNamed, SaveMap
from trolley.runtime.lockstep import Lockstep
from trolley_base.service import BaseService
from trolley_localizer.service import LocalizerService
from trolley_mapper.service import MapperService
from trolley_planner.service import PlannerService

EXPLORE_S = 1200.0
SETTLE_S, SAVED_S = 2.0, 5.0
HEADS = ("", "seed", "explored in", "goals", "time/ideal", "contacts", "says")


class Outcome(NamedTuple):
    """What came of one home."""

    explored_s: float
    """Time that exploring took [s]."""
    says: str
    """What exploring says in the end."""
    ending: str
    """`arrived`, or why a goal was not reached."""
    seconds: float
    """Time that the goals took [s]."""
    contacts: int
    """Contacts with walls, exploring and driving."""


def live_in(scene: Scene, seed: int, lidar: str, *, has_stop_field: bool) -> Outcome:
    """Explore a scene, save the map, and drive to all its goals."""
    with tempfile.TemporaryDirectory() as folder, Lockstep("trolley", seed) as lockstep:
        config_of(scene, seed, lidar, Path(folder))
        robot_toml = Path(folder) / "robot.toml"
        robot_toml.write_text(robot_toml.read_text().partition("[map]")[0])
        config = load_config(robot_toml)
        truths, poses = lockstep.record(topics.SIM_TRUTH), lockstep.record(topics.POSE)
        mapping, goals = lockstep.record(topics.MAPPING), lockstep.record(topics.GOAL)
        base = lockstep.add(BaseService(config))
        for service in (LocalizerService, PlannerService, MapperService):
            lockstep.add(service(config))
        lockstep.run(SETTLE_S)
        lockstep.ask(requests.MAP_NEW, MapNamed(name="own", explore=True))
        lockstep.run_until(lambda: mapping[-1].exploring in ("done", "paused"), EXPLORE_S)
        explored_s, says = lockstep.now_s - SETTLE_S, mapping[-1].message
        lockstep.run(SETTLE_S)
        try:
            lockstep.ask(requests.MAP_SAVE, SaveMap())
        except Refused as refused:
            return Outcome(explored_s, says, f"not saved: {refused}", 0.0, truths[-1].collisions)
        lockstep.run(SAVED_S)
        if not has_stop_field:
            take_stop_field_away(base, config)
        pose = poses[-1].pose
        if pose is None:
            return Outcome(explored_s, says, "lost", 0.0, truths[-1].collisions)
        map_T_true = pose @ truths[-1].pose.inverse()
        began_s, ending = lockstep.now_s, "arrived"
        for goal in scene.goals:
            ending = drive_to(map_T_true @ goal, scene, lockstep, goals)
            if ending != "arrived":
                break
        contacts = sum(one.is_collision for one in world_of(base).contacts)
        return Outcome(explored_s, says, ending, lockstep.now_s - began_s, contacts)


def main() -> None:
    """Live in homes, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    groups = list(dict.fromkeys(row.group for row in STATIC))
    parser.add_argument("--row", nargs="*", choices=groups, default=groups)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--lidar", choices=sorted(LIDARS), default="360")
    parser.add_argument("--stop-field", action="store_true")
    given = parser.parse_args()
    lines: list[list[str]] = []
    num_arrived = 0
    for row in STATIC:
        if row.group not in given.row:
            continue
        for seed in range(given.first_seed, given.first_seed + given.seeds):
            scene = scene_of(row, seed, is_off_grid=False)
            outcome = live_in(scene, seed, given.lidar, has_stop_field=given.stop_field)
            has_arrived = outcome.ending == "arrived"
            num_arrived += has_arrived
            ratio = f"{outcome.seconds / scene.ideal_s():.2f}" if has_arrived else ""
            cells = [f"{outcome.explored_s:.0f} s", outcome.ending, ratio, str(outcome.contacts)]
            lines.append([row.name, str(seed), *cells, outcome.says])
    table(HEADS, lines)
    print(f"lidar {given.lidar}: all goals reached in {num_arrived} of {len(lines)} homes")


if __name__ == "__main__":
    main()
