"""Pointer at the floor."""

import asyncio
import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import viser
from support.pages import page_of

from trolley_viz.pointing.drags import Drags
from trolley_viz.pointing.pointer import Pointed, Pointer, Tool, pointed_by_drag

if TYPE_CHECKING:
    from ..conftest import Stage

CAMERA = np.array([0.0, -4.0, 8.0])


def event(phase: str, start: tuple[float, float], end: tuple[float, float], screen: float) -> Any:
    """A drag between two points of the floor, its end given halfway to the camera as viser may."""
    floor = np.array([*end, 0.0])
    return SimpleNamespace(
        phase=phase,
        start_position=(*start, 0.0),
        end_position=tuple(0.5 * (CAMERA + floor)),
        start_screen_pos=(0.5, 0.5),
        end_screen_pos=(0.5 + screen, 0.5),
        client=SimpleNamespace(camera=SimpleNamespace(position=CAMERA)),
    )


class Gesture:
    """A tool that notes what it is told."""

    def __init__(self) -> None:
        self.moved: list[Pointed | None] = []
        self.done: list[Pointed] = []
        self.tool = Tool("test", self.moved.append, self.done.append)


class Meant(Drags):
    """Takes every end as meant."""

    def __init__(self) -> None:
        super().__init__(lambda call: call(), lambda: 0, lambda: None)

    def on_click(self, event: Any, act: Callable[[], None]) -> None:
        act()

    def take(self, event: Any, act: Callable[[], None], cancel: Callable[[], None]) -> None:
        act()


def arm(server: viser.ViserServer, gesture: Gesture) -> tuple[Pointer, Any]:
    pointing = Pointer(server, Meant())  # type: ignore[arg-type]
    pointing.arm(gesture.tool)
    return pointing, pointing._plane


def test_the_line_of_sight_is_followed_to_the_floor() -> None:
    pointed = pointed_by_drag(event("update", (1.0, 1.0), (2.0, 2.0), 0.1), CAMERA)
    assert pointed is not None
    assert (pointed.x, pointed.y, pointed.yaw) == pytest.approx((1.0, 1.0, np.pi / 4))


def test_a_tiny_drag_means_no_direction() -> None:
    assert pointed_by_drag(event("end", (1.0, 1.0), (1.01, 1.0), 0.004), CAMERA) == Pointed(
        1.0, 1.0
    )


def test_a_drag_into_the_sky_points_at_nothing() -> None:
    up = event("update", (1.0, 1.0), (2.0, 2.0), 0.1)
    up.end_position = (0.0, 20.0, 30.0)
    assert pointed_by_drag(up, CAMERA) is None


def test_press_drag_and_release_are_one_gesture(server: viser.ViserServer) -> None:
    gesture = Gesture()
    pointing, plane = arm(server, gesture)
    drag = plane._impl.drag_cb[0].callback
    for phase, end in (("start", (1.0, 1.0)), ("update", (2.0, 1.0)), ("end", (1.0, 3.0))):
        asyncio.run(drag(event(phase, (1.0, 1.0), end, 0.1 if phase != "start" else 0.0)))
    assert gesture.moved == [Pointed(1.0, 1.0), Pointed(1.0, 1.0, 0.0)]
    assert len(gesture.done) == 1
    assert gesture.done[0].yaw == pytest.approx(np.pi / 2)
    assert pointing.tool is None
    asyncio.run(drag(event("end", (1.0, 1.0), (2.0, 1.0), 0.1)))  # late: the tool is put away
    assert len(gesture.done) == 1


def test_a_click_is_a_place_without_direction(server: viser.ViserServer) -> None:
    gesture = Gesture()
    _, plane = arm(server, gesture)
    click = plane._impl.click_cb[0].callback
    asyncio.run(click(SimpleNamespace(ray_origin=(0, 0, 2), ray_direction=(1, 0, -1))))
    assert gesture.done == [Pointed(2.0, 0.0)]


def test_a_drag_that_ends_in_the_sky_is_no_wish(server: viser.ViserServer) -> None:
    gesture = Gesture()
    pointing, plane = arm(server, gesture)
    drag = plane._impl.drag_cb[0].callback
    asyncio.run(drag(event("update", (1.0, 1.0), (2.0, 1.0), 0.1)))
    up = event("end", (1.0, 1.0), (2.0, 2.0), 0.1)
    up.end_position = (0.0, 20.0, 30.0)
    asyncio.run(drag(up))
    assert gesture.done == []
    assert pointing.tool is gesture.tool
    asyncio.run(drag(event("end", (1.0, 1.0), (2.0, 1.0), 0.1)))
    assert len(gesture.done) == 1


# By arrow keys.
def test_arrow_keys_point_at_where_to_go(stage: "Stage") -> None:
    browser = stage.browse()
    page = page_of(stage)
    page.press_key("↑")  # means nothing before something is to be pointed out
    page.press_key("⏎")
    stage.runtime.run(0.5)
    assert not browser.state.has_cursor
    page.press_key("g")
    stage.runtime.run(0.5)
    assert browser.state.is_pointing
    for key in ("→", "→", "→", "→", "↑", "↑", "⇧←", "⇧←"):
        page.press_key(key)
    stage.runtime.run(0.5)
    assert browser.state.has_cursor
    page.press_key("⏎")
    stage.runtime.run(0.5)
    (goal,) = stage.robot.goals
    assert goal.pose is not None
    assert (goal.pose.x, goal.pose.y) == pytest.approx((1.9, 0.2))  # the robot is at 1.5, 0
    assert goal.pose.yaw == pytest.approx(math.radians(30.0))
    assert not browser.state.is_pointing


def test_what_arrow_keys_point_at_is_gone_with_the_tool(stage: "Stage") -> None:
    browser = stage.browse()
    page = page_of(stage)
    for key in ("p", "↑", "escape", "⏎"):
        page.press_key(key)
    stage.runtime.run(0.5)
    assert stage.robot.poses_set == []
    assert not browser.state.has_cursor
