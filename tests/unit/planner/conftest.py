"""A planner that drives a robot without errors, without any service around."""

from collections.abc import Callable
from typing import Any

import pytest
from support.flatland import MAP_T_ODOM, Flatland

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D
from trolley.messages import BaseState, GoalStatus
from trolley.messages.request_params import SendGoal
from trolley_planner.navigator import Navigator

STEP_NS = 50_000_000


class Ride:
    """The planner's core in a flatland, step by step: 20 Hz odometry and commands, 10 Hz scans."""

    def __init__(self, world: Flatland, config: PlannerConfig | None = None) -> None:
        self.world = world
        self.navigator = Navigator(config or PlannerConfig())
        self.now_ns = 0
        self.pose_state = "localized"
        self.commands: list[Twist2D | None] = []
        self.statuses: list[GoalStatus] = []
        inputs = self.navigator.inputs
        inputs.robot = world.robot()
        inputs.base_T_laser = world.base_T_laser
        if inputs.frame == "map":
            inputs.map, inputs.zones = world.map(), world.zone_list()
        inputs.base = BaseState(stamp_ns=0, mode="ok")
        self.step()

    def step(self, num: int = 1) -> None:
        """Let 50 ms pass, `num` times."""
        for _ in range(num):
            self.now_ns += STEP_NS
            odometry = self.world.odometry(self.now_ns)
            inputs = self.navigator.inputs
            inputs.odometry = odometry
            if (self.now_ns // STEP_NS) % 2:
                if inputs.frame == "map":
                    inputs.update_correction(self.world.correction(self.now_ns))
                    inputs.pose = self.world.estimate(self.now_ns, self.pose_state)
                scan = self.world.scan(self.now_ns)
                self.navigator.update_scan(scan, [odometry], self.now_ns, self.now_ns)
            twist = self.navigator.command(self.now_ns)
            self.navigator.maintain(self.now_ns)
            self.commands.append(twist)
            self.statuses += self.navigator.current.board.pop_changes()
            self.world.drive(twist or Twist2D.zero(), STEP_NS * 1e-9)

    def send(self, pose: Pose2D, **params: Any) -> GoalStatus:
        """Ask for a goal given in frame `grid`."""
        asked = SendGoal(pose=self.world.grid.origin @ pose, **params)
        return self.navigator.requests.send(asked, f"made-{self.now_ns}", self.now_ns)

    def until_over(self, seconds: float = 120.0) -> GoalStatus:
        """Drive until the goal is over, or for so long."""
        return self.until(lambda: not self.navigator.current.board.is_active, seconds)

    def until(self, happened: Callable[[], bool], seconds: float = 60.0) -> GoalStatus:
        """Drive until something is so."""
        for _ in range(round(seconds * 1e9 / STEP_NS)):
            if happened():
                break
            self.step()
        return self.navigator.current.status(self.now_ns)


@pytest.fixture
def ride() -> Callable[..., Ride]:
    """Makes a ride of a flatland and a configuration."""
    return Ride


@pytest.fixture
def map_T_odom() -> Pose2D:
    """Where the odometry began, on the map."""
    return MAP_T_ODOM
