"""Several robots in one flatland, each with a planner: they see each other, and obey at once."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from support.flatland import BEAMS, BOX, Flatland
from trolley import requests, topics
from trolley.config import FootprintConfig, PlannerConfig, RobotConfig, RobotSection
from trolley.geometry import Pose2D, Twist2D
from trolley.gridmap import GridMap
from trolley.messages import BaseState, Battery, Clock, GoalStatus, VelocityCommand
from trolley.messages.request_params import SendGoal
from trolley.runtime.lockstep import Lockstep
from trolley.runtime.service import Service, every, on
from trolley_planner.fleet.neighbours import outline_discs
from trolley_planner.service import PlannerService

DISCS = outline_discs(np.array(BOX))


class SharedFlat(Flatland):
    """A flatland with other robots in it."""

    others: Sequence["SharedFlat"] = ()

    def discs(self) -> NDArray[np.float64]:
        """Where this robot's body is, (n, 3) x, y, radius."""
        return np.column_stack([self.pose.transform_points(DISCS[:, :2]), DISCS[:, 2]])

    def gap(self) -> float:
        """Between this robot's body and the nearest other one [m]."""
        mine, gaps = self.discs(), [math.inf]
        for other in self.others:
            for x, y, radius in other.discs():
                away = np.hypot(mine[:, 0] - x, mine[:, 1] - y) - mine[:, 2] - radius
                gaps.append(float(away.min()))
        return min(gaps)

    def drive(self, twist: Twist2D, dt: float) -> None:
        """Move, but not into another robot either."""
        before, odom, gap = self.pose, self.odom_T_base, self.gap()
        super().drive(twist, dt)
        if self.gap() < min(gap, 0.0):
            self.pose, self.odom_T_base, self.twist = before, odom, Twist2D.zero()
            self.touches += 1

    def ranges(self) -> NDArray[np.float32]:
        """What the lidar measures, other robots included."""
        ranges = super().ranges().astype(np.float64)
        laser = self.pose @ self.base_T_laser
        angles = laser.yaw + np.arange(BEAMS) * (2.0 * math.pi / BEAMS)
        for other in self.others:
            for x, y, radius in other.discs():
                dx, dy = x - laser.x, y - laser.y
                along = dx * np.cos(angles) + dy * np.sin(angles)
                inside = radius**2 - (dx * dx + dy * dy - along * along)
                hit = (inside > 0.0) & (along > 0.0)
                near = along - np.sqrt(np.where(hit, inside, 0.0))
                ranges = np.where(hit, np.minimum(ranges, near), ranges)
        return ranges.astype(np.float32)


class FlatRobot(Service):
    """Base and localizer in one."""

    name = "base"

    def __init__(self, world: SharedFlat) -> None:
        self.world = world
        self.command: VelocityCommand | None = None
        self.command_ns = 0

    def start(self) -> None:
        self.tell_time()
        self.publish(topics.ROBOT, self.world.robot())
        self.publish(topics.TF, self.world.mounting(), "laser")
        self.publish(topics.MAP, self.world.map())
        self.publish(topics.ZONES, self.world.zone_list())
        self.publish(topics.TF, self.world.correction(self.monotonic_ns), "odom")

    def say(self, **state: Any) -> None:
        """Publish a state of the base."""
        self.publish(topics.BASE, BaseState(stamp_ns=self.monotonic_ns, **state))

    def charge(self) -> None:
        """Stand at the charger."""
        self.say(mode="ok", battery=Battery(charging=True))

    @every(0.1, clock="local")
    def tell_time(self) -> None:
        self.publish(topics.CLOCK, Clock(stamp_ns=self.monotonic_ns, rate=1.0, epoch=0))

    @on(topics.COMMAND, "planner")
    def obey(self, command: VelocityCommand, *_: str) -> None:
        self.command, self.command_ns = command, self.monotonic_ns

    @every(0.05, clock="local")
    def move(self) -> None:
        twist = Twist2D.zero()
        if self.command is not None and self.monotonic_ns - self.command_ns < 0.3e9:
            twist = self.command.twist
        self.world.drive(twist, 0.05)
        self.publish(topics.ODOM, self.world.odometry(self.monotonic_ns))

    @every(0.1, clock="local")
    def see(self) -> None:
        self.publish(topics.SCAN, self.world.scan(self.monotonic_ns))
        self.publish(topics.TF, self.world.correction(self.monotonic_ns), "odom")
        self.publish(topics.POSE, self.world.estimate(self.monotonic_ns))


class Household:
    """Robots `a`, `b`, ... on one bus."""

    def __init__(self, folder: Path, grid: GridMap, starts: Sequence[Pose2D]) -> None:
        self.names = [chr(ord("a") + index) for index in range(len(starts))]
        self.lockstep = Lockstep("a", seed=3, state=folder)
        self.worlds = [SharedFlat(grid, start) for start in starts]
        self.said: dict[str, list[GoalStatus]] = {}
        self.robots: dict[str, FlatRobot] = {}
        self.configs: list[RobotConfig] = []
        settings = PlannerConfig(rollouts=64, control_rate_hz=10.0)
        for name, world in zip(self.names, self.worlds, strict=True):
            world.others = [other for other in self.worlds if other is not world]
            section = RobotSection(name=name, footprint=FootprintConfig(polygon_m=list(BOX)))
            self.said[name] = self.lockstep.record(topics.GOAL, robot=name)
            self.robots[name] = self.lockstep.add(FlatRobot(world), name)
            self.configs.append(RobotConfig(robot=section, planner=settings))
            self.lockstep.add(PlannerService(self.configs[-1]), name)
        self.lockstep.run(0.5)

    def send(self, name: str, x: float, y: float) -> None:
        """Send a robot somewhere."""
        goal = SendGoal(pose=Pose2D(x, y, 0.0), xy_tolerance=0.1, yaw_tolerance=3.2)
        self.lockstep.ask(requests.GOAL_SEND, goal, robot=name)

    def run_until_ended(self, seconds: float) -> dict[str, str]:
        """Let time pass until no goal is under way; return how each of them ended."""
        ends = ("arrived", "failed", "canceled", "idle")
        self.lockstep.run_until(
            lambda: all(s[-1].state in ends for s in self.said.values()), seconds
        )
        return {name: said[-1].state for name, said in self.said.items()}

    def messages(self, name: str) -> list[str]:
        """What a robot said, each sentence once, in its order."""
        return list(dict.fromkeys(status.message for status in self.said[name] if status.message))

    @property
    def touches(self) -> int:
        """How often a robot drove into anything."""
        return sum(world.touches for world in self.worlds)
