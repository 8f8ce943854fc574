"""Several robots: who is listed, drawn and stopped."""

import re
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from support.pages import page_of

from trolley import topics
from trolley.geometry import Pose2D
from trolley.messages import BaseState, Battery, Clock, PoseEstimate
from trolley_viz.features.robot_list.panel import member_line
from trolley_viz.robots.fleet import Member

if TYPE_CHECKING:
    from ..conftest import Stage


def say(stage: "Stage", topic: Any, message: Any, robot: str = "kart") -> None:
    stage.runtime.put(topic.key(robot), msgspec.json.encode(message), "application/json")


def estimate(map_name: str = "room", state: Any = "localized", x: float = -1.0) -> PoseEstimate:
    pose = Pose2D(x, 0.5, 0.0)
    return PoseEstimate(
        stamp_ns=1, map=map_name, pose=pose, covariance=None, state=state, match=0.9, spread=0.1
    )


def enter(stage: "Stage") -> None:
    """Let a second robot come into the network."""
    first = stage.hub.robots.get("trolley")
    assert first is not None
    say(stage, topics.ROBOT, msgspec.structs.replace(first, name="kart", title="Kart"))
    stage.runtime.run(0.2)


def live(stage: "Stage") -> None:
    say(stage, topics.CLOCK, Clock(stamp_ns=stage.viz.monotonic_ns, rate=1.0, epoch=0))
    say(stage, topics.POSE, estimate())
    stage.runtime.run(0.3)


def test_one_robot_alone_costs_nothing_more(stage: "Stage") -> None:
    stage.browse()
    assert stage.viz._fleet._watches == {}
    assert not page_of(stage).is_shown("All robots")
    assert not page_of(stage).is_shown("Robot")


def test_others_are_listed_and_drawn_where_they_share_the_map(stage: "Stage") -> None:
    stage.browse()
    enter(stage)
    live(stage)
    layer = stage.layer("others")
    assert list(layer._bodies) == ["kart"]
    assert layer._bodies["kart"].frame.position == pytest.approx([-1.0, 0.5, 0.0])
    page = page_of(stage).within("All robots")
    assert page.labels == ["Stop all robots", "Follow Kart"]
    said = page.text()
    assert said.index("Kart: ") < said.index("Trolley: ")
    say(stage, topics.POSE, estimate("attic"))
    stage.runtime.run(0.3)
    assert layer._bodies == {}
    say(stage, topics.POSE, estimate(state="lost"))
    stage.runtime.run(0.3)
    assert layer._bodies == {}


def test_who_falls_silent_is_grey_and_away(stage: "Stage") -> None:
    stage.browse()
    enter(stage)
    live(stage)
    body = stage.layer("others")._bodies["kart"].body
    known = tuple(body.color)
    stage.runtime.run(1.5)
    assert tuple(body.color) != known
    page = page_of(stage).within("All robots")
    assert "Kart: Away" in page.text()
    stage.runtime.run(5.0)
    assert re.search(r"Kart: Away No contact with the robot for [67] s\.", page.text())
    assert re.fullmatch(r"Kart · [67] s", stage.layer("others")._bodies["kart"].label.text)


def test_another_robot_is_followed_from_the_list_and_from_its_row(stage: "Stage") -> None:
    stage.browse()
    enter(stage)
    live(stage)
    page = page_of(stage)
    own, other = page.value("Robot"), next(one for one in page.options("Robot") if "Kart" in one)
    page.choose("Robot", other)
    stage.runtime.run(0.3)
    assert stage.session.robot == "kart"
    page.press("Follow Trolley")
    stage.runtime.run(0.3)
    assert (stage.session.robot, page.value("Robot")) == ("trolley", own)


def test_without_a_browser_nobody_is_followed(stage: "Stage") -> None:
    stage.browse()
    enter(stage)
    assert stage.viz._fleet._watches
    stage.leave(stage.browsers[0])
    stage.runtime.run(35.0)  # until it can come back no more
    assert stage.viz._fleet._watches == {}


def test_stop_all_stops_all_and_says_who_did_not_answer(stage: "Stage") -> None:
    stage.browse()
    enter(stage)
    stage.runtime.run(0.3)
    page_of(stage).press("Stop all robots")
    stage.runtime.run(1.5)
    assert stage.robot.mode == "stopped"
    line = stage.hub.stops.line("trolley", stage.viz.monotonic_ns)
    assert line is not None
    assert line.text == "NOT STOPPED: no connection (kart)"


def test_the_most_pressing_thing_is_said() -> None:
    battery = Battery(fraction=0.42, voltage=12.0, charging=False)
    stopped = BaseState(stamp_ns=1, mode="stopped", reason="button", battery=battery)
    member = Member("kart", None, stopped, estimate(), None, 1)
    assert member_line(member).headline == "kart: Stopped"
    assert "Battery 42 %." in member_line(member).detail
    assert member_line(member._replace(robot_ns=None)).headline == "kart: Away"
    old = member_line(member._replace(ages={"base": 7.0}))
    assert (old.headline, old.tone) == ("kart: Stopped · 7 s ago", "bad")
    assert "Battery 42 % · 7 s ago." in old.detail
    lost = member._replace(base=None, pose=estimate(state="lost"))
    assert member_line(lost).headline == "kart: Lost"
    assert member_line(lost._replace(pose=None)).tone == "idle"
