"""A viewer in lock-step, a pretend robot that it watches, and pretend browsers that watch it."""

import contextlib
import math
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import viser
from support.processes import find_free_port

from trolley import requests, topics
from trolley.codes import Refused
from trolley.config import FootprintConfig, RobotConfig, RobotSection, VizConfig
from trolley.geometry import Pose2D, Twist2D
from trolley.messages import (
    BaseState,
    Clock,
    GoalStatus,
    Health,
    OccupancyGrid,
    Odometry,
    PoseEstimate,
    Proposal,
    Proposals,
    Robot,
    SavedPose,
    SavedPoses,
    Scan,
    TourStatus,
    Transform,
    floats_to_bytes,
)
from trolley.messages.mapping import PoseState
from trolley.messages.request_params import (
    FollowPerson,
    Nothing,
    SendGoal,
    SetPose,
    StartTour,
    WhichGoal,
    WhichProposal,
)
from trolley.runtime.lockstep import Lockstep
from trolley.runtime.service import Service, answers, every
from trolley_viz.joystick.teleop import PadState
from trolley_viz.languages.catalogue import ENGLISH, catalogues
from trolley_viz.languages.translator import Translator
from trolley_viz.pages.language import in_language
from trolley_viz.pages.page import Page
from trolley_viz.server.lines import Line
from trolley_viz.server.messages import Answer, Notice, PageState, Said, Told
from trolley_viz.server.visitors import NOBODY, Visitor
from trolley_viz.server.web_server import close_scene, open_scene
from trolley_viz.service import VizService
from trolley_viz.session.browser_scene import BrowserScene
from trolley_viz.session.hub import Hub
from trolley_viz.session.robot_scene import RobotScene
from trolley_viz.session.session import Session


class PretendRobot(Service):
    """Stands still in the middle of an empty map and says all that a robot says."""

    name = "base"

    def __init__(self) -> None:
        self.epoch = 0
        self.mode = "ok"
        self.pose_state: PoseState = "localized"
        self.deaf = False
        self.stops = 0
        self.goals: list[SendGoal] = []
        self.followed: list[FollowPerson] = []
        self.dismissed: list[str] = []
        self.poses_set: list[SetPose] = []
        self.tours: list[StartTour] = []
        self.driven_m = 0.0
        """How far it has driven along its x."""
        self.alive = ["localizer", "planner"]
        """The services that tell of their health."""

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
        self._say_goal(None, "idle", None)

    @every(1.0, clock="local")
    def tell_health(self) -> None:
        for name in self.alive:
            health = Health(stamp_ns=self.stamp_ns, state="ok", cpu=0.0, rss=0)
            self.publish(topics.HEALTH, health, name)

    @every(0.1, clock="local")
    def tick(self) -> None:
        stamp = self.epoch + self.monotonic_ns
        self.publish(topics.CLOCK, Clock(stamp_ns=stamp, rate=1.0, epoch=self.epoch))
        link = transform("map", "odom", Pose2D(1.0, 0.0, 0.0), stamp)
        self.publish(topics.TF, link, "odom")
        still = Twist2D(0.0, 0.0, 0.0)
        pose = Pose2D(0.5 + self.driven_m, 0.0, 0.0)
        self.publish(topics.ODOM, Odometry(stamp_ns=stamp, pose=pose, twist=still))
        self.publish(topics.POSE, self.estimate())
        self.publish(topics.BASE, BaseState(stamp_ns=stamp, mode=self.mode))  # type: ignore[arg-type]
        ranges = floats_to_bytes(np.array([1.0, np.inf, 0.0, 2.0]))
        self.publish(topics.SCAN, scan(stamp, ranges))

    def estimate(self) -> PoseEstimate:
        return PoseEstimate(
            stamp_ns=self.epoch + self.monotonic_ns,
            map="room",
            pose=Pose2D(1.5 + self.driven_m, 0.0, 0.0),
            covariance=None,
            state=self.pose_state,
            match=0.93,
            spread=0.05,
        )

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

    @answers(requests.PROPOSALS_DISMISS)
    def dismiss(self, params: WhichProposal) -> Proposal:
        self.dismissed.append(params.id)
        self.publish(topics.PROPOSALS, Proposals(stamp_ns=self.stamp_ns, proposals=[]))
        return Proposal(id=params.id, message="")

    @answers(requests.GOAL_SEND)
    def send(self, params: SendGoal) -> GoalStatus:
        self.goals.append(params)
        if params.pose is not None and params.pose.x > 3.0:
            raise Refused("outside_map")
        return self._say_goal(params.id, "driving", params.pose)

    @answers(requests.GOAL_FOLLOW)
    def follow(self, params: FollowPerson) -> GoalStatus:
        self.followed.append(params)
        status = GoalStatus(
            stamp_ns=self.stamp_ns,
            id=params.id,
            state="driving",
            pose=Pose2D(2.4, 0.0, 0.0),
            person=(3.6, 0.0),
        )
        self.publish(topics.GOAL, status)
        return status

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

    @answers(requests.POSE_FIND)
    def find_pose(self, _: Nothing) -> PoseEstimate:
        self.pose_state = "searching"
        return self.estimate()

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


MADE_UP = {
    "Fits.",
    "It is the file that robot.toml names.",
    "Something <is> so.",
    "Stored.",
    "appeared-2: Something <is> so.",
    "gone-1: Something <is> so.",
    "The disk is full.",
}
"""What programs and robots say here and nobody says elsewhere."""


class Listener(Translator):
    """A translator that remembers which texts it does not know."""

    def __init__(self) -> None:
        super().__init__(catalogues()["de"].all_texts().items())
        self.markup = self._in_markup  # pyrefly: ignore[bad-assignment]  # not cached: what is heard again counts again
        self.unknown: set[str] = set()

    def text(self, english: str) -> str:
        if not self.knows(english):
            self.unknown.add(english)
        return super().text(english)


GERMAN = Listener()


class PretendLine:
    """Stands for the connection to a page; what the page is told is kept, and beats are answered.

    Args:
        key: of the page.
        visitor: who it is.
        say: takes what the page says.
        end: takes note that the line is gone.
    """

    def __init__(
        self, key: str, visitor: Visitor, say: Callable[[Said], None], end: Callable[[], None]
    ) -> None:
        self.key = key
        self.visitor = visitor
        self._say, self._end = say, end
        self.told: list[Told] = []
        self.language = ENGLISH
        self.is_clear = True
        self.is_closed = False
        self.is_heard = True
        """Whether what the page says comes through by itself."""
        self.silence_s = math.inf
        """How long nothing has come in, also of what nobody has handled yet [s]."""

    def send(self, told: Told) -> None:
        self.told.append(told)
        if told.state is not None:
            self.language = told.state.language
        if self.language == ENGLISH:
            in_language(told, GERMAN)
        if told.beat_ms is not None and self.is_heard and not self.is_closed:
            self._say(Said(beat_ms=told.beat_ms))

    def close(self) -> None:
        self.is_closed = True
        self._end()


class Browser:
    """Stands for one browser: viser's handle of it, and the line of its page."""

    def __init__(self, client_id: int, server: viser.ViserServer, line: PretendLine) -> None:
        self.client_id = client_id
        # An API of its own, as viser gives each browser; what goes there is kept and not sent.
        self.scene = cast(Any, OwnScene(server.scene, f"/own{client_id}"))
        self.gui = SimpleNamespace(add_html=self._keep, configure_theme=lambda **_: None)
        self.camera = SimpleNamespace(image_width=1200, image_height=800, fov=0.7)
        self.camera.position = np.array([0.0, 0.0, 10.0])
        self.camera.wxyz = np.array([0.0, 1.0, 0.0, 0.0])  # looks straight down
        self.line = line
        self.secret = ""

    @property
    def notices(self) -> list[tuple[str, str]]:
        """Titles and texts of what the page was told to show for a while."""
        told = [one.notice for one in self.line.told]
        return [(one.title, one.text) for one in told if isinstance(one, Notice)]

    @property
    def answers(self) -> dict[int, Answer]:
        """What the page was answered, by the numbers of what it said."""
        told = [one.answer for one in self.line.told]
        return {one.id: one for one in told if isinstance(one, Answer)}

    @property
    def state(self) -> PageState:
        """The newest state that the page was told."""
        told = [one.state for one in self.line.told if one.state is not None]
        return told[-1]

    @property
    def pad(self) -> PadState:
        """The newest that the page was told of the joystick."""
        told = [one.pad for one in self.line.told if one.pad is not None]
        return told[-1]

    def atomic(self) -> contextlib.AbstractContextManager[None]:
        return contextlib.nullcontext()

    def _keep(self, html: str) -> None:
        (self.secret,) = re.findall('data-secret="(.*?)"', html)


class Stage:
    """Viewer and robot together."""

    def __init__(self, state: Path) -> None:
        self.runtime = Lockstep(state=state)
        self.config = RobotConfig(
            robot=RobotSection(
                name="trolley", footprint=FootprintConfig(length_m=0.4, width_m=0.4)
            ),
            viz=VizConfig(port=find_free_port()),
        )
        self.robot = self.runtime.add(PretendRobot())
        self.viz = self.runtime.add(VizService(self.config))
        self.browsers: dict[int, Any] = {}

    def browse(self, client_id: int = 0, visitor: Visitor = NOBODY) -> Any:
        """Open a browser and let everything settle; the real handle is viser's."""
        browser = Browser(client_id, self.hub.server, self.connect(client_id, visitor))
        self.show(browser)
        self.runtime.run(0.5)
        return browser

    def connect(self, client_id: int = 0, visitor: Visitor = NOBODY) -> PretendLine:
        """Open a line as the page of a browser does, again where there was one before."""
        viz = self.viz
        line = PretendLine(
            f"page-{client_id}",
            visitor,
            lambda said: viz.call_soon(lambda: viz.pages.hear(cast(Line, line), said)),
            lambda: viz.call_soon(lambda: viz.pages.close_line(cast(Line, line))),
        )
        viz.open_line(cast(Line, line))
        return line

    def show(self, browser: Any) -> None:
        """Connect viser's part of a browser, and let its page say that it is the same."""
        self.browsers[browser.client_id] = browser
        self.hub.server.get_clients = lambda: self.browsers  # type: ignore[method-assign, assignment, return-value]
        self.viz.pages.open_scene(browser)
        self.say(browser, Said(scene=browser.secret))

    def say(self, browser: Any, said: Said) -> None:
        """Say something as the page of a browser."""
        self.viz.pages.hear(cast(Line, browser.line), said)

    def leave(self, browser: Any) -> None:
        """Close a browser."""
        del self.browsers[browser.client_id]
        self.viz.pages.close_line(cast(Line, browser.line))
        self.viz.pages.close_scene(browser.client_id)

    @property
    def now_ms(self) -> float:
        """The viewer's time, as a page knows it."""
        return self.viz.monotonic_ns * 1e-6

    def page(self, client_id: int = 0) -> Page:
        """Of a browser."""
        (page,) = [one for one in self.viz.pages.all if one.key == f"page-{client_id}"]
        return page

    @property
    def session(self) -> Session:
        """Of the browser that came first."""
        return next(iter(self.viz.pages.all)).session

    def drawn(self, client_id: int = 0) -> BrowserScene:
        """What a browser alone has in its scene."""
        scene = self.page(client_id).session.window.scene
        assert scene is not None
        return scene

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


@pytest.fixture(autouse=True)
def all_that_is_told_is_in_the_catalogue() -> Iterator[None]:
    """Whatever a page is told in any test here can be said in another language."""
    GERMAN.unknown.clear()
    yield
    assert sorted(GERMAN.unknown - MADE_UP) == []


@pytest.fixture
def stage(tmp_path: Path) -> Iterator[Stage]:
    stage = Stage(tmp_path)
    yield stage
    stage.runtime.close()


@pytest.fixture
def server() -> Iterator[viser.ViserServer]:
    """A scene."""
    server = open_scene()
    yield server
    close_scene(server)
