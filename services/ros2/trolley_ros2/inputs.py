"""What ROS 2 nodes wish of the robot: a velocity, a goal, where it is.

Each goes the way of every program's wish: `base` chooses between the sources of velocities, planner
and localizer accept or refuse. Of a flood, the newest counts.
"""

import threading
from collections.abc import Callable
from typing import Any

from trolley import requests, topics
from trolley.codes import Refused
from trolley.geometry import Twist2D
from trolley.messages import VelocityCommand
from trolley.messages.request_params import SendGoal, SetPose
from trolley.runtime.foreign_bus import ForeignSample
from trolley.runtime.service import Service
from trolley_ros2 import cdr
from trolley_ros2.from_ros import Dropped, decoded, twist_of, where_of
from trolley_ros2.graph import Graph
from trolley_ros2.names import attachment_of, type_and_hash
from trolley_ros2.timing import Delays

SOURCE = "ros2"
"""Whose velocities they are, in `[base] sources`."""
VELOCITY_PERIOD_NS, WISH_PERIOD_NS = 20_000_000, 500_000_000
"""How often a velocity, and how often a goal or a pose, is passed on at most [ns]."""
VELOCITY_LATE_NS, WISH_LATE_NS = 300_000_000, 2_000_000_000
"""How much longer than usual it may have been on its way [ns]."""
VALID_S = 0.5
"""How long a velocity holds: as long as `base` lets one, since most programs publish at 10 Hz."""


class Input:
    """A topic that is listened to: the newest message, at most every `period_ns`.

    Args:
        service: on whose thread messages are obeyed.
        graph: where they come from.
        name: the topic's.
        type_names: what is taken, the usual one first.
        obey: called with a message.
        period_ns: least time between two [ns].
        late_ns: how much longer than usual one may be on its way [ns].
        holds_late: whether a message is obeyed however long it was on its way.
    """

    def __init__(
        self,
        service: Service,
        graph: Graph,
        name: str,
        type_names: tuple[str, ...],
        obey: Callable[[Any], None],
        period_ns: int,
        late_ns: int,
        holds_late: Callable[[Any], bool] = lambda _message: False,
    ) -> None:
        self._service, self._graph = service, graph
        self._name, self._type_names = name, type_names
        self._obey = obey
        self._period_ns, self._late_ns = period_ns, late_ns
        self._holds_late = holds_late
        self._delays = Delays()
        self._lock = threading.Lock()
        self._newest: tuple[ForeignSample, int] | None = None
        self._num_superseded = 0
        self._next_ns = 0

    def start(self) -> None:
        """Listen."""
        self._deadline = self._service.deadline(self._take)
        self._graph.listen(self._name, self._type_names[0], self._store)

    def count(self, reason: str, why: str, number: int = 1) -> None:
        """Count messages that are not obeyed, and say so."""
        self._service.count(f"{self._name}/{reason}", number)
        self._service.log.limited(
            f"{self._name}/{reason}", "Message of ROS 2 dropped", topic=self._name, why=why
        )

    def _store(self, sample: ForeignSample) -> None:
        """Keep the newest (on a thread of Zenoh's)."""
        arrived = (sample, self._service.unix_ns)
        with self._lock:
            is_first = self._newest is None
            self._num_superseded += not is_first
            self._newest = arrived
        if is_first:
            # Never dropped: only the first that waits calls, so nothing would be taken again.
            self._service.call_soon(self._take_when_due, urgent=True, kept=True)

    def _take_when_due(self) -> None:
        wait_ns = self._next_ns - self._service.monotonic_ns
        if wait_ns > 0:
            self._deadline.set(wait_ns * 1e-9)
        else:
            self._take()

    def _take(self) -> None:
        with self._lock:
            newest, self._newest = self._newest, None
            num_superseded, self._num_superseded = self._num_superseded, 0
        if num_superseded:
            rate_hz = 1e9 / self._period_ns
            self.count("flood", f"more than {rate_hz:g} a second", num_superseded)
        if newest is None:
            return
        self._next_ns = self._service.monotonic_ns + self._period_ns
        try:
            self._obey(self._read(*newest))
        except Dropped as dropped:
            self.count(dropped.reason, dropped.why)

    def _read(self, sample: ForeignSample, arrived_ns: int) -> Any:
        """The message.

        Raises:
            Dropped: It is none that can be obeyed.
        """
        type_name, type_hash = type_and_hash(sample.key)
        if type_name not in self._type_names:
            taken = " or ".join(self._type_names)
            raise Dropped("type", f"it is a {type_name}; {taken} is taken")
        if not self._graph.takes_hash(type_name, type_hash):
            raise Dropped("definition", f"its {type_name} is defined otherwise: {type_hash}")
        attachment = attachment_of(sample.attached)
        if attachment is None:
            raise Dropped("no_attachment", "nothing says who sent it when, as rmw_zenoh does")
        is_late = self._delays.is_late(
            attachment.gid, attachment.source_ns, arrived_ns, self._late_ns
        )
        message = decoded(type_name, sample.payload)
        if is_late and not self._holds_late(message):
            raise Dropped("late", "it was too long on its way")
        return message


class Inputs:
    """Subscribes to what ROS 2 nodes publish, and passes it on to the robot."""

    def __init__(self, service: Service, graph: Graph) -> None:
        self._service = service
        self._graph = graph
        self._twists = Input(
            service,
            graph,
            "cmd_vel",
            (cdr.TWIST, cdr.TWIST_STAMPED),
            self._drive,
            VELOCITY_PERIOD_NS,
            VELOCITY_LATE_NS,
            # What stops the robot is never too late.
            lambda message: twist_of(message).is_zero,
        )
        self._goals = Input(
            service, graph, "goal_pose", (cdr.POSE,), self._go, WISH_PERIOD_NS, WISH_LATE_NS
        )
        self._poses = Input(
            service,
            graph,
            "initialpose",
            (cdr.POSE_WITH_COVARIANCE,),
            self._set_pose,
            WISH_PERIOD_NS,
            WISH_LATE_NS,
        )
        self._drivers: dict[str, str] = {}
        self._moves_until_ns = 0

    def start(self) -> None:
        """Listen to all."""
        for one in (self._twists, self._goals, self._poses):
            one.start()
        self._graph.watch_publishers("cmd_vel", self._note_driver)

    def _drive(self, message: Any) -> None:
        twist = twist_of(message)
        self._send(twist)
        until_ns = self._service.monotonic_ns + round(VALID_S * 1e9)
        self._moves_until_ns = 0 if twist.is_zero else until_ns

    def _send(self, twist: Twist2D) -> None:
        now_ns = self._service.now_ns
        if now_ns is None:
            raise Dropped("no_robot", "nothing is heard of the robot")
        command = VelocityCommand(stamp_ns=now_ns, twist=twist, valid_for=VALID_S)
        self._service.publish(topics.COMMAND, command, SOURCE)

    def _note_driver(self, token: str, node: str, is_there: bool) -> None:
        """Note who may drive (on a thread of Zenoh's)."""
        self._service.call_soon(lambda: self._update_drivers(token, node, is_there), urgent=True)

    def _update_drivers(self, token: str, node: str, is_there: bool) -> None:
        if is_there:
            self._drivers[token] = node
            return
        self._drivers.pop(token, None)
        if self._drivers or self._service.monotonic_ns >= self._moves_until_ns:
            return
        # Base would stop the robot once the last velocity has lapsed. It need not drive until then.
        self._moves_until_ns = 0
        try:
            self._send(Twist2D.zero())
        except Dropped as dropped:
            self._twists.count(dropped.reason, dropped.why)
        self._twists.count("node_gone", f"{node}, which was driving, is gone: the robot stops")

    def _go(self, message: Any) -> None:
        where = where_of(message)
        goal = SendGoal(id=self._service.new_id(), pose=where.pose, frame=where.frame)
        self._service.log.info("Goal from ROS 2", x=where.pose.x, y=where.pose.y)
        self._service.request(
            requests.GOAL_SEND, goal, lambda reply: self._note_refusal(self._goals, reply)
        )

    def _set_pose(self, message: Any) -> None:
        where = where_of(message)
        if where.frame != "map":
            raise Dropped("frame", f"its frame is {where.frame!r}: the robot's pose is one in map")
        self._service.request(
            requests.POSE_SET,
            SetPose(pose=where.pose, covariance=where.covariance),
            lambda reply: self._note_refusal(self._poses, reply),
        )

    def _note_refusal(self, of: Input, reply: object) -> None:
        if isinstance(reply, Refused):
            of.count("refused", f"{reply.message} ({reply.code})")
