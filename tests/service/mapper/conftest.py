"""A mapper and a localizer in lock-step with a base that drives as told through two rooms."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from support.flatland import Flatland, two_rooms, with_block

from trolley import requests, topics
from trolley.codes import Refused
from trolley.config import RobotConfig
from trolley.geometry import Pose2D, Twist2D
from trolley.gridmap import GridMap
from trolley.messages import Clock, GoalStatus, MappingStatus, PoseEstimate
from trolley.messages.request_params import MapNamed, WhichGoal
from trolley.runtime.lockstep import Lockstep
from trolley.runtime.service import Service, answers, every
from trolley_localizer.service import LocalizerService
from trolley_mapper.edit.map_versions import MapVersions
from trolley_mapper.service import MapperService
from trolley_tour.service import TourService

EPOCH_NS = 7_000_000_000
START = Pose2D(1.0, 2.6, 0.3)


def flat() -> GridMap:
    """Two rooms that no robot mixes up."""
    furnished = with_block(two_rooms(), 1.5, 0.6, 0.8, 0.3)
    furnished = with_block(furnished, 0.1, 4.6, 0.5, 1.3)
    return with_block(furnished, 6.2, 4.0, 0.9, 0.6)


class Base(Service):
    """Clock, odometry and lidar of a robot that drives as told."""

    name = "base"

    def __init__(self, world: Flatland, run_ns: int = EPOCH_NS) -> None:
        self.world = world
        self.twist = Twist2D.zero()
        self.silent: set[str] = set()
        self.run_ns = run_ns
        self.began_ns = 0

    def stamp(self) -> int:
        return self.run_ns + self.monotonic_ns - self.began_ns

    def start(self) -> None:
        self.began_ns = self.monotonic_ns
        self.tell_time()
        self.publish(topics.ROBOT, self.world.robot())
        if "tf/laser" not in self.silent:
            self.publish(topics.TF, self.world.mounting(), "laser")

    def restart(self, later_s: int = 120) -> None:
        """Begin anew: later, and with the odometry at zero."""
        self.run_ns, self.began_ns = self.stamp() + later_s * 1_000_000_000, self.monotonic_ns
        self.world.odom_T_base = Pose2D.identity()
        self.tell_time()

    @every(0.1, clock="local")
    def tell_time(self) -> None:
        self.publish(topics.CLOCK, Clock(stamp_ns=self.stamp(), rate=1.0, epoch=self.run_ns))

    @every(0.05, clock="local")
    def move(self) -> None:
        self.world.drive(self.twist, 0.05)
        if "odom" not in self.silent:
            self.publish(topics.ODOM, self.world.odometry(self.stamp()))

    @every(0.1, clock="local")
    def see(self) -> None:
        if "scan" not in self.silent:
            self.publish(topics.SCAN, self.world.scan(self.stamp()))


class Planner(Service):
    """One that drives to a goal until it is canceled."""

    name = "planner"
    num_canceled = 0

    @answers(requests.GOAL_CANCEL)
    def cancel(self, _: WhichGoal) -> GoalStatus:
        self.num_canceled += 1
        return GoalStatus(stamp_ns=0, id=None, state="canceled")


class Stage:
    """The services on a bus, and what they said."""

    def __init__(self, folder: Path, *services: str) -> None:
        self.world = Flatland(flat(), START)
        plain = {"robot": {"name": "trolley", "footprint": {"radius_m": 0.17}}}
        self.config = msgspec.convert(plain, RobotConfig)
        self.bus = Lockstep(seed=1, state=folder)
        self.said = self.bus.record(topics.MAPPING)
        self.poses = self.bus.record(topics.POSE)
        self.maps = self.bus.record(topics.MAP)
        self.base = self.bus.add(Base(self.world))
        for name in services:
            self.begin(name)
        self.bus.run(0.5)

    def begin(self, name: str) -> None:
        """Start a service, anew if it was killed."""
        kinds: dict[str, Callable[[RobotConfig], Service]] = {
            "localizer": LocalizerService,
            "mapper": MapperService,
            "tour": TourService,
        }
        self.bus.add(kinds[name](self.config))

    def drive(self, seconds: float, vx: float = 0.25, wz: float = 0.0) -> None:
        """Let the robot drive, then stand."""
        self.base.twist = Twist2D(vx, 0.0, wz)
        self.bus.run(seconds)
        self.base.twist = Twist2D.zero()
        self.bus.run(0.3)

    def ask(self, request: requests.Request[Any, Any], params: msgspec.Struct | None = None) -> Any:
        return self.bus.ask(request, params)

    def refusal(
        self, request: requests.Request[Any, Any], params: msgspec.Struct | None = None
    ) -> Refused:
        """What a request is refused with."""
        with pytest.raises(Refused) as refused:
            self.ask(request, params)
        return refused.value

    def map(self, name: str = "home", seconds: float = 6.0) -> Pose2D:
        """Begin a map and drive a bit; returns where the map has its origin, true_T_map."""
        origin = self.world.map_T_base
        self.ask(requests.MAP_NEW, MapNamed(name=name))
        self.bus.run(0.5)
        self.drive(seconds / 2, 0.25, 0.15)
        self.drive(seconds / 2, 0.1, -0.5)
        return origin

    def straightened(self, true_T_map: Pose2D, name: str = "home") -> Pose2D:
        """Where a saved map has its origin, whose axes run along its walls now: true_T_map."""
        saved = MapVersions(self.bus.state / "maps").newest(name)
        assert saved is not None
        assert saved.start is not None
        return true_T_map @ saved.start.inverse()

    @property
    def status(self) -> MappingStatus:
        return self.said[-1]

    @property
    def pose(self) -> PoseEstimate:
        return self.poses[-1]

    def error_m(self, true_T_map: Pose2D) -> float:
        """How far the newest pose is off."""
        assert self.pose.pose is not None
        return (true_T_map @ self.pose.pose).distance_to(self.world.map_T_base)


@pytest.fixture
def make_stage(tmp_path: Path) -> Iterator[Callable[..., Stage]]:
    stages: list[Stage] = []

    def make(*services: str) -> Stage:
        stages.append(Stage(tmp_path / "state", *(services or ("localizer", "mapper"))))
        return stages[-1]

    yield make
    for stage in stages:
        stage.bus.close()


@pytest.fixture
def stage(make_stage: Callable[..., Stage]) -> Stage:
    return make_stage()
