"""How smoothly a real base is driven: along a straight, and onto a goal.

    python -m bench.planner.smoothness [--seeds 6] [--delay 0.3] [--each]

An empty hall, with the wheels, motors and lidar of `worlds/real.toml`: commands that come late, a
dead band, backlash, castors that kick, slip. Base, localizer and planner run in lock-step. Each
seed drives 6 m to a goal straight ahead, askew to the map's cells as drawn, then to one at the side
that faces elsewhere, and back.
`--delay` is another delay of the motors.

The wobble is the true path's distance from its own straight line, root mean square, between the
first and the last metre. A step is the change from one command to the next beyond what the base's
acceleration and braking allow in that time, other than to a stop that somebody asked for. Hunting
is how often the commanded turn or drive changes its sign within the last 0.3 m. A jerk is that of
the command, over 0.2 s.
"""

import argparse
import math
import tempfile
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from bench.harness.drives import make_config
from bench.harness.figures import at_least, at_most, show, table
from bench.harness.paths import WORLDS
from numpy.typing import NDArray

from trolley import requests, topics
from trolley.geometry import Pose2D, wrap_angle
from trolley.gridmap import GridMap, save_map
from trolley.messages import Truth, VelocityCommand
from trolley.messages.request_params import SendGoal
from trolley.runtime.lockstep import Lockstep
from trolley_base.service import BaseService
from trolley_localizer.service import LocalizerService
from trolley_planner.service import PlannerService

STRAIGHT_M, MOST_ASIDE_M = 6.0, 0.9
AFTERWARDS = (Pose2D(6.0, 1.0, 2.0), Pose2D(1.5, 2.0, 0.5))
WOBBLE_M, NEAR_M, LIMIT_S, SETTLE_S = 0.01, 0.3, 90.0, 1.0
PARTS = ("wheels", "motors", "lidar")
ENDED = ("arrived", "failed", "canceled")
ACCELERATION, DECELERATION = 0.8, 1.0
"""Of base, as it is set without a word in robot.toml [m/s^2]."""
QUIET = 0.02
"""A command smaller than this [m/s, rad/s] has no sign."""


@dataclass
class Leg:
    """One goal.

    Attributes:
        ending: the goal's last state, or why it failed.
        wobble_m: root mean square; of the first leg only.
        off_m: true distance from the goal.
        off_deg: true turn from the goal.
        last_s: from within `NEAR_M` of the goal to the end.
        hunts: changes of sign in that time.
        jerks: of the commands: speed [m/s^3], turn [rad/s^3]; root mean square.
        steps: commands that no base could follow.
    """

    ending: str
    wobble_m: float = math.nan
    off_m: float = math.nan
    off_deg: float = math.nan
    last_s: float = math.nan
    hunts: int = 0
    jerks: tuple[float, float] = (math.nan, math.nan)
    steps: int = 0
    largest: float = 0.0
    """The largest step of the commanded speed beyond what is possible [m/s]."""


@dataclass(frozen=True)
class Heard:
    """What was said during one leg."""

    truths: list[Truth]
    commands: list[VelocityCommand]

    @property
    def xy(self) -> NDArray[np.float64]:
        """Where the robot truly was (n, 2) [m]."""
        return np.array([(truth.pose.x, truth.pose.y) for truth in self.truths])


def straight(seed: int) -> tuple[Pose2D, Pose2D]:
    """Return where the straight begins and where it ends."""
    aside = float(np.random.default_rng([seed, 1]).uniform(-MOST_ASIDE_M, MOST_ASIDE_M))
    yaw = math.atan2(aside, STRAIGHT_M)
    return Pose2D(1.5, 2.0, yaw), Pose2D(1.5 + STRAIGHT_M, 2.0 + aside, yaw)


def hall(folder: Path, start: Pose2D, seed: int, delay_s: float | None = None) -> Path:
    """Write the hall and its world; return the world's file."""
    cells = np.zeros((80, 180), np.int8)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = 100, 100, 100, 100
    rng = np.random.default_rng(seed)
    for _ in range(12):  # something to localize by along the walls
        col, deep = int(rng.integers(4, 170)), int(rng.integers(3, 9))
        cells[(slice(0, deep) if rng.random() < 0.5 else slice(-deep, None)), col : col + 6] = 100
    save_map(GridMap("hall", 0.05, Pose2D.identity(), cells), folder / "hall.yaml")
    real = tomllib.loads((WORLDS / "real.toml").read_text())
    if delay_s is not None:
        real["motors"]["delay_s"] = delay_s
    lines = ['map = "hall.yaml"', f"start = {{ x = {start.x}, y = {start.y}, yaw = {start.yaw} }}"]
    for part in PARTS:
        plain = {key: value for key, value in real[part].items() if not isinstance(value, dict)}
        lines += [f"[{part}]", *(f"{key} = {value}" for key, value in plain.items())]
    world = folder / "hall.toml"
    world.write_text("\n".join(lines) + "\n")
    return world


def drive(seed: int, delay_s: float | None = None) -> list[Leg]:
    """Drive all legs of a seed."""
    legs: list[Leg] = []
    with tempfile.TemporaryDirectory() as name, Lockstep("trolley", seed) as lockstep:
        folder = Path(name)
        start, end = straight(seed)
        world = hall(folder, start, seed, delay_s)
        rest = f'[base.simulated]\nworld = "{world}"\nseed = {seed}\n'
        config = make_config(folder / "hall.yaml", start, rest)
        for service in (BaseService, LocalizerService, PlannerService):
            lockstep.add(service(config))
        heard = Heard(lockstep.record(topics.SIM_TRUTH), lockstep.record(topics.COMMAND, "planner"))
        poses, said = lockstep.record(topics.POSE), lockstep.record(topics.GOAL)
        lockstep.run_until(lambda: bool(poses) and poses[-1].state == "localized", 30.0)
        for goal in (end, *AFTERWARDS):
            begin = len(heard.truths), len(heard.commands)
            lockstep.ask(requests.GOAL_SEND, SendGoal(pose=goal))
            lockstep.run_until(lambda: said[-1].state in ENDED, LIMIT_S)
            lockstep.run(SETTLE_S)
            leg = Heard(heard.truths[begin[0] :], heard.commands[begin[1] :])
            state = said[-1].state
            legs.append(judged(leg, goal, said[-1].reason if state == "failed" else state))
            if goal is end:
                legs[-1].wobble_m = wobble_of(leg.xy)
    return legs


def judged(heard: Heard, goal: Pose2D, ending: str) -> Leg:
    """Judge one leg."""
    leg = Leg(ending)
    end = heard.truths[-1].pose
    leg.off_m, leg.off_deg = (
        end.distance_to(goal),
        math.degrees(abs(wrap_angle(end.yaw - goal.yaw))),
    )
    far = np.hypot(*(heard.xy - (goal.x, goal.y)).T)
    near = np.flatnonzero(far > NEAR_M)
    since_ns = heard.truths[int(near[-1])].stamp_ns if near.size else heard.truths[0].stamp_ns
    times = np.array([one.stamp_ns for one in heard.commands]) * 1e-9
    values = np.array([(one.twist.vx, one.twist.wz) for one in heard.commands])
    last = times > since_ns * 1e-9
    moving = np.abs(values).max(axis=1) > 0.0
    leg.last_s = float(times[moving].max() - since_ns * 1e-9)
    leg.hunts = sum(changes_of_sign(values[last, k]) for k in range(2))
    leg.jerks = (jerk_of(times, values[:, 0]), jerk_of(times, values[:, 1]))
    leg.steps, leg.largest = steps_of(times, values[:, 0])
    return leg


def wobble_of(xy: NDArray[np.float64]) -> float:
    """Distance of a path (n, 2) from its own straight line, root mean square [m]."""
    along = np.hypot(*(xy - xy[0]).T)
    middle = xy[(along > 1.0) & (along < along.max() - 1.0)]
    centred = middle - middle.mean(axis=0)
    return float(np.linalg.svd(centred, compute_uv=False)[-1] / math.sqrt(len(middle)))


def changes_of_sign(values: NDArray[np.float64]) -> int:
    """How often the sign changes, small values left out."""
    signs = np.sign(values[np.abs(values) > QUIET])
    return int(np.count_nonzero(np.diff(signs)))


def jerk_of(times: NDArray[np.float64], values: NDArray[np.float64]) -> float:
    """Root mean square of the second derivative, over 0.2 s."""
    even = np.arange(times[0], times[-1], 0.1)
    return float(np.sqrt(np.mean((np.diff(np.interp(even, times, values), n=2) / 0.01) ** 2)))


def steps_of(times: NDArray[np.float64], speeds: NDArray[np.float64]) -> tuple[int, float]:
    """Count changes of speed that neither acceleration nor braking allows; the largest of them."""
    gap = np.minimum(np.diff(times), 0.2)
    change = np.diff(np.abs(speeds))
    allowed = np.where(change > 0.0, ACCELERATION, DECELERATION) * gap
    over = np.abs(change) - allowed
    return int(np.count_nonzero(over > 0.02)), float(over.max(initial=0.0))


def main() -> None:
    """Drive, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--delay", type=float, help="of the motors [s]")
    parser.add_argument("--each", action="store_true", help="a line for each leg")
    given = parser.parse_args()
    legs: list[Leg] = []
    for seed in range(given.seeds):
        run = drive(seed, given.delay)
        legs += run
        for leg in run if given.each else ():
            print(leg, flush=True)
    arrived = [leg for leg in legs if leg.ending == "arrived"]
    rows = [
        [name, *(f"{value:.3f}" for value in (*np.nanquantile(of, [0.5, 0.95]), np.nanmax(of)))]
        for name, of in (
            ("wobble on the straight [m]", [leg.wobble_m for leg in arrived]),
            ("off the goal by the truth [m]", [leg.off_m for leg in arrived]),
            ("off the goal by the truth [deg]", [leg.off_deg for leg in arrived]),
            ("the last 0.3 m took [s]", [leg.last_s for leg in arrived]),
            ("changes of sign there", [float(leg.hunts) for leg in arrived]),
            ("jerk of the speed [m/s^3]", [leg.jerks[0] for leg in arrived]),
            ("jerk of the turn [rad/s^3]", [leg.jerks[1] for leg in arrived]),
            ("largest impossible step [m/s]", [leg.largest for leg in arrived]),
        )
    ]
    table(["", "median", "95 %", "worst"], rows)
    wobble = float(np.nanmax([leg.wobble_m for leg in arrived]))
    show(
        [
            at_least("arrived", 100.0 * len(arrived) / len(legs), 100.0, "%", 0),
            at_most("wobble, worst", wobble, WOBBLE_M, "m"),
            at_most("impossible steps", float(sum(leg.steps for leg in arrived)), 0.0, digits=0),
        ]
    )


if __name__ == "__main__":
    main()
