"""What is pressed on the map and not let go of; what the page remembers."""

import math
import re
from typing import TYPE_CHECKING

import pytest
from playwright.sync_api import Page, expect
from support.waiting import wait_until

from trolley import topics

from .seeing import pixel_of, scene, undrawn, wait_for_frames
from .test_viewer import FAR, FROM_FAR, button, goal_state

if TYPE_CHECKING:
    from .conftest import Shown

pytestmark = [pytest.mark.slow, pytest.mark.browser]


def test_what_is_not_let_go_of_sends_no_goal(page: Page, shown: "Shown") -> None:
    fingers = page.context.new_cdp_session(page)
    hint = page.locator("#hint")

    def touch(kind: str, *points: tuple[float, float]) -> None:
        at = [{"x": x, "y": y, "id": i} for i, (x, y) in enumerate(points)]
        fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": at})

    def drag_on() -> tuple[float, float]:
        wait_for_frames(page)
        start, end = pixel_of(page, FAR), pixel_of(page, FROM_FAR)
        touch("touchStart", start)
        touch("touchMove", (0.5 * (start[0] + end[0]), 0.5 * (start[1] + end[1])))
        touch("touchMove", end)
        expect(hint).to_have_text(re.compile(r"\d+\.\d m, about [\d.]+ s"))
        return end

    before = shown.robot.latest(topics.GOAL)
    assert before is not None
    button(page, "Go to …").click()
    expect(hint).to_contain_text("Press where it should go")
    drag_on()
    touch("touchCancel")  # as for a call, or a swipe from the edge
    expect(hint).to_contain_text("Press where it should go")
    x, y = drag_on()
    touch("touchStart", (x, y), (x + 40.0, y + 40.0))  # a second finger
    touch("touchEnd")
    expect(hint).to_contain_text("Press where it should go")
    drag_on()
    scene(page).evaluate("window.dispatchEvent(new Event('blur'))")  # as for another window
    expect(hint).to_contain_text("Press where it should go")
    touch("touchEnd")
    page.wait_for_timeout(500)
    goal = shown.robot.latest(topics.GOAL)
    assert goal is not None
    assert goal.id == before.id
    drag_on()
    touch("touchEnd")
    wait_until(lambda: goal_state(shown) == "driving", "it sets off when it is let go")
    button(page, "Cancel").click()
    wait_until(lambda: goal_state(shown) == "canceled", "the goal is taken back")


def test_a_tap_before_the_scene_is_drawn_with_the_tool_sends_the_robot(
    page: Page, shown: "Shown"
) -> None:
    with undrawn(page, period_ms=10_000.0):
        button(page, "Go to …").click()
        expect(page.locator("#hint")).to_contain_text("Press where it should go")
        page.mouse.click(*pixel_of(page, FAR))
        wait_until(lambda: goal_state(shown) == "driving", "it sets off")
    goal = shown.robot.latest(topics.GOAL)
    assert goal is not None
    assert goal.pose is not None
    assert math.dist((goal.pose.x, goal.pose.y), FAR) < 0.1
    button(page, "Cancel").click()
    wait_until(lambda: goal_state(shown) == "canceled", "the goal is taken back")


def test_folders_are_open_as_they_were_left(page: Page, shown: "Shown") -> None:
    def open_tabs() -> None:
        page.get_by_text("Localized").first.wait_for()
        page.get_by_role("tab", name="More").click()

    open_tabs()
    expect(page.get_by_text("Search all commands")).to_be_hidden()
    page.get_by_text("Keys", exact=True).click()
    expect(page.get_by_text("Search all commands")).to_be_visible()
    page.get_by_role("tab", name="Go").click()
    page.get_by_role("tab", name="More").click()
    expect(page.get_by_text("Search all commands")).to_be_visible()
    page.reload()
    open_tabs()
    expect(page.get_by_text("Search all commands")).to_be_visible()
    page.get_by_text("Keys", exact=True).click()
    page.get_by_role("tab", name="Go").click()
