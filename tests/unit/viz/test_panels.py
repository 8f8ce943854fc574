"""The controls and their markup."""

import asyncio
from types import SimpleNamespace
from typing import TYPE_CHECKING

import numpy as np
import pytest
import viser

from trolley_viz.graphics.camera import FIELD_OF_VIEW, stand
from trolley_viz.panels.controls import set_options
from trolley_viz.panels.markup import note, row, table
from trolley_viz.panels.stop_bar import StopBar
from trolley_viz.robots.fleet import Robots
from trolley_viz.robots.stop_presses import StopLine, StopPresses
from trolley_viz.scene.scan_and_particles import weight_colours
from trolley_viz.sentences import StatusLine
from trolley_viz.threads import handler

if TYPE_CHECKING:
    from .conftest import Stage

EVIL = "<img src=x onerror=alert(1)>"


def test_names_from_the_wire_cannot_carry_markup() -> None:
    for text in (row(StatusLine(EVIL, "good", EVIL)), note(EVIL), table([(EVIL, EVIL)])):
        assert "<img" not in text
        assert "&lt;img" in text


def test_what_the_service_changes_itself_is_nobodys_wish() -> None:
    acted: list[object] = []
    handle = handler(lambda call: call(), lambda client, value: acted.append(value))
    target = SimpleNamespace(value="kart")
    asyncio.run(handle(SimpleNamespace(client=None, target=target)))  # type: ignore[arg-type]
    assert acted == []
    asyncio.run(handle(SimpleNamespace(client=object(), target=target)))  # type: ignore[arg-type]
    assert acted == ["kart"]


def test_choices_keep_what_was_chosen(server: viser.ViserServer) -> None:
    empty = str("none")  # noqa: UP018 - a plain str to the type checker
    dropdown = server.gui.add_dropdown("Place", (empty,))
    set_options(dropdown, ["a", "b"], empty)
    dropdown.value = "b"
    set_options(dropdown, ["a", "b", "c"], empty)
    assert dropdown.value == "b"
    set_options(dropdown, [], empty)
    assert (dropdown.value, dropdown.disabled) == ("none", True)


def test_the_stop_bar_says_that_it_is_not_stopped(server: viser.ViserServer) -> None:
    bar = StopBar(server.gui, lambda: None, lambda: None)
    bar.show(StopLine("NOT STOPPED: no connection", is_alarm=True), is_stopped=True)
    assert "NOT STOPPED: no connection" in bar._line.content
    bar.show(None, is_stopped=True)
    assert ">Stopped<" in bar._line.content
    bar.show(None, is_stopped=False)
    assert bar._line.content == ""


def test_stop_is_one_press_whatever_how_often_it_is_pressed() -> None:
    asked: list[str] = []
    presses = StopPresses(lambda robot, answer: asked.append(robot))
    presses.press("a", 0)
    presses.press("b", 0)
    presses.tick(10**8)
    assert asked == ["a", "b"]
    assert presses.line("a", 10**8) == StopLine("Stopping …", is_alarm=False)
    assert presses.line("a", 10**9) == StopLine("NOT STOPPED: no connection (b)", is_alarm=True)
    presses.release("a")
    presses.release("b")
    assert presses.line("a", 10**9) is None


def test_the_own_robot_is_listed_before_it_is_heard_of() -> None:
    robots = Robots("trolley")
    assert robots.labels("trolley", lambda _: True) == {"trolley – away": "trolley"}


def test_heavier_particles_are_darker() -> None:
    faint, strong = weight_colours(np.array([0.1, 1.0], np.float32)).sum(axis=1)
    assert strong < faint
    assert len(weight_colours(np.zeros(3, np.float32))) == 3


@pytest.mark.parametrize("aspect", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("bounds", [(-4.0, -3.0, 4.0, 3.0), (0.0, 0.0, 40.0, 5.0)])
def test_the_whole_map_is_in_the_picture(
    aspect: float, bounds: tuple[float, float, float, float]
) -> None:
    position, look_at = stand(bounds, aspect)
    forward = (look_at - position) / np.linalg.norm(look_at - position)
    right = np.array([1.0, 0.0, 0.0])
    up = np.cross(right, forward)
    x0, y0, x1, y1 = bounds
    tangent = np.tan(0.5 * FIELD_OF_VIEW)
    for corner in ([x0, y0, 0], [x1, y0, 0], [x1, y1, 0], [x0, y1, 0]):
        ray = np.array(corner) - position
        depth = ray @ forward
        assert abs(ray @ up) / depth <= tangent
        assert abs(ray @ right) / depth <= tangent * aspect


def test_notices_do_not_pile_up_over_the_map(stage: "Stage") -> None:
    browser = stage.browse()
    for title in "abc":
        stage.session.tell(title, "", "warn")
    assert browser.shown_notices == ["b", "c"]
