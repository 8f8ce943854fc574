"""How soon base notices that the lidar was turned or a tyre is worn, and that it is never wrong.

    python -m bench.base.upkeep [--change lidar|tyre|none] [--minutes 20] [--seed 1] [--cheap]

The robot drives from goal to goal in `worlds/real.toml`, with slip, delay, dead band, castors,
rugs and people; base, localizer and planner run in lock-step. Wheels and track are as robot.toml
says, as after `trolley setup`. After the third part of the time the lidar is turned by 3 degrees,
or the left tyre loses 3 %. Each proposal is printed with the time since then. With `none` each is
a false one. With `--cheap` the robot steers by pure pursuit, which takes less processor time.
"""

import argparse
import math
import tempfile
import time
from pathlib import Path
from typing import Literal

import numpy as np
from bench.harness.drives import make_config
from bench.harness.houses import free_poses
from bench.harness.paths import WORLDS
from bench.planner.stops import MAP, START

from trolley import codes, requests, topics
from trolley.geometry import Pose2D
from trolley.gridmap import load_map
from trolley.messages import Proposal
from trolley.messages.request_params import SendGoal
from trolley.runtime.lockstep import Lockstep
from trolley_base.service import BaseService
from trolley_base.simulation.simulated_hardware import SimulatedHardware
from trolley_localizer.service import LocalizerService
from trolley_planner.service import PlannerService

Change = Literal["lidar", "tyre", "none"]
ENDED = ("arrived", "failed", "canceled")
CHEAP = '[planner]\ncontroller = "pursuit"\n'
FREE_M, LIMIT_S = 0.35, 120.0


def world_as_set(folder: Path) -> Path:
    """Write the world with wheels that are as robot.toml says; return its file."""
    text = (WORLDS / "real.toml").read_text().replace('"apartment.yaml"', f'"{MAP}"')
    for exact in ("scale_std = 0.006", "turn_scale_std = 0.02"):
        assert exact in text
        text = text.replace(exact, exact.split(" = ")[0] + " = 0.0")
    world = folder / "real.toml"
    world.write_text(text)
    return world


def drive(
    change: Change, minutes: float, seed: int, *, is_cheap: bool
) -> tuple[list[tuple[float, Proposal]], float]:
    """Drive; return proposals with the minutes since the change, and the metres driven."""
    rng = np.random.default_rng(seed)
    goals = iter(free_poses(load_map(MAP), FREE_M, round(20 * minutes) + 50, rng))
    found: list[tuple[float, Proposal]] = []
    with tempfile.TemporaryDirectory() as folder, Lockstep("trolley", seed) as lockstep:
        world = world_as_set(Path(folder))
        rest = f'[base.simulated]\nworld = "{world}"\nseed = {seed}\n'
        config = make_config(MAP, START, rest + (CHEAP if is_cheap else ""))
        base = BaseService(config)
        for service in (base, LocalizerService(config), PlannerService(config)):
            lockstep.add(service)
        poses, said = lockstep.record(topics.POSE), lockstep.record(topics.GOAL)
        truths, proposed = lockstep.record(topics.SIM_TRUTH), lockstep.record(topics.PROPOSALS)
        lockstep.run_until(lambda: bool(poses) and poses[-1].state == "localized", 30.0)
        begun_s, changed_s = lockstep.now_s, 0.0
        way_m, num_seen, last = 0.0, len(proposed), truths[-1].pose
        num_minutes = 0
        while lockstep.now_s - begun_s < 60.0 * minutes:
            if changed_s == 0.0 and lockstep.now_s - begun_s > 20.0 * minutes:
                changed_s = lockstep.now_s
                plant(change, base)
            try:
                lockstep.ask(requests.GOAL_SEND, SendGoal(pose=next(goals)))
            except codes.Refused:
                continue
            lockstep.run_until(lambda: said[-1].state in ENDED, LIMIT_S)
            for truth in truths:
                way_m += last.distance_to(truth.pose)
                last = truth.pose
            for one in proposed[num_seen:]:
                at = (one.stamp_ns * 1e-9 - changed_s) / 60.0 if changed_s else -1.0
                for proposal in one.proposals:
                    found.append((at, proposal))
                    print(f"  {proposal.message} {proposal.settings}", flush=True)
            num_seen = len(proposed)
            minutes_driven = (lockstep.now_s - begun_s) / 60.0
            if int(minutes_driven) > num_minutes:
                num_minutes = int(minutes_driven)
                print(f"after {num_minutes} min, {way_m:.0f} m: {len(found)}", flush=True)
            for heard in (truths, poses, said):
                del heard[:-1]
    return found, way_m


def plant(change: Change, base: BaseService) -> None:
    """Change the robot, and tell nobody."""
    hardware = base.hardware
    assert isinstance(hardware, SimulatedHardware)
    if change == "lidar":
        hardware.simulation.move_lidar(Pose2D(0.0, 0.0, math.radians(3.0)))
    elif change == "tyre":
        hardware.simulation.wear_wheels(0.97, 1.0)


def main() -> None:
    """Drive, and print what is proposed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--change", choices=("lidar", "tyre", "none"), default="none")
    parser.add_argument("--minutes", type=float, default=20.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cheap", action="store_true")
    given = parser.parse_args()
    begun_s = time.process_time()
    found, way_m = drive(given.change, given.minutes, given.seed, is_cheap=given.cheap)
    for at, proposal in found:
        print(f"{at:6.1f} min  {proposal.id}: {proposal.message} {proposal.settings}")
    print(f"{given.change}: {len(found)} proposals in {given.minutes:g} minutes, {way_m:.0f} m")
    print(f"({time.process_time() - begun_s:.0f} s of processor time)")


if __name__ == "__main__":
    main()
