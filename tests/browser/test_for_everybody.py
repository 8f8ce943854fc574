"""The page for those who see little, use no mouse, or have large fingers."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, expect
from support.waiting import wait_until

from trolley import topics

from .conftest import open_page, open_viewer
from .seeing import LATE_MS, pixel_of, poll, press, undrawn
from .test_viewer import button, goal_state

if TYPE_CHECKING:
    from .conftest import Shown

pytestmark = pytest.mark.browser

KITCHEN = (2.149, -2.706)
"""A place of the demo [m]."""
SMALLEST_PX = 44
"""WCAG 2.2's target size at level AAA."""
SMALL_TARGETS = """(smallest) => [...document.querySelectorAll(
  "button, select, summary, input:not([type=hidden])")].filter((one) => {
  if (!one.checkVisibility({ visibilityProperty: true })) return false;
  const target = one.closest("label") ?? one, { width, height } = target.getBoundingClientRect();
  return width > 0 && (width < smallest || height < smallest);
}).map((one) => one.outerHTML.slice(0, 120))"""
TAB_NAMES = ("Go", "Tours", "Map", "More")


def check(page: Page, where: str) -> None:
    """Let axe-core look at the page as it is, and measure what is to be pressed."""
    with undrawn(page):
        found = Axe().run(page, options={"resultTypes": ["violations"], "iframes": False})
    assert found.violations_count == 0, f"{where}: {found.generate_report()}"
    assert page.evaluate(SMALL_TARGETS, SMALLEST_PX) == [], where


COLOURS = """(buttons) => buttons.filter((one) => one.checkVisibility()).map(
  (one) => getComputedStyle(one).backgroundColor)"""


def colours(page: Page, selector: str) -> set[str]:
    """The colours of the buttons that are seen."""
    return set(page.eval_on_selector_all(selector, COLOURS))


def open_folders(page: Page) -> None:
    """Unfold everything that can be seen, also what comes into sight by that."""
    while closed := page.locator("details:not([open]) > summary:visible").all():
        closed[0].click()


@pytest.mark.slow
def test_axe_finds_nothing_on_a_card_and_beside_the_joystick(page: Page) -> None:
    card = page.get_by_role("heading", name="kitchen")
    stick = page.locator(".hand-card")

    def is_open() -> bool:
        """Press until it is: what a busy page holds for a drag opens nothing, and says nothing."""
        if not card.is_visible():
            page.mouse.click(*pixel_of(page, KITCHEN))
            page.wait_for_timeout(LATE_MS)
        return card.is_visible()

    poll(page, is_open, "the card opens")
    check(page, "card")
    press(page, lambda: page.keyboard.press("Escape"), card.is_hidden, "it is put away")
    press(page, lambda: page.keyboard.press("j"), stick.is_visible, "it is driven by hand")
    check(page, "joystick")
    page.keyboard.press("j")
    page.context.set_offline(True)
    expect(page.locator("#lost")).to_be_visible()
    check(page, "no connection")
    page.context.set_offline(False)
    expect(page.locator("#lost")).to_be_hidden()


def test_what_cannot_be_pressed_is_of_one_colour_that_nothing_else_has(page: Page) -> None:
    for look in ("light", "dark"):
        page.emulate_media(color_scheme=look)
        expect(page.locator("html")).to_have_attribute("data-look", look)
        off = colours(page, "#bar button:disabled, #controls button:disabled")
        assert len(off) == 1, look
        assert not off & colours(page, "#bar button:enabled, .control.button:enabled"), look
    page.emulate_media(color_scheme=None)


def test_all_is_done_without_a_mouse(page: Page, shown: "Shown", pictures: Path) -> None:
    """Through the page with Tab, as a screen reader's user goes."""
    names: list[str] = []
    for _ in range(60):
        page.keyboard.press("Tab")
        name = page.evaluate(
            "document.activeElement.getAttribute('aria-label') ?? document.activeElement.innerText"
        )
        names.append(name.strip())
        if names[-1] == "kitchen":
            break
    assert names[-1] == "kitchen", names
    page.screenshot(path=pictures / "focus.png")

    kitchen, resume = button(page, "kitchen"), page.locator("#resume")
    press(
        page,
        lambda: kitchen.press("Enter"),
        lambda: goal_state(shown) == "driving",
        "it sets off",
    )
    page.keyboard.press("Space")

    def mode() -> str:
        base = shown.robot.latest(topics.BASE)
        return "" if base is None else base.mode

    wait_until(lambda: mode() == "stopped", "Space is Stop, wherever the focus is")
    expect(resume).to_be_enabled()
    # Only then does it go on by itself.
    expect(page.locator("#sentence")).to_contain_text("let it go on to kitchen")
    press(page, lambda: resume.press("Enter"), lambda: mode() == "ok", "it may drive again")
    wait_until(lambda: goal_state(shown) == "driving", "and goes on to the kitchen")
    press(
        page,
        lambda: page.keyboard.press("x"),
        lambda: goal_state(shown) == "canceled",
        "X cancels",
    )
    page.get_by_role("tab", name="More").press("Enter")
    page.get_by_text("Layers: Sensing", exact=True).press("Enter")
    box = page.get_by_label("Particles")
    was_on = box.is_checked()
    box.press("Enter")
    expect(box).to_be_checked(checked=not was_on)
    box.press("Enter")
    expect(box).to_be_checked(checked=was_on)
    page.get_by_text("Layers: Sensing", exact=True).press("Enter")
    page.get_by_role("tab", name="Go").press("Enter")
    page.get_by_role("tab", name="Go").focus()
    page.keyboard.press("ArrowRight")
    expect(page.get_by_role("tab", name="Tours")).to_have_attribute("aria-selected", "true")
    page.keyboard.press("ArrowLeft")
    expect(button(page, "kitchen")).to_be_visible()


# These come last: they leave folders of the page open.
@pytest.fixture(params=[pytest.param("light", marks=pytest.mark.slow), "dark", "phone"])
def seen(request: pytest.FixtureRequest, shown: "Shown", browser: Browser) -> Iterator[Page]:
    """The page in its colours; a phone shows the light ones, too."""
    if request.param == "phone":
        phone = open_page(browser, 390, 844, color_scheme="light", has_touch=True, is_mobile=True)
        open_viewer(phone, shown.url)
        yield phone
        phone.context.close()
        return
    page: Page = request.getfixturevalue("page")
    page.emulate_media(color_scheme=request.param)
    is_dark = page.evaluate("matchMedia('(prefers-color-scheme: dark)').matches")
    assert is_dark == (request.param == "dark")
    yield page
    page.emulate_media(color_scheme=None)


def test_axe_finds_nothing_and_all_targets_are_large(seen: Page) -> None:
    for tab in TAB_NAMES:
        seen.get_by_role("tab", name=tab).click()
        open_folders(seen)
        check(seen, tab)
    seen.keyboard.press("Control+k")
    expect(seen.get_by_role("dialog", name="Commands")).to_be_visible()
    check(seen, "commands")
    seen.keyboard.press("Escape")
