"""How rmw_zenoh names things: keys of topics, tokens of the graph, what is attached to messages.

Source:
    ros2/rmw_zenoh, docs/design.md, and rmw_zenoh_cpp/src/detail (liveliness_utils.cpp, qos.cpp,
    attachment_helpers.cpp), as of 2026. The tests hold its published examples.
"""

import re
import struct
from dataclasses import dataclass

GRAPH = "@ros2_lv"
"""What every token of the graph begins with."""
NODE, PUBLISHER, SUBSCRIPTION = "NN", "MP", "MS"
"""Kinds of tokens."""
NO_HASH = "TypeHashNotSupported"
"""What stands in place of a type's hash in ROS 2 Humble, which knows none."""
DEFAULT_DEPTH = 42
"""The depth of rmw_zenoh's default profile, which is not written."""
GID_BYTES = 16
_ATTACHED = struct.Struct(f"<qqB{GID_BYTES}s")
_TOKEN_CHUNKS = 13


@dataclass(frozen=True, slots=True)
class Qos:
    """A publisher's or subscription's quality of service: reliable, the newest `depth` kept.

    Attributes:
        depth: messages that are kept.
        is_transient_local: whether who comes later gets what was published before.
    """

    depth: int
    is_transient_local: bool = False

    @property
    def chunk(self) -> str:
        """Return it as a chunk of a token.

        In this order: reliability, durability, history, deadline, lifespan, liveliness.

        What is as in rmw_zenoh's default profile is left out; 1 is transient local.
        """
        depth = "" if self.depth == DEFAULT_DEPTH else str(self.depth)
        return f":{1 if self.is_transient_local else ''}:,{depth}:,:,:,,"


@dataclass(frozen=True, slots=True)
class Endpoint:
    """A publisher or a subscription.

    Attributes:
        topic: the topic's name from the root, `/kiwi/scan`.
        type_name: as in ROS 2, `sensor_msgs/msg/LaserScan`.
        type_hash: `RIHS01_` and the hash, or `NO_HASH`.
        qos: what is promised, or asked for.
    """

    topic: str
    type_name: str
    type_hash: str
    qos: Qos

    def key(self, domain: int) -> str:
        """The key of its messages."""
        name = self.topic.strip("/")
        return f"{domain}/{name}/{dds_type(self.type_name)}/{self.type_hash}"


@dataclass(frozen=True, slots=True)
class Node:
    """A node, and so whoever publishes or subscribes.

    Attributes:
        domain: `ROS_DOMAIN_ID`.
        session: id of its Zenoh session.
        namespace: `/kiwi`, or `/` for none.
        name: of the node in its namespace.
    """

    domain: int
    session: str
    namespace: str
    name: str

    @property
    def token(self) -> str:
        """Its token; the node is the first thing of its session."""
        return self._begin(0, NODE)

    def endpoint_token(self, number: int, kind: str, endpoint: Endpoint) -> str:
        """The token of one of its publishers or subscriptions.

        Args:
            number: which thing of the session it is, from 1.
            kind: `PUBLISHER` or `SUBSCRIPTION`.
            endpoint: what it is.
        """
        rest = (
            _mangled(endpoint.topic),
            dds_type(endpoint.type_name),
            endpoint.type_hash,
            endpoint.qos.chunk,
        )
        return "/".join((self._begin(number, kind), *rest))

    def _begin(self, number: int, kind: str) -> str:
        # No enclave (of SROS 2), and the node's own number is 0.
        where = (_mangled("/"), _mangled(self.namespace), self.name)
        return "/".join((GRAPH, str(self.domain), self.session, "0", str(number), kind, *where))


@dataclass(frozen=True, slots=True)
class Seen:
    """What a stranger's token says of a publisher or subscription."""

    kind: str
    node: str
    """Namespace and name, `/kiwi/teleop`."""
    topic: str


def publisher_tokens(domain: int, topic: str) -> str:
    """A key expression for the tokens of all publishers of a topic."""
    return f"{GRAPH}/{domain}/*/*/*/{PUBLISHER}/*/*/*/{_mangled(topic)}/**"


def endpoint_of(token: str) -> Seen | None:
    """Read the token of a publisher or subscription; None for any other."""
    chunks = token.split("/")
    # Buffer-aware publishers of newer versions add a chunk at the end.
    kinds = (PUBLISHER, SUBSCRIPTION)
    if len(chunks) < _TOKEN_CHUNKS or chunks[0] != GRAPH or chunks[5] not in kinds:
        return None
    namespace = chunks[7].replace("%", "/").rstrip("/")
    return Seen(chunks[5], f"{namespace}/{chunks[8]}", chunks[9].replace("%", "/"))


def type_and_hash(key: str) -> tuple[str, str]:
    """The type, as ROS 2 names it, and the hash at the end of a topic's key."""
    _, _, dds = key.rpartition("/")[0].rpartition("/")
    return ros_type(dds), key.rpartition("/")[2]


def dds_type(type_name: str) -> str:
    """`std_msgs/msg/String` as `std_msgs::msg::dds_::String_`."""
    package, kind, name = type_name.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def ros_type(dds: str) -> str:
    """`std_msgs::msg::dds_::String_` as `std_msgs/msg/String`; anything else as it is."""
    found = re.fullmatch(r"(\w+)::(\w+)::dds_::(\w+)_", dds)
    return dds if found is None else "/".join(found.groups())


def namespace_of(robot: str) -> str:
    """A namespace for a robot: its name, with what no name in ROS 2 may hold replaced by `_`.

    Source:
        design.ros2.org, Topic and Service name mapping to DDS: letters, digits and single `_`,
        and no digit first.
    """
    name = re.sub(r"_+", "_", robot.replace("-", "_"))
    return f"/_{name}" if name[0].isdigit() else f"/{name}"


def joined(namespace: str, name: str) -> str:
    """A topic's name from the root: `/kiwi/scan`, without a namespace `/scan`."""
    return f"{namespace.rstrip('/')}/{name}"


@dataclass(frozen=True, slots=True)
class Attachment:
    """What comes with each message.

    Attributes:
        number: of the message, from its publisher's first, which is 1.
        source_ns: the publisher's clock as it published [ns since 1970].
        gid: the publisher, 16 bytes.
    """

    number: int
    source_ns: int
    gid: bytes

    def pack(self) -> bytes:
        """Return the attachment as bytes."""
        return _ATTACHED.pack(self.number, self.source_ns, GID_BYTES, self.gid)


def attachment_of(data: bytes) -> Attachment | None:
    """Read what came with a message; None where it is none of rmw_zenoh's."""
    if len(data) != _ATTACHED.size:
        return None
    number, source_ns, length, gid = _ATTACHED.unpack(data)
    return Attachment(number, source_ns, gid) if length == GID_BYTES else None


def _mangled(name: str) -> str:
    return name.replace("/", "%")
