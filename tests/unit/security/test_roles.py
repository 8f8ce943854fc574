"""What each role may do, judged as Zenoh does: a rule holds for keys that it includes wholly."""

import re

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from trolley import requests, topics
from trolley.security.certificates import ROLES
from trolley.security.host_keys import KeysError
from trolley.security.roles import EVERYTHING, all_but, grants
from trolley.topics import Kind

NAMES = st.sampled_from(["kiwi", "lime", "viz", "base"])
STREAMS = [topic for topic in topics.TOPICS if topic.kind is Kind.STREAM]
STORED = [topic for topic in topics.TOPICS if topic.kind is Kind.STORED]


def may(role: str, message: str, key: str, name: str = "kiwi") -> bool:
    """Whether a message enters a router."""
    asked = zenoh.KeyExpr(key)
    return any(
        zenoh.KeyExpr(rule).includes(asked)
        for grant in grants(role, name)
        if message in grant.messages
        for rule in grant.keys
    )


@pytest.mark.parametrize("role", ROLES)
@pytest.mark.parametrize("topic", topics.TOPICS, ids=lambda topic: topic.name)
def test_everybody_reads_everything(role: str, topic: topics.Topic) -> None:
    for robot in ("*", "lime"):
        assert may(role, "declare_subscriber", topic.key(robot))
        assert may(role, "query", topic.key(robot))
    assert may(role, "declare_subscriber", "trolley/**")
    assert may(role, "liveliness_query", topics.ALIVE.key("*"))
    assert may(role, "declare_liveliness_subscriber", topics.ALIVE.key("*"))


@pytest.mark.parametrize("request_", requests.REQUESTS, ids=lambda request: request.name)
def test_who_may_ask_what(request_: requests.Request) -> None:
    key = request_.key("lime")
    assert may("operator", "query", key)
    assert may("viewer", "query", key) == (request_ is requests.BASE_STOP)
    assert not may("robot", "query", key, name="kiwi")
    assert may("robot", "query", key, name="lime")


@pytest.mark.parametrize("role", ["viewer", "operator"])
def test_all_robots_can_be_stopped(role: str) -> None:
    assert may(role, "query", requests.BASE_STOP.key("*"))
    assert may(role, "query", requests.BASE_STOP.key("lime"))


@pytest.mark.parametrize("role", ["viewer", "operator"])
@pytest.mark.parametrize("topic", STREAMS, ids=lambda topic: topic.name)
def test_no_stream_of_a_robot_is_forged(role: str, topic: topics.Topic) -> None:
    if topic is topics.COMMAND:
        key = topic.key("lime", "planner")
    elif topic is topics.TF:
        key = topic.key("lime", "odom")
    else:
        key = topic.key("lime", *["base"] * topic.num_parts)
    is_own = topic is topics.CHOICE
    # Costs are of the programs that publish them, and close nothing.
    may_put = is_own or (role == "operator" and topic is topics.COSTS)
    assert may(role, "put", key) == may_put
    assert may(role, "reply", key) == is_own
    assert may(role, "declare_queryable", key) == is_own


@pytest.mark.parametrize("role", ["viewer", "operator", "robot"])
@pytest.mark.parametrize("message", ["put", "delete", "reply", "declare_queryable"])
def test_nobody_answers_for_a_robot(role: str, message: str) -> None:
    for request in requests.REQUESTS:
        assert not may(role, message, request.key("lime"), name="kiwi")
    assert not may(role, "liveliness_token", topics.ALIVE.key("lime", "base", "x"), name="kiwi")


@pytest.mark.parametrize("topic", STORED, ids=lambda topic: topic.name)
def test_operators_store_and_viewers_do_not(topic: topics.Topic) -> None:
    key = topic.key("lime", *["Küche", "1"][: topic.num_parts])
    for message in ("put", "delete"):
        assert may("operator", message, key)
        assert not may("viewer", message, key)
        assert not may("robot", message, key)


def test_operators_clear_drawings() -> None:
    for topic in (topics.MARKER, topics.OVERLAY):
        below = topic.key("lime").rstrip("*/")
        assert may("operator", "delete", f"{below}/**")
    assert may("operator", "delete", topics.MARKER.key("lime", "plan").replace("/*", "/**"))


@pytest.mark.parametrize(
    ("source", "is_allowed"),
    [("teleop", True), ("ros2", True), ("planner", False), ("calibrate", False), ("*", False)],
)
def test_operators_drive_by_hand_and_from_ros_only(source: str, is_allowed: bool) -> None:
    assert may("operator", "put", topics.COMMAND.key("lime", source)) == is_allowed


@pytest.mark.parametrize("role", ["viewer", "operator", "robot"])
def test_no_node_of_ros_comes_in_from_another_host(role: str) -> None:
    for message in EVERYTHING:
        assert not may(role, message, "0/kiwi/cmd_vel/geometry_msgs::msg::dds_::Twist_/RIHS01_1")
        assert not may(role, message, "@ros2_lv/0/a/0/1/MP/%/%/node/%kiwi%cmd_vel/x/y/::,1:,:,:,,")


@pytest.mark.parametrize(
    ("child", "is_allowed"),
    [
        *(
            (child, True)
            for child in ("camera", "od", "odom2", "Odom", "o", "base", "l", "base_link_2")
        ),
        *((child, False) for child in ("odom", "laser", "base_link")),
        *((child, False) for child in ("*", "**", "o$*", "$*m", "od$*m", "b$*", "la$*er", "*/x")),
    ],
)
def test_operators_have_frames_of_their_own(child: str, is_allowed: bool) -> None:
    assert may("operator", "put", topics.TF.key("lime", child)) == is_allowed
    assert may("operator", "put", topics.TF.key("*", child)) == is_allowed
    assert not may("viewer", "put", topics.TF.key("lime", child))


@given(
    names=st.lists(st.text("abc", min_size=1, max_size=3), min_size=1, max_size=3),
    asked=st.lists(st.sampled_from(["a", "b", "c", "$*"]), min_size=1, max_size=4),
)
def test_all_names_but_some_and_no_pattern_that_could_mean_them(
    names: list[str], asked: list[str]
) -> None:
    """Judged by Zenoh's own words for `includes` and `intersects`."""
    chunk = re.sub(r"(\$\*)+", "$*", "".join(asked))
    wanted = zenoh.KeyExpr(f"tf/{'*' if chunk == '$*' else chunk}")
    is_allowed = any(zenoh.KeyExpr(f"tf/{one}").includes(wanted) for one in all_but(names))
    means_one = any(wanted.intersects(zenoh.KeyExpr(f"tf/{name}")) for name in names)
    assert not (is_allowed and means_one)
    assert is_allowed or means_one or "*" in str(wanted)


@pytest.mark.parametrize("role", ["viewer", "operator"])
def test_a_viewer_shows_itself(role: str) -> None:
    run = "pc-1-2"
    assert may(role, "liveliness_token", topics.ALIVE.key("lime", "viz-pc", run))
    assert may(role, "put", topics.HEALTH.key("lime", "viz-pc"))
    assert may(role, "put", topics.CHOICE.key("lime", "menu"))
    assert not may(role, "put", topics.HEALTH.key("lime", "vi"))


@given(
    name=NAMES, other=NAMES, message=st.sampled_from(EVERYTHING), rest=st.text("ab/", max_size=8)
)
def test_a_robot_does_everything_under_its_own_name_only(
    name: str, other: str, message: str, rest: str
) -> None:
    chunks = [chunk for chunk in rest.split("/") if chunk] or ["x"]
    reads = message in ("declare_subscriber", "query") or message.endswith(
        ("liveliness_subscriber", "liveliness_query")
    )
    for key in (
        "/".join(("trolley", other, *chunks)),
        "/".join(("trolley", other, "@do", *chunks)),
    ):
        expected = other == name or (reads and "@do" not in key)
        assert may("robot", message, key, name=name) == expected


def test_what_is_outside_of_trolley_is_nobodys() -> None:
    for role in ROLES:
        for message in EVERYTHING:
            for key in ("other/x", "@/router/local", "**"):
                assert not may(role, message, key)


def test_no_other_role_is_known() -> None:
    with pytest.raises(KeysError, match="not a role"):
        grants("ca", "trolley")
