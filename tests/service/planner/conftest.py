"""The planner service in lock-step, with a base and a localizer that make no errors."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.flatland import BOX, Flatland, two_rooms

from trolley import requests, topics
from trolley.config import FootprintConfig, PlannerConfig, RobotConfig, RobotSection
from trolley.geometry import Pose2D, Twist2D
from trolley.messages import BaseState, Clock, GoalStatus, VelocityCommand
from trolley.messages.request_params import SendGoal
from trolley.runtime.lockstep import Lockstep
from trolley.runtime.service import Service, every, on
from trolley_planner.service import PlannerService

EPOCH_NS = 7_000_000_000
START = Pose2D(1.0, 3.0, 0.0)


class PerfectRobot(Service):
    """Base and localizer in one: a clock, a flatland, and commands that are obeyed at once."""

    name = "base"

    def __init__(self, world: Flatland) -> None:
        self.world = world
        self.run_ns = EPOCH_NS
        self.began_ns = 0
        self.command: VelocityCommand | None = None
        self.command_ns = 0
        self.base_state = BaseState(stamp_ns=0, mode="ok")
        self.silent: set[str] = set()
        self.pose_state = "localized"
        self.off_map_m: float | None = None

    @property
    def robot_ns(self) -> int:
        return self.run_ns + self.monotonic_ns - self.began_ns

    def start(self) -> None:
        self.began_ns = self.monotonic_ns
        stamp = self.robot_ns
        self.tell_time()
        self.publish(topics.ROBOT, self.world.robot())
        self.publish(topics.TF, self.world.mounting(), "laser")
        self.publish(topics.MAP, self.world.map())
        self.publish(topics.ZONES, self.world.zone_list())
        self.publish(topics.TF, self.world.correction(stamp), "odom")

    def restart(self) -> None:
        """Begin a new epoch."""
        self.run_ns, self.began_ns = self.robot_ns + 120_000_000_000, self.monotonic_ns
        self.tell_time()

    def say(self, **state: Any) -> None:
        """Publish a state of the base."""
        self.base_state = BaseState(stamp_ns=self.robot_ns, **state)
        self.publish(topics.BASE, self.base_state)

    @every(0.1, clock="local")
    def tell_time(self) -> None:
        if "clock" not in self.silent:
            self.publish(topics.CLOCK, Clock(stamp_ns=self.robot_ns, rate=1.0, epoch=self.run_ns))

    @on(topics.COMMAND, "planner")
    def obey(self, command: VelocityCommand, *_: str) -> None:
        self.command, self.command_ns = command, self.monotonic_ns

    @every(0.05, clock="local")
    def move(self) -> None:
        twist = Twist2D.zero()
        if self.command is not None and self.monotonic_ns - self.command_ns < 0.3e9:
            twist = self.command.twist
        self.world.drive(twist, 0.05)
        if "odom" not in self.silent:
            self.publish(topics.ODOM, self.world.odometry(self.robot_ns))

    @every(0.1, clock="local")
    def see(self) -> None:
        stamp = self.robot_ns
        if "scan" not in self.silent:
            self.publish(topics.SCAN, self.world.scan(stamp))
        if "pose" not in self.silent:
            if "correction" not in self.silent:
                self.publish(topics.TF, self.world.correction(stamp), "odom")
            self.publish(topics.POSE, self.world.estimate(stamp, self.pose_state, self.off_map_m))


class Stage:
    """A planner, the robot that obeys it, and what was said."""

    def __init__(self, folder: Path, world: Flatland, **planner: Any) -> None:
        section = RobotSection(name="trolley", footprint=FootprintConfig(polygon_m=list(BOX)))
        settings = PlannerConfig(**planner)
        self.config = RobotConfig(robot=section, planner=settings)
        self.lockstep = Lockstep(state=folder, seed=3)
        self.world = world
        self.robot = PerfectRobot(world)
        self.commands = self.lockstep.record(topics.COMMAND, "planner")
        self.goals = self.lockstep.record(topics.GOAL)
        self.paths = self.lockstep.record(topics.PATH)
        self.lockstep.add(self.robot)
        self.planner = self.lockstep.add(PlannerService(self.config))
        self.lockstep.run(0.5)

    def send(self, pose: Pose2D, **params: Any) -> GoalStatus:
        """Ask for a goal."""
        asked = SendGoal(pose=pose, **params)
        return self.lockstep.ask(requests.GOAL_SEND, asked)

    def until(self, state: str, seconds: float = 90.0) -> GoalStatus:
        """Let time pass until the goal is in a state."""
        assert self.lockstep.run_until(lambda: self.goals[-1].state == state, seconds)
        return self.goals[-1]

    def stands(self) -> bool:
        """Whether the robot has been commanded to stand, or nothing at all."""
        self.lockstep.run(0.6)
        return self.world.twist.is_zero


@pytest.fixture
def stage(tmp_path: Path) -> Iterator[Stage]:
    """A robot in the left one of two rooms."""
    made = Stage(tmp_path, Flatland(two_rooms(), START))
    yield made
    made.lockstep.close()


@pytest.fixture
def far_side() -> Pose2D:
    """A place in the room on the right."""
    return Pose2D(6.5, 4.5, 0.5 * math.pi)
