"""A robot on emulated devices, with everything in reach that can be broken.

The board and the lidar are played by `trolley emulate`, so the robot continues to exist when base
dies. Its true position comes over a router of its own, so whatever happens to the robot's router,
the observer still sees it.
"""

import contextlib
import json
import math
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

from bench.faults.proxy import Proxy
from bench.faults.saved import Saved, read_saved
from bench.harness.drives import CORRIDOR, ENTRANCE, KITCHEN

from trolley import requests, topics
from trolley.cli.demo_robot import Choices, write_settings
from trolley.codes import Refused
from trolley.connection import Connection, RobotUnreachable
from trolley.geometry import Pose2D
from trolley.messages import (
    BaseState,
    Clock,
    Health,
    PoseEstimate,
    SavedPose,
    Stop,
    Tour,
    TourStatus,
    Truth,
    Zone,
)
from trolley.messages.request_params import Nothing, StartTour
from trolley.requests import Request
from trolley.runtime import codec
from trolley.runtime.bus import Sample
from trolley.runtime.supervisor import Supervisor
from trolley.runtime.zenoh_bus import ZenohBus, open_bus, open_router
from trolley.topics import Qos, Topic

T = TypeVar("T")
R = TypeVar("R")
ROBOT = "faulty"
SERVICES = ("base", "localizer", "mapper", "planner", "tour", "viz")
DEVICES = ("linorobot", "ld19")
STANDS_MPS, DRIVES_MPS = 0.01, 0.12
FAR_AWAY = [(-9.0, -9.0), (-8.0, -9.0), (-8.0, -8.0)]
STANDS_FOR_S = 0.3
# The unit of base asks for this; without root it stays as it is.
BASE_NICE = -10
START_S = 240.0
TROLLEY = [sys.executable, "-m", "trolley.cli"]


@dataclass(frozen=True)
class Seen:
    """The truth at one moment of local monotonic time."""

    at_s: float
    speed: float
    """True speed [m/s], turning counted at 0.2 m."""
    truth: Truth


class Missing(Exception):
    """Something did not come in time; the text says what."""


class Rig:
    """All of a robot's processes; a context manager.

    Args:
        folder: for settings and, unless `state` is given, the state.
        state: the state folder.
        environment: added to the services' environment.
        router: more words for the command line of the robot's router.
    """

    def __init__(
        self,
        folder: Path,
        state: Path | None = None,
        environment: Mapping[str, str] | None = None,
        router: Sequence[str] = (),
    ) -> None:
        self.folder = folder
        self.state = state or folder / "state"
        self.seen: deque[Seen] = deque(maxlen=20_000)
        self.tour: TourStatus | None = None
        self.base: BaseState | None = None
        self.pose: PoseEstimate | None = None
        self._found_s = -math.inf
        self.reports: list[str] = []
        self._ports = [_free_port() for _ in range(4)]
        self.endpoint, self.judge, self.cut_endpoint = (
            f"tcp/127.0.0.1:{port}" for port in self._ports[:3]
        )
        self._environment = dict(environment or {})
        self._router_words = list(router)
        self._stack = ExitStack()
        self._router: subprocess.Popen[bytes] | None = None
        self._end = threading.Event()

    # Life.
    def __enter__(self) -> Self:
        try:
            self._start()
        except BaseException:
            self._stack.close()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()

    def _start(self) -> None:
        port, _, _, viz_port = self._ports
        choices = Choices(name=ROBOT, port=port, viz_port=viz_port, seed=3, devices=DEVICES)
        self.folder.mkdir(exist_ok=True)
        config = write_settings(choices, self.folder)
        cut = self.folder / "planner.toml"
        cut.write_text(config.read_text().replace(self.endpoint, self.cut_endpoint))
        environment = {
            "TROLLEY_STATE": str(self.state),
            "TROLLEY_CONFIG": str(config),
            "TROLLEY_LOG": "warning",
            **self._environment,
        }
        self._stack.enter_context(open_router([self.judge]))
        self.start_router()
        self._stack.callback(self.stop_router)
        self.proxy = self._stack.enter_context(Proxy(self._ports[2], port))
        self._start_emulator(config)
        modules: dict[str, str | list[str]] = {
            **{name: f"trolley_{name}" for name in SERVICES},
            "planner": ["trolley_planner", "--config", str(cut)],
        }
        self.supervisor = Supervisor(modules, environment, self._note)
        self._stack.enter_context(self.supervisor)
        threading.Thread(target=self._keep_nice, daemon=True).start()
        eye = self._stack.enter_context(open_bus([self.judge], 20.0))
        eye.subscribe(topics.SIM_TRUTH.key(ROBOT), self._see)
        clock = threading.Thread(target=self._tell_time, args=(eye,))
        clock.start()
        self._stack.callback(clock.join)
        self._stack.callback(self._end.set)
        self.connection = self._stack.enter_context(Connection([self.endpoint], 20.0))
        for topic, name in ((topics.TOUR, "tour"), (topics.BASE, "base"), (topics.POSE, "pose")):
            self._follow(topic, name)
        self.connection.listen(topics.POSE.key(ROBOT), self._note_pose)

    def _start_emulator(self, config: Path) -> None:
        command = [*TROLLEY, "emulate", *DEVICES, "--quiet", "--robot", ROBOT]
        command += ["--connect", self.judge, "--config", str(config), "--seed", "3"]
        command += ["--ports", str(self.folder / "ports")]
        self.emulator = subprocess.Popen(command, stdin=subprocess.PIPE)
        _be_nice(self.emulator.pid)
        self._stack.callback(self._end_emulator)

    def _end_emulator(self) -> None:
        self.emulator.terminate()
        self.emulator.wait(20.0)
        assert self.emulator.stdin is not None
        self.emulator.stdin.close()

    def device_fault(self, fault: str) -> None:
        """Make a device go wrong: `ld19:silence+5`."""
        assert self.emulator.stdin is not None
        self.emulator.stdin.write(f"{fault}\n".encode())
        self.emulator.stdin.flush()

    def start_router(self) -> None:
        """Start the robot's router."""
        words = [*TROLLEY, "router", "--listen", self.endpoint, *self._router_words]
        self._router = subprocess.Popen(words)
        self.wait(lambda: _answers(self._ports[0]), 30.0, "the router")

    def stop_router(self) -> None:
        """Kill the robot's router."""
        if self._router is not None:
            self._router.kill()
            self._router.wait()
            self._router = None

    @property
    def router_pid(self) -> int:
        """The robot's router."""
        assert self._router is not None
        return self._router.pid

    def _note(self, report: str) -> None:
        self.reports.append(report)

    def _keep_nice(self) -> None:
        """Give base the priority that its unit asks for, each time it is started."""
        known: int | None = None
        while not self._end.wait(0.05):
            pid = self.supervisor.children["base"].pid
            if pid is not None and pid != known:
                _be_nice(pid)
                known = pid

    # Seeing.
    def _tell_time(self, eye: ZenohBus) -> None:
        """The truth is published by a clock; this one does not end with base."""
        while not self._end.wait(0.1):
            clock = Clock(stamp_ns=time.monotonic_ns(), rate=1.0, epoch=0)
            payload = codec.encode(clock, "msgpack")
            eye.put(topics.CLOCK.key(ROBOT), payload, codec.MIME["msgpack"], Qos.SENSOR)

    def _see(self, sample: Sample) -> None:
        truth = codec.decode(Truth, sample.payload, sample.encoding)
        speed = abs(truth.twist.vx) + 0.2 * abs(truth.twist.wz)
        self.seen.append(Seen(time.monotonic(), speed, truth))

    def _follow(self, topic: Topic[Any], name: str) -> None:
        def take(sample: Sample) -> None:
            try:
                setattr(self, name, codec.decode(topic.message, sample.payload, sample.encoding))
            except codec.BadPayload:
                return  # somebody else's rubbish, in the tests of that

        self.connection.listen(topic.key(ROBOT), take)

    def _note_pose(self, sample: Sample) -> None:
        with contextlib.suppress(codec.BadPayload):
            pose = codec.decode(PoseEstimate, sample.payload, sample.encoding)
            if pose.state == "localized":
                self._found_s = time.monotonic()

    def is_found_since(self, since_s: float) -> bool:
        """Whether it has known where it is after that moment of local monotonic time."""
        return self._found_s > since_s

    @property
    def speed(self) -> float:
        """How fast it truly is [m/s]."""
        return self.seen[-1].speed if self.seen else 0.0

    @property
    def collisions(self) -> int:
        """Contacts that the robot drove into."""
        return self.seen[-1].truth.collisions if self.seen else 0

    def stood_after(self, since_s: float) -> float | None:
        """Seconds until the robot first stood still for a while; None: not yet."""
        stands_since_s: float | None = None
        for seen in tuple(self.seen):
            if seen.at_s <= since_s:
                continue
            if seen.speed >= STANDS_MPS:
                stands_since_s = None
            elif stands_since_s is None:
                stands_since_s = seen.at_s
            elif seen.at_s - stands_since_s >= STANDS_FOR_S:
                return stands_since_s - since_s
        return None

    def fastest_between(self, from_s: float, to_s: float) -> float:
        """The highest speed in a span of time [m/s]."""
        return max((one.speed for one in tuple(self.seen) if from_s < one.at_s < to_s), default=0.0)

    def wait(self, happened: Callable[[], T], seconds: float, what: str) -> T:
        """Wait until something is true.

        Raises:
            Missing: It is not in time.
        """
        end_s = time.monotonic() + seconds
        while not (result := happened()):
            if time.monotonic() > end_s:
                raise Missing(f"not within {seconds:.0f} s: {what}")
            time.sleep(0.01)
        return result

    def health(self, service: str) -> Health | None:
        """A service's report about itself."""
        return self.connection.latest(ROBOT, topics.HEALTH, service)

    def pid(self, service: str) -> int:
        """The process of a service."""
        child = self.supervisor.children[service]
        self.wait(lambda: child.pid is not None, 30.0, f"{service} runs")
        return child.pid or 0

    @property
    def restarts(self) -> dict[str, int]:
        """How often each service was restarted."""
        return {name: child.restarts for name, child in self.supervisor.children.items()}

    def kill(self, pid: int) -> None:
        """Kill a service's process; nothing where it has ended by itself."""
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)

    def signal(self, service: str, number: signal.Signals) -> None:
        """Send a signal to a service, or to the router."""
        os.kill(self.router_pid if service == "router" else self.pid(service), number)

    # Asking.
    def ask(self, request: Request[Any, R], params: object = None) -> R:
        """Ask the robot."""
        given: Any = Nothing() if params is None else params
        return self.connection.ask(ROBOT, request, given)

    def ask_patiently(self, request: Request[Any, R], params: object = None) -> R:
        """Ask until it is answered, but not refused for good."""
        end_s = time.monotonic() + START_S
        while True:
            try:
                return self.ask(request, params)
            except (Refused, RobotUnreachable) as problem:
                if time.monotonic() > end_s:
                    raise Missing(f"{request.name}: {problem}") from problem
            time.sleep(0.3)

    def prepare(self) -> None:
        """Save something of everything, and drive a tour without an end."""
        self.wait(lambda: self.seen, START_S, "the truth")
        self.wait(lambda: self.pose and self.pose.state == "localized", START_S, "localized")
        for name, pose in (("corridor", CORRIDOR), ("kitchen", KITCHEN)):
            self.ask_patiently(requests.POSES_PUT, SavedPose(name=name, map="apartment", pose=pose))
        tour = Tour(name="evening", stops=[Stop(name="kitchen")])
        self.ask_patiently(requests.TOURS_PUT, tour)
        zone = Zone(name="well", kind="keepout", points=FAR_AWAY)
        self.ask_patiently(requests.ZONES_PUT, zone)
        self.ask_patiently(requests.TOUR_START, StartTour(name="evening"))
        self.ask_patiently(requests.TOUR_STOP)
        self.start_tour()
        self.wait_for_driving()  # the planner comes last; until then nobody answers its requests

    def start_tour(self) -> None:
        """Let it drive round forever."""
        places = (CORRIDOR, ENTRANCE, KITCHEN, Pose2D(0.549, 0.218, 0.2579))
        stops = [Stop(pose=place, retries=2, on_failure="skip") for place in places]
        tour = StartTour(tour=Tour(name="round", stops=stops, repeat=0))
        self.ask_patiently(requests.TOUR_START, tour)

    def wait_for_driving(self, seconds: float = START_S) -> None:
        """Wait until it drives along."""
        self.wait(
            lambda: self.tour and self.tour.state == "driving" and self.speed > DRIVES_MPS,
            seconds,
            "the robot drives",
        )

    def saved(self) -> Saved:
        """What is saved now."""
        return read_saved(self.state, ROBOT)


def _be_nice(pid: int) -> None:
    if os.geteuid() == 0:
        try:
            os.setpriority(os.PRIO_PROCESS, pid, BASE_NICE)
        except ProcessLookupError:
            return  # it has ended already


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _answers(port: int) -> bool:
    with socket.socket() as probe:
        probe.settimeout(0.2)
        return probe.connect_ex(("127.0.0.1", port)) == 0


def describe(rig: Rig) -> str:
    """How the robot is, in one line, for what went wrong."""
    tour, base = rig.tour, rig.base
    return json.dumps(
        {
            "tour": tour and [tour.state, tour.message],
            "base": base and [base.mode, base.reason],
            "pose": rig.pose and rig.pose.state,
            "speed": round(rig.speed, 3),
            "restarts": rig.restarts,
            "reports": rig.reports[-4:],
        }
    )
