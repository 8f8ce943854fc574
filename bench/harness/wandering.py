"""A robot that drives to random goals in the apartment, judged by the truth; it can be lifted."""

import math
import runpy
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from bench.harness.drives import make_config
from bench.harness.houses import free_poses, seen_from
from bench.harness.paths import WORLDS
from numpy.typing import NDArray

from trolley import codes, requests, topics
from trolley.geometry import Pose2D, angle_difference
from trolley.gridmap import GridMap, distance_transform, load_map, save_map
from trolley.messages import PoseEstimate
from trolley.messages.request_params import SendGoal, SetPose
from trolley.runtime.lockstep import Lockstep
from trolley_base.service import BaseService
from trolley_base.simulation.simulated_hardware import SimulatedHardware
from trolley_base.world.world_file import load_world
from trolley_localizer.service import LocalizerService
from trolley_planner.service import PlannerService

APARTMENT = WORLDS / "apartment.yaml"
START = Pose2D(0.549, 0.218, 0.2579)
# Things of the world that are not on the map, with a robot's width about them: x, y, reach [m].
IN_THE_WAY = ((4.25, 1.2, 0.5), (5.0, -1.35, 0.5))
# Beyond these errors the robot counts as being elsewhere [m, rad].
FAR_M, FAR_RAD = 0.5, math.radians(20.0)
# After this long at one goal, another is tried [s].
PATIENCE_S = 40.0
STEP_S = 0.1
ENDED = ("idle", "arrived", "failed", "canceled")

PEOPLE = """
[[person]]
name = "child"
path = [[0.0, 0.3], [2.6, 0.6], [2.6, 1.5], [1.2, 1.3]]
speed_mps = 0.9
legs = true

[[person]]
name = "visitor"
path = [[3.8, 1.6], [6.3, 1.3], [5.6, -0.6], [5.2, -1.9]]
speed_mps = 0.7
dwell_s = 3.0
legs = true
"""


def write_world(
    folder: Path,
    *,
    name: str = "apartment",
    moved_seed: int | None = None,
    people: bool = False,
    mirror: bool = True,
    field_of_view: float | None = None,
) -> Path:
    """Write a world of the demo's apartment into a folder, changed.

    Args:
        folder: where the files go.
        name: of the world, `apartment` or `real`.
        moved_seed: chooses a third of the furniture, which is moved; the robot's map is not.
        people: two more of them walk about.
        mirror: the hall's mirror is there.
        field_of_view: of the lidar [rad], None for the world's own.
    """
    text = (WORLDS / f"{name}.toml").read_text()
    if not mirror:
        head, _, rest = text.partition("\n[[mirror]]")
        text = head + rest[rest.index("\n[[") :]
    map_file = APARTMENT
    if moved_seed is not None:
        map_file = folder / "moved.yaml"
        save_map(move_furniture(moved_seed), map_file)
    text = text.replace('"apartment.yaml"', f'"{map_file}"')
    text += PEOPLE * people
    if field_of_view is not None:
        head, _, rest = text.partition("\n[lidar]\n")
        text = f"{head}\n[lidar]\nfield_of_view = {field_of_view}\n{rest}"
    world = folder / f"{name}.toml"
    world.write_text(text)
    return world


def move_furniture(seed: int) -> GridMap:
    """The apartment with a third of its furniture 0.3 to 1 m from where it was."""
    maps: dict[str, Any] = runpy.run_path(str(WORLDS / "make_maps.py"))
    plan = maps["APARTMENT"]
    rng = np.random.default_rng(seed)
    furniture = dict(plan.furniture)
    left = round(len(furniture) / 3)
    for name in rng.permutation(list(furniture)):
        pieces = np.array(furniture[name])
        for _ in range(50):
            way, size = rng.uniform(-math.pi, math.pi), rng.uniform(0.3, 1.0)
            shift = size * np.array([math.cos(way), math.sin(way)])
            moved = pieces + np.repeat(shift, 2)
            if left > 0 and _is_in_a_room(moved, list(plan.rooms.values())):
                furniture[name] = [tuple(piece) for piece in moved.tolist()]
                left -= 1
                break
    assert left == 0, "another seed: too little of the furniture has room to move"
    return maps["draw"](plan._replace(furniture=furniture))


def _is_in_a_room(pieces: NDArray[np.float64], rooms: list[tuple[float, ...]]) -> bool:
    """Whether pieces (n, 4) x, x, y, y stand in one room, and not where the robot starts."""
    x0, x1, y0, y1 = pieces.T
    away = np.hypot(
        np.maximum(np.maximum(x0 - START.x, START.x - x1), 0.0),
        np.maximum(np.maximum(y0 - START.y, START.y - y1), 0.0),
    )
    return bool(np.all(away > 0.4)) and any(
        bool(np.all((x0 >= room[0]) & (x1 <= room[1]) & (y0 >= room[2]) & (y1 <= room[3])))
        for room in rooms
    )


@dataclass(frozen=True)
class Track:
    """What the localizer said and what was true, one entry per pose.

    Attributes:
        stamps_s: robot time of the poses [s].
        error_m: distance from the truth [m], infinite without a pose.
        error_rad: of the heading [rad].
        states: what the localizer said.
    """

    stamps_s: NDArray[np.float64]
    error_m: NDArray[np.float64]
    error_rad: NDArray[np.float64]
    states: NDArray[np.str_]

    @property
    def is_far(self) -> NDArray[np.bool_]:
        """Where the robot is elsewhere."""
        return (self.error_m > FAR_M) | (self.error_rad > FAR_RAD)

    @property
    def is_known(self) -> NDArray[np.bool_]:
        """Where the localizer was sure."""
        return self.states == "localized"

    def episodes(self, condition: NDArray[np.bool_], least_s: float = 0.0) -> list[float]:
        """How long the condition held each time that it held at least so long [s]."""
        edges = np.diff(np.concatenate([[False], condition, [False]]).astype(np.int8))
        spans = zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1, strict=True)
        lasted = [float(self.stamps_s[last] - self.stamps_s[first]) for first, last in spans]
        return [one for one in lasted if one >= least_s]


class Wanderer:
    """All that drives a robot, in lock-step, and random goals.

    Args:
        world: a world file, the demo's or one from `write_world`.
        seed: of everything random.
        told: where the localizer is told that the robot starts.
        true: where it starts; None: where the world says.
        more: TOML for the robot's configuration.
    """

    def __init__(
        self,
        world: Path,
        seed: int,
        told: Pose2D = START,
        true: Pose2D | None = None,
        more: str = "",
    ) -> None:
        rest = f'[base.simulated]\nworld = "{world}"\nseed = {seed}\n'
        if true is not None:
            rest += f"start = {{ x = {true.x}, y = {true.y}, yaw = {true.yaw} }}\n"
        rest += "[planner]\nturn_to_find = true\n" + more
        config = make_config(APARTMENT, told, rest)
        self.lockstep = Lockstep(config.robot.name, seed)
        self.truths = self.lockstep.record(topics.SIM_TRUTH)
        self.poses = self.lockstep.record(topics.POSE)
        self.suspects = self.lockstep.record(topics.SUSPECTS)
        self._goals = self.lockstep.record(topics.GOAL)
        self._base = self.lockstep.add(BaseService(config))
        self.lockstep.add(LocalizerService(config))
        self.lockstep.add(PlannerService(config))
        self.map = load_map(APARTMENT)
        self.floor = load_world(world).grid
        self._distance = distance_transform(self.map.occupied_mask(), self.map.resolution)
        self._rng = np.random.default_rng(seed)
        self._goal_since_s = -math.inf
        self.goals = 0

    @property
    def latest(self) -> PoseEstimate:
        """The newest estimate."""
        return self.poses[-1]

    @property
    def is_known(self) -> bool:
        """Whether the localizer is sure."""
        return bool(self.poses) and self.latest.state == "localized"

    @property
    def true_pose(self) -> Pose2D:
        """Where the robot is."""
        return self.truths[-1].pose

    def run_until(self, happened: Callable[[], bool], seconds: float) -> bool:
        """Drive from goal to goal until something has happened."""
        end_s = self.lockstep.now_s + seconds
        while self.lockstep.now_s < end_s:
            self._drive_on()
            self.lockstep.run(STEP_S)
            if happened():
                return True
        return False

    def run(self, seconds: float) -> None:
        """Drive from goal to goal."""
        self.run_until(lambda: False, seconds)

    def _drive_on(self) -> None:
        """Choose another goal if there is none, or if it takes too long."""
        if not self.poses or self.latest.state not in ("localized", "unsure"):
            return
        is_busy = bool(self._goals) and self._goals[-1].state not in ENDED
        if is_busy and self.lockstep.now_s - self._goal_since_s < PATIENCE_S:
            return
        pose = free_poses(self.map, 0.3, 1, self._rng)[0]
        try:
            self.lockstep.ask(requests.GOAL_SEND, SendGoal(pose=pose))
        except codes.Refused:
            return  # in a room that cannot be reached, or with something on it: another one then
        self._goal_since_s = self.lockstep.now_s
        self.goals += 1

    def lift(self, place: Pose2D) -> None:
        """Put the robot elsewhere; its wheels do not notice."""
        hardware = self._base.hardware
        assert isinstance(hardware, SimulatedHardware)
        hardware.simulation.lift_robot(place)

    def explained_share(self, from_pose: Pose2D, at: Pose2D) -> float:
        """Share of what a lidar really sees at one pose that the map explains from another."""
        ranges = seen_from(self.floor, at, 360, 8.0).astype(np.float64)
        angles = -math.pi + np.arange(360) * (2.0 * math.pi / 360)
        seen = np.isfinite(ranges)
        ends = np.column_stack([ranges * np.cos(angles), ranges * np.sin(angles)])[seen]
        cells = self.map.world_to_cell(from_pose.transform_points(ends))
        inside = self.map.contains_cell(cells)
        near = self._distance[tuple(cells[inside].T)] <= 0.15
        return float(np.count_nonzero(near)) / max(1, len(ends))

    def set_pose(self, pose: Pose2D) -> None:
        """Tell the localizer where the robot is."""
        self.lockstep.ask(requests.POSE_SET, SetPose(pose=pose))

    def track(self) -> Track:
        """What was said and what was true."""
        stamps = np.array([truth.stamp_ns for truth in self.truths], np.float64)
        x = np.array([truth.pose.x for truth in self.truths])
        y = np.array([truth.pose.y for truth in self.truths])
        yaw = np.unwrap([truth.pose.yaw for truth in self.truths])
        at = np.array([pose.stamp_ns for pose in self.poses], np.float64)
        true = np.column_stack([np.interp(at, stamps, column) for column in (x, y, yaw)])
        error_m, error_rad = np.full(at.size, np.inf), np.full(at.size, np.inf)
        for k, estimate in enumerate(self.poses):
            if estimate.pose is not None:
                error_m[k] = estimate.pose.distance_to(Pose2D.from_array(true[k]))
                error_rad[k] = abs(angle_difference(estimate.pose.yaw, float(true[k, 2])))
        states = np.array([pose.state for pose in self.poses])
        return Track(at * 1e-9, error_m, error_rad, states)

    def close(self) -> None:
        """Stop everything."""
        self.lockstep.close()
