"""The robot as a node among ROS 2's: its publishers, its subscriptions, and who else there is."""

import hashlib
from collections.abc import Callable
from typing import Any

from trolley.runtime.foreign_bus import ForeignBus, ForeignPublisher, ForeignSample
from trolley_ros2 import cdr
from trolley_ros2.names import (
    GID_BYTES,
    PUBLISHER,
    SUBSCRIPTION,
    Attachment,
    Endpoint,
    Node,
    Qos,
    endpoint_of,
    joined,
    publisher_tokens,
)

NODE_NAME = "trolley"


class Publisher:
    """A publisher that shows in the graph."""

    def __init__(self, foreign: ForeignPublisher, token: str) -> None:
        self._foreign = foreign
        self._number = 0
        # rmw_zenoh takes another hash of the token. All that counts is that it is always the same.
        self._gid = hashlib.blake2b(token.encode(), digest_size=GID_BYTES).digest()

    @property
    def is_heard(self) -> bool:
        """Whether anybody subscribes."""
        return self._foreign.is_heard

    def publish(self, message: Any, unix_ns: int) -> None:
        """Publish a message, by the host's clock at `unix_ns`.

        Raises:
            NotWritten: A number is too large for its field.
        """
        payload = cdr.write(message)
        self._number += 1
        self._foreign.put(payload, Attachment(self._number, unix_ns, self._gid).pack())

    def forget(self) -> None:
        """Keep the newest message no longer."""
        self._foreign.forget()


class Graph:
    """The robot's node in the ROS graph, and the other nodes that are seen there.

    Args:
        ros: a session at the nodes' router.
        domain: their ROS_DOMAIN_ID.
        namespace: the robot's.
        distro: `jazzy` or `humble`.
    """

    def __init__(self, ros: ForeignBus, domain: int, namespace: str, distro: str) -> None:
        self._ros = ros
        self._distro = distro
        self._node = Node(domain, ros.session_id, namespace, NODE_NAME)
        self._num_endpoints = 0

    def join(self) -> None:
        """Show the node."""
        self._ros.bus.declare_token(self._node.token)

    def advertise(
        self, name: str, type_name: str, qos: Qos, on_heard: Callable[[], None]
    ) -> Publisher:
        """Show a publisher; `on_heard` comes on a thread of Zenoh's."""
        endpoint = self._endpoint(name, type_name, qos)
        foreign = self._ros.publisher(
            endpoint.key(self._node.domain),
            keeps_newest=qos.is_transient_local,
            on_heard=on_heard,
        )
        return Publisher(foreign, self._show(PUBLISHER, endpoint))

    def listen(self, name: str, type_name: str, callback: Callable[[ForeignSample], None]) -> None:
        """Show a subscription; `callback` comes on a thread of Zenoh's, for every type there is."""
        endpoint = self._endpoint(name, type_name, Qos(depth=1))
        begin = endpoint.key(self._node.domain).rsplit("/", 2)[0]
        self._ros.subscribe(f"{begin}/*/*", callback)
        self._show(SUBSCRIPTION, endpoint)

    def watch_publishers(self, name: str, callback: Callable[[str, str, bool], None]) -> None:
        """Call back, on a thread of Zenoh's, with token, node, and whether one came or went."""
        topic = joined(self._node.namespace, name)

        def receive(token: str, is_there: bool) -> None:
            seen = endpoint_of(token)
            if seen is not None:
                callback(token, seen.node, is_there)

        # Not those of all other things: a large system has thousands.
        tokens = publisher_tokens(self._node.domain, topic)
        self._ros.bus.watch_tokens(tokens, receive)

    def takes_hash(self, type_name: str, type_hash: str) -> bool:
        """Whether a type's hash is that of the definition which we know, of any release."""
        return type_hash in (cdr.type_hash(type_name, "jazzy"), cdr.type_hash(type_name, "humble"))

    def _endpoint(self, name: str, type_name: str, qos: Qos) -> Endpoint:
        type_hash = cdr.type_hash(type_name, self._distro)
        return Endpoint(joined(self._node.namespace, name), type_name, type_hash, qos)

    def _show(self, kind: str, endpoint: Endpoint) -> str:
        self._num_endpoints += 1
        token = self._node.endpoint_token(self._num_endpoints, kind, endpoint)
        self._ros.bus.declare_token(token)
        return token
