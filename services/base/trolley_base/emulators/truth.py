"""Publishes where an emulated robot really is, as a reference for viewers and tests."""

import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

from trolley import topics
from trolley.connection import Connection, RobotUnreachable, Target
from trolley.messages import Clock, Truth
from trolley.runtime import codec
from trolley.runtime.bus import Query, Sample
from trolley.runtime.robot_time import FollowedTime
from trolley_base.simulation.shared_world import TRUTH_S
from trolley_base.world import TrueState

CONNECT_S, RETRY_S = 1.0, 1.0


class TruthPublisher:
    """Publishes `sim/truth` at 20 Hz while there is a router, and a `base` that says the time.

    Args:
        target: the robot and its routers.
        truth: returns the true state, stamped in local monotonic time.
        tell: called with a line for a person.
    """

    def __init__(
        self,
        target: Target,
        world: str,
        truth: Callable[[], TrueState],
        tell: Callable[[str], None],
    ) -> None:
        assert target.robot is not None
        self._robot, self._endpoints = target.robot, target.endpoints
        self._keys = target.keys
        self._world = world
        self._truth = truth
        self._tell = tell
        self._time = FollowedTime()
        self._lock = threading.Lock()
        self._latest: Truth | None = None
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="truth", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._end.set()
        self._thread.join()

    def _run(self) -> None:
        where = ", ".join(self._endpoints)
        has_reported = False
        while not self._end.is_set():
            try:
                with Connection(self._endpoints, CONNECT_S, self._keys) as connection:
                    self._tell(f"sim/truth of {self._robot} goes to {where}")
                    self._publish(connection)
            except RobotUnreachable:
                if not has_reported:
                    self._tell(f"no router at {where} yet: working alone until there is one")
                    has_reported = True
                self._end.wait(RETRY_S)

    def _publish(self, connection: Connection) -> None:
        """Publish until the end; the connection comes back by itself."""
        key = topics.SIM_TRUTH.key(self._robot)
        closers = (
            connection.listen(topics.CLOCK.key(self._robot), self._hear),
            connection.bus.serve(key, lambda query: self._answer(query, key)),
        )
        try:
            while not self._end.wait(TRUTH_S):
                message = self._message()
                if message is not None:
                    connection.publish(self._robot, topics.SIM_TRUTH, message)
        finally:
            for closer in closers:
                closer.close()

    def _message(self) -> Truth | None:
        """Return the true state in robot time; None while the robot time is unknown."""
        state = self._truth()
        with self._lock:
            stamp_ns = self._time.now(state.stamp_ns)
            self._latest = None if stamp_ns is None else self._as_message(state, stamp_ns)
            return self._latest

    def _as_message(self, state: TrueState, stamp_ns: int) -> Truth:
        return Truth(
            stamp_ns=stamp_ns,
            world=self._world,
            pose=state.pose,
            twist=state.twist,
            collisions=state.collisions,
            clearance=state.clearance,
        )

    def _hear(self, sample: Sample) -> None:
        arrived_ns = time.monotonic_ns()
        try:
            clock = codec.decode(Clock, sample.payload, sample.encoding)
        except codec.BadPayload:
            return
        with self._lock:
            self._time.hear(clock, arrived_ns)

    def _answer(self, query: Query, key: str) -> None:
        with self._lock:
            latest = self._latest
        if latest is not None:
            fmt = codec.format_asked(codec.parse_parameters(query.parameters), "json")
            query.reply(key, codec.encode(latest, fmt), codec.MIME[fmt])
        query.finish()
