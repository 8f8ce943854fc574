"""Talk to a robot from Python.

    from trolley import Robot

    with Robot() as robot:                  # the only robot on the network
        print(robot.pose().pose)
        robot.go_to("kitchen")              # waits; raises Refused if it does not arrive
        robot.go_to((1.0, 2.0), wait=False)
        for status in robot.follow():       # how it goes
            print(status.state, status.distance_remaining)

`trolley.AsyncRobot` is the same for asyncio.

Exceptions: `trolley.Refused` (the robot said no, or did not get there: `code` is one of
`trolley.codes`, the text one sentence), `trolley.RobotUnreachable` (no router, no such robot, or it
fell silent), `trolley.SeveralRobots` (name one), `trolley.config.ConfigError` (a robot.toml that
cannot be used), and ValueError for what could never be sent, such as a pose that is not finite.
"""

import copy
import math
import secrets
import sys
import threading
import time
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, TypeVar

import msgspec
import numpy as np

from trolley import codes, requests, teleop, topics
from trolley.codes import Refused
from trolley.connection import (
    ASK_TIMEOUT_S,
    MOST_WAITING,
    Arrival,
    Closed,
    Connection,
    RobotTime,
    RobotUnreachable,
    Subscription,
    find_target,
    pick_robot,
)
from trolley.geometry import Pose2D, Twist2D
from trolley.gridmap import GridMap
from trolley.gridmap.wire import grid_of
from trolley.laser_scan import LaserScan
from trolley.messages import (
    BaseState,
    Battery,
    CapturedPose,
    GoalStatus,
    MapInfo,
    Marker,
    Overlay,
    PoseEstimate,
    SavedPose,
    Setting,
    Settings,
    Tour,
    TourStatus,
    VelocityCommand,
    Zone,
    request_params,
)
from trolley.messages.types import floats_from_bytes
from trolley.picture import MapPicture
from trolley.requests import Request
from trolley.runtime import codec
from trolley.runtime.zenoh_bus import is_forked
from trolley.topics import Qos, Topic

if TYPE_CHECKING:
    from PIL.Image import Image as PillowImage

M = TypeVar("M", bound=msgspec.Struct)
P = TypeVar("P", bound=msgspec.Struct)
R = TypeVar("R")

Place = str | Pose2D | Sequence[float]
"""A saved place's name, a pose, or x [m], y [m] and perhaps yaw [rad] in the planner's frame."""

GOAL_ENDS = ("arrived", "failed", "canceled")
TRIP_ENDS = ("done", "failed", "stopped", "idle")
STALE_AFTER_S = 1.0
SILENCE_S = 2.5
"""Silence after which the other side is asked whether it is still there."""
STOP_TRIES = 3
STOP_TRY_S, STOP_PAUSE_S = 0.7, 0.1
ANY_HEADING = 3.15
ASK_AGAIN_S, ASK_AGAIN_FOR_S = 0.5, 10.0
"""A stream that fell silent is asked for this often, and for as long: a supervisor restarts its
owner meanwhile."""
LOOK_AGAIN_S = 0.1
"""How often it is looked whether a robot that was named is there."""
FIND_TIMEOUT_S = 60.0
CHECKED_WITHIN_S = 3.0
"""How long a pose that was found may be `unsure`, since it is checked against further scans."""
GIVE_UP_S = 3.0
"""How long closing waits until the goals are canceled that somebody waits for."""
LOAD_TIMEOUT_S = 60.0
"""How long a map may take to be read by a small computer."""


class Robot:
    """One robot; a context manager (or call `close`).

    It may be used by several threads. A goal or a trip belongs to the robot, not to the program
    that sent it: if the program dies, the robot finishes it.

    Args:
        name: Which robot; else the configuration file's, else the only one on the network.
        connect: Endpoints of its router, such as "tls/kiwi.local:7448"; else the file's.
        config: A `robot.toml`; else `TROLLEY_CONFIG`, else /etc/trolley/robot.toml.
        connect_timeout: How long to wait for the router, and for a robot that was named [s]: it may
            just be starting.

    Raises:
        RobotUnreachable: No router answers, or no robot, or none of that name, is there.
        SeveralRobots: None was named and there are several.
        ConfigError: The configuration file cannot be used.
        ValueError: `connect` is no endpoint.
    """

    name: str
    """The robot's name."""

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
            found = pick_robot(connection, target)
            deadline = _deadline(connect_timeout)
            while found == target.robot and not connection.services(found):
                if _left(deadline) <= 0.0:
                    raise connection.unknown_robot(found)
                time.sleep(LOOK_AGAIN_S)
            self._talk_over(connection, found)
            # Also where nobody calls `close`, as in a notebook: an open session hangs Python's end.
            self._end: weakref.finalize[Any, Any] | None
            self._end = weakref.finalize(self, connection.__exit__, None, None, None)
            undo.pop_all()  # from now on `close` ends the connection

    @classmethod
    def over(cls, connection: Connection, name: str) -> "Robot":
        """A robot over a connection that somebody else opens and closes."""
        robot = cls.__new__(cls)
        robot._talk_over(connection, name)  # noqa: SLF001
        return robot

    @classmethod
    def names(
        cls,
        connect: str | Sequence[str] | None = None,
        config: Path | str | None = None,
        connect_timeout: float = 5.0,
    ) -> list[str]:
        """The robots on the network: `for name in Robot.names(): Robot(name).stop()`.

        Raises:
            RobotUnreachable: No router answers.
        """
        target = find_target(None, [connect] if isinstance(connect, str) else connect, config)
        with Connection(target.endpoints, connect_timeout, target.keys) as connection:
            return connection.robots()

    def _talk_over(self, connection: Connection, name: str) -> None:
        self.name = name
        self._connection = connection
        self._end = None
        self._hand = _Hand(connection, name)
        # Goals, also of those apart, and the threads that wait for them.
        self._awaited: dict[str | None, int] = {}
        self._listen_apart()

    def _listen_apart(self) -> None:
        # A plain flag: a signal may not set a threading.Event whose `wait` it interrupts.
        self._is_closed = False
        self._lock = threading.RLock()  # a signal may close what is just beginning
        self._begun: weakref.WeakSet[Subscription[Any] | Robot] = weakref.WeakSet()

    def apart(self) -> "Robot":
        """The same robot over the same connection; closing it only ends what was begun with it."""
        apart = copy.copy(self)
        apart._end = None  # noqa: SLF001
        apart._listen_apart()  # noqa: SLF001
        self._begin(apart)
        return apart

    def _begin(self, what: "Subscription[Any] | Robot") -> None:
        """Note what has to end with this robot."""
        with self._lock:
            self._begun.add(what)
            is_late = self._is_closed
        if is_late:
            what.close()

    def close(self) -> None:
        """End the connection, and whatever waits for the robot: that raises RobotUnreachable.

        Goals that `go_to` waits for are canceled.
        """
        if is_forked():
            return
        with self._lock:
            self._is_closed = True
            begun = list(self._begun)
        for one in begun:
            one.close()
        if self._end is None:
            return
        for goal, thread in list(self._awaited.items()):
            if thread == threading.get_ident():  # a signal has interrupted `go_to`
                del self._awaited[goal]
                self._give_up(goal, None)
        deadline = _deadline(GIVE_UP_S)
        while self._awaited and _left(deadline) > 0.0:
            time.sleep(0.01)
        self._end()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        where = "closed" if self._is_closed else f"at {', '.join(self._connection.endpoints)}"
        return f"<Robot {self.name} {where}>"

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
        return self._open().ask(self.name, request, asked, timeout)

    def get(self, topic: Topic[M], *parts: str) -> dict[tuple[str, ...], M]:
        """The latest values of a topic, by the chunks of their keys that vary."""
        return self._open().get(self.name, topic, *parts)

    def latest(self, topic: Topic[M], *parts: str) -> M | None:
        """The latest value of one key, None if nobody has it."""
        return self._open().latest(self.name, topic, *parts)

    def subscribe(
        self,
        topic: Topic[M],
        *parts: str,
        most_waiting: int = MOST_WAITING,
        with_latest: bool = True,
    ) -> Subscription[M]:
        """Listen, and get messages with their key, size and time of arrival.

        `with robot.subscribe(topics.HEALTH) as arrivals: arrival = arrivals.next(1.0)`.

        Args:
            topic: what to listen to.
            parts: the chunks of its key that vary; those left out may be anything.
            most_waiting: how many messages are kept that are not read yet.
            with_latest: whether it begins with the latest value, however old.
        """
        subscription = self._open().subscribe(
            self.name, topic, *parts, most_waiting=most_waiting, with_latest=with_latest
        )
        self._begin(subscription)
        return subscription

    def stream(self, topic: Topic[M], *parts: str, timeout: float | None = None) -> Iterator[M]:
        """Each message of a topic from now on, the latest that is known first.

        Of a sensor's stream (`trolley.topics` says which they are) a program that is slower than
        the robot gets the newest message and misses others; of a state's, all (but see
        `trolley.connection.MOST_WAITING`). It continues when the robot or its router was restarted.

        Raises:
            RobotUnreachable: Nothing came for `timeout` seconds (None: wait for ever), or this
                Robot was closed.
        """
        waiting = 1 if topic.qos is Qos.SENSOR else MOST_WAITING
        return self._stream(topic, parts, timeout, waiting)

    def _stream(
        self, topic: Topic[M], parts: tuple[str, ...], timeout: float | None, waiting: int
    ) -> Iterator[M]:
        with self.subscribe(topic, *parts, most_waiting=waiting) as arrivals:
            while True:
                arrival = arrivals.next(timeout)
                if arrival is None:
                    self._open()
                    name = "/".join(topic.key(self.name, *parts).split("/")[2:])
                    raise RobotUnreachable(f"nothing came on {name} of {self.name} for {timeout} s")
                yield arrival.message

    def on(self, topic: Topic[M], call: Callable[[M], object], *parts: str) -> Subscription[M]:
        """Call with each message of a topic, on a thread of its own, until the result is closed.

        It calls as `stream` yields. If `call` raises, Python prints the traceback, and it is not
        called again.
        """
        waiting = 1 if topic.qos is Qos.SENSOR else MOST_WAITING
        subscription = self.subscribe(topic, *parts, most_waiting=waiting)

        def run() -> None:
            with subscription:
                for arrival in subscription:
                    call(arrival.message)

        threading.Thread(target=run, name=f"on {topic.name}", daemon=True).start()
        return subscription

    def publish(self, topic: Topic[M], message: M, *parts: str) -> None:
        """Publish a message, as a program does that takes a service's place.

        What nobody may send is dropped on the way, as is everything while there is no router.

        Raises:
            ValueError: No receiver would accept it, such as a number that is not finite.
        """
        try:
            codec.decode(topic.message, codec.encode(message, "msgpack"), codec.MIME["msgpack"])
        except codec.BadPayload as problem:
            raise ValueError(f"{topic.message.__name__}: {problem}") from problem
        self._open().publish(self.name, topic, message, *parts)

    def _open(self) -> Connection:
        if self._is_closed:
            raise Closed
        return self._connection

    # Where it is.
    def pose(self) -> PoseEstimate:
        """The newest estimate, whatever its state.

        Raises:
            Refused: `not_ready` without a localizer, `stale` if the estimate is over 1 s old.
        """
        now_ns = self._open().robot_now_ns(self.name)  # first: a late answer makes no pose old
        estimate = self._have(
            topics.POSE, "There is no pose: the localizer is not running, or has no map."
        )
        if now_ns is None:
            self._open()
            raise Refused(codes.STALE, "The pose has no age: base is not running.")
        age_s = (now_ns - estimate.stamp_ns) * 1e-9
        if age_s > STALE_AFTER_S:
            raise Refused(codes.STALE, f"The newest pose is {age_s:.1f} s old.", age=age_s)
        return estimate

    def poses(self, timeout: float | None = None) -> Iterator[PoseEstimate]:
        """The newest estimate, again and again: `for pose in robot.poses(): ...`; see `stream`."""
        return self._stream(topics.POSE, (), timeout, 1)

    def set_pose(self, pose: Pose2D | Sequence[float]) -> PoseEstimate:
        """Tell the robot that it is roughly at a pose on the map: x [m], y [m], yaw [rad].

        Raises:
            Refused: `outside_map`, `in_obstacle`, `mapping`.
        """
        return self.ask(requests.POSE_SET, request_params.SetPose(pose=as_pose(pose)))

    def find(self, timeout: float = FIND_TIMEOUT_S) -> PoseEstimate:
        """Let the robot search the whole map for its pose, and wait for the result.

        A pose that is still `unsure` after 3 s more is returned as it is.

        Raises:
            Refused: `lost` if it is not found, `mapping`; `timeout`.
        """
        asked = self.ask(requests.POSE_FIND)
        deadline = _deadline(timeout)
        with self.subscribe(topics.POSE, most_waiting=1) as estimates:
            found = asked
            while found.state == "searching" or found.stamp_ns <= asked.stamp_ns:
                if _left(deadline) <= 0.0:
                    raise Refused(codes.TIMEOUT, f"Not found after {timeout:g} s.")
                arrival = self._next(estimates, _left(deadline))
                found = found if arrival is None else arrival.message
            checked = _deadline(CHECKED_WITHIN_S)
            while found.state == "unsure" and _left(checked) > 0.0:
                arrival = self._next(estimates, _left(checked))
                found = found if arrival is None else arrival.message
        if found.state not in ("localized", "unsure"):
            raise Refused(codes.LOST, found.message or "The robot was not found on the map.")
        return found

    def wait_until_localized(self, timeout: float | None = None) -> PoseEstimate:
        """Wait until the robot knows where it is; return that.

        Raises:
            Refused: `not_localized` after `timeout` seconds, with what the localizer says.
        """
        deadline, last = _deadline(timeout), self.latest(topics.POSE)
        # The latest value may be left from before the lidar, or base, fell silent.
        with self.subscribe(topics.POSE, most_waiting=1, with_latest=False) as estimates:
            while True:
                arrival = self._next(estimates, _left(deadline))
                if arrival is not None:
                    last = arrival.message
                    if last.state == "localized":
                        return last
                if _left(deadline) <= 0.0:
                    said = "there is no pose" if last is None else last.message or last.state
                    if last is not None and last.state == "localized":
                        said = "no pose came in that time"
                        if timeout is not None and timeout > STALE_AFTER_S:
                            said = "its pose is old, since the localizer gets no scans"
                    why = f"Not localized after {timeout:g} s: {said}"
                    raise Refused(codes.NOT_LOCALIZED, f"{why.rstrip('.')}.")

    def capture(
        self, name: str | None = None, *, icon: str = "", replace: bool = False
    ) -> CapturedPose:
        """Where the robot is; with a name, save it as that place (averaged, the robot standing).

        Raises:
            Refused: `lost`, `stale`, `moving`, `not_converged`, `exists`.
        """
        params = request_params.Capture(name=name, icon=icon, replace=replace)
        return self.ask(requests.POSE_CAPTURE, params)

    # What it sees and has.
    def scan(self) -> LaserScan:
        """The newest revolution of the lidar, as arrays.

        Raises:
            Refused: `not_ready` if there is none.
        """
        return LaserScan.of(self._have(topics.SCAN, "There is no scan: base or its lidar is off."))

    def scans(self, timeout: float | None = None) -> Iterator[LaserScan]:
        """Revolutions of the lidar: `for scan in robot.scans(): scan.points()`; see `stream`."""
        return map(LaserScan.of, self._stream(topics.SCAN, (), timeout, 1))

    def battery(self) -> Battery:
        """Charge, voltage, and whether it is charging; None where the robot does not measure it.

        Raises:
            Refused: `not_ready` if base is not running.
        """
        return self._have(topics.BASE, "Base is not running.").battery or Battery()

    def map(self) -> GridMap:
        """The map: `cells` is (rows, cols) int8, 0 free to 100 occupied, -1 unknown.

        Raises:
            Refused: `not_ready` if there is none.
        """
        missing = "There is no map: the localizer has loaded none."
        return grid_of(self._have(topics.MAP, missing))

    def maps(self) -> list[str]:
        """The names of the maps that the robot can load."""
        return self.ask(requests.MAP_LIST)

    def load_map(self, name: str, at: Pose2D | Sequence[float] | None = None) -> MapInfo:
        """Change to another map, and wait until it is in use.

        Args:
            name: one of `maps()`.
            at: where the robot is on it; without, it searches.

        Raises:
            Refused: `unknown_name`, `outside_map`, `in_obstacle`, `mapping`; `timeout`.
        """
        before = self.latest(topics.ZONES)
        pose = None if at is None else as_pose(at)
        try:
            return self.ask(requests.MAP_LOAD, request_params.LoadMap(name=name, pose=pose))
        except Refused as refused:
            if refused.code != codes.TIMEOUT:
                raise
        # Reading a large map takes a small computer longer than an answer may.
        deadline = _deadline(LOAD_TIMEOUT_S)
        while _left(deadline) > 0.0:
            self._pause(ASK_AGAIN_S)
            zones = self.latest(topics.ZONES)
            if zones is not None and zones.map == name and zones != before:
                grid = self.latest(topics.MAP)
                if grid is not None and grid.name == name:
                    return msgspec.convert(grid, MapInfo, from_attributes=True)
        raise Refused(codes.TIMEOUT, f"The map {name} is not in use yet; see `trolley status`.")

    def zones(self) -> list[Zone]:
        """The zones of the map: mirrors, glass, no-go and slow areas, rooms.

        Raises:
            Refused: `not_ready` if there is no map.
        """
        missing = "There are no zones: the localizer has loaded no map."
        return self._have(topics.ZONES, missing).zones

    def put_zone(self, zone: Zone) -> Zone:
        """Save a zone; it replaces one of the same name.

        Raises:
            Refused: `bad_request` for a shape that is none, `not_saved`, `mapping`.
        """
        return self.ask(requests.ZONES_PUT, zone)

    def delete_zone(self, name: str) -> None:
        """Delete a zone.

        Raises:
            Refused: `unknown_name`, `not_saved`, `mapping`.
        """
        self.ask(requests.ZONES_DELETE, request_params.Named(name=name))

    def places(self) -> dict[str, SavedPose]:
        """The saved places of all maps, by name.

        Raises:
            Refused: `not_ready` if the tour service is not running.
        """
        saved = self._have(topics.POSES, "The tour service is not running.")
        return {place.name: place for place in saved.poses}

    def put_place(
        self, name: str, pose: Pose2D | Sequence[float], *, icon: str = "", note: str = ""
    ) -> SavedPose:
        """Save a place of the present map; it replaces one of the same name. See also `capture`.

        Raises:
            Refused: `bad_request` for a name that cannot be one, `not_saved`.
        """
        place = SavedPose(name=name, pose=as_pose(pose), icon=icon, note=note)
        return self.ask(requests.POSES_PUT, place)

    def delete_place(self, name: str) -> None:
        """Delete a place.

        Raises:
            Refused: `unknown_name`, `not_saved`.
        """
        self.ask(requests.POSES_DELETE, request_params.Named(name=name))

    def tours(self) -> dict[str, Tour]:
        """The saved tours, by name.

        Raises:
            Refused: `not_ready` if the tour service is not running.
        """
        saved = self._have(topics.TOURS, "The tour service is not running.")
        return {tour.name: tour for tour in saved.tours}

    def put_tour(self, tour: Tour) -> Tour:
        """Save a tour; it replaces one of the same name.

        Raises:
            Refused: `bad_request`, `not_saved`. Places need not be saved before the trip.
        """
        return self.ask(requests.TOURS_PUT, tour)

    def delete_tour(self, name: str) -> None:
        """Delete a tour.

        Raises:
            Refused: `unknown_name`, `not_saved`.
        """
        self.ask(requests.TOURS_DELETE, request_params.Named(name=name))

    # Where it goes.
    def go_to(
        self,
        place: Place,
        wait: bool = True,
        timeout: float | None = None,
        *,
        speed: float | None = None,
        via: Sequence[Pose2D | Sequence[float]] = (),
        xy_tolerance: float | None = None,
        yaw_tolerance: float | None = None,
        frame: str | None = None,
    ) -> GoalStatus:
        """Drive to a place; with `wait` until it is there. `follow` shows how it goes.

        Ctrl-C while it waits, or whatever else a signal's handler raises, cancels the goal. While
        it is paused, since somebody stopped the robot, say, it goes on waiting: continue the goal
        by `ask(requests.GOAL_RESUME)`.

        Args:
            place: a saved place's name, a pose, or x [m], y [m] and perhaps yaw [rad]; without a
                yaw any heading will do.
            wait: whether to wait until the robot has arrived.
            timeout: how long to wait [s]; None: as long as it takes.
            speed: at most this fast [m/s].
            via: poses on the way, in this order.
            xy_tolerance: how far from the place it may end [m], at least 0.005; None: 0.05.
            yaw_tolerance: how far from the heading it may end [rad], at least 0.01; None: 0.05, pi:
                any heading.
            frame: the frame of the coordinates; None: the planner's, the only one that it takes.

        Returns:
            The goal's status: `arrived`, or without `wait` what came of sending it.

        Raises:
            Refused: The goal was refused or not reached: the reason's code and a sentence;
                `timeout` after `timeout` seconds (the robot drives on).
            ValueError: What could be no place.
        """
        goal = goal_to(
            place,
            speed=speed,
            via=[as_pose(one) for one in via],
            xy_tolerance=xy_tolerance,
            yaw_tolerance=yaw_tolerance,
            frame=frame,
        )
        if not wait:
            return self.ask(requests.GOAL_SEND, goal)
        self._open()
        self._awaited[goal.id] = threading.get_ident()
        is_left = True  # a signal's handler may raise anything
        try:
            self.ask(requests.GOAL_SEND, goal)
            *_, status = self.follow(goal.id, timeout)
            is_left = False
        except (Refused, RobotUnreachable) as problem:
            is_left = isinstance(problem, Closed)
            raise
        finally:
            if is_left and goal.id in self._awaited:
                self._give_up(goal.id, sys.exc_info()[1])
            self._awaited.pop(goal.id, None)
        if status.state != "arrived":
            self._open()  # closing it has canceled the goal, whose status may still come
            code = status.reason or status.state
            raise Refused(code, status.message or None, goal=status.id)
        return status

    def _give_up(self, goal: str | None, error: BaseException | None) -> None:
        """Cancel a goal that nobody waits for any longer; the error is told if that fails."""
        try:
            which = request_params.WhichGoal(id=goal)
            self._connection.ask(self.name, requests.GOAL_CANCEL, which)
        except (Refused, RobotUnreachable) as problem:
            if error is not None:
                error.add_note(f"The goal was not canceled: {problem}")

    def follow(self, goal: str | None = None, timeout: float | None = None) -> Iterator[GoalStatus]:
        """Each status of a goal (the current one if none is named) until it has ended.

        Raises:
            Refused: `restarted` if the planner came back without it, or never had it; `timeout`.
            RobotUnreachable: The planner is gone.
        """
        deadline = _deadline(timeout)
        with self.subscribe(topics.GOAL) as statuses:
            while True:
                arrival = self._next(statuses, _left(deadline))
                status = self._goal_now(goal) if arrival is None else arrival.message
                if goal is None:
                    goal = status.id
                if status.id != goal:  # a newer goal's, or an older one's last word
                    status = self._goal_now(goal)
                yield status
                if status.state in (*GOAL_ENDS, "idle"):
                    return
                if _left(deadline) <= 0.0:
                    raise Refused(codes.TIMEOUT, f"Not there after {timeout:g} s.", goal=goal)

    def follow_person(
        self,
        point: Sequence[float] | None = None,
        *,
        distance: float | None = None,
        speed: float | None = None,
        frame: str | None = None,
    ) -> GoalStatus:
        """Begin to follow a person; it continues until they are lost or the goal is canceled.

        Args:
            point: who is nearest to x, y [m]; None: the nearest one ahead of the robot.
            distance: how far to stay behind them [m], 0.8 to 2; None: 1.2.
            speed: at most this fast [m/s].
            frame: the frame of the point; None: the planner's.

        Raises:
            Refused: `nobody`, or why it cannot drive there.
        """
        goal = person_at(point, distance=distance, speed=speed, frame=frame)
        return self.ask(requests.GOAL_FOLLOW, goal)

    def cancel(self, goal: str | None = None) -> GoalStatus:
        """Cancel a goal, or the current one."""
        return self.ask(requests.GOAL_CANCEL, request_params.WhichGoal(id=goal))

    # Trips.
    def tour(self, name: str, wait: bool = True, timeout: float | None = None) -> TourStatus:
        """Drive a saved tour; with `wait` until it has ended: see `state` and `results`.

        Requests for it while it drives are `requests.TOUR_PAUSE`, `TOUR_RESUME`, `TOUR_SKIP` and
        `TOUR_STOP`: `robot.ask(requests.TOUR_STOP)`.

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
        known = None if trip is None else self.latest(topics.TOUR)
        newest_ns = 0 if known is None else known.stamp_ns
        with self.subscribe(topics.TOUR) as statuses:
            while True:
                arrival = self._next(statuses, _left(deadline))
                status = arrival.message if arrival else self._ask_again(topics.TOUR, "tour")
                if status.trip != trip and 0 < status.stamp_ns < newest_ns:
                    continue  # said before the trip began: answers overtake streams on a slow link
                newest_ns = status.stamp_ns
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
                    raise Refused(codes.TIMEOUT, f"Not done after {timeout:g} s.", trip=trip)

    # Driving by hand.
    def now_ns(self) -> int | None:
        """Robot time [ns], None while nothing is received from the robot."""
        self._open()
        return self._hand.now_ns()

    def drive(self, twist: Twist2D, valid_for: float = teleop.VALID_S) -> None:
        """Drive at a velocity for a moment, as from a joystick: call it 10 to 30 times a second.

        It takes precedence over the planner, whose goal is paused. The robot stops `valid_for`
        seconds (at most 0.5) after the last call, also if the program dies.

        Raises:
            RobotUnreachable: Nothing is received from the robot, so nothing was sent.
            ValueError: A number that is not finite; nothing was sent.
        """
        if not (twist.is_finite() and math.isfinite(valid_for)):
            raise ValueError(f"a velocity needs finite numbers, not {twist} for {valid_for} s")
        self._open()
        self._hand.drive(twist, valid_for)

    # Drawing into the viewer.
    def put_marker(self, namespace: str, name: str, marker: Marker) -> None:
        """Draw a marker; it replaces one of the same namespace and name."""
        self.publish(topics.MARKER, marker, namespace, name)

    def delete_marker(self, namespace: str = "*", name: str = "*") -> None:
        """Delete a marker, all of a namespace, or all."""
        self._open().delete(self.name, topics.MARKER, namespace, name)

    def put_overlay(self, name: str, overlay: Overlay) -> None:
        """Show a panel over the scene; it replaces one of the same name."""
        self.publish(topics.OVERLAY, overlay, name)

    def delete_overlay(self, name: str = "*") -> None:
        """Delete a panel, or all."""
        self._open().delete(self.name, topics.OVERLAY, name)

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
            except Closed:
                raise
            except (Refused, RobotUnreachable):
                self._pause(STOP_PAUSE_S)
        raise RobotUnreachable(f"NOT STOPPED: no connection to base of {self.name}")

    def resume(self) -> BaseState:
        """Allow it to drive again; nothing sets off by itself."""
        return self.ask(requests.BASE_RESUME)

    # A look at it.
    def picture(self, side: int = 800) -> "PillowImage":
        """The map from above with robot, places, zones, path and what the lidar sees.

        Args:
            side: its longer side [pixels].

        Raises:
            Refused: `not_ready` if there is no map.
        """
        grid, zones, places = self.map(), self.latest(topics.ZONES), self.latest(topics.POSES)
        about, estimate, path = (
            self.latest(topics.ROBOT),
            self.latest(topics.POSE),
            self.latest(topics.PATH),
        )
        pose = None if estimate is None else estimate.pose
        points = np.empty((0, 2))
        scan, mounting = self.latest(topics.SCAN), self.latest(topics.TF, "laser")
        if pose is not None and scan is not None and mounting is not None:
            points = (pose @ mounting.pose).transform_points(LaserScan.of(scan).points())
        return MapPicture(
            grid,
            pose,
            about.footprint if about is not None else (),
            points,
            points[:0]
            if path is None
            else floats_from_bytes(path.poses, 3)[:, :2].astype(np.float64),
            places.poses if places is not None else (),
            zones.zones if zones is not None else (),
        ).draw(side)

    def _repr_png_(self) -> bytes | None:
        """What a notebook shows of it; where there is no map, it shows `repr`."""
        try:
            picture: Any = self.picture()
        except (Refused, RobotUnreachable):
            return None
        return picture._repr_png_()

    def _have(self, topic: Topic[M], missing: str) -> M:
        message = self.latest(topic)
        if message is None:
            connection = self._open()
            if not connection.services(self.name):
                raise connection.unknown_robot(self.name)
            raise Refused(codes.NOT_READY, missing, service=topic.first_owner)
        return message

    def _next(self, arrivals: Subscription[M], left_s: float) -> Arrival[M] | None:
        """The next message; None after a while, when the other side should be asked."""
        arrival = arrivals.next(min(SILENCE_S, left_s))
        if arrival is None:
            self._open()
        return arrival

    def _pause(self, seconds: float) -> None:
        time.sleep(seconds)
        self._open()

    def _goal_now(self, goal: str | None) -> GoalStatus:
        """The status of a goal, even if a newer one is under way."""
        if goal is None:
            return self._ask_again(topics.GOAL, "planner")
        found = self._open().get(self.name, topics.GOAL, parameters={"id": goal})
        if not found and self._ask_again(topics.GOAL, "planner").id != goal:
            raise Refused(
                codes.RESTARTED,
                f"The planner does not know the goal {goal}: it was restarted, or never had it.",
            )
        return found.get(()) or self._ask_again(topics.GOAL, "planner")

    def _ask_again(self, topic: Topic[M], service: str) -> M:
        """Read a stream that fell silent, giving a supervisor time to restart its owner."""
        deadline = _deadline(ASK_AGAIN_FOR_S)
        while _left(deadline) > 0.0:
            message = self.latest(topic)
            if message is not None:
                return message
            self._pause(ASK_AGAIN_S)
        raise RobotUnreachable(
            f"{service} of {self.name} is silent; "
            "if only the connection is lost, the robot drives on"
        )


class _Hand:
    """What driving by hand remembers from one command to the next."""

    def __init__(self, connection: Connection, robot: str) -> None:
        self._connection, self._robot = connection, robot
        self._lock = threading.RLock()  # a signal may halt the drive that it interrupts
        self._time: RobotTime | None = None
        self._stamp_ns = 0  # of the last command

    def now_ns(self) -> int | None:
        with self._connection.using(), self._lock:  # one that was forked never gets the lock
            return self._now_ns()

    def _now_ns(self) -> int | None:
        if self._time is None:
            self._time = RobotTime(self._connection, self._robot)
        return self._time.now_ns()

    def drive(self, twist: Twist2D, valid_for: float) -> None:
        with self._connection.using(), self._lock:  # one that was forked never gets the lock
            stamp_ns = self._now_ns()
            if stamp_ns is None:
                raise RobotUnreachable(f"NOT CONNECTED: nothing is received from {self._robot}")
            self._stamp_ns = max(stamp_ns, self._stamp_ns + 1)  # base drops what is not newer
            command = VelocityCommand(stamp_ns=self._stamp_ns, twist=twist, valid_for=valid_for)
            self._connection.publish(self._robot, topics.COMMAND, command, teleop.SOURCE)


def as_pose(place: Pose2D | Sequence[float]) -> Pose2D:
    """A pose, or x [m], y [m] and perhaps yaw [rad], as a pose.

    Raises:
        ValueError: Other than two or three finite numbers.
    """
    if isinstance(place, Pose2D):
        place = (place.x, place.y, place.yaw)
    try:
        numbers = [float(number) for number in place]
    except TypeError:
        numbers = []
    if len(numbers) not in (2, 3):
        raise ValueError(f"a place has two or three numbers (x, y, yaw), not {place!r}")
    return Pose2D.from_array((*numbers, 0.0)[:3])


def goal_to(
    place: Place,
    *,
    speed: float | None = None,
    via: Sequence[Pose2D] = (),
    xy_tolerance: float | None = None,
    yaw_tolerance: float | None = None,
    frame: str | None = None,
) -> request_params.SendGoal:
    """A goal at a place, with an id; the arguments are those of `Robot.go_to`.

    Raises:
        ValueError: A place that cannot be one.
    """
    name, pose = (place, None) if isinstance(place, str) else (None, as_pose(place))
    if not isinstance(place, str | Pose2D) and len(place) == 2 and yaw_tolerance is None:
        yaw_tolerance = ANY_HEADING
    given = {"speed": speed, "xy_tolerance": xy_tolerance, "yaw_tolerance": yaw_tolerance}
    return request_params.SendGoal(
        id=_new_id(),
        name=name,
        pose=pose,
        via=list(via),
        frame=frame,
        **_numbers(given),
    )


def person_at(
    point: Sequence[float] | None = None,
    *,
    distance: float | None = None,
    speed: float | None = None,
    frame: str | None = None,
) -> request_params.FollowPerson:
    """A request to follow a person, with an id; the arguments are those of `Robot.follow_person`.

    Raises:
        ValueError: A point that is not two finite numbers.
    """
    if point is not None and len(point) != 2:
        raise ValueError(f"a point has two numbers (x, y), not {len(point)}")
    at = None if point is None else as_pose(point)
    return request_params.FollowPerson(
        id=_new_id(),
        point=None if at is None else (at.x, at.y),
        frame=frame,
        **_numbers({"distance": distance, "speed": speed}),
    )


def _new_id() -> str:
    return f"py-{secrets.token_hex(6)}"


def _numbers(given: dict[str, float | None]) -> dict[str, Any]:
    """What was given, NumPy's numbers too; the rest is left to the request's own defaults."""
    return {name: float(number) for name, number in given.items() if number is not None}


def _deadline(timeout: float | None) -> float | None:
    return None if timeout is None else time.monotonic() + timeout


def _left(deadline: float | None) -> float:
    return SILENCE_S if deadline is None else max(0.0, deadline - time.monotonic())
