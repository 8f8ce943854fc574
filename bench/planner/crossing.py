"""One crossing of a world in lock-step: a simulated base, a planner, and the truth as the judge."""

import functools
import math
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from bench.planner.dwa import DwaService
from bench.planner.fields import GOAL_M, World
from numpy.typing import NDArray

from trolley import codes, requests, topics
from trolley.config import RobotConfig, load_config
from trolley.geometry import Pose2D, Twist2D
from trolley.gridmap import GridMap, save_map
from trolley.messages import Truth
from trolley.messages.request_params import SendGoal
from trolley.runtime.lockstep import Lockstep
from trolley_base.description import footprint_of, limits_of
from trolley_base.safety.stop_field import StopField
from trolley_base.service import BaseService
from trolley_planner.control.local_costmap import LocalCostmap
from trolley_planner.control.mppi import Mppi
from trolley_planner.control.pure_pursuit import PurePursuit
from trolley_planner.service import PlannerService

LENGTH_M, WIDTH_M = 0.46, 0.42
NEAR_M, MOVED_M, LIMIT_S = 1.0, 0.1, 100.0
TRUTH_S = 0.05
SCORE_SPEED = 2.0

Ending = Literal["success", "collision", "time-out", "failed"]

_ROBOT = """
[robot]
name = "trolley"
footprint = {{ length_m = {length}, width_m = {width} }}
[base.simulated]
world = "{world}"
seed = {seed}
[base.limits]
max_speed_mps = {speed}
max_wz_radps = {turn}
acceleration_mps2 = {acceleration}
deceleration_mps2 = {acceleration}
angular_acceleration_radps2 = 8.0
[planner]
frame = "odom"
max_speed_mps = {speed}
{planner}
"""

# The wheels tell the heading as a gyroscope does: about a degree wrong after 10 m. Nobody corrects
# the odometry here, and its errors are not the planner's fault.
_WORLD = """
map = "floor.yaml"
start = {{ x = 0.0, y = 0.0, yaw = 0.0 }}
[wheels]
track_m = 0.37
scale_std = 0.0005
turn_scale_std = 0.002
slip_per_m = 0.005
yaw_slip_per_m = 0.002
yaw_slip_per_rad = 0.003
[lidar]
beams = 720
field_of_view = {view}
rate_hz = 50.0
range_max_m = 30.0
noise_m = 0.01
noise_share = 0.0
[limits]
max_speed_mps = {speed}
max_wz_radps = {turn}
acceleration_mps2 = {acceleration}
deceleration_mps2 = {acceleration}
angular_acceleration_radps2 = 8.0
angular_deceleration_radps2 = 8.0
"""


@dataclass(frozen=True)
class Setup:
    """How a robot drives.

    Attributes:
        name: what the tables call it.
        speed_mps: highest speed of planner, base and motors.
        acceleration_mps2: of base and motors, speeding up and braking.
        turn_radps: highest turn rate.
        planner: more TOML for `[planner]`; None: the reference drives.
        has_stop_field: whether base holds the robot before what it would hit. Without it, the
            planner is on its own.
    """

    name: str
    speed_mps: float = 0.5
    acceleration_mps2: float = 2.5
    turn_radps: float = 1.5
    planner: str | None = ""
    has_stop_field: bool = False


@dataclass(frozen=True)
class Crossing:
    """The outcome."""

    world: str
    setup: str
    ending: Ending
    seconds: float
    score: float
    closest_m: float
    jerk_mps3: float
    """Root mean square of the true speed's second derivative."""
    turn_jerk_radps3: float
    commands: int
    planner_s: float
    """Processor time of the planner."""
    controller_s: float
    """The part of it for window, cost-to-go and rollouts."""
    shortest_m: float
    reason: str = ""


class _NoStopField(StopField):
    """Lets everything pass."""

    def scale(self, twist: Twist2D, points: NDArray[np.float64]) -> float:
        del twist, points
        return 1.0


def take_stop_field_away(base: BaseService, config: RobotConfig) -> None:
    """Let the robot be driven into what it sees: the planner must not need the stop field."""
    base._drive._limiter._field = _NoStopField(footprint_of(config), limits_of(config), 0.0)


def cross(world: World, setup: Setup, seed: int) -> Crossing:
    """Send the robot to the goal and judge by `sim/truth`."""
    shortest_m = world.shortest_m(0.5 * WIDTH_M)
    corners = [
        (x * 0.5 * LENGTH_M, y * 0.5 * WIDTH_M) for x, y in ((1, 1), (-1, 1), (-1, -1), (1, -1))
    ]
    with tempfile.TemporaryDirectory() as folder, Lockstep("trolley", seed) as lockstep:
        config = _config(world, setup, seed, Path(folder))
        base = lockstep.add(BaseService(config))
        if not setup.has_stop_field:
            take_stop_field_away(base, config)
        goal = Pose2D(GOAL_M, 0.0, 0.0)
        is_reference = setup.planner is None
        lockstep.add(
            DwaService(corners, (goal.x, goal.y)) if is_reference else PlannerService(config)
        )
        clock = _Clock(lockstep)
        truths, goals = lockstep.record(topics.SIM_TRUTH), lockstep.record(topics.GOAL)
        commands = lockstep.record(topics.COMMAND, "planner")
        lockstep.run(1.0)
        clock.begin()
        before = len(commands)
        reason = ""
        if not is_reference:
            try:
                lockstep.ask(requests.GOAL_SEND, SendGoal(pose=goal, yaw_tolerance=math.pi))
            except codes.Refused as refused:
                reason = refused.code
        judge = _Judge(truths, goal)
        ended = lambda: bool(goals) and goals[-1].state in ("failed", "arrived")  # noqa: E731
        lockstep.run_until(lambda: judge.has_ended() or ended(), LIMIT_S + 20)
        if ended():
            reason = goals[-1].reason or "elsewhere"  # its odometry led it astray
        ending = judge.ending(bool(reason))
        seconds = judge.seconds
        clock.close()
        best_s = shortest_m / SCORE_SPEED
        score = best_s / min(max(seconds, 2.0 * best_s), 8.0 * best_s)
        jerk = _jerks(truths)
        return Crossing(
            world.name, setup.name, ending, seconds, score if ending == "success" else 0.0,
            judge.closest_m, jerk[0], jerk[1], len(commands) - before, clock.planner_s,
            clock.controller_s, shortest_m,
            reason,
        )  # fmt: skip


class _Clock:
    """Measures the processor time of the planner, and of the controller as a part of it."""

    def __init__(self, lockstep: Lockstep) -> None:
        self.planner_s = 0.0
        self.controller_s = 0.0
        self._owners = (
            (LocalCostmap, "update"),
            (LocalCostmap, "compute_cost_to_go"),
            (Mppi, "command"),
            (PurePursuit, "command"),
        )
        self._plain = [getattr(owner, name) for owner, name in self._owners]
        for (owner, name), function in zip(self._owners, self._plain, strict=True):
            setattr(owner, name, self._timed(function, "controller_s"))
        node = lockstep.nodes["planner"]
        node.step = self._timed(node.step, "planner_s")

    def begin(self) -> None:
        """Start counting."""
        self.planner_s = self.controller_s = 0.0

    def close(self) -> None:
        """Restore everything."""
        for (owner, name), function in zip(self._owners, self._plain, strict=True):
            setattr(owner, name, function)

    def _timed(self, function: Callable[..., Any], total: str) -> Callable[..., Any]:
        @functools.wraps(function)
        def timed(*args: object, **keywords: object) -> Any:
            began = time.thread_time()
            try:
                return function(*args, **keywords)
            finally:
                setattr(self, total, getattr(self, total) + time.thread_time() - began)

        return timed


class _Judge:
    """Checks each true state once."""

    def __init__(self, truths: list[Truth], goal: Pose2D) -> None:
        self._truths = truths
        self._goal = goal
        self._seen = len(truths)
        self._start = truths[-1]
        self._began_ns: int | None = None
        self._now_ns = 0
        self._state: Ending | None = None
        self.closest_m = math.inf

    @property
    def seconds(self) -> float:
        """Time since the robot moved [s], as the public runs are timed."""
        return 0.0 if self._began_ns is None else (self._now_ns - self._began_ns) * 1e-9

    def has_ended(self) -> bool:
        """Whether the outcome is decided."""
        for truth in self._truths[self._seen :]:
            self._look(truth)
        self._seen = len(self._truths)
        return self._state is not None

    def ending(self, has_given_up: bool) -> Ending:
        """The outcome."""
        return self._state or ("failed" if has_given_up else "time-out")

    def _look(self, truth: Truth) -> None:
        if self._state is not None:
            return
        self._now_ns = truth.stamp_ns
        self.closest_m = min(self.closest_m, truth.clearance)
        if self._began_ns is None and truth.pose.distance_to(self._start.pose) >= MOVED_M:
            self._began_ns = truth.stamp_ns
        if truth.collisions > 0:
            self._state = "collision"
        elif truth.pose.distance_to(self._goal) <= NEAR_M:
            self._state = "success"
        elif self.seconds >= LIMIT_S:
            self._state = "time-out"


def _jerks(truths: list[Truth]) -> tuple[float, float]:
    """Root mean squares of the second derivatives of speed and turn rate.

    Speeds are averaged over 0.2 s first: motors follow each command in a jump, which would count
    more the less its period matches that of the truth.
    """
    speeds = np.array([(truth.twist.vx, truth.twist.wz) for truth in truths])
    smooth = np.array([np.convolve(column, np.full(4, 0.25), mode="valid") for column in speeds.T])
    second = np.diff(smooth[:, ::2], n=2, axis=1) / (2.0 * TRUTH_S) ** 2
    linear, turning = np.sqrt((second**2).mean(axis=1)).tolist()
    return linear, turning


def _config(world: World, setup: Setup, seed: int, folder: Path) -> RobotConfig:
    """Write the world and the robot down, and read the robot."""
    floor = GridMap("floor", 0.5, Pose2D(-8.0, -10.0, 0.0), np.zeros((40, 64), dtype=np.int8))
    save_map(floor, folder / "floor.yaml")
    limits = {
        "speed": setup.speed_mps,
        "turn": setup.turn_radps,
        "acceleration": setup.acceleration_mps2,
    }
    text = _WORLD.format(view=math.radians(270.0), **limits)
    for x, y, radius in world.circles.tolist():
        text += f"[[circle]]\nx = {x}\ny = {y}\nradius_m = {radius}\n"
    for x, y, length, width in world.boxes:
        text += f"[[box]]\nx = {x}\ny = {y}\nlength_m = {length}\nwidth_m = {width}\n"
    for person in world.people:
        path = [list(point) for point in person.path]
        text += f"[[person]]\npath = {path}\nspeed_mps = {person.speed_mps}\nlegs = true\n"
    (folder / "field.toml").write_text(text)
    robot = _ROBOT.format(
        length=LENGTH_M, width=WIDTH_M, world=folder / "field.toml", seed=seed,
        planner=setup.planner or "", **limits,
    )  # fmt: skip
    (folder / "robot.toml").write_text(robot)
    return load_config(folder / "robot.toml")
