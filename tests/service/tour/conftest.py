"""A tour service in lock-step with a scripted planner, base and localizer."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import pytest

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.config import FootprintConfig, RobotConfig, RobotSection, TourConfig
from trolley.geometry import Pose2D, Twist2D
from trolley.messages import (
    BaseState,
    Clock,
    GoalState,
    GoalStatus,
    MappingState,
    MappingStatus,
    Odometry,
    PoseEstimate,
    SavedPose,
    Stop,
    Tour,
    TourStatus,
)
from trolley.messages import Path as PlannedPath
from trolley.messages.request_params import SendGoal, WhichGoal
from trolley.runtime.lockstep import Lockstep
from trolley.runtime.service import Service, answers, every, gets
from trolley_tour.service import TourService

EPOCH_NS = 5_000_000_000
DRIVE_S = 4.0
CERTAIN = [1e-4, 0.0, 0.0, 0.0, 1e-4, 0.0, 0.0, 0.0, 1e-4]

PLACES = {
    "corridor": Pose2D(5.315, 1.366, -1.044),
    "entrance": Pose2D(5.775, -1.246, -2.57),
    "kitchen": Pose2D(2.149, -2.706, -2.88),
}


class FakeBase(Service):
    """A clock, odometry and a state."""

    name = "base"

    def __init__(self, epoch_ns: int = EPOCH_NS) -> None:
        self.epoch = epoch_ns
        self.began_ns: int | None = None
        self.twist = Twist2D.zero()
        self.base_state = BaseState(stamp_ns=0, mode="ok")

    @property
    def robot_ns(self) -> int:
        if self.began_ns is None:
            self.began_ns = self.monotonic_ns
        return self.epoch + self.monotonic_ns - self.began_ns

    @every(0.1, clock="local")
    def tick(self) -> None:
        stamp_ns = self.robot_ns
        self.publish(topics.CLOCK, Clock(stamp_ns=stamp_ns, rate=1.0, epoch=self.epoch))
        pose = Pose2D.identity()
        self.publish(topics.ODOM, Odometry(stamp_ns=stamp_ns, pose=pose, twist=self.twist))

    def say(
        self, mode: Literal["ok", "stopped"] = "ok", source: str | None = None, message: str = ""
    ) -> None:
        state = BaseState(stamp_ns=self.robot_ns, mode=mode, source=source, message=message)
        self.publish(topics.BASE, state)


class FakeLocalizer(Service):
    """A pose ten times a second."""

    name = "localizer"

    def __init__(self) -> None:
        self.estimate = PoseEstimate(
            stamp_ns=0,
            map="apartment",
            pose=Pose2D(1.0, 2.0, 0.5),
            covariance=CERTAIN,
            state="localized",
            match=0.9,
            spread=0.05,
        )
        self.jitter: list[Pose2D] = []
        self.silent = False

    @every(0.1, clock="robot")
    def tick(self) -> None:
        if not self.silent:
            pose = self.jitter.pop(0) if self.jitter else self.estimate.pose
            self.publish(topics.POSE, replace(self.estimate, stamp_ns=self.stamp_ns, pose=pose))


class FakeMapper(Service):
    """What it is doing, each second."""

    name = "mapper"
    phase: MappingState = "idle"

    @every(1.0, clock="local")
    def tick(self) -> None:
        self.publish(topics.MAPPING, MappingStatus(stamp_ns=self.stamp_ns, state=self.phase))


def replace(value, **changes):
    import msgspec

    return msgspec.structs.replace(value, **changes)


@dataclass
class Plan:
    """What becomes of the next goal: refused, or ended after a while."""

    refuse: Refused | None = None
    state: GoalState = "arrived"
    reason: str = ""
    message: str = ""
    seconds: float = DRIVE_S


class FakePlanner(Service):
    """Takes goals and ends them as the script says; without one they arrive after 4 s."""

    name = "planner"

    def __init__(self, script: list[Plan] | None = None) -> None:
        self.script = script or []
        self.sent: list[SendGoal] = []
        """Every goal/send that was asked, refused ones too."""
        self.goals: dict[str, GoalStatus] = {}
        self.current: str | None = None
        self.ends: dict[str, tuple[int, Plan]] = {}

    def start(self) -> None:
        self.publish(topics.GOAL, GoalStatus(stamp_ns=self.stamp_ns, id=None, state="idle"))

    @answers(requests.GOAL_SEND)
    def send(self, goal: SendGoal) -> GoalStatus:
        assert goal.id is not None
        self.sent.append(goal)
        if goal.id in self.goals:
            return self.goals[goal.id]
        plan = self.script.pop(0) if self.script else Plan()
        if plan.refuse is not None:
            raise plan.refuse
        self.end(self.current, "canceled", codes.REPLACED)
        self.current = goal.id
        self.ends[goal.id] = (self.monotonic_ns + int(plan.seconds * 1e9), plan)
        return self.say(goal.id, "planning")

    @answers(requests.GOAL_PREVIEW)
    def preview(self, goal: SendGoal) -> PlannedPath:
        plan = self.script.pop(0) if self.script else Plan()
        if plan.refuse is not None:
            raise plan.refuse
        return PlannedPath(
            stamp_ns=self.stamp_ns, frame="map", poses=memoryview(bytes(12 * 21)), dt=0.5
        )

    @answers(requests.GOAL_CANCEL)
    def cancel(self, params: WhichGoal) -> GoalStatus:
        return self.change(params, "canceled", codes.CANCELED)

    @answers(requests.GOAL_PAUSE)
    def pause(self, params: WhichGoal) -> GoalStatus:
        return self.change(params, "paused", codes.PAUSED)

    @answers(requests.GOAL_RESUME)
    def resume(self, params: WhichGoal) -> GoalStatus:
        return self.change(params, "driving", "")

    @gets(topics.GOAL)
    def get_goal(self, parameters: dict[str, str]) -> dict[tuple[str, ...], GoalStatus]:
        wanted = parameters.get("id", self.current)
        idle = GoalStatus(stamp_ns=self.stamp_ns, id=None, state="idle")
        return {(): self.goals[wanted] if wanted is not None else idle}

    def change(self, params: WhichGoal, state: GoalState, reason: str) -> GoalStatus:
        if params.id is None or params.id != self.current or not self.drives(params.id):
            raise Refused(codes.NOT_CURRENT)
        return self.say(params.id, state, reason)

    def drives(self, goal_id: str | None) -> bool:
        known = self.goals.get(goal_id or "")
        return known is not None and known.state not in ("arrived", "failed", "canceled")

    def end(
        self, goal_id: str | None, state: GoalState, reason: str = "", message: str = ""
    ) -> None:
        if goal_id is not None and self.drives(goal_id):
            self.say(goal_id, state, reason, message)

    def say(
        self, goal_id: str, state: GoalState, reason: str = "", message: str = ""
    ) -> GoalStatus:
        end_ns, plan = self.ends[goal_id]
        status = GoalStatus(
            stamp_ns=self.stamp_ns,
            id=goal_id,
            state=state,
            reason=reason,
            message=message,
            elapsed=max(0.0, plan.seconds + (self.monotonic_ns - end_ns) * 1e-9),
        )
        self.goals[goal_id] = status
        self.publish(topics.GOAL, status)
        return status

    @every(0.2, clock="local")
    def tick(self) -> None:
        if self.current is None or not self.drives(self.current):
            return
        end_ns, plan = self.ends[self.current]
        status = self.goals[self.current]
        if status.state == "paused":
            return
        if self.monotonic_ns >= end_ns:
            self.end(self.current, plan.state, plan.reason, plan.message)
        else:
            self.say(self.current, "driving")

    @property
    def ids(self) -> list[str]:
        """The ids that were sent, without repetitions."""
        return list(dict.fromkeys(goal.id or "" for goal in self.sent))


@dataclass
class Home:
    """Everything that runs, and short words for what tests do with it."""

    lockstep: Lockstep
    config: RobotConfig
    base: FakeBase = field(default_factory=FakeBase)
    localizer: FakeLocalizer = field(default_factory=FakeLocalizer)
    planner: FakePlanner = field(default_factory=FakePlanner)
    mapper: FakeMapper = field(default_factory=FakeMapper)
    tour: TourService = field(init=False)

    def __post_init__(self) -> None:
        self.lockstep.add(self.base)
        self.lockstep.add(self.localizer)
        self.lockstep.add(self.planner)
        self.lockstep.add(self.mapper)
        self.statuses = self.lockstep.record(topics.TOUR)
        self.add_tour()
        self.lockstep.run(0.5)

    def add_tour(self) -> None:
        self.tour = self.lockstep.add(TourService(self.config))

    def save_places(self) -> None:
        for name, pose in PLACES.items():
            place = SavedPose(name=name, map="apartment", pose=pose)
            self.lockstep.ask(requests.POSES_PUT, place)

    def start(self, *stops: Stop | str, **options) -> TourStatus:
        made = [Stop(name=stop) if isinstance(stop, str) else stop for stop in stops]
        tour = Tour(stops=made, **options)
        return self.lockstep.ask(requests.TOUR_START, requests.TOUR_START.params(tour=tour))

    @property
    def status(self) -> TourStatus:
        return self.statuses[-1]

    def results(self) -> list[tuple[int, str, str]]:
        return [(one.stop, one.state, one.code) for one in self.status.results]

    def run_until(self, state: str, seconds: float = 60.0) -> TourStatus:
        assert self.lockstep.run_until(lambda: self.status.state == state, seconds), self.status
        return self.status

    def restart_tour(self) -> None:
        self.lockstep.kill("tour")
        self.add_tour()

    def restart_base(self, epoch_ns: int) -> None:
        self.lockstep.kill("base")
        self.base = self.lockstep.add(FakeBase(epoch_ns))
        self.lockstep.run(0.5)

    def restart_planner(self) -> None:
        self.lockstep.kill("planner")
        self.planner = self.lockstep.add(FakePlanner())


def make_config(**tour) -> RobotConfig:
    footprint = FootprintConfig(length_m=0.3, width_m=0.2)
    robot = RobotSection(name="trolley", footprint=footprint)
    return RobotConfig(robot=robot, tour=TourConfig(**tour))


@pytest.fixture
def make_home(tmp_path: Path) -> Iterator[Callable[..., Home]]:
    """Makes a home; a second one in a test finds the state of the first."""
    homes: list[Lockstep] = []

    def make(**tour) -> Home:
        lockstep = Lockstep(state=tmp_path)
        homes.append(lockstep)
        return Home(lockstep, make_config(**tour))

    yield make
    for lockstep in homes:
        lockstep.close()


@pytest.fixture
def home(make_home: Callable[..., Home]) -> Home:
    """All services with the article's three places saved."""
    made = make_home()
    made.save_places()
    return made


@pytest.fixture
def plan() -> type[Plan]:
    """What the planner's script is made of."""
    return Plan
