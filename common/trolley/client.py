"""Talk to a robot from Python.

    from trolley import Robot

    with Robot() as robot:                  # the only robot on the network
        print(robot.pose().pose)
        robot.go_to("kitchen")              # waits; raises Refused if it does not arrive
        robot.go_to((1.0, 2.0, 1.57), wait=False)
        for status in robot.follow():
            print(status.state, status.distance_remaining)

Exceptions: `trolley.codes.Refused` (the robot said no, or did not get there: `code` is one of
`trolley.codes`), `trolley.RobotUnreachable` (no router, no such robot),
`trolley.SeveralRobots` (name one), `trolley.config.ConfigError`.
"""

import secrets
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

import msgspec

from trolley import codes, requests, teleop, topics
from trolley.codes import Refused
from trolley.connection import (
    ASK_TIMEOUT_S,
    Connection,
    RobotTime,
    RobotUnreachable,
    Subscription,
    find_target,
    pick_robot,
)
from trolley.geometry import Pose2D, Twist2D
from trolley.messages import (
    BaseState,
    CapturedPose,
    GoalStatus,
    Marker,
    Overlay,
    PoseEstimate,
    Setting,
    Settings,
    TourStatus,
    VelocityCommand,
    request_params,
)
from trolley.requests import Request
from trolley.topics import Topic

M = TypeVar("M", bound=msgspec.Struct)
P = TypeVar("P", bound=msgspec.Struct)
R = TypeVar("R")

Place = str | Pose2D | Sequence[float]
"""A saved pose's name, a pose, or x [m], y [m] and perhaps yaw [rad] in the planner's frame."""

GOAL_ENDS = ("arrived", "failed", "canceled")
TRIP_ENDS = ("done", "failed", "stopped", "idle")
STALE_AFTER_S = 1.0
SILENCE_S = 2.5
"""Silence after which the other side is asked whether it is still there."""
STOP_TRIES = 3
STOP_TRY_S = 0.7
ANY_HEADING = 3.15


class Robot:
    """One robot; a context manager (or call `close`).

    Args:
        name: Which robot; else the configuration file's, else the only one on the network.
        connect: Endpoints of its router, such as "tls/kiwi.local:7448"; else the file's.
        config: A `robot.toml`; else `TROLLEY_CONFIG`, else /etc/trolley/robot.toml.
        connect_timeout: How long to wait for the router [s].

    Raises:
        RobotUnreachable: No router answers, or no robot is there.
        SeveralRobots: None was named and there are several.
        ConfigError: The configuration file cannot be used.
    """

    def __init__(
        self,
        name: str | None = None,
        connect: str | Sequence[str] | None = None,
        config: Path | str | None = None,
        connect_timeout: float = 5.0,
    ) -> None:
        target = find_target(name, [connect] if isinstance(connect, str) else connect, config)
        connection = Connection(target.endpoints, connect_timeout, target.keys)
        with ExitStack() as undo:
            undo.enter_context(connection)
            self.name = pick_robot(connection, target)
            undo.pop_all()  # from now on `close` ends the connection
        self._talk_over(connection)

    @classmethod
    def over(cls, connection: Connection, name: str) -> "Robot":
        """A robot over a connection that somebody else opens and closes."""
        robot = cls.__new__(cls)
        robot.name = name
        robot._talk_over(connection)
        return robot

    def _talk_over(self, connection: Connection) -> None:
        self._connection = connection
        self._time: RobotTime | None = None
        self._stamp_ns = 0  # of the last command

    def close(self) -> None:
        """End the connection."""
        self._connection.__exit__(None, None, None)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def connection(self) -> Connection:
        """The layer below: other robots, services that are alive."""
        return self._connection

    # Anything of the contract.
    def ask(
        self, request: Request[P, R], params: P | None = None, timeout: float = ASK_TIMEOUT_S
    ) -> R:
        """Ask a request of `trolley.requests`; wait `timeout` seconds for the answer."""
        asked = request.params() if params is None else params
        return self._connection.ask(self.name, request, asked, timeout)

    def get(self, topic: Topic[M], *parts: str) -> dict[tuple[str, ...], M]:
        """The latest values of a topic, by the chunks of their keys that vary."""
        return self._connection.get(self.name, topic, *parts)

    def latest(self, topic: Topic[M], *parts: str) -> M | None:
        """The latest value of one key, None if nobody has it."""
        return self._connection.latest(self.name, topic, *parts)

    def subscribe(self, topic: Topic[M], *parts: str) -> Subscription[M]:
        """Listen: `with robot.subscribe(topics.SCAN) as scans: scan = scans.next(1.0).message`."""
        return self._connection.subscribe(self.name, topic, *parts)

    # Where it is.
    def pose(self) -> PoseEstimate:
        """The newest estimate, whatever its state.

        Raises:
            Refused: `not_ready` without a localizer, `stale` if the estimate is over 1 s old.
        """
        estimate = self.latest(topics.POSE)
        now_ns = self._connection.robot_now_ns(self.name)
        if estimate is None:
            raise Refused(codes.NOT_READY, "There is no pose: the localizer is not running.")
        if now_ns is None:
            raise Refused(codes.STALE, "The pose has no age: base is not running.")
        age_s = (now_ns - estimate.stamp_ns) * 1e-9
        if age_s > STALE_AFTER_S:
            raise Refused(codes.STALE, f"The newest pose is {age_s:.1f} s old.", age=age_s)
        return estimate

    def capture(
        self, name: str | None = None, *, icon: str = "", replace: bool = False
    ) -> CapturedPose:
        """Where the robot is; with a name, save it as that place (averaged, the robot standing).

        Raises:
            Refused: `lost`, `stale`, `moving`, `not_converged`, `exists`.
        """
        params = request_params.Capture(name=name, icon=icon, replace=replace)
        return self.ask(requests.POSE_CAPTURE, params)

    # Where it goes.
    def send(self, place: Place, **options: Any) -> GoalStatus:
        """Send a goal without waiting; `options` are fields of `request_params.SendGoal`."""
        return self.ask(requests.GOAL_SEND, goal_to(place, **options))

    def go_to(
        self, place: Place, wait: bool = True, timeout: float | None = None, **options: Any
    ) -> GoalStatus:
        """Drive to a place; with `wait` until it is there.

        Raises:
            Refused: The goal was refused or not reached, with the reason's code; `timeout` after
                `timeout` seconds (the robot drives on).
        """
        goal = goal_to(place, **options)
        status = self.ask(requests.GOAL_SEND, goal)
        if not wait:
            return status
        *_, status = self.follow(goal.id, timeout)
        if status.state != "arrived":
            code = status.reason or status.state
            raise Refused(code, status.message or None, goal=status.id)
        return status

    def follow(self, goal: str | None = None, timeout: float | None = None) -> Iterator[GoalStatus]:
        """Each status of a goal (the current one if none is named) until it has ended.

        Raises:
            Refused: `restarted` if the planner came back without it, `timeout`. RobotUnreachable:
            The planner is gone.
        """
        deadline = _deadline(timeout)
        with self.subscribe(topics.GOAL) as statuses:
            while True:
                arrival = statuses.next(min(SILENCE_S, _left(deadline)))
                status = self._goal_now(goal) if arrival is None else arrival.message
                if goal is None:
                    goal = status.id
                if status.id != goal:  # a newer goal's, or an older one's last word
                    status = self._goal_now(goal)
                yield status
                if status.state in (*GOAL_ENDS, "idle"):
                    return
                if _left(deadline) <= 0.0:
                    raise Refused(codes.TIMEOUT, f"Not there after {timeout:.0f} s.", goal=goal)

    def follow_person(self, point: Sequence[float] | None = None, **options: Any) -> GoalStatus:
        """Begin to follow the person nearest to x, y [m], or the nearest one ahead of the robot.

        It continues until the person is lost or the goal is canceled: see `follow`. `options` are
        fields of `request_params.FollowPerson`.

        Raises:
            Refused: `nobody`, or why it cannot drive there.
        """
        return self.ask(requests.GOAL_FOLLOW, person_at(point, **options))

    def cancel(self, goal: str | None = None) -> GoalStatus:
        """Cancel a goal, or the current one."""
        return self.ask(requests.GOAL_CANCEL, request_params.WhichGoal(id=goal))

    # Trips.
    def tour(self, name: str, wait: bool = True, timeout: float | None = None) -> TourStatus:
        """Drive a stored tour; with `wait` until it has ended: see `state` and `results`.

        Raises:
            Refused: It cannot be started; `timeout`.
        """
        status = self.ask(requests.TOUR_START, request_params.StartTour(name=name))
        if not wait:
            return status
        *_, last = self.follow_tour(status.trip, timeout)
        return last

    def follow_tour(
        self, trip: str | None = None, timeout: float | None = None
    ) -> Iterator[TourStatus]:
        """Each status of a trip (the current one if none is named) until it has ended.

        Raises:
            Refused: `replaced` if another trip took its place, `timeout`. RobotUnreachable: The
            tour service is gone.
        """
        deadline = _deadline(timeout)
        with self.subscribe(topics.TOUR) as statuses:
            while True:
                arrival = statuses.next(min(SILENCE_S, _left(deadline)))
                status = arrival.message if arrival else self._ask_again(topics.TOUR, "tour")
                if trip is None:
                    trip = status.trip
                if status.trip is None and trip is not None:
                    raise Refused(codes.RESTARTED, "The tour service no longer knows the trip.")
                if status.trip != trip:
                    raise Refused(codes.REPLACED, "Another trip took its place.", trip=status.trip)
                yield status
                if status.state in TRIP_ENDS:
                    return
                if _left(deadline) <= 0.0:
                    raise Refused(codes.TIMEOUT, f"Not done after {timeout:.0f} s.", trip=trip)

    # Driving by hand.
    def now_ns(self) -> int | None:
        """Robot time [ns], None while nothing is received from the robot."""
        if self._time is None:
            self._time = RobotTime(self._connection, self.name)
        return self._time.now_ns()

    def drive(self, twist: Twist2D, valid_for: float = teleop.VALID_S) -> None:
        """Drive at a velocity for a moment, as from a joystick: call it 10 to 30 times a second.

        It takes precedence over the planner, whose goal is paused. The robot stops `valid_for`
        seconds (at most 0.5) after the last call.

        Raises:
            RobotUnreachable: Nothing is received from the robot, so nothing was sent.
        """
        stamp_ns = self.now_ns()
        if stamp_ns is None:
            raise RobotUnreachable(f"NOT CONNECTED: nothing is received from {self.name}")
        self._stamp_ns = max(stamp_ns, self._stamp_ns + 1)  # base drops what is not newer
        command = VelocityCommand(stamp_ns=self._stamp_ns, twist=twist, valid_for=valid_for)
        self._connection.publish(self.name, topics.COMMAND, command, teleop.SOURCE)

    # Drawing into the viewer.
    def put_marker(self, namespace: str, name: str, marker: Marker) -> None:
        """Draw a marker; it replaces one of the same namespace and name."""
        self._connection.publish(self.name, topics.MARKER, marker, namespace, name)

    def delete_marker(self, namespace: str = "*", name: str = "*") -> None:
        """Delete a marker, all of a namespace, or all."""
        self._connection.delete(self.name, topics.MARKER, namespace, name)

    def put_overlay(self, name: str, overlay: Overlay) -> None:
        """Show a panel over the scene; it replaces one of the same name."""
        self._connection.publish(self.name, topics.OVERLAY, overlay, name)

    def delete_overlay(self, name: str = "*") -> None:
        """Delete a panel, or all."""
        self._connection.delete(self.name, topics.OVERLAY, name)

    # Settings.
    def config(self, section: str | None = None, key: str | None = None) -> list[Setting]:
        """The settings, those of a section such as "planner", or one of them.

        Raises:
            Refused: `unknown_name`.
        """
        asked = request_params.WhichConfig(section=section, key=key)
        return self.ask(requests.CONFIG_GET, asked).settings

    def set_config(self, section: str, *, save: bool = True, **values: Any) -> Settings:
        """Change settings: `robot.set_config("planner", max_speed_mps=0.3)`; None: the default.

        With `save` they are written into robot.toml, too. The answer's `message` says whether they
        are and when they count; each setting's `value` is what counts now.

        Raises:
            Refused: `bad_request` for a value that is not allowed, `only_in_file`, `file_changed`.
        """
        asked = request_params.SetConfig(section=section, values=values, save=save)
        return self.ask(requests.CONFIG_SET, asked)

    # Stopping.
    def stop(self) -> BaseState:
        """Stop the robot until it is resumed; the request is sent up to three times.

        Raises:
            RobotUnreachable: NOT STOPPED: base does not answer.
        """
        for _ in range(STOP_TRIES):
            try:
                return self.ask(requests.BASE_STOP, timeout=STOP_TRY_S)
            except (Refused, RobotUnreachable):
                time.sleep(0.1)
        raise RobotUnreachable(f"NOT STOPPED: no connection to base of {self.name}")

    def resume(self) -> BaseState:
        """Allow it to drive again; nothing sets off by itself."""
        return self.ask(requests.BASE_RESUME)

    def _goal_now(self, goal: str | None) -> GoalStatus:
        """The status of a goal, even if a newer one is under way."""
        if goal is None:
            return self._ask_again(topics.GOAL, "planner")
        found = self._connection.get(self.name, topics.GOAL, parameters={"id": goal})
        if not found and self._ask_again(topics.GOAL, "planner").id != goal:
            raise Refused(codes.RESTARTED, "The planner was restarted and the goal is gone.")
        return found.get(()) or self._ask_again(topics.GOAL, "planner")

    def _ask_again(self, topic: Topic[M], service: str) -> M:
        """Read a stream that fell silent, giving a supervisor time to restart its owner."""
        for _ in range(20):
            message = self.latest(topic)
            if message is not None:
                return message
            time.sleep(0.5)
        raise RobotUnreachable(f"{service} of {self.name} is silent")


def goal_to(place: Place, **options: Any) -> request_params.SendGoal:
    """A goal at a place, with an id; without a yaw any heading will do.

    Raises:
        ValueError: Coordinates that are not two or three numbers.
    """
    options.setdefault("id", f"py-{secrets.token_hex(6)}")
    if isinstance(place, str):
        return request_params.SendGoal(name=place, **options)
    if isinstance(place, Pose2D):
        return request_params.SendGoal(pose=place, **options)
    if len(place) not in (2, 3):
        raise ValueError(f"a place has two or three numbers (x, y, yaw), not {len(place)}")
    if len(place) == 2:
        options.setdefault("yaw_tolerance", ANY_HEADING)
    pose = Pose2D.from_array((*place, 0.0)[:3])
    return request_params.SendGoal(pose=pose, **options)


def person_at(point: Sequence[float] | None = None, **options: Any) -> request_params.FollowPerson:
    """A request to follow the person nearest to a point, or the nearest one ahead, with an id.

    Raises:
        ValueError: A point that is not two numbers.
    """
    options.setdefault("id", f"py-{secrets.token_hex(6)}")
    if point is None:
        return request_params.FollowPerson(**options)
    if len(point) != 2:
        raise ValueError(f"a point has two numbers (x, y), not {len(point)}")
    x, y = point
    return request_params.FollowPerson(point=(float(x), float(y)), **options)


def _deadline(timeout: float | None) -> float | None:
    return None if timeout is None else time.monotonic() + timeout


def _left(deadline: float | None) -> float:
    return SILENCE_S if deadline is None else max(0.0, deadline - time.monotonic())
