"""What `trolley top` and `trolley status` show."""

from typing import Any

import pytest
from msgspec.structs import replace

from trolley import topics
from trolley.cli.columns import Column, table_lines
from trolley.cli.robot_sentence import robot_sentence
from trolley.cli.top import sentence_of
from trolley.cli.top_picture import (
    Picture,
    ServiceView,
    lines_of,
    short_bytes,
    short_time,
    topic_views,
)
from trolley.geometry import Pose2D
from trolley.messages import (
    BaseState,
    GoalState,
    GoalStatus,
    Health,
    PoseEstimate,
    PoseState,
    TourStatus,
)
from trolley.runtime import codec
from trolley.traffic import Flow, Tally

OK = Health(stamp_ns=1, state="ok", cpu=0.123, rss=150_000_000, up=75.0)
OFTEN = Flow(1.0, 70.0, 0.4)
FLOWS = {
    topics.SCAN.key("one"): Flow(10.0, 30_000.0, 0.1),
    topics.POSE.key("one"): Flow(3.0, 900.0, 0.1),
    topics.ODOM.key("one"): Flow(30.0, 3000.0, 0.0),
    topics.CLOCK.key("one"): Flow(10.0, 400.0, 0.0),
    topics.PATH.key("one"): Flow(0.0, 0.0, 99.0),
    topics.BASE.key("one"): Flow(0.0, 0.0, 99.0),
    "trolley/one/zap": Flow(9.0, 9.0, 0.0),
}


def service(name: str = "base", **fields: Any) -> ServiceView:
    known: dict[str, Any] = {
        "is_alive": True,
        "health": OK,
        "flow": OFTEN,
        "restarts": 0,
    }
    return ServiceView("one", name, **(known | fields))


@pytest.fixture
def picture() -> Picture:
    services = [service(), service("tour", is_alive=False), service("planner", health=None)]
    return Picture({"one": "It stands."}, services, topic_views(FLOWS, {}, "bytes"))


def test_services_are_alive_silent_or_gone() -> None:
    assert service().state == "ok"
    assert service(flow=None).state == "silent"
    assert service(flow=Flow(0.0, 0.0, 9.0)).state == "silent"
    assert service(health=None).state == "starting"
    assert service(is_alive=False).state == "gone"


def test_topics_are_sorted_and_what_ended_is_left_out() -> None:
    by_bytes = [one.name for one in topic_views(FLOWS, {}, "bytes")]
    assert by_bytes == ["scan", "odom", "pose", "clock", "base"]
    assert [one.name for one in topic_views(FLOWS, {}, "rate")][:2] == ["odom", "clock"]
    assert [one.name for one in topic_views(FLOWS, {}, "name")] == sorted(by_bytes)


def test_a_wrong_rate_is_seen() -> None:
    wrong = {one.name: one.is_wrong for one in topic_views(FLOWS, {}, "name")}
    assert wrong == {"scan": False, "pose": True, "odom": False, "clock": False, "base": True}
    half = {one.name: str(one.wanted) for one in topic_views(FLOWS, {"one": 0.5}, "name")}
    assert (half["odom"], half["clock"]) == ("10-25", "10")


@pytest.mark.parametrize("width", [20, 50, 80, 200])
@pytest.mark.parametrize("height", [5, 12, 24, None])
def test_the_picture_fits_its_terminal(picture: Picture, width: int, height: int | None) -> None:
    lines = lines_of(picture, width, height)
    assert all(len(text) <= width for text, _ in lines)
    if height is not None:
        assert len(lines) <= height
        assert "q quit"[: width - 15] in lines[-1][0]


def test_what_is_wrong_is_coloured(picture: Picture) -> None:
    colours = {text.split()[0]: colour for text, colour in lines_of(picture, 80, None) if text}
    assert (colours["scan"], colours["pose"], colours["base"]) == (None, "red", "red")
    assert (colours["tour"], colours["planner"]) == ("red", "yellow")


def test_several_robots_are_told_apart(picture: Picture) -> None:
    two = Picture({"one": "", "two": ""}, picture.services, picture.topics)
    lines = [text for text, _ in lines_of(two, 80, None)]
    assert any(text.startswith("one/scan ") for text in lines)
    assert any(text.startswith("one/tour ") for text in lines)


def test_names_cannot_steer_the_terminal() -> None:
    evil = Picture({"one": "\x1b[2J"}, [service("\x1b[31m")], [])
    assert not any("\x1b" in text for text, _ in lines_of(evil, 80, 24))


def test_narrow_tables_leave_out_what_matters_least() -> None:
    columns = (Column("NAME", is_number=False), Column("MUCH", 9), Column("LITTLE", 1))
    rows = [("a", "1", "2"), ("long name", "10", "-")]
    assert table_lines(columns, rows, 40)[0] == "NAME       MUCH  LITTLE"
    assert table_lines(columns, rows, 16) == (
        "NAME       MUCH",
        ["a             1", "long name    10"],
    )
    assert table_lines(columns, rows, 4) == ("NAME", ["a", "long"])
    assert table_lines(columns, [("a", "1", "-")], 40)[0] == "NAME  MUCH"
    assert table_lines(columns, [], 40) == ("NAME", [])


def test_a_service_tells_itself_how_long_it_is_up() -> None:
    assert service().up_s == 75.0
    assert service(health=Health(stamp_ns=1, state="ok")).up_s is None  # of an earlier release
    assert service(health=None).up_s is None
    assert service(is_alive=False).up_s is None


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.04, "0.0 s"), (75.0, "75 s"), (600.0, "10 min"), (9000.0, "2 h"), (3e5, "3 d")],
)
def test_times_are_short(seconds: float, text: str) -> None:
    assert short_time(seconds) == text


@pytest.mark.parametrize(
    ("number", "text"), [(3.2, "3 B"), (3200.0, "3.2 kB"), (32e3, "32 kB"), (5e6, "5.0 MB")]
)
def test_bytes_are_short(number: float, text: str) -> None:
    assert short_bytes(number) == text


def pose(state: PoseState) -> PoseEstimate:
    return PoseEstimate(
        stamp_ns=1,
        map="home",
        pose=Pose2D(0.0, 0.0, 0.0),
        covariance=[0.0] * 9,
        state=state,
        match=0.9,
        spread=0.0,
    )


BASE = BaseState(stamp_ns=1, mode="ok")
STOPPED = "Stopped. `trolley resume` lets it drive."
NO_POSE = "It has no pose yet: there is no map, or its localizer is not running."
HERE = pose("localized")
DISCARDED = replace(pose("searching"), map=None, pose=None, message="there is no map")


def goal(state: GoalState, **fields: Any) -> GoalStatus:
    return GoalStatus(stamp_ns=1, id="a", state=state, **fields)


@pytest.mark.parametrize(
    ("said", "sentence"),
    [
        ((None, HERE, None, None), "No contact with the robot."),
        ((BASE, HERE, None, None), "Ready."),
        ((BASE, None, None, None), "Ready."),
        ((BASE, None, goal("idle"), None), NO_POSE),
        ((BASE, None, goal("idle", frame="odom"), None), "Ready."),
        ((BASE, DISCARDED, None, None), "It has no map: make one (`trolley map new NAME`)."),
        ((BASE, pose("lost"), None, None), "The robot does not know where it is."),
        (
            (BaseState(stamp_ns=1, mode="stopped", reason="button"), HERE, None, None),
            STOPPED,
        ),
        (
            (BaseState(stamp_ns=1, mode="ok", source="teleop"), HERE, goal("paused"), None),
            "Driven by teleop.",
        ),
        ((BASE, HERE, goal("driving", eta=12.0), None), "Driving to its goal, 12 s left."),
        (
            (BASE, HERE, goal("paused", reason="stopped", message=STOPPED), None),
            "Paused: `trolley ask goal/resume` continues it, `trolley cancel` ends it.",
        ),
        (
            (BASE, HERE, goal("paused", reason="off_map", message="Off the map."), None),
            "Paused: Off the map.",
        ),
        ((BASE, HERE, goal("arrived"), None), "It has arrived."),
        (
            (BASE, HERE, goal("failed", message="There is no path."), None),
            "The last goal failed: There is no path.",
        ),
        (
            (
                BASE,
                HERE,
                goal("driving", eta=70.0),
                TourStatus(stamp_ns=1, name="home", trip="a", state="driving", stop=1),
            ),
            "On tour home, stop 2, driving, 1 min 10 s left.",
        ),
    ],
)
def test_a_robot_is_told_in_one_sentence(said: tuple, sentence: str) -> None:
    assert robot_sentence(*said) == sentence


def test_what_a_silent_base_said_last_is_not_believed() -> None:
    message = codec.encode(BASE, "msgpack"), codec.MIME["msgpack"]
    tallies = {topics.BASE.key("one"): Tally(1, 9, 100.0, message)}
    assert sentence_of(tallies, "one", 101.0) == "Ready."
    assert sentence_of(tallies, "one", 104.0) == "No contact with the robot."


def test_an_old_pose_is_no_pose() -> None:
    assert robot_sentence(BASE, HERE, None, None, is_stale=True) == "The pose is out of date."
