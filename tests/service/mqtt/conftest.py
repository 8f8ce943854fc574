"""The bridge in lock-step between a scripted robot and a broker in memory."""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from msgspec import structs
from support.samples import make_robot

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.config import FootprintConfig, MqttConfig, RobotConfig, RobotSection, WebhookConfig
from trolley.geometry import Pose2D
from trolley.messages import (
    BaseState,
    Clock,
    GoalStatus,
    Health,
    PoseEstimate,
    SavedPose,
    SavedPoses,
    Stop,
    Tour,
    Tours,
    TourStatus,
)
from trolley.messages.request_params import Nothing, SendGoal, StartTour, WhichGoal
from trolley.runtime.lockstep import Lockstep
from trolley.runtime.service import Service, answers, every
from trolley_mqtt.connection import Arrived, Broker, Connected, Event, Lost, Subscription
from trolley_mqtt.service import MqttService

BASE = "trolley/robby"


class ScriptedRobot(Service):
    """Everything that the bridge hears of, in one."""

    name = "base"

    def __init__(self) -> None:
        self.asked: list[tuple[str, Any]] = []
        self.base = BaseState(stamp_ns=0, mode="ok")
        self.goal = GoalStatus(stamp_ns=0, id=None, state="idle")
        self.trip = TourStatus(stamp_ns=0, name=None, trip=None, state="idle")
        self.position = Pose2D(1.0, 2.0, 0.0)
        self.map = "home"
        self.refuse: Refused | None = None
        self.is_deaf = False
        self.has_planner = self.has_localizer = True

    @every(0.1, clock="local")
    def tick(self) -> None:
        stamp_ns = self.monotonic_ns
        self.publish(topics.CLOCK, Clock(stamp_ns=stamp_ns, rate=1.0, epoch=0))
        estimate = PoseEstimate(
            stamp_ns=stamp_ns,
            map=self.map,
            pose=self.position,
            covariance=[0.0] * 9,
            state="localized",
            match=0.9,
            spread=0.0,
        )
        if self.has_localizer:
            self.publish(topics.POSE, estimate)
        self.publish(topics.BASE, structs.replace(self.base, stamp_ns=stamp_ns))
        self.publish(topics.GOAL, structs.replace(self.goal, stamp_ns=stamp_ns))
        self.publish(topics.TOUR, structs.replace(self.trip, stamp_ns=stamp_ns))
        if self.has_planner:
            self.publish(topics.HEALTH, Health(stamp_ns=stamp_ns, state="ok"), "planner")

    def be_replayed(self) -> None:
        self.publish(topics.ROBOT, structs.replace(make_robot("robby"), replayed=True))

    def save(self, places: Sequence[str], tours: Sequence[str] = ()) -> None:  # pyrefly: ignore[bad-override]
        poses = [
            SavedPose(name=name, map="home", pose=Pose2D(5.0 * index, 2.0, 0.0))
            for index, name in enumerate(places)
        ]
        stored = [Tour(name=name, stops=[Stop(name=places[0])]) for name in tours]
        self.publish(topics.POSES, SavedPoses(stamp_ns=0, poses=poses))
        self.publish(topics.TOURS, Tours(stamp_ns=0, tours=stored))

    def _note(self, name: str, params: Any) -> None:
        self.asked.append((name, params))
        if self.refuse is not None:
            raise self.refuse

    @answers(requests.GOAL_SEND)
    def send(self, goal: SendGoal) -> GoalStatus:
        self._note("goal/send", goal.name)
        self.goal = GoalStatus(stamp_ns=0, id=goal.id, state="driving")
        return self.goal

    @answers(requests.GOAL_PAUSE)
    def pause_goal(self, which: WhichGoal) -> GoalStatus:
        self._note("goal/pause", which.id)
        return self.goal

    @answers(requests.GOAL_CANCEL)
    def cancel_goal(self, which: WhichGoal) -> GoalStatus:
        self._note("goal/cancel", which.id)
        return self.goal

    @answers(requests.TOUR_START)
    def start_tour(self, params: StartTour) -> TourStatus:
        self._note("tour/start", params.name)
        return self.trip

    @answers(requests.TOUR_PAUSE)
    def pause_tour(self, params: Nothing) -> TourStatus:
        self._note("tour/pause", None)
        return self.trip

    @answers(requests.TOUR_RESUME)
    def resume_tour(self, params: Nothing) -> TourStatus:
        self._note("tour/resume", None)
        return self.trip

    @answers(requests.BASE_STOP)
    def halt(self, params: Nothing) -> BaseState:
        if self.is_deaf:
            raise Refused(codes.NOT_READY)
        self.asked.append(("base/stop", None))
        self.base = BaseState(stamp_ns=0, mode="stopped", reason=codes.BUTTON)
        return self.base


@dataclass
class MemoryBroker:
    """A broker and the connection to it: it keeps what is retained, and it can stall."""

    broker: Broker
    precious: str
    kept: dict[str, bytes] = field(default_factory=dict)
    published: list[tuple[str, bytes]] = field(default_factory=list)
    valid_s: dict[str, int] = field(default_factory=dict)
    """How long the newest message of a topic is kept at most; 0: for good."""
    is_up: bool = True
    is_stalled: bool = False
    forbidden: str = "-"
    """The beginning of the topics to which the account may not write."""
    dropped: int = 0
    waiting: list[Arrived] = field(default_factory=list)
    _events: list[Event] = field(default_factory=list)
    _subscriptions: Sequence[Subscription] = ()
    _wake: Callable[[], None] = lambda: None

    def start(self, subscriptions: Sequence[Subscription], wake: Callable[[], None]) -> None:
        self._subscriptions, self._wake = subscriptions, wake
        if self.is_up:
            self.connect()

    def connect(self) -> None:
        self.is_up = True
        self._put(Connected())
        for subscription in self._subscriptions:
            for topic, payload in list(self.kept.items()):
                if subscription.with_kept and _fits(subscription.topics, topic):
                    self._put(Arrived(topic, payload, is_retained=True))

    def lose(self) -> None:
        self.is_up = False
        self.kept[self.broker.will[0]] = self.broker.will[1]
        self._put(Lost("The connection was lost."))

    def take_events(self) -> list[Event]:
        events, self._events = self._events, []
        return events

    def take_num_dropped(self) -> int:
        dropped, self.dropped = self.dropped, 0
        return dropped

    def publish(self, topic: str, payload: bytes, *, keep: bool, valid_s: int = 0) -> None:
        self.published.append((topic, payload))
        self.valid_s[topic] = valid_s
        if topic.startswith(self.forbidden):
            return
        if keep and payload:
            self.kept[topic] = payload
        elif keep:
            self.kept.pop(topic, None)
        self.send(topic, payload)

    def send(self, topic: str, payload: bytes | str = b"", *, is_retained: bool = False) -> None:
        """What some client publishes."""
        data = payload.encode() if isinstance(payload, str) else payload
        if any(_fits(subscription.topics, topic) for subscription in self._subscriptions):
            arrived = Arrived(topic, data, is_retained)
            if self.is_stalled:
                self.waiting.append(arrived)
            else:
                self._put(arrived)

    def send_before_marks(self, topic: str, payload: bytes) -> None:
        """What the broker has in store overtakes all that waits."""
        self._put(Arrived(topic, payload, is_retained=False))

    def flow_again(self) -> None:
        self.is_stalled = False
        waiting, self.waiting = self.waiting, []
        for arrived in waiting:
            self._put(arrived)

    def close(self) -> None:
        self.kept[self.broker.will[0]] = self.broker.will[1]

    def _put(self, event: Event) -> None:
        self._events.append(event)
        self._wake()


def _fits(pattern: str, topic: str) -> bool:
    wanted, have = pattern.split("/"), topic.split("/")
    return len(wanted) == len(have) and all(
        want in ("+", word) for want, word in zip(wanted, have, strict=True)
    )


@dataclass
class Bridge:
    """All that runs, and short words for it."""

    lockstep: Lockstep
    robot: ScriptedRobot
    broker: MemoryBroker
    service: MqttService

    def run(self, seconds: float) -> None:
        self.lockstep.run(seconds)

    def do(self, verb: str, payload: bytes | str = b"PRESS", **options: Any) -> None:
        self.broker.send(f"{BASE}/do/{verb}", payload, **options)
        self.run(0.3)

    @property
    def state(self) -> dict[str, Any]:
        return json.loads(self.broker.kept[f"{BASE}/state"])

    @property
    def announced(self) -> dict[str, dict[str, Any]]:
        """What Home Assistant finds, by `component/object_id`."""
        found: dict[str, dict[str, Any]] = {}
        for topic, payload in self.broker.kept.items():
            parts = topic.split("/")
            if parts[0] == "homeassistant":
                found[f"{parts[1]}/{parts[3]}"] = json.loads(payload)
        return found

    @property
    def counters(self) -> dict[str, int]:
        return self.lockstep.counters("mqtt")


@pytest.fixture
def make_bridge(tmp_path: Path) -> Iterator[Callable[..., Bridge]]:
    """Makes a bridge; `kept` is what the broker has from before."""
    opened: list[Lockstep] = []

    def make(
        kept: dict[str, bytes] | None = None,
        *,
        is_up: bool = True,
        forbidden: str = "-",
        webhook: WebhookConfig | None = None,
        broker: str = "broker.home",
        drives_itself: bool = True,
        **mqtt: Any,
    ) -> Bridge:
        lockstep = Lockstep(robot="robby", state=tmp_path)
        opened.append(lockstep)
        made: list[MemoryBroker] = []

        def connect(broker: Broker, precious: str) -> MemoryBroker:
            made.append(MemoryBroker(broker, precious, dict(kept or {}), is_up=is_up))
            made[0].forbidden = forbidden
            return made[0]

        config = RobotConfig(
            robot=RobotSection(name="robby", footprint=FootprintConfig(radius_m=0.2)),
            mqtt=MqttConfig(broker=broker, **mqtt),
            webhook=webhook or WebhookConfig(),
        )
        robot = ScriptedRobot()
        robot.has_planner = robot.has_localizer = drives_itself
        lockstep.add(robot)
        robot.save(["kitchen", "hall"], ["evening"])
        service = lockstep.add(MqttService(config, connect))
        lockstep.run(2.5)
        if not made:  # where no broker is named, nobody has connected
            connect(Broker(host="", port=1, client_id="", will=("", b"")), "")
        return Bridge(lockstep, robot, made[0], service)

    yield make
    for lockstep in opened:
        lockstep.close()


@pytest.fixture
def bridge(make_bridge: Callable[..., Bridge]) -> Bridge:
    """A bridge that is connected."""
    return make_bridge()
