"""A robot that runs into something which its lidar cannot see drives around it from then on."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest

from trolley import codes, requests, topics
from trolley.config import RobotConfig
from trolley.geometry import Pose2D
from trolley.gridmap import FREE, OCCUPIED, GridMap, save_map
from trolley.messages import GoalStatus, Truth
from trolley.messages.request_params import SendGoal
from trolley.runtime.lockstep import Lockstep
from trolley_base.drivers import ChassisReading, Contact
from trolley_base.service import BaseService
from trolley_planner.service import PlannerService

WORLD = """
map = "hall.yaml"
start = {x = -1.5, y = 0.0, yaw = 0.0}
[[box]]
x = 0.0
y = 0.0
length_m = 0.15
width_m = 0.25
seen = false
[lidar]
noise_m = 0.0
"""
CONTACT_M = 0.002


class Stage:
    """Base and planner in lock-step; the simulated chassis has a bumper around its front."""

    def __init__(self, folder: Path, listed: dict[str, object]) -> None:
        cells = np.full((84, 124), OCCUPIED, dtype=np.int8)
        cells[2:-2, 2:-2] = FREE
        save_map(GridMap("hall", 0.05, Pose2D(-3.1, -2.1, 0.0), cells), folder / "hall.yaml")
        (folder / "low.toml").write_text(WORLD)
        plain = {
            "robot": {"name": "trolley", "footprint": {"radius_m": 0.17}},
            "base": {"simulated": {"world": "low", "seed": 3}, "scans": listed},
            "planner": {"frame": "odom"},
            "folder": str(folder),
        }
        config = msgspec.convert(plain, RobotConfig)
        self.lockstep = Lockstep("trolley", state=folder / "state")
        self.truths: list[Truth] = self.lockstep.record(topics.SIM_TRUTH)
        self.goals: list[GoalStatus] = self.lockstep.record(topics.GOAL)
        self.base = self.lockstep.add(BaseService(config))
        self.lockstep.add(PlannerService(config))
        self.num_hits = 0
        self._is_hit = False
        chassis = self.base.hardware.chassis
        read = chassis.read

        def feel() -> ChassisReading:
            was_hit, self._is_hit = self._is_hit, self.truths[-1].clearance < CONTACT_M
            self.num_hits += self._is_hit and not was_hit
            felt = ((-1.0, 1.0),) if self._is_hit else ()
            alarms = (codes.BUMPER,) if self._is_hit else ()
            contacts = (Contact(codes.BUMPER, felt),)
            return dataclasses.replace(read(), contacts=contacts, alarms=alarms)

        self.lockstep.run(1.0)
        chassis.read = feel  # type: ignore[method-assign]

    def go(self, x: float) -> GoalStatus:
        """Drive there, or give up; seconds of simulated time are cheap."""
        self.lockstep.ask(requests.GOAL_SEND, SendGoal(pose=Pose2D(x, 0.0, 0.0)))
        self.lockstep.run_until(lambda: self.goals[-1].state in ("arrived", "failed"), 120.0)
        return self.goals[-1]


@pytest.fixture
def stages() -> Iterator[list[Stage]]:
    made: list[Stage] = []
    yield made
    for stage in made:
        stage.lockstep.close()


def test_it_drives_around_what_its_bumper_has_met(tmp_path: Path, stages: list[Stage]) -> None:
    stage = Stage(tmp_path, {"bumper": {"kept_s": 60.0}})
    stages.append(stage)
    assert stage.go(3.0).state == "arrived"
    assert stage.num_hits == 1


@pytest.mark.slow
def test_it_never_gets_past_where_the_bumper_is_not_listed(
    tmp_path: Path, stages: list[Stage]
) -> None:
    stage = Stage(tmp_path, {})
    stages.append(stage)
    assert stage.go(3.0).reason == "blocked"
    assert stage.num_hits > 1
