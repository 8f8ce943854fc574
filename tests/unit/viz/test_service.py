"""The viewer as a service: what it subscribes to, draws, asks and remembers."""

import socket
import tomllib
from types import SimpleNamespace
from typing import TYPE_CHECKING

import msgspec
import numpy as np
import pytest

from trolley import topics
from trolley.config import VizConfig
from trolley.messages import GoalStatus
from trolley.runtime.lockstep import Lockstep
from trolley_viz.pointing import Pointed
from trolley_viz.service import VizService

if TYPE_CHECKING:
    from .conftest import Stage


def test_without_a_browser_only_robots_and_clocks_are_followed(stage: "Stage") -> None:
    stage.runtime.run(2.0)
    assert stage.viz._feeds.names() == []
    stage.browse()
    assert {"scan", "pose", "map", "odom"} <= set(stage.viz._feeds.names())
    stage.viz._client_left(0)
    stage.runtime.run(0.5)
    assert stage.viz._feeds.names() == []


def test_a_layer_that_is_off_is_not_subscribed_to(stage: "Stage") -> None:
    stage.browse()
    assert "costmap" not in stage.viz._feeds.names()
    stage.viz.switch_layer("costmap", is_on=True)
    stage.viz.switch_layer("particles", is_on=False)
    stage.runtime.run(0.2)
    assert "costmap" in stage.viz._feeds.names()
    assert "particles" not in stage.viz._feeds.names()


def test_robot_and_scan_are_drawn_where_they_are(stage: "Stage") -> None:
    stage.browse()
    frame = stage.layer("robot")._frame
    assert frame.visible
    assert frame.position == pytest.approx([1.5, 0.0, 0.0])
    points = stage.layer("scan")._points.points
    # Laser at (1.6, 0): 1 m ahead, and 2 m to the right; no echo and invalid are left out.
    np.testing.assert_allclose(points[:, :2], [[2.6, 0.0], [1.6, -2.0]], atol=1e-6)


def test_the_map_is_drawn_once_with_its_walls(stage: "Stage") -> None:
    stage.browse()
    floor, walls = stage.layer("map")._nodes
    assert walls.vertices.max(axis=0)[:2] == pytest.approx([6.0, 0.1])
    assert floor.position == pytest.approx([-3.0, -2.0, 0.0])
    stage.runtime.run(2.0)
    assert stage.layer("map")._nodes == [floor, walls]


def test_only_places_of_this_map_are_shown(stage: "Stage") -> None:
    stage.browse()
    assert list(stage.layer("places")._nodes) == ["kitchen"]


def test_camera_is_moved_once_for_a_map(stage: "Stage") -> None:
    browser = stage.browse()
    assert browser.camera.position is not None
    browser.camera.position = None
    stage.runtime.run(1.0)
    assert browser.camera.position is None
    stage.viz.fit_view(browser)
    assert browser.camera.position is not None


def test_stop_is_asked_until_it_is_answered(stage: "Stage") -> None:
    stage.browse()
    stage.robot.deaf = True
    stage.viz.press_stop()
    stage.runtime.run(2.0)
    assert stage.robot.stops >= 4
    line = stage.viz.stops.line("trolley", stage.viz.monotonic_ns)
    assert line is not None
    assert line.is_alarm
    assert line.text == "NOT STOPPED: no connection"
    stage.robot.deaf = False
    stage.runtime.run(1.0)
    assert stage.viz.stops.line("trolley", stage.viz.monotonic_ns) is None
    asked = stage.robot.stops
    stage.runtime.run(1.0)
    assert stage.robot.stops == asked


def test_stop_goes_on_when_the_browser_is_closed(stage: "Stage") -> None:
    stage.browse()
    stage.runtime.kill("base")
    stage.viz.press_stop()
    stage.viz._client_left(0)
    stage.runtime.run(3.0)
    robot = stage.runtime.add(type(stage.robot)())
    stage.runtime.run(1.0)
    assert robot.stops == 1


def test_a_silent_robot_is_away_and_its_scan_vanishes(stage: "Stage") -> None:
    stage.browse()
    assert not stage.viz.is_away("trolley")
    stage.runtime.kill("base")
    stage.runtime.run(1.5)
    assert stage.viz.is_away("trolley")
    assert not stage.layer("scan")._points.visible


def test_a_second_robot_can_be_chosen(stage: "Stage") -> None:
    message = stage.viz._robot_watch
    stage.browse()
    first = stage.viz.robots.robot
    assert first is not None
    kart = msgspec.structs.replace(first, name="kart", title="Kart")
    stage.runtime.put(topics.ROBOT.key("kart"), msgspec.json.encode(kart), "application/json")
    stage.runtime.run(0.5)
    assert message.by_parts.keys() == {("trolley",), ("kart",)}
    labels = stage.viz.robots.labels(stage.viz.is_away)
    assert labels == {"Kart – away": "kart", "Trolley": "trolley"}
    stage.viz.select_robot("kart")
    stage.runtime.run(0.5)
    assert stage.viz.robots.robot is not None
    assert stage.viz.robots.robot.name == "kart"
    assert not stage.layer("robot")._frame.visible


def test_pointing_sends_the_goal_in_the_frame_that_is_drawn(stage: "Stage") -> None:
    stage.browse()
    stage.viz.actions._go_to(Pointed(2.0, 1.0, 0.5))
    stage.viz.actions._go_to(Pointed(2.0, 1.0))
    stage.runtime.run(0.5)
    dragged, clicked = stage.robot.goals
    assert dragged.pose is not None
    assert (dragged.pose.yaw, dragged.frame) == (0.5, "map")
    assert dragged.yaw_tolerance < 0.1
    assert clicked.yaw_tolerance > 3.14
    assert dragged.id != clicked.id


def test_a_refusal_is_told_in_words(stage: "Stage") -> None:
    browser = stage.browse()
    stage.viz.actions._go_to(Pointed(9.0, 1.0))
    stage.runtime.run(0.5)
    assert browser.notices == [("The robot does not go there", "That place lies outside the map.")]


def test_without_a_service_the_refusal_names_it(stage: "Stage") -> None:
    browser = stage.browse()
    stage.viz.actions.start_tour("article")
    stage.runtime.run(0.5)
    assert "tour is not running" in browser.notices[0][1]


def test_steering_names_the_goal_that_was_seen(stage: "Stage") -> None:
    asked: list[object] = []
    stage.viz.actions._ask = lambda request, params, failed: asked.append(params)  # type: ignore[method-assign]
    stage.viz.actions.steer_goal("Cancel", GoalStatus(stamp_ns=1, id="a1", state="driving"))
    assert asked[0].id == "a1"  # type: ignore[attr-defined]


def test_layers_are_remembered(stage: "Stage") -> None:
    stage.browse()
    stage.viz.switch_layer("frames", is_on=True)
    stage.viz.set_dark(is_dark=True)
    stage.runtime.run(0.1)
    stored = tomllib.loads((stage.viz.state.path / "viewer.toml").read_text())
    assert stored["dark"] is True
    assert stored["layers"]["frames"] is True
    stage.runtime.kill("viz")
    stage.viz.stop()
    again = stage.runtime.add(VizService(stage.config))
    assert again._scene.choices()["frames"]
    assert again._settings.dark


def test_broken_settings_are_kept_aside_and_the_viewer_starts(stage: "Stage") -> None:
    path = stage.viz.state.path / "viewer.toml"
    stage.runtime.kill("viz")
    stage.viz.stop()
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("layers = 3")
    viz = stage.runtime.add(VizService(stage.config))
    assert viz._scene.choices()["map"]
    assert list(path.parent.glob("viewer.toml.broken-*"))


def test_a_new_epoch_draws_everything_anew(stage: "Stage") -> None:
    stage.browse()
    drawn = stage.layer("map")._drawn
    stage.robot.epoch = 10**18
    stage.runtime.run(2.0)
    assert stage.layer("map")._drawn[0] is not drawn[0]
    assert stage.layer("robot")._frame.visible


def test_a_taken_port_ends_it_with_a_sentence(
    stage: "Stage", caplog: pytest.LogCaptureFixture
) -> None:
    with socket.socket() as other, Lockstep() as runtime:
        other.bind(("127.0.0.1", 0))
        other.listen()
        taken = VizConfig(port=other.getsockname()[1])
        service = VizService(SimpleNamespace(robot=stage.config.robot, viz=taken))  # type: ignore[arg-type]
        with pytest.raises(SystemExit):
            runtime.add(service)


def test_nobody_gets_a_public_tunnel(stage: "Stage") -> None:
    assert stage.viz._server is not None
    assert stage.viz._server.request_share_url() is None
    assert stage.viz._server.get_host() == "127.0.0.1"
