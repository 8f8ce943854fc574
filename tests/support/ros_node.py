"""A node as rmw_zenoh makes one: its session's settings, its tokens, its attachments.

Written by hand after ros2/rmw_zenoh (docs/design.md, DEFAULT_RMW_ZENOH_SESSION_CONFIG.json5), and
not with the names of `trolley ros2`.
"""

import json
import struct
import time
from types import SimpleNamespace
from typing import Any

import zenoh
import zenoh.ext

from support import ros2
from support.waiting import wait_until
from trolley_ros2 import cdr


class RosNode:
    """A node with a session of its own.

    Args:
        endpoint: of its router.
        name: of the node.
        mode: `peer`, as by default, or `client`.
        hashes: whether its release of ROS 2 has hashes of types.
    """

    def __init__(
        self, endpoint: str, name: str = "rviz", mode: str = "peer", *, hashes: bool = True
    ) -> None:
        self._hashes = hashes
        self._name = name
        self._number = 0
        self._kept: list[Any] = []
        config = zenoh.Config()
        settings = {
            "mode": mode,
            "connect/endpoints": [endpoint],
            "listen/endpoints": ["tcp/localhost:0"] if mode == "peer" else [],
            "scouting/multicast/enabled": False,
            "scouting/gossip/target": {"router": ["router", "peer"], "peer": ["router"]},
            "timestamping/enabled": {"router": True, "peer": True, "client": True},
        }
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
        self.session = zenoh.open(config)
        self.id = str(self.session.info.zid())
        self._token(f"@ros2_lv/0/{self.id}/0/0/NN/%/%/{name}")

    def close(self) -> None:
        self.session.close()

    def key(self, topic: str, type_name: str, type_hash: str | None = None) -> str:
        package, kind, name = type_name.split("/")
        known = ros2.DEFINITIONS.hash_rihs01(type_name) if self._hashes else "TypeHashNotSupported"
        return f"0{topic}/{package}::{kind}::dds_::{name}_/{type_hash or known}"

    def subscribe(
        self, topic: str, type_name: str, *, transient_local: bool = False
    ) -> list[SimpleNamespace]:
        """Messages as they come, read by a library that the bridge does not use."""
        key = self.key(topic, type_name)
        seen: list[SimpleNamespace] = []

        def take(sample: zenoh.Sample) -> None:
            # As rmw_zenoh: what nothing is attached to is dropped.
            assert sample.attachment is not None
            number, _, length, _ = struct.unpack("<qqB16s", sample.attachment.to_bytes())
            assert number > 0
            assert length == 16
            seen.append(ros2.read(type_name, sample.payload.to_bytes()))

        if transient_local:
            subscriber = zenoh.ext.declare_advanced_subscriber(
                self.session,
                key,
                take,
                history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
                recovery=zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
                subscriber_detection=True,
            )
        else:
            subscriber = zenoh.ext.declare_advanced_subscriber(self.session, key, take)
        self._kept.append(subscriber)
        self._entity("MS", topic, key)
        return seen

    def unsubscribe(self) -> None:
        """Take back the newest subscription and its token."""
        for one in (self._kept.pop(), self._kept.pop()):
            one.undeclare()

    def advertise(self, topic: str, type_name: str, type_hash: str | None = None) -> "RosPublisher":
        key = self.key(topic, type_name, type_hash)
        publisher = zenoh.ext.declare_advanced_publisher(self.session, key)
        return RosPublisher(publisher, self._entity("MP", topic, key))

    def graph(self) -> list[str]:
        """All tokens of the domain, without what is a session's own: as `ros2 topic list` asks."""
        replies = self.session.liveliness().get("@ros2_lv/0/**", timeout=10.0)
        tokens = [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]
        return sorted("/".join(token.split("/")[5:]) for token in tokens if self.id not in token)

    def topics(self) -> list[str]:
        """`ros2 topic list`."""
        return sorted({t.split("/")[4].replace("%", "/") for t in self.graph() if t[:2] != "NN"})

    def _entity(self, kind: str, topic: str, key: str) -> Any:
        self._number += 1
        begin = f"@ros2_lv/0/{self.id}/0/{self._number}/{kind}/%/%/{self._name}"
        type_and_hash = "/".join(key.rsplit("/", 2)[1:])
        return self._token(f"{begin}/{topic.replace('/', '%')}/{type_and_hash}/::,10:,:,:,,")

    def _token(self, key: str) -> Any:
        self._kept.append(self.session.liveliness().declare_token(key))
        return self._kept[-1]


class RosPublisher:
    """A publisher that counts what it sends."""

    def __init__(self, publisher: Any, token: Any) -> None:
        self._publisher, self._token = publisher, token
        self._number = 0

    def publish(self, message: Any) -> None:
        self.put(cdr.write(message))

    def put(self, payload: bytes, *, delayed_s: float = 0.0, attached: bool = True) -> None:
        self._number += 1
        source_ns = time.time_ns() - round(delayed_s * 1e9)
        attachment = struct.pack("<qqB16s", self._number, source_ns, 16, b"g" * 16)
        self._publisher.put(payload, attachment=attachment if attached else None)


def wait_for(messages: list[Any], what: str, count: int = 1) -> Any:
    """The newest message, once there are so many."""
    wait_until(lambda: len(messages) >= count, what)
    return messages[-1]
