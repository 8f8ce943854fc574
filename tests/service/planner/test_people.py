"""Planner, base and localizer among people who walk: what is left of them when they are gone."""

import importlib
import math
import pkgutil
from pathlib import Path

import numpy as np
import pytest
from bench.harness.drives import make_config
from support.flatland import empty_room, with_block

import trolley_planner
from trolley import requests, topics
from trolley.geometry import Pose2D
from trolley.gridmap import distance_transform, save_map
from trolley.messages.request_params import SendGoal
from trolley.messages.types import floats_from_bytes
from trolley.runtime.lockstep import Lockstep
from trolley_base.service import BaseService
from trolley_base.simulation.simulated_hardware import SimulatedHardware
from trolley_localizer.service import LocalizerService
from trolley_planner.costmap.costmap import Costmap
from trolley_planner.service import PlannerService

WALKS = [
    ([[2.0, 1.0], [8.0, 6.0]], 0.9),
    ([[2.0, 6.0], [8.0, 1.0]], 1.1),
    ([[5.0, 1.5], [5.0, 6.5]], 0.7),
    ([[1.5, 3.5], [8.5, 3.5]], 1.2),
]
MODULES = [one.name for one in pkgutil.walk_packages(trolley_planner.__path__, "trolley_planner.")]
WEST, EAST = Pose2D(1.0, 3.5, 0.0), Pose2D(9.0, 3.5, 0.0)
GOALS = [EAST, Pose2D(1.5, 6.0, 1.0), Pose2D(8.5, 1.0, 0.0), WEST]
NEAR_WALL_M = 0.3
"""The noise of lidar and pose leaves single echoes beside walls."""


def compiled() -> dict[str, int]:
    """How many versions of each kernel of the planner there are."""
    return {
        f"{module.__name__}.{name}": len(value.signatures)
        for module in map(importlib.import_module, MODULES)
        for name, value in vars(module).items()
        if hasattr(value, "signatures")
    }


class Hall:
    """A hall of 10 x 7 m with a wall that hides a part of it, a robot, and four people."""

    def __init__(self, folder: Path) -> None:
        grid = with_block(empty_room(10.0, 7.0), 4.5, 0.0, 0.3, 1.2)
        save_map(grid, folder / "hall.yaml")
        lines = ['map = "hall.yaml"', "start = { x = 1.0, y = 3.5, yaw = 0.0 }"]
        for number, (path, speed) in enumerate(WALKS):
            lines += ["[[person]]", f'name = "person {number}"', f"path = {path}"]
            lines += [f"speed_mps = {speed}", "legs = true", f"dwell_s = {0.5 * number}"]
        world = folder / "hall.toml"
        world.write_text("\n".join(lines))
        config = make_config(
            folder / "hall.yaml", WEST, f'[base.simulated]\nworld = "{world}"\nseed = 3\n'
        )
        self.lockstep = Lockstep(config.robot.name, 3)
        self.goals = self.lockstep.record(topics.GOAL)
        poses = self.lockstep.record(topics.POSE)
        self._base = self.lockstep.add(BaseService(config))
        self.lockstep.add(LocalizerService(config))
        self._planner = self.lockstep.add(PlannerService(config))
        assert self.lockstep.run_until(lambda: bool(poses) and poses[-1].state == "localized", 20.0)
        self._is_open = distance_transform(grid.occupied_mask(), 0.05) > NEAR_WALL_M
        self.ever_seen = np.zeros(grid.cells.shape, dtype=np.bool_)

    @property
    def costmap(self) -> Costmap:
        return self._planner.navigator.costmap_manager.require_context().costmap

    def seen(self) -> np.ndarray:
        """Where the costmap holds an obstacle away from the walls."""
        return (self.costmap.obstacle_layer.grid.evidence > 0) & self._is_open

    def drive_for(self, seconds: float, goals: list[Pose2D]) -> None:
        """Drive from goal to goal, and end at the last of them."""
        number, until_s = 0, self.lockstep.now_s + seconds
        while number == 0 or self.lockstep.now_s < until_s or number % len(goals):
            self.lockstep.ask(requests.GOAL_SEND, SendGoal(pose=goals[number % len(goals)]))
            number += 1
            for _ in range(400):
                self.lockstep.run(0.2)
                self.ever_seen |= self.seen()
                if self.goals[-1].state in ("arrived", "failed"):
                    break

    def send_people_home(self) -> None:
        """Take everybody out of the world."""
        hardware = self._base.hardware
        assert isinstance(hardware, SimulatedHardware)
        hardware.simulation.remove_people()


@pytest.mark.slow
@pytest.mark.timeout(3600)  # ten simulated minutes, on a busy machine
@pytest.mark.parametrize(
    ("minutes", "goals"),
    [(0.5, [EAST, WEST]), (10.0, GOALS)],
)
def test_nothing_is_left_of_people_who_are_gone(
    tmp_path: Path, minutes: float, goals: list[Pose2D]
) -> None:
    hall = Hall(tmp_path)
    ready = compiled()
    hall.drive_for(60.0 * minutes, goals)
    assert compiled() == ready, "a kernel was compiled while the robot drove"
    assert np.count_nonzero(hall.ever_seen) > 100, "the robot has met hardly anybody"
    hall.send_people_home()
    hall.lockstep.run(3.0)
    in_sight = hall.seen()
    in_sight[:24, 90:130] = False  # behind the wall
    assert not in_sight.any()
    hall.lockstep.run(7.0)
    assert not hall.seen().any()
    path = hall.lockstep.ask(requests.GOAL_PREVIEW, SendGoal(pose=EAST))
    poses = floats_from_bytes(path.poses).reshape(-1, 3).astype(np.float64)
    length = float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum())
    straight = math.dist(poses[0, :2], poses[-1, :2])
    assert straight > 7.8
    assert length <= 1.005 * straight
    assert np.abs(poses[:, 1] - 3.5).max() < 0.1
    hall.lockstep.close()
