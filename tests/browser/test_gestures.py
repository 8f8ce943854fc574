"""What is pressed on the map and not let go of; what the page remembers."""

import re
from typing import TYPE_CHECKING

import pytest
from playwright.sync_api import Page, expect
from support.waiting import wait_until

from trolley import topics

from .test_viewer import FAR, FROM_FAR, button, goal_state, pixel_of, wait_for_frames

if TYPE_CHECKING:
    from .conftest import Shown

pytestmark = [pytest.mark.slow, pytest.mark.browser]

PHONE = {"width": 390, "height": 844}


def test_a_finger_that_the_phone_takes_away_sends_no_goal(page: Page, shown: "Shown") -> None:
    assert page.context.browser is not None
    context = page.context.browser.new_context(viewport=PHONE, has_touch=True, is_mobile=True)
    phone = context.new_page()
    phone.set_default_timeout(60_000)
    phone.goto(shown.url)
    phone.get_by_text("Localized").first.wait_for()
    fingers = context.new_cdp_session(phone)
    hint = phone.locator("#trolley-hint")
    button(phone, "Go to …").tap()
    expect(hint).to_contain_text("Press where to go")

    def touch(kind: str, *points: tuple[float, float]) -> None:
        at = [{"x": x, "y": y, "id": i} for i, (x, y) in enumerate(points)]
        fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": at})

    def drag_on() -> tuple[tuple[float, float], tuple[float, float]]:
        wait_for_frames(phone)
        start, end = pixel_of(phone, FAR), pixel_of(phone, FROM_FAR)
        touch("touchStart", start)
        touch("touchMove", (0.5 * (start[0] + end[0]), 0.5 * (start[1] + end[1])))
        touch("touchMove", end)
        expect(hint).to_have_text(re.compile(r"\d+\.\d m, about [\d.]+ s"))
        return start, end

    drag_on()
    touch("touchCancel")  # as for a call, or a swipe from the edge
    expect(hint).to_contain_text("Press where to go")
    _, end = drag_on()
    touch("touchStart", end, (end[0] + 40.0, end[1] + 40.0))  # a second finger
    touch("touchEnd")
    expect(hint).to_contain_text("Press where to go")
    drag_on()
    phone.evaluate("window.dispatchEvent(new Event('blur'))")  # as Chromium does for another window
    expect(hint).to_contain_text("Press where to go")
    touch("touchEnd")
    phone.wait_for_timeout(500)
    goal = shown.robot.latest(topics.GOAL)
    assert goal is not None
    assert goal.state == "idle"
    drag_on()
    touch("touchEnd")
    wait_until(lambda: goal_state(shown) == "driving", 20.0, "it sets off when it is let go")
    button(phone, "Cancel").tap()
    wait_until(lambda: goal_state(shown) == "canceled", 20.0, "the goal is taken back")
    context.close()


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
