"""Several robots in one house, in lock-step: goals, waits, collisions, judged by the truth.

    python -m bench.fleet.robots [--robots 10] [--minutes 30] [--seed 1] [--alone] [--hearing]

Each robot drives to one random place after the other; no place is given to two robots at once. All
services but the viewer are the real ones. `--alone` hides the robots from each other's planners,
which then know only what their lidars see; `--profile` prints where the time goes. `--hearing`
prints instead what hearing nine others costs a planner.
"""

import argparse
import cProfile
import dataclasses
import math
import pstats
import random
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence

import msgspec
import numpy as np
from bench.harness.drives import make_config
from bench.harness.figures import at_least, at_most, show
from bench.harness.paths import WORLDS

from trolley import codes, requests, topics
from trolley.config import RobotConfig
from trolley.geometry import Pose2D
from trolley.messages import GoalStatus, Path, PoseEstimate, Truth
from trolley.messages.request_params import SendGoal
from trolley.messages.types import floats_to_bytes
from trolley.runtime import codec
from trolley.runtime.bus import Sample
from trolley.runtime.lockstep import Lockstep
from trolley.runtime.service import Service, every
from trolley_base.service import BaseService
from trolley_localizer.service import LocalizerService
from trolley_planner.service import PlannerService
from trolley_tour.service import TourService

PLACES = {
    "kitchen table": (1.5, 1.0), "kitchen window": (1.5, 2.6), "kitchen corner": (3.2, 0.7),
    "dining table": (4.8, 1.5), "sideboard": (6.6, 1.0), "dining window": (6.6, 3.2),
    "office desk": (8.7, 0.8), "office shelf": (9.8, 2.6), "office plant": (8.1, 2.9),
    "bed": (11.4, 1.5), "wardrobe": (13.3, 3.4), "bedroom lamp": (13.3, 0.5),
    "sofa": (1.5, 6.2), "bookshelf": (4.6, 8.6), "television": (1.5, 8.7), "piano": (4.7, 6.3),
    "washbasin": (6.1, 8.6), "study desk": (9.2, 7.8), "globe": (8.0, 8.8), "armchair": (9.8, 6.0),
    "guest bed": (12.8, 8.6), "guest window": (13.4, 6.3), "guest chair": (11.1, 6.4),
    "west end": (0.5, 4.75), "east end": (13.5, 4.75),
}  # fmt: skip
ENDED = ("arrived", "failed", "canceled")
CHEAP = "[planner]\nrollouts = 96\ncontrol_rate_hz = 10.0\n"
"""Fewer rollouts and commands than usual, so that ten robots need no more than one core."""
STUCK_S = 180.0
"""Only a deadlock keeps a robot with a goal standing for this long."""


class Crowd(Service):
    """As many robots as are wanted that say what robots say, as often, and drive up and down."""

    name = "base"

    def __init__(self, count: int) -> None:
        self._count = count
        way = np.linspace((6.0, 4.9, 0.0), (12.0, 4.9, 0.0), 121)
        self._path = Path(stamp_ns=0, frame="map", poses=floats_to_bytes(way))

    @every(0.1, clock="local")
    def tell(self) -> None:
        """Publish pose and trajectory of each, less often the goal, and seldom the path."""
        tenth = self.monotonic_ns // 100_000_000
        for index in range(self._count):
            name, x = f"crowd{index}", 6.0 + 0.05 * ((tenth + 9 * index) % 120)
            poses = np.linspace((x, 4.9, 0.0), (x + 1.2, 4.9, 0.0), 25)
            estimate = PoseEstimate(
                stamp_ns=self.monotonic_ns, map="house", pose=Pose2D(x, 4.9, 0.0),
                covariance=[0.0] * 9, state="localized", match=1.0, spread=0.0,
            )  # fmt: skip
            self.publish(topics.POSE, estimate, robot=name)
            ahead = Path(stamp_ns=0, frame="map", poses=floats_to_bytes(poses), dt=0.1)
            self.publish(topics.TRAJECTORY, ahead, robot=name)
            if tenth % 2 == 0:
                status = GoalStatus(stamp_ns=0, id="g", state="driving")
                self.publish(topics.GOAL, status, robot=name)
            if tenth % 30 == 0:
                self.publish(topics.PATH, self._path, robot=name)


def hearing(counts: Sequence[int], seconds: float) -> None:
    """Print what of a core a planner takes that drives while it hears so many others."""
    for count in counts:
        house = House(1, 1, sees_others=True)
        house.lockstep.add(Crowd(count), "crowd")
        house.lockstep.run(4.0)
        node, used_s = house.lockstep.nodes["planner"], 0.0
        step = node.step

        def timed(step: Callable[[], bool] = step) -> bool:
            nonlocal used_s
            began_s = time.process_time()
            did = step()
            used_s += time.process_time() - began_s
            return did

        node.step = timed
        for _ in range(round(seconds)):
            house.step()
        print(
            f"planner with {count} others: {100.0 * used_s / seconds:.1f} % of a core", flush=True
        )
        house.lockstep.close()


class Hermit(PlannerService):
    """A planner that hears of nobody else."""

    def _watch_others(self) -> None:
        """Hear nobody."""


@dataclasses.dataclass
class Visitor:
    """One robot, its goals, and their outcomes."""

    name: str
    place: str
    goal: str | None = None
    due_s: float = 0.0
    status: GoalStatus | None = None
    truth: Truth | None = None
    stood_since_s: float = 0.0
    stood_at: Pose2D | None = None
    longest_s: float = 0.0
    longest_why: str = ""
    endings: Counter[str] = dataclasses.field(default_factory=Counter)
    hits: list[tuple[float, Pose2D]] = dataclasses.field(default_factory=list)
    waited_s: float = 0.0
    driven_m: float = 0.0
    closest_m: float = math.inf

    def hear_truth(self, truth: Truth, now_s: float) -> None:
        """Take where it really is."""
        before, self.truth = self.truth, truth
        self.closest_m = min(self.closest_m, truth.clearance)
        if before is not None:
            self.driven_m += before.pose.distance_to(truth.pose)
            if truth.collisions > before.collisions:
                self.hits.append((now_s, truth.pose))
        moved = self.stood_at is None or self.stood_at.distance_to(truth.pose) > 0.1
        if moved or self.goal is None:
            self.stood_at, self.stood_since_s = truth.pose, now_s
        elif now_s - self.stood_since_s > self.longest_s and self.status is not None:
            self.longest_s = now_s - self.stood_since_s
            self.longest_why = f"{self.status.state}: {self.status.message or self.status.reason}"


class House:
    """All robots on one bus."""

    def __init__(self, count: int, seed: int, *, sees_others: bool) -> None:
        self.lockstep = Lockstep("r0", seed)
        self._random = random.Random(seed)
        places = self._random.sample(sorted(PLACES), count)
        self.visitors = [Visitor(f"r{index}", place) for index, place in enumerate(places)]
        for index, visitor in enumerate(self.visitors):
            config = _config(visitor, seed + index)
            for service in (BaseService, LocalizerService, PlannerService, TourService):
                made = Hermit if service is PlannerService and not sees_others else service
                self.lockstep.add(made(config), visitor.name)
            self._listen(visitor)

    def _listen(self, visitor: Visitor) -> None:
        def hear_truth(sample: Sample) -> None:
            truth = codec.decode(Truth, sample.payload, sample.encoding)
            visitor.hear_truth(truth, self.lockstep.now_s)

        def hear_goal(sample: Sample) -> None:
            status = codec.decode(GoalStatus, sample.payload, sample.encoding)
            if visitor.goal is None or status.id != visitor.goal:
                return
            if status.reason == codes.WAITING:
                visitor.waited_s += 0.2
            visitor.status = status
            if status.state in ENDED:
                ending = status.state if status.state == "arrived" else status.reason
                visitor.endings[ending] += 1
                if status.state != "arrived":
                    print(f"{self.lockstep.now_s:7.1f} s  {visitor.name} to {visitor.place}:"
                          f" {status.state}, {status.message}", flush=True)  # fmt: skip
                visitor.goal = None
                visitor.due_s = self.lockstep.now_s + self._random.uniform(1.0, 6.0)

        bus = self.lockstep.bus
        bus.subscribe(topics.SIM_TRUTH.key(visitor.name), hear_truth)
        bus.subscribe(topics.GOAL.key(visitor.name), hear_goal)

    def step(self) -> None:
        """Let a second pass, and send each free robot somewhere else."""
        self.lockstep.run(1.0)
        for visitor in self.visitors:
            if visitor.goal is None and self.lockstep.now_s >= visitor.due_s:
                self._send(visitor)

    def _send(self, visitor: Visitor) -> None:
        taken = {one.place for one in self.visitors}
        place = self._random.choice(sorted(set(PLACES) - taken))
        x, y = PLACES[place]
        visitor.goal = f"g{sum(visitor.endings.values())}-{visitor.name}"
        goal = SendGoal(
            id=visitor.goal, pose=Pose2D(x, y, 0.0), xy_tolerance=0.15, yaw_tolerance=3.2
        )
        try:
            self.lockstep.ask(requests.GOAL_SEND, goal, robot=visitor.name)
            visitor.place = place
        except codes.Refused as refused:
            visitor.endings[f"refused {refused.code}"] += 1
            visitor.goal, visitor.due_s = None, self.lockstep.now_s + 5.0
            print(f"{self.lockstep.now_s:7.1f} s  {visitor.name} to {place}: {refused.message}")


def _config(visitor: Visitor, seed: int) -> RobotConfig:
    x, y = PLACES[visitor.place]
    start = Pose2D(x, y, 0.0)
    rest = (
        f'[base.simulated]\nworld = "{WORLDS / "house.toml"}"\nseed = {seed}\n'
        f"start = {{ x = {x}, y = {y}, yaw = 0.0 }}\n{CHEAP}"
    )
    config = make_config(WORLDS / "house.yaml", start, rest)
    robot = msgspec.structs.replace(config.robot, name=visitor.name)
    return msgspec.structs.replace(config, robot=robot)


def report(house: House, minutes: float, cpu_s: float) -> None:
    """Print a line for each robot and the figures."""
    for one in house.visitors:
        print(
            f"{one.name}: {dict(one.endings)}, {one.driven_m:.0f} m, waited {one.waited_s:.0f} s,"
            f" stood {one.longest_s:.0f} s at most ({one.longest_why}),"
            f" closest {one.closest_m:.3f} m, collisions {len(one.hits)}"
        )
    endings = sum((one.endings for one in house.visitors), Counter[str]())
    ended = sum(endings.values())
    hits = sum(len(one.hits) for one in house.visitors)
    count = len(house.visitors)
    print(
        f"{count} robots, {minutes:.1f} simulated minutes: {ended} goals, {dict(endings)},"
        f" {60.0 * endings['arrived'] / minutes / count:.1f} arrivals an hour and robot;"
        f" {cpu_s:.0f} s of processor time"
    )
    share = 100.0 * endings["arrived"] / max(ended, 1)
    longest_s = max(one.longest_s for one in house.visitors)
    show(
        [
            at_most(f"{count} robots: collisions", float(hits), 0.0, digits=0),
            at_most(f"{count} robots: longest stand with a goal", longest_s, STUCK_S, "s", 0),
            at_least(f"{count} robots: goals reached", share, 98.0, "%", 1),
        ]
    )


def _interruptible(count: int) -> Iterator[int]:
    """Count up; a Ctrl-C ends that early, and what was driven until then is reported."""
    asked: list[int] = []
    signal.signal(signal.SIGINT, lambda number, _: asked.append(number))
    for index in range(count):
        if asked:
            return
        yield index


def main() -> None:
    """Drive and report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=3)
    parser.add_argument("--minutes", type=float, default=3.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--alone", action="store_true", help="robots do not hear of each other")
    parser.add_argument("--profile", action="store_true")
    parser.add_argument("--hearing", action="store_true", help="the cost of hearing nine others")
    options = parser.parse_args()
    if options.hearing:
        hearing((0, 9), 20.0)
        return
    house = House(options.robots, options.seed, sees_others=not options.alone)
    house.lockstep.run(4.0)
    profile = cProfile.Profile()
    started_s, began = time.process_time(), time.monotonic()
    if options.profile:
        profile.enable()
    seconds = 0
    for second in _interruptible(round(60.0 * options.minutes)):
        house.step()
        seconds = second + 1
        if second % 60 == 59:
            used_s = time.process_time() - started_s
            print(
                f"{(second + 1) // 60} min: {used_s:.0f} s of processor time,"
                f" {time.monotonic() - began:.0f} s,"
                f" {sum(one.endings['arrived'] for one in house.visitors)} arrived",
                flush=True,
            )
    profile.disable()
    if options.profile:
        pstats.Stats(profile).sort_stats("tottime").print_stats(25)
    report(house, seconds / 60.0, time.process_time() - started_s)
    house.lockstep.close()


if __name__ == "__main__":
    main()
