"""One drive of a scene in lock-step: a simulated base, the planner, the true pose, and the judge.

Unless asked for, the localizer is not in the loop: `TruePose` gives its map and, 20 times a second,
the true pose.
People are moved and judged here, 50 times a second.
"""

import math
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from bench.planner.crossing import take_stop_field_away
from bench.planner.known_people import Informant, Knows
from bench.planner.people_judge import PEOPLE_S, SOMEBODY, Hit, PeopleJudge
from bench.planner.situations import SPEED_MPS, TURN_RADPS, Scene
from numpy.typing import NDArray

from trolley import codes, requests, topics
from trolley.config import RobotConfig, load_config
from trolley.geometry import Pose2D, angle_difference
from trolley.gridmap import GridMap, save_map
from trolley.gridmap.wire import map_message
from trolley.messages import GoalStatus, Odometry, PoseEstimate, Scan, Transform, Truth, Zones
from trolley.messages.request_params import SendGoal
from trolley.runtime.lockstep import Lockstep
from trolley.runtime.service import Service, on
from trolley_base.description import footprint_of
from trolley_base.service import BaseService
from trolley_base.simulation.simulated_hardware import SimulatedHardware
from trolley_base.world.simulation import Simulation
from trolley_localizer.service import LocalizerService
from trolley_planner.service import PlannerService
from trolley_planner.warmup import warm_up

LIDARS = {
    "360": "beams = 360\nrate_hz = 10.0\n",
    "180": f"beams = 180\nrate_hz = 10.0\nfield_of_view = {math.pi}\n",
    "5hz": "beams = 360\nrate_hz = 5.0\n",
}
LIMIT_S = 120.0
"""Nobody waits longer for a robot at one goal [s]."""
ENDED = ("arrived", "failed", "canceled")
TRUE_M, TRUE_RAD = 0.08, 0.08
"""How far off the robot may truly stand where it says that it has arrived: its tolerances, and what
the wheels' odometry is wrong between two true poses."""
SETTLE_S = 1.5
HISTORY_S = 1.0

_ROBOT = """
[robot]
name = "trolley"
footprint = {{ polygon_m = {polygon} }}
[base.simulated]
world = "{folder}/home.toml"
seed = {seed}
[base.limits]
max_speed_mps = {speed}
max_wz_radps = {turn}
[planner]
frame = "{frame}"
"""
_MAP = """
[map]
file = "{name}.yaml"
[start]
pose = {{ x = {x}, y = {y}, yaw = {yaw} }}
"""
_WORLD = """
map = "floor.yaml"
start = {{ x = {x}, y = {y}, yaw = {yaw} }}
[lidar]
range_max_m = 12.0
{lidar}
"""
# In frame `odom` nobody corrects the wheels, whose errors are not the planner's fault.
_GOOD_WHEELS = """
[wheels]
scale_std = 0.0005
turn_scale_std = 0.002
slip_per_m = 0.005
yaw_slip_per_m = 0.002
yaw_slip_per_rad = 0.003
"""
_BOX = "[[box]]\nx = {}\ny = {}\nlength_m = {}\nwidth_m = {}\n"


class TruePose(Service):
    """Stands in for the localizer: the map, and where the robot truly is."""

    name = "localizer"

    def __init__(self, grid: GridMap) -> None:
        self._grid = grid

    def start(self) -> None:
        """Publish the map."""
        self._odometry = self.watch(topics.ODOM, seconds=HISTORY_S)
        self.publish(topics.MAP, map_message(self.stamp_ns, self._grid))
        self.publish(topics.ZONES, Zones(stamp_ns=self.stamp_ns, map=self._grid.name, zones=[]))

    @on(topics.SIM_TRUTH)
    def take_truth(self, truth: Truth) -> None:
        """Publish the pose, by the odometry of the same moment."""
        same: Odometry | None = next(
            (one for one in self._odometry.history if one.stamp_ns == truth.stamp_ns), None
        )
        if same is None:
            return
        map_T_odom = truth.pose @ same.pose.inverse()
        transform = Transform(stamp_ns=truth.stamp_ns, parent="map", child="odom", pose=map_T_odom)
        estimate = PoseEstimate(
            stamp_ns=truth.stamp_ns, map=self._grid.name, pose=truth.pose,
            covariance=[0.0] * 9, state="localized", match=1.0, spread=0.0,
        )  # fmt: skip
        self.publish(topics.TF, transform, "odom")
        self.publish(topics.POSE, estimate)


class TimedPlanner(PlannerService):
    """The planner, and the processor time of its longest cycle."""

    longest_ms = 0.0

    @on(topics.SCAN)
    def on_scan(self, scan: Scan) -> None:
        """Run the cycle."""
        began_s = time.thread_time()
        super().on_scan(scan)
        self.longest_ms = max(self.longest_ms, 1e3 * (time.thread_time() - began_s))


@dataclass(frozen=True)
class Setting:
    """How all scenes are driven.

    Attributes:
        lidar: one of `LIDARS`.
        has_stop_field: base holds the robot before what it would hit.
        localizes: the localizer finds the pose, instead of being told the truth.
        knows: what the planner goes by about people.
    """

    lidar: str = "360"
    has_stop_field: bool = False
    localizes: bool = False
    knows: Knows = "tracks"


@dataclass
class Visit:
    """How it went."""

    scene: Scene
    seed: int
    ending: str = "arrived"
    """`arrived`, or why not; `contact` comes first."""
    seconds: float = 0.0
    ideal_s: float = math.nan
    driven_m: float = 0.0
    ideal_m: float = math.nan
    """Driven without people [m]."""
    recoveries: int = 0
    touched: int = 0
    """Contacts with walls and things."""
    closest_m: float = math.inf
    trace: list[tuple[float, Pose2D]] = field(default_factory=list)
    """Time [s] and true pose, 20 times a second."""
    contacts: list[tuple[float, float]] = field(default_factory=list)
    """Where the robot was at each contact with walls and things [m]."""
    hits: list[Hit] = field(default_factory=list)
    """Contacts with people."""
    longest_ms: float = 0.0
    """Processor time of the planner's longest cycle."""
    near_share: float = 0.0
    """Share of the time in which somebody's body was within 0.45 m of the footprint."""
    people: list[tuple[float, NDArray[np.float64]]] = field(default_factory=list)
    """Time and where everybody was [s, (n, 2) m]."""

    @property
    def is_success(self) -> bool:
        """Whether all goals were reached, and nothing was touched."""
        return self.ending == "arrived"

    def num_hits(self, *, moving: bool) -> int:
        """Contacts with people while the robot moved, or while it stood."""
        return sum(hit.is_moving == moving for hit in self.hits)

    @property
    def ratio(self) -> float:
        """Time / ideal time."""
        return self.seconds / self.ideal_s if self.is_success else math.inf


def drive(scene: Scene, seed: int, setting: Setting) -> Visit:
    """Drive all goals of a scene, one after the other; the seed is that of the robot's errors."""
    visit = Visit(scene, seed)
    with tempfile.TemporaryDirectory() as folder, Lockstep("trolley", seed) as lockstep:
        config = config_of(scene, seed, setting.lidar, Path(folder))
        base = lockstep.add(BaseService(config))
        if not setting.has_stop_field:
            take_stop_field_away(base, config)
        if scene.frame == "map":
            lockstep.add(LocalizerService(config) if setting.localizes else TruePose(scene.map()))
        warm_up()
        planner = lockstep.add(TimedPlanner(config))
        world = world_of(base)
        people = crowd = None
        if scene.crowd is not None:
            crowd = scene.crowd()
            people = PeopleJudge(crowd, world, footprint_of(config))
        truths, said = lockstep.record(topics.SIM_TRUTH), lockstep.record(topics.GOAL)
        odometry = lockstep.record(topics.ODOM)
        lockstep.run(SETTLE_S)
        informant = None
        if people is not None and crowd is not None and setting.knows != "tracks":
            judge = people

            def frame_T_people() -> Pose2D:
                is_true = scene.frame == "map"
                true_T_base = truths[-1].pose
                return (true_T_base if is_true else odometry[-1].pose) @ true_T_base.inverse()

            informant = Informant(
                planner, crowd, setting.knows,
                (lambda: judge.seconds, lambda: lockstep.now_s), frame_T_people,
            )  # fmt: skip
        for goal in scene.goals:
            began_s, before = lockstep.now_s, len(truths)
            visit.ending = drive_to(goal, scene, lockstep, said, people, informant)
            visit.seconds += lockstep.now_s - began_s
            visit.recoveries += said[-1].recoveries if said else 0
            visit.trace += [(one.stamp_ns * 1e-9, one.pose) for one in truths[before:]]
            # Nobody corrects the wheels in frame `odom`: what they tell is where the goal lies.
            is_true = scene.frame == "map"
            pose = truths[-1].pose if is_true else scene.start @ odometry[-1].pose
            if visit.is_success and not _is_at(pose, goal, scene):
                visit.ending = "elsewhere"
            if not visit.is_success:
                break
        visit.longest_ms = planner.longest_ms
        _judge(visit, truths, world, people)
    return visit


def drive_to(
    goal: Pose2D,
    scene: Scene,
    lockstep: Lockstep,
    said: list[GoalStatus],
    people: PeopleJudge | None = None,
    informant: Informant | None = None,
) -> str:
    """Drive to a goal; return `arrived`, or why not.

    Args:
        goal: in the frame of the scene; with another map, in that map.
        scene: whose goal it is.
        lockstep: that the robot runs in.
        said: what the planner says of its goals.
        people: who walk meanwhile, and are judged.
        informant: who tells the planner of them.
    """
    there = goal if scene.frame == "map" else scene.start.inverse() @ goal
    asked = SendGoal(pose=there, xy_tolerance=scene.xy, yaw_tolerance=scene.yaw)
    try:
        lockstep.ask(requests.GOAL_SEND, asked)
    except codes.Refused as refused:
        return f"refused: {refused.code}"

    def has_ended() -> bool:
        if informant is not None:
            informant.tell()
        if people is not None:
            people.update(lockstep.now_s)
            if people.hits and scene.forgives == "":
                return True
        return said[-1].state in ENDED

    if not lockstep.run_until(has_ended, LIMIT_S):
        return "timeout"
    last = said[-1]
    return last.state if last.state == "arrived" else last.reason or last.state


def _judge(
    visit: Visit, truths: list[Truth], world: Simulation, people: PeopleJudge | None
) -> None:
    """Complete a drive by what was touched and how near things came."""
    driven_into = [
        one for one in world.contacts if one.is_collision and not one.name.startswith(SOMEBODY)
    ]
    visit.touched = len(driven_into)
    visit.contacts = [_place(truths, one.stamp_ns) for one in driven_into]
    visit.closest_m = min(one.clearance for one in truths)
    if people is not None:
        visit.closest_m, visit.hits, visit.people = people.closest_m, people.hits, people.trace
        visit.near_share = people.near_s / max(people.seconds, PEOPLE_S)
    if visit.touched or any(_counts(hit, visit.scene) for hit in visit.hits):
        visit.ending = "contact"
    points = np.array([(pose.x, pose.y) for _, pose in visit.trace]).reshape(-1, 2)
    visit.driven_m = float(np.hypot(*np.diff(points, axis=0).T).sum())


def _counts(hit: Hit, scene: Scene) -> bool:
    """Whether a contact makes the drive a failure."""
    return scene.forgives == "" or (scene.forgives == "standing" and hit.is_moving)


def world_of(base: BaseService) -> Simulation:
    """Return the world of a base that is simulated."""
    hardware = base.hardware
    if not isinstance(hardware, SimulatedHardware):
        raise TypeError("the base of a scene is simulated")
    return hardware.simulation


def _is_at(pose: Pose2D, goal: Pose2D, scene: Scene) -> bool:
    off = abs(angle_difference(pose.yaw, goal.yaw))
    return pose.distance_to(goal) <= scene.xy + TRUE_M and off <= scene.yaw + TRUE_RAD


def _place(truths: list[Truth], stamp_ns: int) -> tuple[float, float]:
    nearest = min(truths, key=lambda one: abs(one.stamp_ns - truths[0].stamp_ns - stamp_ns))
    return nearest.pose.x, nearest.pose.y


def config_of(scene: Scene, seed: int, lidar: str, folder: Path) -> RobotConfig:
    """Write the world and the robot down, and read the robot.

    What is solid stands there exactly, not in the cells of the map that the planner gets.
    """
    grid = scene.map()
    width, height = grid.size_m
    ends = np.array([(0.0, 0.0), (width, 0.0), (0.0, height), (width, height)])
    ends = grid.origin.transform_points(ends)
    cols, rows = ((ends.max(axis=0) - ends.min(axis=0)) // 0.25).astype(int).tolist()
    cells = np.zeros((rows + 40, cols + 40), dtype=np.int8)
    x, y = (ends.min(axis=0) - 5.0).tolist()
    corner = Pose2D(x, y, 0.0)
    save_map(GridMap("floor", 0.25, corner, cells), folder / "floor.yaml")
    start = scene.start
    text = _WORLD.format(x=start.x, y=start.y, yaw=start.yaw, lidar=LIDARS[lidar])
    text += _GOOD_WHEELS if scene.frame == "odom" else ""
    text += "".join(_BOX.format(*box) for box in (*scene.boxes, *scene.things))
    (folder / "home.toml").write_text(text)
    robot = _ROBOT.format(
        polygon=[list(corner) for corner in scene.body.corners], folder=folder, seed=seed,
        speed=SPEED_MPS, turn=TURN_RADPS, frame=scene.frame,
    )  # fmt: skip
    save_map(grid, folder / f"{grid.name}.yaml")
    robot += _MAP.format(name=grid.name, x=start.x, y=start.y, yaw=start.yaw)
    (folder / "robot.toml").write_text(robot)
    return load_config(folder / "robot.toml")
