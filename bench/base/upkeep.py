"""How soon base notices that the lidar was turned or a tyre is worn, and that it is never wrong.

    python -m bench.base.upkeep [--change lidar] [--minutes 20] [--seed 1] [--cheap]

The robot drives from goal to goal in `worlds/real.toml`, with slip, delay, dead band, castors,
rugs and people; base, localizer and planner run in lock-step. Wheels and track are as robot.toml
says, as after `trolley setup`. After the third part of the time something changes, such as a lidar
that is turned by 3 degrees: see `CASES`. Each proposal is printed with the time since then. It is
false if it comes before, or names another cause. With `none`, and where only people and rugs are
added, each is a false one. With `--cheap` the planner steers by pure pursuit, which takes less
processor time; with `--cruise` a simple driver that knows the truth takes the planner's place,
which takes so little that a night of driving fits into an hour.
"""

import argparse
import contextlib
import math
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from bench.harness.cruise import Cruise
from bench.harness.drives import make_config
from bench.harness.houses import free_poses
from bench.harness.paths import WORLDS
from bench.planner.stops import MAP, START

from trolley import codes, requests, topics
from trolley.config import RobotConfig
from trolley.geometry import Pose2D
from trolley.gridmap import load_map
from trolley.messages import Proposal
from trolley.messages.request_params import SendGoal
from trolley.runtime.lockstep import Lockstep
from trolley_base.service import BaseService
from trolley_base.simulation.simulated_hardware import SimulatedHardware
from trolley_base.world import OtherRobot, Simulation
from trolley_localizer.service import LocalizerService
from trolley_planner.service import PlannerService

How = Literal["whole", "cheap", "cruise"]
ENDED = ("arrived", "failed", "canceled")
CHEAP = '[planner]\ncontroller = "pursuit"\n'
TRACK = "[base.odometry]\ntrack_m = 0.2\n"
FREE_M, LIMIT_S = 0.35, 120.0
REPORT_MINUTES = 5
COMPANION_M = 0.8
"""Distance that somebody who walks along keeps from the robot [m]."""
LEG = 0.1 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
"""How large that person is for the lidar [m]."""
RUG = """
[[rug]]
name = "thick rug"
x = 2.0
y = -0.5
length_m = 6.0
width_m = 4.0
slip = 0.05
pull_per_m = 0.06
"""


class Case(NamedTuple):
    """What changes, and which of `CAUSES` a true proposal names; empty: none is to come.

    Of rugs it says that they, or both wheels, may be the cause; they lie there from the beginning.
    """

    plant: Callable[[Simulation], None] = lambda _: None
    truth: tuple[str, ...] = ()
    world: str = ""
    has_companion: bool = False


def lidar_at(x: float, y: float, degrees: float) -> Callable[[Simulation], None]:
    """Move the lidar from the robot's middle, where robot.toml says that it is."""
    return lambda world: world.move_lidar(Pose2D(x, y, math.radians(degrees)))


def worn(left: float, right: float) -> Callable[[Simulation], None]:
    """Leave so much of the tyres."""
    return lambda world: world.wear_wheels(left, right)


CAUSES = ("lidar is turned", "moved by", "left wheel", "right wheel", "The track", "both", "fit")
CASES = {
    "none": Case(),
    "companion": Case(has_companion=True),
    "rug": Case(truth=("both",), world=RUG),
    "lidar": Case(lidar_at(0.0, 0.0, 3.0), ("lidar is turned",)),
    "lidar-back": Case(lidar_at(0.0, 0.0, -2.0), ("lidar is turned",)),
    "lidar-ahead": Case(lidar_at(0.02, 0.0, 0.0), ("moved by",)),
    "lidar-aside": Case(lidar_at(0.0, 0.02, 0.0), ("moved by",)),
    "tyre": Case(worn(0.97, 1.0), ("left wheel",)),
    "right-tyre": Case(worn(1.0, 0.97), ("right wheel",)),
    "both-tyres": Case(worn(0.98, 0.98), ("both",)),
    "track": Case(lambda world: world.widen_track(1.03), ("The track",)),
}


class Found(NamedTuple):
    """A proposal, and the minutes since the change; negative: before it."""

    minutes: float
    proposal: Proposal
    is_true: bool


def world_as_set(folder: Path, more: str) -> Path:
    """Write the world with wheels that are as robot.toml says; return its file."""
    text = (WORLDS / "real.toml").read_text().replace('"apartment.yaml"', f'"{MAP}"')
    for exact in ("scale_std = 0.006", "turn_scale_std = 0.02"):
        assert exact in text
        text = text.replace(exact, exact.split(" = ")[0] + " = 0.0")
    world = folder / "real.toml"
    world.write_text(text + more)
    return world


class Trial:
    """One robot that drives, and what it proposes.

    Args:
        lockstep: in which everything runs.
        case: what is to change.
        config: the robot's.
        how: what drives it.
    """

    def __init__(self, lockstep: Lockstep, case: Case, config: RobotConfig, how: How) -> None:
        self._lockstep, self._case, self._how = lockstep, case, how
        base = lockstep.add(BaseService(config))
        lockstep.add(LocalizerService(config))
        if how != "cruise":
            lockstep.add(PlannerService(config))
        hardware = base.hardware
        assert isinstance(hardware, SimulatedHardware)
        self._world = hardware.simulation
        self._poses, self._said = lockstep.record(topics.POSE), lockstep.record(topics.GOAL)
        self._proposed = lockstep.record(topics.PROPOSALS)
        self._cruise = Cruise(lockstep, load_map(MAP), self._meanwhile)
        self._person = START @ Pose2D(-COMPANION_M, 0.0, 0.0)
        self._changed_s: float | None = None
        self._last = START
        self.way_m = 0.0
        """The metres driven."""
        self.found: list[Found] = []
        """What was proposed so far."""
        lockstep.run_until(lambda: self._is_localized, 30.0)

    @property
    def _is_localized(self) -> bool:
        return bool(self._poses) and self._poses[-1].state == "localized"

    def plant(self) -> None:
        """Change the robot, and tell nobody."""
        if self._changed_s is None:
            self._changed_s = self._lockstep.now_s
            self._case.plant(self._world)

    def go_to(self, goal: Pose2D) -> None:
        """Drive to a goal, and print what is proposed on the way."""
        if self._how == "cruise":
            self._cruise.go_to(goal)
        else:
            with contextlib.suppress(codes.Refused):
                self._lockstep.ask(requests.GOAL_SEND, SendGoal(pose=goal))
                self._lockstep.run_until(self._has_ended, LIMIT_S)
        for one in self._proposed:
            since = -1.0 if self._changed_s is None else one.stamp_ns * 1e-9 - self._changed_s
            for proposal in one.proposals:
                named = tuple(cause for cause in CAUSES if cause in proposal.message)
                is_true = named == self._case.truth and (since >= 0.0 or self._case.world != "")
                self.found.append(Found(since / 60.0, proposal, is_true))
                print(f"  {proposal.message} {proposal.settings}", flush=True)
        for heard in (self._poses, self._said):
            del heard[:-1]
        self._proposed.clear()

    def _has_ended(self) -> bool:
        self._meanwhile()
        return self._said[-1].state in ENDED

    def _meanwhile(self) -> bool:
        """Measure the way, and let the companion follow it."""
        pose = self._world.truth().pose
        self.way_m += self._last.distance_to(pose)
        self._last = pose
        if self._case.has_companion:
            self._person = walk_along(self._world, self._person)
        return False


def walk_along(world: Simulation, at: Pose2D) -> Pose2D:
    """Let a person come after the robot, and step back before it; return where they stand."""
    robot = world.truth().pose
    share = COMPANION_M / max(at.distance_to(robot), 1e-6)
    stand = Pose2D(robot.x + share * (at.x - robot.x), robot.y + share * (at.y - robot.y), 0.0)
    world.set_others([OtherRobot("companion", LEG + np.array([stand.x, stand.y]))])
    return stand


def drive(case: Case, minutes: float, seed: int, how: How) -> tuple[list[Found], float]:
    """Drive; return what was proposed, and the metres driven."""
    rng = np.random.default_rng(seed)
    goals = free_poses(load_map(MAP), FREE_M, round(20 * minutes) + 50, rng)
    with tempfile.TemporaryDirectory() as folder, Lockstep("trolley", seed) as lockstep:
        world = world_as_set(Path(folder), case.world)
        rest = f'[base.simulated]\nworld = "{world}"\nseed = {seed}\n' + TRACK
        config = make_config(MAP, START, rest + (CHEAP if how == "cheap" else ""))
        trial = Trial(lockstep, case, config, how)
        begun_s, reported, way_m = lockstep.now_s, 0, 0.0
        for goal in goals:
            minutes_driven = (lockstep.now_s - begun_s) / 60.0
            if int(minutes_driven) >= reported + REPORT_MINUTES:
                if trial.way_m < way_m + 1.0:
                    raise SystemExit(f"The robot stands since minute {reported}: nothing is shown.")
                reported, way_m = int(minutes_driven), trial.way_m
                told = f"after {reported} min, {way_m:.0f} m: {len(trial.found)}"
                print(told, flush=True)
            if minutes_driven > minutes:
                break
            if minutes_driven > minutes / 3.0:
                trial.plant()
            trial.go_to(goal)
        return trial.found, trial.way_m


def main() -> None:
    """Drive, and print what is proposed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--change", choices=tuple(CASES), default="none")
    parser.add_argument("--minutes", type=float, default=20.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cheap", dest="how", action="store_const", const="cheap", default="whole")
    parser.add_argument("--cruise", dest="how", action="store_const", const="cruise")
    given = parser.parse_args()
    begun_s = time.process_time()
    found, way_m = drive(CASES[given.change], given.minutes, given.seed, given.how)
    for at, proposal, is_true in found:
        judged = "true" if is_true else "FALSE"
        print(f"{at:6.1f} min  {judged} {proposal.id}: {proposal.message} {proposal.settings}")
    first = next((f"after {one.minutes:.1f} min" for one in found if one.is_true), "never")
    num_false = sum(not one.is_true for one in found)
    length = f"in {given.minutes:g} minutes, {way_m:.0f} m"
    print(f"{given.change}: true {first}, {num_false} false, {length}")
    print(f"({time.process_time() - begun_s:.0f} s of processor time)")


if __name__ == "__main__":
    main()
