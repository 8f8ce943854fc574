"""The card of a touched spot, which leaves the spot in sight."""

import re
from typing import TYPE_CHECKING

import pytest
from playwright.sync_api import Browser, Page, expect

from .conftest import open_page, open_viewer
from .seeing import canvas, poll, press, scene, undrawn

if TYPE_CHECKING:
    from .conftest import Shown

pytestmark = pytest.mark.browser

CARD = "#over > .card:not([hidden])"
SPOTS = [(0.2, 0.2), (0.8, 0.3), (0.5, 0.5), (0.8, 0.6), (0.45, 0.8)]
"""Shares of the map's width and height."""
FREE = [(0.2, 0.2), (0.4, 0.25), (0.5, 0.5), (0.8, 0.3)]
"""Those that no button covers on a phone that lies on its side."""
IS_BACK = "one => one.style.translate === '0px' && one.getAnimations().length === 0"
TOUCH_AS_IT_CLOSES = """async ([x, y]) => {
  const card = document.querySelector("#over > .of-spot");
  const inside = document.getElementById("scene").contentWindow;
  const drawn = () => new Promise((done) => requestAnimationFrame(() => setTimeout(done)));
  card.hidden = true;
  for (const name of ["pointerdown", "pointerup"]) {
    const at = { clientX: x, clientY: y, bubbles: true };
    inside.document.body.dispatchEvent(new inside.PointerEvent(name, at));
  }
  await drawn();
  card.hidden = false;
  await drawn();
}"""
"""What a page does that is told late of a card that its person has closed."""


def sees(page: Page, x: float, y: float) -> bool:
    """Whether the picture is seen at a point of it, and neither a card nor a button over it."""
    box = canvas(page).bounding_box()
    assert box is not None
    at = [box["x"] + x, box["y"] + y]
    return page.evaluate("([x, y]) => document.elementFromPoint(x, y)?.id", at) == "scene"


def touch(page: Page, x: float, y: float) -> None:
    """Touch a point of the picture until its card is open: a busy page takes a tap for a drag."""

    def push() -> None:
        canvas(page).click(position={"x": x, "y": y})

    press(page, push, page.locator(CARD).is_visible, "the card is open", again_s=5)


def close(page: Page) -> None:
    """Close the card, until the picture has come back: where it slides, touches miss the spot."""

    def is_closed() -> bool:
        return not page.locator(CARD).is_visible() and page.locator("#scene").evaluate(IS_BACK)

    press(page, lambda: page.keyboard.press("Escape"), is_closed, "the card is closed", again_s=15)


@pytest.mark.parametrize(
    ("width", "height", "spots"),
    [
        (1024, 768, SPOTS),
        (390, 844, SPOTS),
        pytest.param(844, 390, FREE, marks=pytest.mark.slow),
    ],
)
def test_a_card_leaves_the_touched_spot_in_sight(
    shown: "Shown", browser: Browser, width: int, height: int, spots: list[tuple[float, float]]
) -> None:
    is_phone = min(width, height) < 737
    page = open_page(browser, width, height, has_touch=is_phone, is_mobile=is_phone)
    open_viewer(page, shown.url)
    if width < 737:
        page.locator("#handle").press("ArrowDown")
    page.wait_for_timeout(500)
    size = scene(page).evaluate("[innerWidth, innerHeight]")
    with undrawn(page):
        for across, down in spots:
            x, y = across * size[0], down * size[1]
            touch(page, x, y)
            poll(page, lambda x=x, y=y: sees(page, x, y), f"{across}, {down} is seen")
            close(page)
    page.context.close()


def test_a_spot_moves_the_picture_for_its_own_card_alone(shown: "Shown", browser: Browser) -> None:
    page = open_page(browser, 390, 844, has_touch=True, is_mobile=True)
    open_viewer(page, shown.url)
    page.locator("#handle").press("ArrowDown")
    page.wait_for_timeout(500)
    picture = page.locator("#scene")
    at_rest = picture.evaluate("one => one.style.translate")
    with undrawn(page):
        touch(page, 175, 500)
        expect(picture).not_to_have_attribute("style", re.compile(re.escape(f": {at_rest};")))
        close(page)
        other = page.locator("#over > .card:not(.of-spot)")
        other.evaluate("card => { card.hidden = false }")
        page.wait_for_timeout(1000)
        assert picture.evaluate("one => one.style.translate") == at_rest
        other.evaluate("card => { card.hidden = true }")
        page.evaluate(TOUCH_AS_IT_CLOSES, [175, 500])
        assert picture.evaluate("one => one.style.translate") != at_rest
    page.context.close()


def test_a_card_stays_where_it_is_while_the_connection_is_lost(
    shown: "Shown", browser: Browser
) -> None:
    page = open_page(browser, 390, 844, has_touch=True, is_mobile=True)
    open_viewer(page, shown.url)
    card = page.locator("#over > .of-spot")
    card.evaluate("card => { card.hidden = false }")
    before = card.bounding_box()
    page.evaluate("document.body.dataset.line = 'lost'")
    assert card.bounding_box() == before
    page.context.close()
