"""The viewer as a service: what it subscribes to, draws, asks and remembers."""

import socket
import stat
import tomllib
from types import SimpleNamespace
from typing import TYPE_CHECKING

import msgspec
import numpy as np
import pytest
from msgspec import structs
from support.pages import page_of

from trolley import topics
from trolley.config import VizConfig
from trolley.messages import GoalStatus, SuspectLine
from trolley.runtime.lockstep import Lockstep
from trolley_viz.graphics.camera import INITIAL_ASPECT, UNKNOWN_MAP, Bounds, stand
from trolley_viz.pointing.pointer import Pointed
from trolley_viz.robots.view import View
from trolley_viz.scene.map_layers import OLD_NS, map_bounds
from trolley_viz.server.messages import Said, Stop
from trolley_viz.server.visitors import Visitor
from trolley_viz.service import VizService
from trolley_viz.session.browser_choices import MAX_BROWSERS, Choices, ViewerSettings

if TYPE_CHECKING:
    from .conftest import Stage


def test_without_a_browser_only_robots_and_clocks_are_followed(stage: "Stage") -> None:
    stage.runtime.run(2.0)
    assert stage.streams() == set()
    browser = stage.browse()
    assert {"scan", "pose", "map", "odom"} <= stage.streams()
    streams = stage.scenes["trolley"].streams
    stage.leave(browser)
    stage.runtime.run(29.0)
    assert "scan" not in streams.names()  # of the drawings nobody sees any
    assert stage.scenes != {}
    stage.runtime.run(2.0)
    assert streams.names() == []
    assert stage.scenes == {}


def test_a_layer_that_is_off_is_not_subscribed_to(stage: "Stage") -> None:
    stage.browse()
    assert "costmap" not in stage.streams()
    stage.session.preferences.switch_layer("costmap", is_on=True)
    stage.session.preferences.switch_layer("particles", is_on=False)
    stage.runtime.run(0.2)
    assert "costmap" in stage.streams()
    assert "particles" not in stage.streams()


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
    floor, walls = stage.layer("map")._map.nodes
    assert walls.vertices.max(axis=0)[:2] == pytest.approx([6.0, 0.1])
    assert floor.position == pytest.approx([-3.0, -2.0, 0.0])
    stage.runtime.run(2.0)
    assert stage.layer("map")._map.nodes == [floor, walls]


def test_a_map_that_grows_stays_until_it_is_drawn_anew_under_a_name_of_its_own(
    stage: "Stage",
) -> None:
    """A glb that replaces one of its name is shown late, and where the scene begins."""
    stage.browse()
    drawn = stage.layer("map")._map
    before = drawn.nodes
    grid = stage.session.view.streams.latest(topics.MAP)
    assert grid is not None
    stage.robot.publish(topics.MAP, structs.replace(grid))
    stage.runtime.run(1.0)
    assert drawn._old == before
    assert not {one.name for one in before} & {one.name for one in drawn.nodes}
    stage.runtime.run(OLD_NS * 1e-9)
    assert drawn._old == []
    stage.robot.publish(topics.MAP, structs.replace(grid, name="other"))
    stage.runtime.run(1.0)
    assert drawn._old == []


def test_only_places_of_this_map_are_shown(stage: "Stage") -> None:
    stage.browse()
    assert list(stage.layer("places")._nodes) == ["kitchen"]


def test_camera_is_moved_once_for_a_map(stage: "Stage") -> None:
    browser = stage.browse()
    stage.runtime.run(5.0)
    fitted = browser.camera.position
    browser.camera.position = fitted + 1.0
    stage.runtime.run(1.0)
    assert browser.camera.position == pytest.approx(fitted + 1.0)
    stage.session.window.fit()
    assert browser.camera.position != pytest.approx(fitted + 1.0)


def test_a_view_that_is_where_every_page_begins_is_left_alone(stage: "Stage") -> None:
    browser = stage.browse()
    bounds = map_bounds(stage.session.view)
    assert bounds is not None
    browser.camera.image_width = round(INITIAL_ASPECT * 800)
    stage.session.window.fit()
    stage.runtime.run(3.0)
    fits: list[object] = []
    watched = SimpleNamespace(camera=browser.camera, atomic=lambda: fits.append(1))
    stage.session.window._viewport._client = watched  # type: ignore[assignment]
    stage.runtime.run(3.0)
    assert fits == []


def test_the_map_fits_a_picture_that_turns_unless_somebody_looks_elsewhere(stage: "Stage") -> None:
    browser, session = stage.browse(), stage.session
    stage.runtime.run(5.0)
    wide = browser.camera.position
    session.window.resized((390.0, 844.0))
    stage.runtime.run(5.0)
    high = browser.camera.position
    assert high[2] > wide[2] + 1.0
    browser.camera.position = high + 1.0
    session.window.resized((844.0, 390.0))
    stage.runtime.run(5.0)
    assert browser.camera.position == pytest.approx(high + 1.0)


def test_a_page_that_starts_very_slowly_is_looked_after_once_it_speaks(stage: "Stage") -> None:
    browser, session = stage.browse(), stage.session
    stage.runtime.run(5.0)
    fitted = browser.camera.position
    bounds = map_bounds(session.view)
    assert bounds is not None
    browser.camera.position, _ = stand(bounds, INITIAL_ASPECT)
    session.window.resized((1200.0, 800.0))
    stage.runtime.run(5.0)
    assert browser.camera.position == pytest.approx(fitted, abs=0.5)


def test_a_page_that_starts_slowly_sees_the_map_all_the_same(stage: "Stage") -> None:
    browser = stage.browse()
    start = stand(UNKNOWN_MAP, INITIAL_ASPECT)[0]
    browser.camera.position = start
    stage.runtime.run(0.2)
    assert browser.camera.position != pytest.approx(start)
    stage.runtime.run(100.0)
    browser.camera.position = start
    stage.runtime.run(0.2)
    assert browser.camera.position != pytest.approx(start)


def test_a_view_for_a_layout_that_was_not_is_mended(stage: "Stage") -> None:
    browser = stage.browse()
    first = browser.camera.position
    browser.camera.image_width = 400  # the panel takes its place
    stage.runtime.run(2.5)
    assert browser.camera.position[2] > first[2] + 1.0
    browser.camera.position = first + 9.0
    stage.runtime.run(5.0)
    assert browser.camera.position == pytest.approx(first + 9.0)


def test_the_bounds_of_the_map_are_not_looked_for_for_ever(
    stage: "Stage", monkeypatch: pytest.MonkeyPatch
) -> None:
    looked: list[float] = []

    def counted(view: View) -> Bounds | None:
        looked.append(stage.viz.monotonic_ns)
        return map_bounds(view)

    monkeypatch.setattr("trolley_viz.session.viewport.map_bounds", counted)
    stage.browse()
    stage.runtime.run(10.0)
    settled = len(looked)
    assert settled > 0
    stage.runtime.run(5.0)
    assert len(looked) == settled


def test_stop_is_asked_until_it_is_answered(stage: "Stage") -> None:
    stage.browse()
    stage.robot.deaf = True
    stage.session.press_stop()
    stage.runtime.run(2.0)
    assert stage.robot.stops >= 4
    line = stage.hub.stops.line("trolley", stage.viz.monotonic_ns)
    assert line is not None
    assert line.is_alarm
    assert line.text == "NOT STOPPED: no connection"
    stage.robot.deaf = False
    stage.runtime.run(1.0)
    assert stage.hub.stops.line("trolley", stage.viz.monotonic_ns) is None
    asked = stage.robot.stops
    stage.runtime.run(1.0)
    assert stage.robot.stops == asked


def test_stop_goes_on_when_the_browser_is_closed(stage: "Stage") -> None:
    browser = stage.browse()
    stage.runtime.kill("base")
    stage.session.press_stop()
    stage.leave(browser)
    stage.runtime.run(3.0)
    robot = stage.runtime.add(type(stage.robot)())
    stage.runtime.run(1.0)
    assert robot.stops == 1


def test_a_silent_robot_is_away_and_its_scan_vanishes(stage: "Stage") -> None:
    stage.browse()
    assert stage.hub.robot_ns("trolley") is not None
    stage.runtime.kill("base")
    stage.runtime.run(1.5)
    assert stage.hub.robot_ns("trolley") is None
    assert not stage.layer("scan")._points.visible


def test_a_second_robot_can_be_chosen(stage: "Stage") -> None:
    message = stage.viz._robot_watch
    stage.browse()
    first = stage.hub.robots.get("trolley")
    assert first is not None
    kart = msgspec.structs.replace(first, name="kart", title="Kart")
    stage.runtime.put(topics.ROBOT.key("kart"), msgspec.json.encode(kart), "application/json")
    stage.runtime.run(0.5)
    assert message.by_parts.keys() == {("trolley",), ("kart",)}
    labels = stage.session.robot_labels()
    assert labels == {"Kart – away": "kart", "Trolley": "trolley"}
    stage.session.follow("kart")
    stage.runtime.run(0.5)
    assert set(stage.scenes) == {"kart"}
    assert not stage.layer("robot", "kart")._frame.visible


def test_pointing_sends_the_goal_in_the_frame_that_is_drawn(stage: "Stage") -> None:
    stage.browse()
    stage.session.aiming._go_to(Pointed(2.0, 1.0, 0.5))
    stage.session.aiming._go_to(Pointed(2.0, 1.0))
    stage.runtime.run(0.5)
    dragged, clicked = stage.robot.goals
    assert dragged.pose is not None
    assert (dragged.pose.yaw, dragged.frame) == (0.5, "map")
    assert dragged.yaw_tolerance < 0.1
    assert clicked.yaw_tolerance > 3.14
    assert dragged.id != clicked.id


def test_a_refusal_is_told_in_words(stage: "Stage") -> None:
    browser = stage.browse()
    stage.session.aiming._go_to(Pointed(9.0, 1.0))
    stage.runtime.run(0.5)
    assert browser.notices == [("The robot cannot go there", "That place lies outside the map.")]


def test_without_a_service_the_refusal_names_it(stage: "Stage") -> None:
    browser = stage.browse()
    stage.session.actions.steer_tour("Pause")
    stage.runtime.run(0.5)
    assert "The tour service is not running" in browser.notices[0][1]


def test_steering_names_the_goal_that_was_seen(stage: "Stage") -> None:
    stage.browse()
    asked: list[object] = []
    stage.session.actions.ask = lambda request, params, failed: asked.append(params)  # type: ignore[method-assign]
    stage.session.actions.steer_goal("Cancel", GoalStatus(stamp_ns=1, id="a1", state="driving"))
    assert asked[0].id == "a1"  # type: ignore[attr-defined]


ANN, BEN = Visitor("ann"), Visitor("ben")


def test_what_each_browser_chose_is_remembered(stage: "Stage") -> None:
    stage.browse(0, ANN)
    stage.session.preferences.switch_layer("costmap", is_on=True)
    stage.session.choose_look(dark=True, light=False)
    stage.runtime.run(0.1)
    stored = tomllib.loads((stage.viz.state.path / "viewer.toml").read_text())
    assert stored["browsers"]["ann"]["dark"] is True
    assert stored["browsers"]["ann"]["layers"] == {"costmap": True}
    stage.runtime.kill("viz")
    stage.viz.stop()
    stage.viz = stage.runtime.add(VizService(stage.config))
    stage.browse(0, BEN)
    assert not stage.session.preferences.layers["costmap"]
    ann = stage.browse(1, ANN)
    session = stage.page(1).session
    assert session.preferences.layers["costmap"]
    assert ann.state.dark


def test_two_pages_of_one_browser_forget_nothing_of_each_other(stage: "Stage") -> None:
    pages = [stage.browse(i, ANN) for i in (0, 1)]
    here, there = stage.page(0).session.preferences, stage.page(1).session.preferences
    mirror = SuspectLine(points=[(0.0, 0.0), (1.0, 0.0)], score=0.9)
    there.choose_language("de")
    there.dismiss("room", mirror)
    here.fold("Keys", is_open=True)
    for browser in pages:
        stage.leave(browser)
    stage.browse(2, ANN)
    later = stage.page(2).session.preferences
    assert later.choices.language == "de"
    assert [one.map for one in later.choices.dismissed] == ["room"]
    assert later.is_open("Keys", default=False)


def test_nobody_in_particular_is_not_remembered(stage: "Stage") -> None:
    stage.browse()
    stage.session.preferences.switch_layer("costmap", is_on=True)
    stage.runtime.run(0.1)
    assert not (stage.viz.state.path / "viewer.toml").exists()


def test_only_so_many_browsers_are_remembered() -> None:
    settings = ViewerSettings()
    for i in range(MAX_BROWSERS + 5):
        settings = settings.with_choices(f"b{i}", Choices(dark=True))
    settings = settings.with_choices("b50", Choices())
    assert len(settings.browsers) == MAX_BROWSERS
    assert next(iter(settings.browsers)) == "b5"
    assert [*settings.browsers][-1] == "b50"


def test_each_browser_shows_and_follows_what_it_wants(stage: "Stage") -> None:
    stage.browse(0, ANN)
    stage.browse(1, BEN)
    ann, ben = stage.page(0).session, stage.page(1).session
    ann.preferences.switch_layer("scan", is_on=False)
    ben.follow("kart")
    stage.runtime.run(0.2)
    assert stage.drawn(0).is_visible("trolley")
    assert not stage.drawn(0).is_visible("kart")
    assert not stage.drawn(0).is_visible("trolley", "scan")
    assert stage.drawn(1).is_visible("kart", "scan")
    assert "scan" in stage.streams("kart")
    assert "scan" not in stage.streams("trolley")
    ben.follow("trolley")
    stage.runtime.run(0.2)
    assert set(stage.scenes) == {"trolley"}
    assert stage.drawn(1).is_visible("trolley", "scan")
    assert "scan" in stage.streams("trolley")


def test_a_viewer_has_stop_and_nothing_that_moves(stage: "Stage") -> None:
    browser = stage.browse(0, Visitor("guest", "viewer"))
    page = page_of(stage)
    assert page.labels[4:8] == ["Past", "Tours", "Past trips", "More"]
    assert page.keys == []
    assert "You may look, but not drive." in page.text()
    stage.say(browser, Said(stop=Stop(id=1, robots=["trolley"])))
    stage.runtime.run(0.5)
    assert stage.robot.mode == "stopped"


def test_a_refusal_is_told_to_the_one_who_asked(stage: "Stage") -> None:
    one, other = stage.browse(0), stage.browse(1)
    session = stage.page(1).session
    session.aiming._go_to(Pointed(9.0, 1.0))
    stage.runtime.run(0.5)
    assert (len(one.notices), len(other.notices)) == (0, 1)


def test_broken_settings_are_kept_aside_and_the_viewer_starts(stage: "Stage") -> None:
    path = stage.viz.state.path / "viewer.toml"
    stage.runtime.kill("viz")
    stage.viz.stop()
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("browsers = 3")
    stage.viz = stage.runtime.add(VizService(stage.config))
    stage.browse(0, ANN)
    assert stage.session.preferences.layers["map"]
    assert list(path.parent.glob("viewer.toml.broken-*"))


def test_what_base_has_not_measured_stays_in_the_picture_when_it_is_restarted(
    stage: "Stage",
) -> None:
    stage.browse()
    streams = stage.scenes["trolley"].streams
    places, (grid, *_) = streams.latest(topics.POSES), stage.layer("map")._drawn
    assert places is not None
    assert grid is not None
    stage.robot.epoch = 10**18
    stage.runtime.run(0.5)
    assert streams.latest(topics.POSES) is places
    assert stage.layer("map")._drawn[0] is grid
    assert min(one.stamp_ns for one in streams.history(topics.ODOM)) >= 10**18
    assert min(one.stamp_ns for one in streams.history(topics.SCAN)) >= 10**18
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
    assert stage.hub.server.request_share_url() is None
    assert stage.hub.server.get_host().startswith("127.")


def test_tokens_are_kept_and_only_their_owner_reads_them(stage: "Stage") -> None:
    path = stage.viz.state.path / "viewer_access.toml"
    tokens = path.read_text()
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    stage.runtime.kill("viz")
    stage.viz.stop()
    stage.runtime.add(VizService(stage.config))
    assert path.read_text() == tokens


FAR = '{"stamp_ns":1,"lines":[{"points":[[-1e308,0],[1e308,0]],"score":1}]}'
LONG = '{"kind":"line","size":[1e306,1,1],"points":[[0,0,0],[1,1,0]]}'
NOWHERE = (
    '{"stamp_ns":1,"map":"room","changes":[{"id":"1","kind":"gone","points":[],"strokes":[],'
    '"width":0.1,"seconds":1,"score":1}]}'
)
OUTSIDE = (
    '{"stamp_ns":1,"name":"t","trip":"abc","state":"driving","stop":0,'
    '"tour":{"stops":[{"pose":{"x":1.7e308,"y":0,"yaw":0}}]}}'
)


@pytest.mark.parametrize(
    ("key", "message"),
    [
        (topics.MARKER.key("trolley", "me", "1"), LONG),
        (topics.CHANGES.key("trolley"), NOWHERE),
        (topics.SUSPECTS.key("trolley"), FAR),
        (topics.TOUR.key("trolley"), OUTSIDE),
    ],
)
def test_no_message_ends_the_viewer(stage: "Stage", key: str, message: str) -> None:
    stage.browse()
    stage.runtime.put(key, message.encode(), "application/json")
    stage.runtime.run(1.0)
    small = message.replace("e306", "e12").replace("1.7e308", "1e12").replace("1e308", "1e12")
    stage.runtime.put(key, small.encode(), "application/json")
    stage.runtime.run(1.0)
    assert stage.layer("robot")._frame.visible
