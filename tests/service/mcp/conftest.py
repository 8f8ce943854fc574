"""An assistant's client, the bridge and a scripted robot, in simulated time, without threads."""

import dataclasses
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

import anyio
import numpy as np
import pytest
from mcp import Client
from msgspec import structs

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.config import McpConfig
from trolley.geometry import Pose2D
from trolley.messages import (
    BaseState,
    CapturedPose,
    Clock,
    GoalStatus,
    MappingStatus,
    OccupancyGrid,
    PastTrip,
    PoseEstimate,
    SavedPose,
    SavedPoses,
    Scan,
    Stop,
    Tour,
    Tours,
    TourStatus,
    Transform,
    Zone,
    Zones,
)
from trolley.messages.request_params import (
    AskHistory,
    Capture,
    MapNamed,
    Nothing,
    SaveMap,
    SendGoal,
    StartTour,
    WhichGoal,
)
from trolley.runtime.lockstep import Lockstep
from trolley.runtime.service import Service, answers, every
from trolley.runtime.serving import Later
from trolley_mcp.robot_link import RobotLink
from trolley_mcp.server import make_server
from trolley_mcp.service import AssistantService

TICK_S = 0.05
DRIVE_S = 3.0
ROOM = Zone(name="Küche", kind="room", points=[(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)])


class ScriptedRobot(Service):
    """Every service of a robot in one; drives end after `drive_s`, as `end` says."""

    name = "base"

    def __init__(self) -> None:
        self.asked: list[tuple[str, Any]] = []
        self.refuse: Refused | None = None
        self.is_deaf = False
        self.answers_goals = True
        self.silent: set[str] = set()
        self.rate = 1.0
        self.drive_s = DRIVE_S
        self.end: tuple[Any, str, str] = ("arrived", "", "")
        self.base = BaseState(stamp_ns=0, mode="ok")
        self.goal = GoalStatus(stamp_ns=0, id=None, state="idle")
        self.trip = TourStatus(stamp_ns=0, name=None, trip=None, state="idle")
        self.mapping = MappingStatus(stamp_ns=0, state="idle")
        self.pose_state: Any = "localized"
        self._ends_ns: int | None = None

    def start(self) -> None:
        places = [("kitchen", 1.0), ("hall", 5.0)]
        self.save([SavedPose(name=n, map="home", pose=Pose2D(x, 2.0, 0.0)) for n, x in places])
        tour = Tour(name="evening", stops=[Stop(name="kitchen"), Stop(name="hall")])
        self.publish(topics.TOURS, Tours(stamp_ns=0, tours=[tour]))
        self.publish(topics.ZONES, Zones(stamp_ns=0, map="home", zones=[ROOM]))
        cells = np.full((80, 120), 0, np.int8)
        cells[0], cells[-1], cells[:, 0], cells[:, -1] = 100, 100, 100, 100
        self.publish(
            topics.MAP,
            OccupancyGrid(
                stamp_ns=0,
                name="home",
                frame="map",
                resolution=0.05,
                width=120,
                height=80,
                origin=Pose2D(0.0, 0.0, 0.0),
                cells=memoryview(cells.tobytes()),
            ),
        )
        mount = Transform(stamp_ns=0, parent="base_link", child="laser", pose=Pose2D(0.1, 0.0, 0.0))
        self.publish(topics.TF, mount, "laser")

    def say(self, topic: Any, message: Any, *parts: str) -> None:
        if topic.name not in self.silent:
            self.publish(topic, message, *parts)

    def save(self, places: list[SavedPose]) -> None:  # pyrefly: ignore[bad-override]
        self.say(topics.POSES, SavedPoses(stamp_ns=0, poses=places))

    @every(0.1, clock="local")
    def tick(self) -> None:
        now_ns = int(self.monotonic_ns * self.rate)
        self.publish(topics.CLOCK, Clock(stamp_ns=now_ns, rate=self.rate, epoch=0))
        if self._ends_ns is not None and now_ns >= self._ends_ns:
            self._ends_ns = None
            state, reason, message = self.end
            if self.trip.state == "driving":
                self.trip = structs.replace(
                    self.trip, state="done" if state == "arrived" else state, reason=reason
                )
            else:
                self.goal = structs.replace(
                    self.goal, state=state, reason=reason, message=message, elapsed=DRIVE_S
                )
        elif self.goal.state == "driving":
            left_m = max(0.0, (self._ends_ns or now_ns) - now_ns) * 1e-9
            self.goal = structs.replace(self.goal, distance_remaining=left_m)
        self.publish(topics.BASE, structs.replace(self.base, stamp_ns=now_ns))
        self.say(topics.GOAL, structs.replace(self.goal, stamp_ns=now_ns))
        self.say(topics.TOUR, structs.replace(self.trip, stamp_ns=now_ns))
        self.publish(topics.MAPPING, structs.replace(self.mapping, stamp_ns=now_ns))
        estimate = PoseEstimate(
            stamp_ns=now_ns,
            map="home",
            pose=Pose2D(2.0, 2.0, 0.0),
            covariance=[0.0] * 9,
            state=self.pose_state,
            match=0.9,
            spread=0.0,
        )
        self.say(topics.POSE, estimate)
        ranges = np.full(8, 1.0, np.float32)
        ranges[::2] = np.inf
        scan = Scan(
            stamp_ns=now_ns,
            frame="laser",
            angle_min=0.0,
            angle_increment=0.785,
            time_increment=0.0,
            range_min=0.1,
            range_max=8.0,
            ranges=memoryview(ranges.tobytes()),
        )
        self.publish(topics.SCAN, scan)

    def _note(self, name: str, params: Any) -> None:
        self.asked.append((name, params))
        if self.refuse is not None:
            raise self.refuse
        if self.base.mode == "stopped" and name in ("goal/send", "map/new"):
            raise Refused(codes.STOPPED)

    def names_asked(self) -> list[str]:
        return [name for name, _ in self.asked]

    @answers(requests.GOAL_SEND)
    def send(self, goal: SendGoal) -> GoalStatus | Later[GoalStatus]:
        self._note("goal/send", goal)
        self._ends_ns = self.monotonic_ns + int(self.drive_s * 1e9)
        self.goal = GoalStatus(stamp_ns=self.monotonic_ns, id=goal.id, state="driving")
        return self.goal if self.answers_goals else Later()

    @answers(requests.GOAL_CANCEL)
    def cancel(self, which: WhichGoal) -> GoalStatus:
        self._note("goal/cancel", which)
        if which.id != self.goal.id:
            raise Refused(codes.NOT_CURRENT)
        self._ends_ns = None
        self.goal = structs.replace(self.goal, state="canceled", reason=codes.CANCELED)
        return self.goal

    @answers(requests.TOUR_START)
    def start_tour(self, params: StartTour) -> TourStatus | Later[TourStatus]:
        self._note("tour/start", params)
        if params.name != "evening":
            raise Refused(codes.UNKNOWN_NAME, "There is no such tour.")
        self._ends_ns = self.monotonic_ns + int(self.drive_s * 1e9)
        now_ns = self.monotonic_ns
        self.trip = TourStatus(stamp_ns=now_ns, name=params.name, trip="t1", state="driving")
        return self.trip if self.answers_goals else Later()

    @answers(requests.TOUR_STOP)
    def stop_tour(self, params: Nothing) -> TourStatus:
        self._note("tour/stop", params)
        self.trip = structs.replace(self.trip, state="stopped")
        return self.trip

    @answers(requests.TOUR_HISTORY)
    def history(self, params: AskHistory) -> list[PastTrip]:
        self._note("tour/history", params)
        return [PastTrip(trip="a", name="evening", state="done", reached=2, message="Done.")]

    @answers(requests.POSE_CAPTURE)
    def capture(self, params: Capture) -> CapturedPose:
        self._note("pose/capture", params)
        return CapturedPose(
            name=params.name or "",
            map="home",
            pose=Pose2D(2.0, 2.0, 0.0),
            state="localized",
            match=0.9,
            age=0.0,
        )

    @answers(requests.MAP_NEW)
    def new_map(self, params: MapNamed) -> MappingStatus:
        self._note("map/new", params)
        self.mapping = MappingStatus(stamp_ns=0, state="mapping", name=params.name)
        return self.mapping

    @answers(requests.MAP_SAVE)
    def save_map(self, params: SaveMap) -> MappingStatus:
        self._note("map/save", params)
        return MappingStatus(stamp_ns=0, state="saving", name="attic")

    @answers(requests.MAP_CANCEL)
    def cancel_map(self, params: Nothing) -> MappingStatus:
        self._note("map/cancel", params)
        if self.mapping.state == "idle":
            raise Refused(codes.NOT_MAPPING)
        self.mapping = MappingStatus(stamp_ns=0, state="idle")
        return self.mapping

    @answers(requests.BASE_STOP)
    def halt(self, params: Nothing) -> BaseState:
        if self.is_deaf:
            raise Refused(codes.NOT_READY)
        self.asked.append(("base/stop", params))
        self.base = BaseState(stamp_ns=self.monotonic_ns, mode="stopped", reason=codes.BUTTON)
        if self.goal.state == "driving":
            self._ends_ns = None
            self.goal = structs.replace(self.goal, state="paused", reason=codes.STOPPED)
        return self.base

    @answers(requests.BASE_RESUME)
    def resume(self, params: Nothing) -> BaseState:
        self._note("base/resume", params)
        self.base = BaseState(stamp_ns=self.monotonic_ns, mode="ok")
        return self.base


@dataclasses.dataclass
class Talk:
    """A conversation: what is called, and what the robot was asked."""

    lockstep: Lockstep
    robot: ScriptedRobot
    client: Client
    others: list[Client] = dataclasses.field(default_factory=list[Client])
    told: list[tuple[float, float | None, str | None]] = dataclasses.field(default_factory=list)

    async def call(self, tool: str, client: Client | None = None, /, **arguments: Any) -> Any:
        async def tell(progress: float, total: float | None, message: str | None) -> None:
            self.told.append((progress, total, message))

        return await (client or self.client).call_tool(tool, arguments, progress_callback=tell)

    async def until(self, happened: Callable[[], object]) -> None:
        with anyio.fail_after(20):
            while not happened():
                await anyio.sleep(0)


Script = Callable[[Talk], Awaitable[None]]


@pytest.fixture
def converse(tmp_path: Path) -> Iterator[Callable[..., ScriptedRobot]]:
    """Runs a script of one or two sessions with a fresh robot."""
    opened: list[Lockstep] = []

    def run(
        script: Script, *, sessions: int = 1, mode: Any = "auto", tick_s: float = TICK_S, **mcp: Any
    ) -> ScriptedRobot:
        lockstep = Lockstep(robot="robby", state=tmp_path)
        opened.append(lockstep)
        robot = lockstep.add(ScriptedRobot())
        links: list[RobotLink] = []
        for number in range(sessions):
            links.append(lockstep.add(AssistantService()).robot_link)
            # Each has a label of its own, as in processes.
            lockstep.nodes[f"mcp-{number}"] = lockstep.nodes.pop("mcp")
        lockstep.run(0.5)
        servers = [
            make_server(link, McpConfig(**mcp), lambda: lockstep.now_ns * 1e-9) for link in links
        ]

        async def pump() -> None:
            while True:
                lockstep.run(tick_s)
                await anyio.sleep(0)

        async def main() -> None:
            async with anyio.create_task_group() as tasks:
                tasks.start_soon(pump)
                async with Client(servers[0], mode=mode) as client:
                    if sessions == 1:
                        await script(Talk(lockstep, robot, client))
                    else:
                        async with Client(servers[1], mode=mode) as second:
                            await script(Talk(lockstep, robot, client, [second]))
                tasks.cancel_scope.cancel()

        anyio.run(main)
        return robot

    yield run
    for lockstep in opened:
        lockstep.close()
