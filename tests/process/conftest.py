"""Real sessions over a real router on loopback, and a robot that answers by a script."""

import os
import secrets
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from support.processes import find_free_port
from support.waiting import PATIENCE_S, wait_until

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.messages import (
    BaseState,
    Clock,
    GoalStatus,
    Odometry,
    PoseEstimate,
    Robot,
    SavedPose,
    SavedPoses,
    Transform,
    Twist2D,
)
from trolley.messages.mapping import PoseState
from trolley.messages.request_params import Nothing, SendGoal, WhichGoal
from trolley.runtime.log import Log
from trolley.runtime.node import Node
from trolley.runtime.process import Run
from trolley.runtime.service import Service, answers, every, gets
from trolley.runtime.state import StateFolder
from trolley.runtime.zenoh_bus import open_bus, open_router

FOOTPRINT = [(0.1, 0.1), (-0.1, 0.1), (-0.1, -0.1), (0.1, -0.1)]
KITCHEN = SavedPose(name="kitchen", map="home", pose=Pose2D(2.0, 1.0, 0.0))


class ScriptedRobot(Service):
    """Base, localizer, planner and tour in one: goals end as `script` says."""

    name = "base"

    def __init__(self, name: str, script: tuple[GoalStatus, ...]) -> None:
        self._name = name
        self._script = script
        self._statuses: dict[str, GoalStatus] = {}
        self._left: list[GoalStatus] = []
        self.current = GoalStatus(stamp_ns=0, id=None, state="idle")
        self.stopped = False
        self.is_blind = False
        self.pose_states: list[PoseState] = []
        """What its next poses are; it is localized after them."""
        self.clock_every = 1
        self._num_ticks = 0
        self.sent: list[SendGoal] = []
        self.canceled: list[str | None] = []
        self.is_up = threading.Event()

    def start(self) -> None:
        robot = Robot(
            stamp_ns=0,
            name=self._name,
            title="Scripted",
            footprint=FOOTPRINT,
            drive="differential",
            max_speed=0.5,
            max_wz=1.0,
            deceleration=1.0,
            simulated=True,
        )
        self.publish(topics.ROBOT, robot)
        self.publish(topics.POSES, SavedPoses(stamp_ns=0, poses=[KITCHEN]))
        self.publish(
            topics.TF,
            Transform(
                stamp_ns=0,
                parent="base_link",
                child="laser",
                pose=Pose2D(0.1, 0.0, 0.0),
                z=0.2,
            ),
            "laser",
        )
        self.publish(topics.GOAL, self.current)

    @every(0.1, clock="local")
    def tick(self) -> None:
        stamp_ns = time.time_ns()
        self._num_ticks += 1
        if self._num_ticks % self.clock_every == 0:
            self.publish(topics.CLOCK, Clock(stamp_ns=stamp_ns, rate=1.0, epoch=0))
        pose = Pose2D(1.0, 0.0, 0.5)
        odometry = Odometry(stamp_ns=stamp_ns, pose=pose, twist=Twist2D.zero())
        self.publish(topics.ODOM, odometry)
        mode = "stopped" if self.stopped else "ok"
        self.publish(topics.BASE, BaseState(stamp_ns=stamp_ns, mode=mode))
        if self._left:
            self._set(self._left.pop(0))

    @every(0.1, clock="local")
    def locate(self) -> None:
        if self.is_blind:
            return
        stamp_ns = time.time_ns()
        map_T_odom = Pose2D(0.0, 2.0, 0.0)
        self.publish(
            topics.TF,
            Transform(stamp_ns=stamp_ns, parent="map", child="odom", pose=map_T_odom),
            "odom",
        )
        estimate = PoseEstimate(
            stamp_ns=stamp_ns,
            map="home",
            pose=map_T_odom @ Pose2D(1.0, 0.0, 0.5),
            covariance=[0.0] * 9,
            state=self.pose_states.pop(0) if self.pose_states else "localized",
            match=0.9,
            spread=0.0,
            message="checking",
        )
        self.publish(topics.POSE, estimate)
        self.is_up.set()

    @answers(requests.POSE_FIND)
    def find_it(self, _params: Nothing) -> PoseEstimate:
        self.pose_states = ["searching", "unsure", "unsure", *self.pose_states]
        return PoseEstimate(
            stamp_ns=time.time_ns(),
            map="home",
            pose=None,
            covariance=None,
            state="searching",
            match=0.0,
            spread=0.0,
        )

    @answers(requests.BASE_STOP)
    def stop_it(self, _params: Nothing) -> BaseState:
        self.stopped = True
        return BaseState(stamp_ns=0, mode="stopped", reason=codes.BUTTON)

    @answers(requests.BASE_RESUME)
    def resume_it(self, _params: Nothing) -> BaseState:
        self.stopped = False
        return BaseState(stamp_ns=0, mode="ok")

    @answers(requests.GOAL_SEND)
    def send(self, params: SendGoal) -> GoalStatus:
        if params.name not in (None, "kitchen"):
            raise Refused(codes.UNKNOWN_NAME, f"There is no saved place called {params.name}.")
        self.sent.append(params)
        assert params.id is not None
        first = GoalStatus(stamp_ns=1, id=params.id, state="planning", pose=params.pose)
        self._left = [
            GoalStatus(stamp_ns=2 + i, id=params.id, state=one.state, reason=one.reason)
            for i, one in enumerate(self._script)
        ]
        self._set(first)
        return first

    @answers(requests.GOAL_CANCEL)
    def cancel(self, params: WhichGoal) -> GoalStatus:
        self.canceled.append(params.id)
        self._left = []
        self._set(
            GoalStatus(stamp_ns=99, id=self.current.id, state="canceled", reason=codes.CANCELED)
        )
        return self.current

    @gets(topics.GOAL)
    def get_goal(self, parameters: dict[str, str]) -> dict[tuple[str, ...], GoalStatus]:
        wanted = parameters.get("id")
        if wanted is None:
            return {(): self.current}
        return {(): self._statuses[wanted]} if wanted in self._statuses else {}

    def arrive(self) -> None:
        """Reach the goal with the next tick, whatever the script says."""
        assert self.current.id is not None
        self._left = [GoalStatus(stamp_ns=50, id=self.current.id, state="arrived")]

    def replace_goal(self) -> None:
        """As when somebody else sends a goal: the status of the old one is not heard any more."""
        old = self.current.id
        assert old is not None
        self._left = []
        self._statuses[old] = GoalStatus(
            stamp_ns=50, id=old, state="canceled", reason=codes.REPLACED
        )
        self._set(GoalStatus(stamp_ns=51, id="other", state="driving"))

    def forget_goals(self) -> None:
        """As when the planner was restarted."""
        self._left, self._statuses = [], {}
        self._set(GoalStatus(stamp_ns=0, id=None, state="idle"))

    def _set(self, status: GoalStatus) -> None:
        self.current = status
        if status.id is not None:
            self._statuses[status.id] = status
        self.publish(topics.GOAL, status)


class ThreadHost:
    """What a node needs besides the bus, for a service on a thread of the test."""

    def __init__(self, folder: Path) -> None:
        self.state = StateFolder(folder / "state", Log("test"))
        self.maps = StateFolder(folder / "maps", Log("test"))

    def monotonic_ns(self) -> int:
        return time.monotonic_ns()

    def since_boot_ns(self) -> int:
        return time.clock_gettime_ns(time.CLOCK_BOOTTIME)

    def unix_ns(self) -> int:
        return time.time_ns()

    def utc_now(self) -> str | None:
        return None

    def new_id(self) -> str:
        return secrets.token_hex(6)

    def work(self, fn: Callable[[], Any], done: Callable[[Any], None]) -> None:
        done(fn())

    def usage(self) -> tuple[float, int]:
        return 0.0, 0


@contextmanager
def running(robot: ScriptedRobot, name: str, endpoint: str, folder: Path) -> Iterator[Node]:
    """Run a scripted robot on a thread."""
    with open_bus([endpoint], PATIENCE_S) as bus:
        node = Node(robot, name, bus, ThreadHost(folder))
        stop = threading.Event()

        def run() -> None:
            node.open()
            while not stop.is_set():
                node.step()
                due_s = (node.next_due_ns() - time.monotonic_ns()) * 1e-9
                node.inbox.wait(min(max(due_s, 0.0), 0.1))

        thread = threading.Thread(target=run)
        thread.start()
        assert robot.is_up.wait(PATIENCE_S)
        # Last, so that who sees it finds everything else, too: the router keeps the order.
        bus.declare_token(topics.ALIVE.key(name, "base", str(Run.here())))
        try:
            yield node
        finally:
            stop.set()
            thread.join()
            node.close()


@pytest.fixture
def port() -> int:
    """A free TCP port of loopback."""
    return find_free_port()


@pytest.fixture
def endpoint(port: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A router on loopback; state and configuration are the test's own."""
    monkeypatch.setenv("TROLLEY_STATE", str(tmp_path / "state"))
    monkeypatch.delenv("TROLLEY_CONFIG", raising=False)
    where = f"tcp/127.0.0.1:{port}"
    with open_router([where]):
        yield where


ARRIVES = tuple(
    GoalStatus(stamp_ns=0, id=None, state=state) for state in ("driving", "driving", "arrived")
)


@pytest.fixture
def add_robot(endpoint: str, tmp_path: Path) -> Iterator[Callable[..., ScriptedRobot]]:
    """Start scripted robots, which others see from then on: `add_robot("one", script)`."""
    with ExitStack() as stack:
        onlooker = stack.enter_context(open_bus([endpoint], PATIENCE_S))

        def add(name: str = "one", script: tuple[GoalStatus, ...] = ARRIVES) -> ScriptedRobot:
            robot = ScriptedRobot(name, script)
            stack.enter_context(running(robot, name, endpoint, tmp_path / name))
            # The robot has declared its token; the router may come round to it later.
            alive = topics.ALIVE.key(name)
            wait_until(lambda: onlooker.alive(alive, PATIENCE_S), f"the router knows {name}")
            return robot

        yield add


@pytest.fixture
def trolley(tmp_path: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run the real command: `trolley("pose", "--json")`."""

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        environment = {**os.environ, "TROLLEY_STATE": str(tmp_path / "cli-state")}
        return subprocess.run(
            [str(Path(sys.executable).with_name("trolley")), *arguments],
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            env=environment,
            cwd=tmp_path,
            check=False,
        )

    return run
