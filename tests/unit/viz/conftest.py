"""A viewer in lock-step, a pretend robot that it watches, and pretend browsers that watch it."""

import contextlib
import socket
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import viser

from trolley import requests, topics
from trolley.codes import Refused
from trolley.config import FootprintConfig, RobotConfig, RobotSection, VizConfig
from trolley.geometry import Pose2D, Twist2D
from trolley.messages import (
    BaseState,
    Clock,
    GoalStatus,
    OccupancyGrid,
    Odometry,
    PoseEstimate,
    Robot,
    SavedPose,
    SavedPoses,
    Scan,
    TourStatus,
    Transform,
    floats_to_bytes,
)
from trolley.messages.request_params import Nothing, SendGoal, SetPose, StartTour, WhichGoal
from trolley.runtime.lockstep import Lockstep
from trolley.runtime.service import Service, answers, every
from trolley_viz.panels.console import Console
from trolley_viz.server.access import AccessControl, AccessTokens
from trolley_viz.server.visitors import NOBODY, Visitor
from trolley_viz.server.web_server import open_server
from trolley_viz.service import VizService
from trolley_viz.session.hub import Hub
from trolley_viz.session.robot_scene import RobotScene
from trolley_viz.session.session import Session


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class PretendRobot(Service):
    """Stands still in the middle of an empty map and says all that a robot says."""

    name = "base"

    def __init__(self) -> None:
        self.epoch = 0
        self.mode = "ok"
        self.deaf = False
        self.stops = 0
        self.goals: list[SendGoal] = []
        self.poses_set: list[SetPose] = []
        self.tours: list[StartTour] = []
        self.driven_m = 0.0
        """How far it has driven along its x."""

    def start(self) -> None:
        name, square = self.robot, [(0.2, -0.2), (0.2, 0.2), (-0.2, 0.2), (-0.2, -0.2)]
        self.publish(
            topics.ROBOT,
            Robot(
                stamp_ns=0,
                name=name,
                title=name.title(),
                footprint=square,
                drive="differential",
                max_speed=0.6,
                max_wz=1.5,
                deceleration=0.8,
            ),
        )
        cells = np.zeros((40, 60), np.int8)
        cells[0] = 100
        self.publish(
            topics.MAP,
            OccupancyGrid(
                stamp_ns=0,
                name="room",
                frame="map",
                resolution=0.1,
                width=60,
                height=40,
                origin=Pose2D(-3.0, -2.0, 0.0),
                cells=memoryview(cells.tobytes()),
            ),
        )
        self.publish(topics.TF, transform("base_link", "laser", Pose2D(0.1, 0.0, 0.0)), "laser")
        kitchen = SavedPose(name="kitchen", map="room", pose=Pose2D(2.0, 1.0, 0.0))
        elsewhere = SavedPose(name="attic", map="house", pose=Pose2D(0.0, 0.0, 0.0))
        self.publish(topics.POSES, SavedPoses(stamp_ns=0, poses=[kitchen, elsewhere]))

    @every(0.1, clock="local")
    def tick(self) -> None:
        stamp = self.epoch + self.monotonic_ns
        self.publish(topics.CLOCK, Clock(stamp_ns=stamp, rate=1.0, epoch=self.epoch))
        link = transform("map", "odom", Pose2D(1.0, 0.0, 0.0), stamp)
        self.publish(topics.TF, link, "odom")
        still = Twist2D(0.0, 0.0, 0.0)
        pose = Pose2D(0.5 + self.driven_m, 0.0, 0.0)
        self.publish(topics.ODOM, Odometry(stamp_ns=stamp, pose=pose, twist=still))
        self.publish(
            topics.POSE,
            PoseEstimate(
                stamp_ns=stamp,
                map="room",
                pose=Pose2D(1.5, 0.0, 0.0),
                covariance=None,
                state="localized",
                match=0.93,
                spread=0.05,
            ),
        )
        self.publish(topics.BASE, BaseState(stamp_ns=stamp, mode=self.mode))  # type: ignore[arg-type]
        ranges = floats_to_bytes(np.array([1.0, np.inf, 0.0, 2.0]))
        self.publish(topics.SCAN, scan(stamp, ranges))

    @answers(requests.BASE_STOP)
    def stop_now(self, params: Nothing) -> BaseState:
        self.stops += 1
        if self.deaf:
            raise Refused("timeout")
        self.mode = "stopped"
        return BaseState(stamp_ns=self.stamp_ns, mode="stopped")

    @answers(requests.BASE_RESUME)
    def go_on(self, params: Nothing) -> BaseState:
        self.mode = "ok"
        return BaseState(stamp_ns=self.stamp_ns, mode="ok")

    @answers(requests.GOAL_SEND)
    def send(self, params: SendGoal) -> GoalStatus:
        self.goals.append(params)
        if params.pose is not None and params.pose.x > 3.0:
            raise Refused("outside_map")
        return self._say_goal(params.id, "driving", params.pose)

    @answers(requests.GOAL_CANCEL)
    def cancel(self, params: WhichGoal) -> GoalStatus:
        return self._say_goal(params.id, "canceled", None)

    @answers(requests.POSE_SET)
    def set_pose(self, params: SetPose) -> PoseEstimate:
        self.poses_set.append(params)
        return PoseEstimate(
            stamp_ns=self.stamp_ns,
            map="room",
            pose=params.pose,
            covariance=None,
            state="localized",
            match=0.9,
            spread=0.1,
        )

    @answers(requests.TOUR_START)
    def start_tour(self, params: StartTour) -> TourStatus:
        self.tours.append(params)
        return TourStatus(stamp_ns=self.stamp_ns, name=None, trip="t1", state="driving")

    def _say_goal(self, goal_id: str | None, state: Any, pose: Pose2D | None) -> GoalStatus:
        status = GoalStatus(stamp_ns=self.stamp_ns, id=goal_id, state=state, pose=pose)
        self.publish(topics.GOAL, status)
        return status


def transform(parent: str, child: str, pose: Pose2D, stamp_ns: int = 0) -> Transform:
    return Transform(stamp_ns=stamp_ns, parent=parent, child=child, pose=pose)


def scan(stamp_ns: int, ranges: memoryview) -> Scan:
    return Scan(
        stamp_ns=stamp_ns,
        frame="laser",
        angle_min=0.0,
        angle_increment=np.pi / 2,
        time_increment=0.0,
        range_min=0.1,
        range_max=8.0,
        ranges=ranges,
    )


class OwnScene:
    """Puts what one browser sees alone beside what all see, under other paths."""

    def __init__(self, scene: viser.SceneApi, above: str) -> None:
        self._scene = scene
        self._above = above

    def __getattr__(self, name: str) -> Any:
        add = getattr(self._scene, name)
        return lambda path, *args, **options: add(f"{self._above}{path}", *args, **options)


class Browser:
    """Stands for viser's handle of one browser."""

    def __init__(self, client_id: int, server: viser.ViserServer) -> None:
        self.client_id = client_id
        # An API of its own, as viser gives each browser; what goes there is kept and not sent.
        self.scene = cast(Any, OwnScene(server.scene, f"/own{client_id}"))
        self.gui = server.gui
        self.camera = SimpleNamespace(image_width=1200, image_height=800, fov=0.7)
        self.camera.position = np.array([0.0, 0.0, 10.0])
        self.camera.wxyz = np.array([0.0, 1.0, 0.0, 0.0])  # looks straight down
        self.notices: list[tuple[str, str]] = []
        self.shown_notices: list[str] = []

    def atomic(self) -> contextlib.AbstractContextManager[None]:
        return contextlib.nullcontext()

    def add_notification(self, title: str, body: str, **_: Any) -> SimpleNamespace:
        self.notices.append((title, body))
        self.shown_notices.append(title)
        return SimpleNamespace(remove=lambda: self.shown_notices.remove(title))


class Stage:
    """Viewer and robot together."""

    def __init__(self, state: Path) -> None:
        self.runtime = Lockstep(state=state)
        self.config = RobotConfig(
            robot=RobotSection(
                name="trolley", footprint=FootprintConfig(length_m=0.4, width_m=0.4)
            ),
            viz=VizConfig(port=free_port()),
        )
        self.robot = self.runtime.add(PretendRobot())
        self.viz = self.runtime.add(VizService(self.config))

    def browse(self, client_id: int = 0, visitor: Visitor = NOBODY) -> Any:
        """Open a browser and let everything settle; the real handle is viser's."""
        browser = Browser(client_id, self.hub.server)
        self.hub.server.get_clients = lambda: self.viz.browsers  # type: ignore[method-assign, assignment, return-value]
        self.viz.open_browser(browser, visitor)  # type: ignore[arg-type]
        self.runtime.run(0.5)
        return browser

    @property
    def session(self) -> Session:
        """Of the browser that came first."""
        return next(iter(self.viz.browsers.values())).session

    @property
    def console(self) -> Console:
        """Of the browser that came first."""
        return next(iter(self.viz.browsers.values())).console

    @property
    def hub(self) -> Hub:
        assert self.viz.hub is not None
        return self.viz.hub

    @property
    def scenes(self) -> Mapping[str, RobotScene]:
        return self.hub.scenes.by_robot

    def layer(self, key: str, robot: str = "trolley") -> Any:
        return self.scenes[robot].scene.layer(key)

    def streams(self, robot: str = "trolley") -> set[str]:
        """The streams that are subscribed to."""
        stage = self.scenes.get(robot)
        return set() if stage is None else set(stage.streams.names())


@pytest.fixture
def stage(tmp_path: Path) -> Iterator[Stage]:
    stage = Stage(tmp_path)
    yield stage
    stage.runtime.close()


def open_gate() -> AccessControl:
    return AccessControl(0, (), always_ask=False, tokens=AccessTokens.new())


@pytest.fixture
def server() -> Iterator[viser.ViserServer]:
    server = open_server(VizConfig(port=free_port()), open_gate())
    yield server
    server.stop()
