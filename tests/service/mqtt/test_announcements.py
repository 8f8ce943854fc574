"""What Home Assistant is told there is."""

import json
import os
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import support

from trolley import topics
from trolley.geometry import Pose2D
from trolley.messages import BaseState, Battery, Stop, Tour, Tours

if TYPE_CHECKING:
    from .conftest import Bridge

CONFIG = "homeassistant/button/trolley_robby"


def go_buttons(bridge: "Bridge") -> list[str]:
    return sorted(
        entity["payload_press"]
        for entity in bridge.announced.values()
        if entity.get("command_topic") == "~/do/go"
    )


def test_each_place_and_tour_has_a_button(bridge: "Bridge") -> None:
    assert go_buttons(bridge) == ["hall", "kitchen"]
    names = {entity["name"] for entity in bridge.announced.values()}
    assert {
        "Go to kitchen",
        "Tour evening",
        "Stop",
        "Pause",
        "Continue",
        "Cancel",
        "Message",
    } <= names
    assert len({entity["unique_id"] for entity in bridge.announced.values()}) == len(
        bridge.announced
    )


def test_a_tour_of_another_map_has_no_button(bridge: "Bridge") -> None:
    stops = [Stop(pose=Pose2D(1.0, 0.0, 0.0))]
    tours = [Tour(name=on_map, stops=stops, map=on_map) for on_map in ("home", "attic")]
    for on_map in ("home", "attic"):
        bridge.robot.map = on_map
        bridge.robot.publish(topics.TOURS, Tours(stamp_ns=0, tours=tours))
        bridge.run(1.5)
        names = {entity["name"] for entity in bridge.announced.values()}
        assert [one for one in ("home", "attic") if f"Tour {one}" in names] == [on_map]


def test_a_button_does_what_the_bridge_understands(bridge: "Bridge") -> None:
    button = next(one for one in bridge.announced.values() if one["name"] == "Go to hall")
    topic = button["command_topic"].replace("~", button["~"])
    bridge.broker.send(topic, button["payload_press"])
    bridge.run(0.5)
    assert bridge.robot.asked == [("goal/send", "hall")]


def test_buttons_follow_the_places(bridge: "Bridge") -> None:
    bridge.robot.save(["kitchen", "cellar"])
    bridge.run(1.5)
    assert go_buttons(bridge) == ["cellar", "kitchen"]
    assert not any("tour_evening" in name for name in bridge.announced)
    bridge.robot.map = "attic"
    bridge.run(1.5)
    assert go_buttons(bridge) == []


def test_what_an_earlier_run_announced_and_is_gone_is_taken_back(
    make_bridge: "Callable[..., Bridge]",
) -> None:
    other = "homeassistant/button/trolley_lawn/go_shed_1/config"
    kept = {f"{CONFIG}/go_cellar_12345678/config": b"{}", other: b'{"command_topic": "x"}'}
    bridge = make_bridge(kept)
    assert f"{CONFIG}/go_cellar_12345678/config" not in bridge.broker.kept
    assert bridge.broker.kept[other]  # another robot's


def test_nothing_is_taken_back_before_the_places_are_known(
    make_bridge: "Callable[..., Bridge]",
) -> None:
    topic = f"{CONFIG}/go_cellar_12345678/config"
    bridge = make_bridge({topic: b"{}"}, is_up=False)
    bridge.service.robot_inputs.tours.latest = None
    bridge.broker.connect()
    bridge.run(1.5)
    assert topic in bridge.broker.kept


def test_a_robot_that_is_away_can_be_stopped_and_what_is_said_of_it_is_seen(
    bridge: "Bridge",
) -> None:
    always = {
        address
        for address, entity in bridge.announced.items()
        if entity["availability"] == [{"topic": "~/bridge"}]
    }
    assert always == {
        "button/stop",
        "sensor/activity",
        "sensor/message",
        "sensor/answer",
        "binary_sensor/problem",
    }


def test_a_battery_is_announced_when_there_is_one(bridge: "Bridge") -> None:
    assert "sensor/battery" not in bridge.announced
    bridge.robot.base = BaseState(stamp_ns=0, mode="ok", battery=Battery(fraction=0.4))
    bridge.run(1.5)
    assert bridge.announced["sensor/battery"]["device_class"] == "battery"
    assert "binary_sensor/charging" not in bridge.announced


def test_home_assistant_that_starts_is_told_everything_again(bridge: "Bridge") -> None:
    topics = set(bridge.broker.kept)
    bridge.broker.published.clear()
    bridge.run(3.0)
    assert {topic for topic, _ in bridge.broker.published} == {"trolley/robby/echo"}
    bridge.broker.send("homeassistant/status", "online")
    bridge.run(1.5)
    again = {topic for topic, _ in bridge.broker.published}
    assert topics - again <= {"trolley/robby/bridge"}
    bridge.broker.published.clear()
    for _ in range(50):  # a flood of births does not become one of announcements
        bridge.broker.send("homeassistant/status", "online")
        bridge.run(0.1)
    assert len(bridge.broker.published) < 10


def test_names_are_made_safe_and_stay_apart(bridge: "Bridge") -> None:
    bridge.robot.save(["Küche", "Kuche", "書斎", "a-b", "a b", "a_b"])
    bridge.run(1.5)
    assert len(go_buttons(bridge)) == 6
    for name in bridge.announced:
        assert name.replace("/", "").replace("_", "").isascii()


def test_hundreds_of_places_are_bounded(bridge: "Bridge") -> None:
    bridge.robot.save([f"place {index:03}" for index in range(500)])
    bridge.run(1.5)
    assert len(go_buttons(bridge)) == 100


def test_an_account_that_may_not_announce_is_reported(
    make_bridge: "Callable[..., Bridge]",
) -> None:
    bridge = make_bridge(forbidden="homeassistant/")
    health = bridge.lockstep.record(topics.HEALTH, "mqtt")
    bridge.run(1.5)
    assert health[-1].state == "degraded"
    assert "may this account read and write homeassistant/#?" in health[-1].message
    bridge.broker.forbidden = "-"
    bridge.broker.send("homeassistant/status", "online")
    bridge.run(2.5)
    assert health[-1].state == "ok"
    for topic in list(bridge.broker.kept):  # somebody deletes the device in Home Assistant
        if topic.startswith("homeassistant/"):
            bridge.broker.send(topic, "")
    bridge.run(2.5)
    assert health[-1].state == "ok"


def test_without_a_prefix_nothing_is_announced(make_bridge: "Callable[..., Bridge]") -> None:
    bridge = make_bridge(discovery_prefix="")
    assert bridge.announced == {}
    assert bridge.state["activity"] == "ready"


def test_every_announcement_is_json_of_a_reasonable_size(bridge: "Bridge") -> None:
    for topic, payload in bridge.broker.kept.items():
        if topic.startswith("homeassistant/"):
            assert json.loads(payload)["origin"]["name"] == "Trolley"
            assert len(payload) < 1024


def test_home_assistants_own_schemas_have_nothing_against_it(bridge: "Bridge") -> None:
    python = os.environ.get("TROLLEY_HOME_ASSISTANT")
    if not python:
        pytest.skip("TROLLEY_HOME_ASSISTANT names no Python that has Home Assistant")
    bridge.robot.base = BaseState(
        stamp_ns=0, mode="ok", battery=Battery(fraction=0.5, charging=False)
    )
    bridge.run(1.5)
    kinds = {address.split("/")[0] for address in bridge.announced}
    assert kinds == {"sensor", "binary_sensor", "event", "vacuum", "button", "image"}
    judge = Path(support.__path__[0]) / "home_assistant_schema.py"
    words = subprocess.run(
        [python, str(judge)],
        input=json.dumps(bridge.announced),
        capture_output=True,
        text=True,
        check=True,
    )
    assert words.stdout == ""
