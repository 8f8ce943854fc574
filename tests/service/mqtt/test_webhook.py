"""The same events at a web server as at the broker, with a broker and without one."""

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import pytest
from support.waiting import wait_until
from support.web import WebServer, with_status

from trolley import codes, topics
from trolley.config import ConfigError, FootprintConfig, RobotConfig, RobotSection, WebhookConfig
from trolley.messages import GoalStatus, Health
from trolley_mqtt.service import MqttService

from .test_events import events

if TYPE_CHECKING:
    from .conftest import Bridge


@pytest.fixture
def server() -> Iterator[WebServer]:
    opened = WebServer()
    yield opened
    opened.close()


def drive(bridge: "Bridge", goal: str, end: str = "arrived", reason: str = "") -> None:
    bridge.robot.goal = GoalStatus(stamp_ns=0, id=goal, state="driving")
    bridge.run(1.5)
    bridge.robot.goal = GoalStatus(stamp_ns=0, id=goal, state=end, reason=reason)  # pyrefly: ignore[bad-argument-type]
    bridge.run(1.5)


def health(bridge: "Bridge") -> Health:
    told = bridge.lockstep.record(topics.HEALTH, "mqtt")
    bridge.run(2.5)
    return told[-1]


def test_web_server_and_broker_are_told_the_same(
    make_bridge: Callable[..., "Bridge"], server: WebServer
) -> None:
    bridge = make_bridge(webhook=WebhookConfig(urls=[server.url, server.url]))
    drive(bridge, "a")
    drive(bridge, "b", "failed", codes.NO_PATH)
    wait_until(lambda: len(server.taken) == 4, "both addresses are told both")
    told = {one["id"]: one for one in server.taken}
    assert len(told) == 2
    for one, said in zip(told.values(), events(bridge), strict=True):
        assert one == said | {
            "version": 1,
            "robot": "robby",
            "title": "robby",
            "id": one["id"],
            "at": None,
        }


def test_no_broker_is_needed(make_bridge: Callable[..., "Bridge"], server: WebServer) -> None:
    bridge = make_bridge(broker="", webhook=WebhookConfig(urls=[server.url]))
    drive(bridge, "a")
    wait_until(lambda: server.taken, "it is told")
    assert health(bridge).state == "ok"


def test_only_what_is_wanted_is_sent(
    make_bridge: Callable[..., "Bridge"], server: WebServer
) -> None:
    bridge = make_bridge(webhook=WebhookConfig(urls=[server.url], events=["failed"]))
    drive(bridge, "a")
    drive(bridge, "b", "failed", codes.NO_PATH)
    wait_until(lambda: server.taken, "it is told")
    assert [one["event_type"] for one in server.taken] == ["failed"]


def test_health_says_what_is_wrong_until_it_is_well_again(
    make_bridge: Callable[..., "Bridge"], server: WebServer
) -> None:
    server.answers = [with_status(404), with_status(200)]
    bridge = make_bridge(webhook=WebhookConfig(urls=[server.url]))
    drive(bridge, "a")

    said = wait_until(lambda: (now := health(bridge)).state == "degraded" and now, "it is told of")
    assert isinstance(said, Health)
    assert said.message == (
        f"The webhook at 127.0.0.1:{server.port} refuses what is sent to it: "
        "it answers 404 Not Found."
    )
    drive(bridge, "b")
    wait_until(lambda: health(bridge).state == "ok", "it is well again")
    assert bridge.counters["webhook/sent"] == bridge.counters["webhook/lost"] == 1


def test_a_bridge_to_nowhere_is_refused() -> None:
    config = RobotConfig(robot=RobotSection(name="robby", footprint=FootprintConfig(radius_m=0.2)))
    with pytest.raises(ConfigError, match=r"neither \[mqtt\] broker nor \[webhook\] urls is set"):
        MqttService(config)
    assert config.idle_services == {"mqtt"}
