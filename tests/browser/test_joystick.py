"""The joystick on the screen: pressed, dragged and let go in a real browser."""

import os
import re
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from playwright.sync_api import Browser, Page, expect
from support.standing import HandDriven, stands
from support.waiting import wait_until

from trolley import topics

from .conftest import open_page, open_viewer

if TYPE_CHECKING:
    from .conftest import Shown

pytestmark = [pytest.mark.slow, pytest.mark.browser]

UP, LEFT = (0.0, -1.0), (-1.0, 0.0)


@pytest.fixture
def driven(shown: "Shown") -> Iterator[HandDriven]:
    watched = HandDriven(shown.robot)
    yield watched
    watched.close()


@pytest.fixture
def open_pad(shown: "Shown", browser: Browser) -> Iterator[Callable[[], Page]]:
    opened: list[Page] = []

    def open_it(width: int = 420, height: int = 560) -> Page:
        """A small page: the fewer pixels to draw in software, the more time for the rest."""
        page = open_page(browser, width, height)
        opened.append(page)
        open_viewer(page, shown.url)
        page.get_by_role("button", name="Drive by hand").click()
        expect(page.locator(".hand-card")).not_to_have_class("hand-card hand-off")
        return page

    yield open_it
    for page in opened:
        if not page.is_closed():
            page.close()


def press(page: Page, towards: tuple[float, float]) -> None:
    """Press in the middle of the pad and drag to its rim."""
    box = page.locator(".hand-pad").bounding_box()
    assert box is not None
    x, y, reach = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2, box["width"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + reach * towards[0], y + reach * towards[1], steps=4)


def source(shown: "Shown") -> str | None:
    base = shown.robot.latest(topics.BASE)
    return None if base is None else base.source


def test_press_drives_and_release_stops(
    shown: "Shown", driven: HandDriven, open_pad: Callable[..., Page], pictures: Path
) -> None:
    page = open_pad()
    press(page, UP)
    wait_until(lambda: driven.twist().vx > 0.2, "it drives forward")
    assert driven.twist().vx < 0.27
    page.screenshot(path=pictures / "joystick.png")
    page.mouse.up()
    driven.wait_until_it_stands()
    wait_until(lambda: source(shown) is None, "the joystick gives the robot back")
    page.locator(".hand-pad").focus()
    page.keyboard.down("ArrowLeft")
    wait_until(lambda: driven.twist().wz > 0.5, "the arrow keys drive it, too: it turns left")
    page.keyboard.up("ArrowLeft")
    driven.wait_until_it_stands()


def test_the_slider_bounds_the_speed(
    shown: "Shown", driven: HandDriven, open_pad: Callable[..., Page]
) -> None:
    page = open_pad()
    page.get_by_label("Speed", exact=True).fill("0.1")
    press(page, (0.0, 1.0))
    wait_until(lambda: driven.twist().vx < -0.08, "it backs up")
    assert driven.twist().vx > -0.12
    page.mouse.up()
    driven.wait_until_it_stands()


@pytest.mark.parametrize("way", ["crashed", "closed", "hanging", "left"])
def test_a_page_that_is_gone_holds_nothing(
    shown: "Shown", browser: Browser, driven: HandDriven, open_pad: Callable[..., Page], way: str
) -> None:
    page = open_pad()
    press(page, LEFT)
    wait_until(lambda: driven.twist().wz > 0.5, "it turns")
    if way == "crashed":
        session = browser.new_browser_cdp_session()
        for process in session.send("SystemInfo.getProcessInfo")["processInfo"]:
            if process["type"] == "renderer":
                os.kill(process["id"], signal.SIGKILL)
    elif way == "closed":
        page.close()
    elif way == "hanging":
        page.evaluate("setTimeout(() => { for (const t = Date.now(); Date.now() < t + 3000;); })")
    else:
        page.evaluate("window.dispatchEvent(new Event('blur'))")
    driven.wait_until_it_stands()


def test_one_browser_drives_and_the_other_is_told(
    shown: "Shown", driven: HandDriven, open_pad: Callable[..., Page]
) -> None:
    one, other = open_pad(), open_pad()
    told = other.get_by_text(re.compile("^Driven from .*Let go"))
    press(one, LEFT)
    wait_until(lambda: driven.twist().wz > 0.5, "it turns left")
    expect(told).to_be_visible()
    press(other, (1.0, 0.0))
    assert driven.twist().wz >= 0.0  # a slow page may have let go by now, but nobody turns right
    one.mouse.up()
    press(one, LEFT)
    wait_until(lambda: driven.twist().wz > 0.5, "it obeys the first, though the other presses, too")
    one.mouse.up()
    driven.wait_until_it_stands()
    other.mouse.up()
    expect(told).to_have_count(0)
    press(other, (1.0, 0.0))
    wait_until(lambda: driven.twist().wz < -0.5, "it turns right")
    other.mouse.up()
    driven.wait_until_it_stands()


def test_stop_while_it_is_held_stops_for_good(
    shown: "Shown", driven: HandDriven, open_pad: Callable[..., Page]
) -> None:
    page = open_pad()
    press(page, LEFT)
    wait_until(lambda: driven.twist().wz > 0.5, "it turns")
    shown.robot.stop()
    driven.wait_until_it_stands()
    expect(page.locator(".hand-say")).to_have_text("Stopped. “Drive on” lets it drive.")
    page.mouse.up()
    shown.robot.resume()
    expect(page.locator(".hand-say")).to_have_text("")
    assert stands(driven.twist())


def test_without_base_it_cannot_be_held(
    shown: "Shown", driven: HandDriven, open_pad: Callable[..., Page]
) -> None:
    page = open_pad()
    press(page, LEFT)
    wait_until(lambda: driven.twist().wz > 0.5, "it turns")
    killed = shown.demo.children()["base"]
    shown.demo.kill_service("base")
    wait_until(lambda: shown.demo.children().get("base", killed) != killed, "base is started anew")
    wait_until(lambda: shown.robot.now_ns() is not None, "base is back")
    wait_until(lambda: shown.robot.latest(topics.BASE) is not None, "base speaks")
    expect(page.locator(".hand-card")).not_to_have_class("hand-card hand-off")
    assert stands(driven.twist())  # still pressed, but nothing sets off by itself
    page.mouse.up()


@pytest.mark.parametrize(("width", "height"), [(1024, 768), (760, 900)])
def test_what_became_of_stop_is_beside_the_panel(
    shown: "Shown", open_pad: Callable[..., Page], width: int, height: int
) -> None:
    page = open_pad(width, height)
    shown.robot.stop()
    line = page.locator("#stop-line")
    expect(line).to_contain_text("Stopped")
    # In one go: the page soon writes again what it is told.
    gap = line.evaluate("""(line) => {
      line.textContent = "Stopped from the computer that runs this page";
      const panel = document.getElementById("panel").getBoundingClientRect();
      return panel.left - line.getBoundingClientRect().right;
    }""")
    shown.robot.resume()
    assert gap >= 0


def test_what_became_of_stop_covers_no_tab_of_a_phone(
    shown: "Shown", open_pad: Callable[..., Page]
) -> None:
    page = open_pad(390, 844)
    expect(page.get_by_role("tab", name="Tours")).to_be_visible()
    shown.robot.stop()
    expect(page.locator("#stop-line")).to_contain_text("Stopped")
    free = page.get_by_role("tab", name="Tours").evaluate("""(tab) => {
      const { left, top } = tab.getBoundingClientRect();
      return tab.contains(document.elementFromPoint(left + 20, top + 20));
    }""")
    shown.robot.resume()
    assert free
