import struct

import pytest
import zenoh

from trolley.config.ros2 import why_no_namespace
from trolley_ros2.names import (
    NO_HASH,
    PUBLISHER,
    SUBSCRIPTION,
    Attachment,
    Endpoint,
    Node,
    Qos,
    Seen,
    attachment_of,
    dds_type,
    endpoint_of,
    joined,
    namespace_of,
    publisher_tokens,
    ros_type,
    type_and_hash,
)

STRING = "std_msgs/msg/String"
STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
CHATTER = f"std_msgs::msg::dds_::String_/{STRING_HASH}"


def chatter(depth: int, topic: str = "/chatter") -> Endpoint:
    return Endpoint(topic, STRING, STRING_HASH, Qos(depth))


# The examples of ros2/rmw_zenoh, docs/design.md.


def test_a_topics_key_is_that_of_the_published_examples() -> None:
    assert chatter(10).key(0) == f"0/chatter/{CHATTER}"
    assert chatter(10, "/robot1/chatter").key(0) == f"0/robot1/chatter/{CHATTER}"


def test_tokens_are_those_of_the_published_examples() -> None:
    listener = Node(2, "aac3178e146ba6f1fc6e6a4085e77f21", "/", "listener")
    assert listener.token == "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/listener"
    assert listener.endpoint_token(10, SUBSCRIPTION, chatter(10)) == (
        "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/10/MS/%/%/listener/%chatter/"
        f"{CHATTER}/::,10:,:,:,,"
    )
    talker = Node(2, "8b20917502ee955ac4476e0266340d5c", "/", "talker")
    assert talker.endpoint_token(10, PUBLISHER, chatter(7)) == (
        "@ros2_lv/2/8b20917502ee955ac4476e0266340d5c/0/10/MP/%/%/talker/%chatter/"
        f"{CHATTER}/::,7:,:,:,,"
    )


def test_a_namespace_is_mangled_in_tokens_and_plain_in_keys() -> None:
    node = Node(0, "ab", "/home/kiwi", "trolley")
    token = node.endpoint_token(1, PUBLISHER, chatter(42, "/home/kiwi/chatter"))
    assert token == (
        f"@ros2_lv/0/ab/0/1/MP/%/%home%kiwi/trolley/%home%kiwi%chatter/{CHATTER}/::,:,:,:,,"
    )


def test_transient_local_is_written_as_the_durability() -> None:
    assert Qos(1, is_transient_local=True).chunk == ":1:,1:,:,:,,"


def test_humble_has_no_hash() -> None:
    key = Endpoint("/chatter", STRING, NO_HASH, Qos(10)).key(0)
    assert key == "0/chatter/std_msgs::msg::dds_::String_/TypeHashNotSupported"


def test_what_a_token_says_is_read_again() -> None:
    node = Node(3, "ab", "/kiwi", "teleop")
    token = node.endpoint_token(4, PUBLISHER, chatter(10, "/kiwi/cmd_vel"))
    assert endpoint_of(token) == Seen(PUBLISHER, "/kiwi/teleop", "/kiwi/cmd_vel")
    assert endpoint_of(token + "/cpu") == endpoint_of(token)
    assert endpoint_of(node.token) is None
    assert endpoint_of("@ros2_lv/0") is None
    assert endpoint_of("trolley/kiwi/scan") is None


def test_publishers_of_a_topic_are_found_by_their_tokens_and_nothing_else() -> None:
    node = Node(3, "ab", "/kiwi", "teleop")
    driver = node.endpoint_token(4, PUBLISHER, chatter(10, "/kiwi/cmd_vel"))
    wanted = zenoh.KeyExpr(publisher_tokens(3, "/kiwi/cmd_vel"))
    assert wanted.includes(zenoh.KeyExpr(driver))
    assert wanted.includes(zenoh.KeyExpr(driver + "/cpu"))
    listener = node.endpoint_token(4, SUBSCRIPTION, chatter(10, "/kiwi/cmd_vel"))
    other = node.endpoint_token(4, PUBLISHER, chatter(10, "/kiwi/cmd_vel_raw"))
    for token in (listener, other, node.token):
        assert not wanted.includes(zenoh.KeyExpr(token))


def test_types_are_read_from_a_key() -> None:
    assert type_and_hash(f"0/robot1/chatter/{CHATTER}") == (STRING, STRING_HASH)
    assert ros_type(dds_type(STRING)) == STRING
    assert type_and_hash("scan") == ("", "scan")


@pytest.mark.parametrize(
    ("robot", "namespace"),
    [("kiwi", "/kiwi"), ("kiwi-2", "/kiwi_2"), ("2", "/_2"), ("a-_b", "/a_b"), ("-", "/_")],
)
def test_every_robots_name_makes_a_namespace(robot: str, namespace: str) -> None:
    assert namespace_of(robot) == namespace
    assert why_no_namespace(namespace) == ""


@pytest.mark.parametrize("text", ["", "kiwi", "/kiwi/", "//", "/2", "/a*", "/a b", "/ä", "/a%"])
def test_what_is_no_namespace_is_refused(text: str) -> None:
    assert "is not a namespace" in why_no_namespace(text)


def test_names_are_joined() -> None:
    assert joined("/kiwi", "scan") == "/kiwi/scan"
    assert joined("/", "local_costmap/costmap") == "/local_costmap/costmap"


def test_an_attachment_is_that_of_the_design() -> None:
    data = Attachment(7, 1_700_000_000_000_000_000, bytes(range(16))).pack()
    # 8 bytes number, 8 bytes time, both little-endian, 1 byte length of the gid, 16 bytes gid.
    assert data == (
        (7).to_bytes(8, "little")
        + (1_700_000_000_000_000_000).to_bytes(8, "little")
        + b"\x10"
        + bytes(range(16))
    )
    assert attachment_of(data) == Attachment(7, 1_700_000_000_000_000_000, bytes(range(16)))


@pytest.mark.parametrize(
    "data", [b"", b"\0" * 32, b"\0" * 34, struct.pack("<qqB16s", 1, 2, 12, bytes(16))]
)
def test_what_is_no_attachment_is_none(data: bytes) -> None:
    assert attachment_of(data) is None
