"""A session with programs that do not speak Trolley's wire, at the same router or another.

They need what a `Bus` has not: bytes that travel beside each message, the newest message for those
who come later, and word of whether anybody listens.
"""

# Zenoh's stubs leave most of its results without a type.

import dataclasses
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from typing import Any

import zenoh
import zenoh.ext

from trolley.runtime.zenoh_bus import LARGEST, ZenohBus, open_bus

MISSED_S = 0.5
"""How often those who keep the newest message are told its number, if it has changed: who missed it
asks for it then."""


@dataclasses.dataclass(frozen=True, slots=True)
class ForeignSample:
    """A message of theirs, and what travelled beside it; b"" where nothing did."""

    key: str
    payload: bytes
    attached: bytes


class ForeignPublisher:
    """Publishes under one key, and knows whether anybody listens there.

    Args:
        session: to publish in.
        key: where.
        keeps_newest: whether who comes later gets the newest message.
        on_heard: called, on a thread of Zenoh's, when somebody begins or nobody continues to
            listen.
    """

    def __init__(
        self, session: zenoh.Session, key: str, *, keeps_newest: bool, on_heard: Callable[[], None]
    ) -> None:
        self._session, self._key = session, key
        self._keeps_newest = keeps_newest
        self._publisher = self._declare()
        # An advanced publisher does not tell whether it is heard.
        self._beside = session.declare_publisher(key)
        status: Any = self._beside.matching_status  # its stub says bool
        self.is_heard = bool(status.matching)

        def take(status: Any) -> None:
            self.is_heard = bool(status.matching)
            on_heard()

        self._listener = self._beside.declare_matching_listener(take)

    def put(self, payload: bytes, attached: bytes) -> None:
        """Publish."""
        self._publisher.put(payload, attachment=attached)

    def forget(self) -> None:
        """Keep the newest message no longer: it may be out of date when somebody comes."""
        if self._keeps_newest:
            self._publisher.undeclare()
            self._publisher = self._declare()

    def _declare(self) -> "zenoh.ext.AdvancedPublisher":
        if not self._keeps_newest:
            return zenoh.ext.declare_advanced_publisher(
                self._session, self._key, congestion_control=zenoh.CongestionControl.DROP
            )
        return zenoh.ext.declare_advanced_publisher(
            self._session,
            self._key,
            congestion_control=zenoh.CongestionControl.DROP,
            cache=zenoh.ext.CacheConfig(max_samples=1),
            publisher_detection=True,
            sample_miss_detection=zenoh.ext.MissDetectionConfig(
                heartbeat=None, sporadic_heartbeat=MISSED_S
            ),
        )


class ForeignBus:
    """What others publish and listen to; use `open_foreign_bus`."""

    def __init__(self, bus: ZenohBus) -> None:
        self.bus = bus
        """The session's tokens and connection."""
        self._kept: list[object] = []  # what loses its handle is taken back

    @property
    def session_id(self) -> str:
        """The session's id, as Zenoh writes it."""
        return str(self.bus.session.info.zid())

    def publisher(
        self, key: str, *, keeps_newest: bool, on_heard: Callable[[], None]
    ) -> ForeignPublisher:
        """Begin to publish under a key; the arguments are those of `ForeignPublisher`."""
        return ForeignPublisher(self.bus.session, key, keeps_newest=keeps_newest, on_heard=on_heard)

    def subscribe(self, key_expr: str, callback: Callable[[ForeignSample], None]) -> None:
        """Call back, on one of Zenoh's threads, for each put that matches, as long as this is open.

        Of a payload that is too large for any message, only the size is read.
        """

        def receive(sample: zenoh.Sample) -> None:
            if sample.kind != zenoh.SampleKind.PUT:
                return
            size = len(sample.payload)
            payload = sample.payload.to_bytes() if size <= LARGEST else bytes(LARGEST + 1)
            attachment = sample.attachment
            attached = b"" if attachment is None else attachment.to_bytes()
            callback(ForeignSample(str(sample.key_expr), payload, attached))

        self._kept.append(self.bus.session.declare_subscriber(key_expr, receive))


@contextmanager
def open_foreign_bus(endpoints: Sequence[str], timeout_s: float) -> Generator[ForeignBus]:
    """Connect to the router at `endpoints`.

    Raises:
        NotConnected: Nobody answers within `timeout_s`.
    """
    with open_bus(endpoints, timeout_s) as bus:
        yield ForeignBus(bus)
