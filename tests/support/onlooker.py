"""A program on another host: it notes when messages come, drives by hand and sends goals.

It runs as a process of its own in a network namespace and is asked over a pipe.
"""

import dataclasses
import multiprocessing
import threading
import time
from multiprocessing.connection import Connection as Pipe
from typing import Any

from support import wifi
from trolley import requests, topics
from trolley.codes import Refused
from trolley.connection import Arrival, Connection, RobotTime, RobotUnreachable
from trolley.geometry import Pose2D, Twist2D
from trolley.messages import VelocityCommand
from trolley.messages.request_params import Nothing, SendGoal
from trolley.runtime.bus import Sample
from trolley.teleop import PERIOD_S, SOURCE, VALID_S
from trolley.topics import Topic

WATCHED = {
    "clock": topics.CLOCK,
    "odom": topics.ODOM,
    "pose": topics.POSE,
    "teleop": topics.COMMAND,
    "goal": topics.GOAL,
    "truth": topics.SIM_TRUTH,
}


@dataclasses.dataclass(frozen=True)
class Seen:
    """When a message came, when it was made, and the speed or state it told of."""

    at_s: float
    stamp_s: float
    what: Any = None


@dataclasses.dataclass(frozen=True)
class Answer:
    """How a request ended for the one who asked."""

    code: str
    took_s: float


class Onlooker:
    """The asking end; a program in the namespace `namespace` at the router `endpoint`.

    With `hears_all` it subscribes to all that there is, as a viewer with every layer does.
    """

    def __init__(self, namespace: str, endpoint: str, robot: str, hears_all: bool = False) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, inner = context.Pipe()
        self._process = context.Process(
            target=_run, args=(inner, namespace, endpoint, robot, hears_all), daemon=True
        )
        self._process.start()
        inner.close()

    def seen(self, name: str, since_s: float = 0.0) -> list[Seen]:
        """Messages of a stream in `WATCHED` that came since a moment of the monotonic clock."""
        return self._ask("seen", name, since_s)

    def count_bytes(self) -> int:
        """How much a program that hears all has heard."""
        return self._ask("count_bytes")

    def drive(self, vx: float, until_s: float) -> None:
        """Send `cmd_vel/teleop` until a moment, while all else goes on."""
        self._ask("drive", vx, until_s)

    def send_goal(self, pose: Pose2D) -> Answer:
        """Ask the robot to drive somewhere, and wait for the answer."""
        return self._ask("send_goal", pose)

    def stop(self) -> Answer:
        """Ask the robot to stop, and wait for the answer."""
        return self._ask("stop")

    def close(self) -> None:
        """End the program."""
        self._process.terminate()
        self._process.join()
        self._process.close()
        self._pipe.close()

    def _ask(self, method: str, *arguments: Any) -> Any:
        self._pipe.send((method, arguments))
        answer = self._pipe.recv()
        if isinstance(answer, BaseException):
            raise answer
        return answer


class _Program:
    def __init__(self, connection: Connection, robot: str, hears_all: bool) -> None:
        self.num_bytes = 0
        if hears_all:
            connection.listen(f"trolley/{robot}/**", self._hear)
        self._connection = connection
        self._robot = robot
        self._time = RobotTime(connection, robot)
        self._seen: dict[str, list[Seen]] = {name: [] for name in WATCHED}
        for name, topic in WATCHED.items():
            threading.Thread(target=self._watch, args=(name, topic), daemon=True).start()

    def seen(self, name: str, since_s: float) -> list[Seen]:
        return [one for one in list(self._seen[name]) if one.at_s >= since_s]

    def count_bytes(self) -> int:
        return self.num_bytes

    def drive(self, vx: float, until_s: float) -> None:
        threading.Thread(target=self._drive, args=(vx, until_s), daemon=True).start()

    def send_goal(self, pose: Pose2D) -> Answer:
        return self._timed(requests.GOAL_SEND, SendGoal(pose=pose))

    def stop(self) -> Answer:
        return self._timed(requests.BASE_STOP, Nothing())

    def _timed(self, request: Any, params: Any) -> Answer:
        asked_s = time.monotonic()
        try:
            self._connection.ask(self._robot, request, params)
            code = "ok"
        except Refused as refused:
            code = refused.code
        except RobotUnreachable:
            code = "unreachable"
        return Answer(code, time.monotonic() - asked_s)

    def _drive(self, vx: float, until_s: float) -> None:
        stamp_ns = 0
        while time.monotonic() < until_s:
            # Where the robot's clock is silent a stubborn program goes on counting by itself.
            now_ns = self._time.now_ns() or stamp_ns + round(PERIOD_S * 1e9)
            stamp_ns = max(now_ns, stamp_ns + 1)
            command = VelocityCommand(
                stamp_ns=stamp_ns, twist=Twist2D(vx, 0.0, 0.0), valid_for=VALID_S
            )
            self._connection.publish(self._robot, topics.COMMAND, command, SOURCE)
            time.sleep(PERIOD_S)

    def _hear(self, sample: Sample) -> None:
        self.num_bytes += len(sample.payload)

    def _watch(self, name: str, topic: Topic[Any]) -> None:
        with self._connection.subscribe(self._robot, topic, with_latest=False) as arrivals:
            for arrival in arrivals:
                self._seen[name].append(_note(arrival))


def _note(arrival: Arrival[Any]) -> Seen:
    message = arrival.message
    what = getattr(message, "state", None)
    if hasattr(message, "twist"):
        what = abs(message.twist.vx) + 0.2 * abs(message.twist.wz)
    return Seen(arrival.arrived_s, message.stamp_ns * 1e-9, what)


def _run(pipe: Pipe, namespace: str, endpoint: str, robot: str, hears_all: bool) -> None:
    wifi.enter(namespace)
    with Connection([endpoint], 60.0) as connection:
        program = _Program(connection, robot, hears_all)
        while True:
            try:
                method, arguments = pipe.recv()
            except EOFError:
                return
            pipe.send(getattr(program, method)(*arguments))
