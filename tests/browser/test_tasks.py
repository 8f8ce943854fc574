"""What people do without reading anything, and how often they press for it, with mouse and fingers.

The page itself counts what is pressed. What everybody needs is in view; one may scroll to the rest.
"""

import math
import re
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import pytest
from playwright.sync_api import Browser, CDPSession, Locator, Page, expect
from support.waiting import wait_until

from trolley import requests, topics
from trolley.messages import Tour, Zone
from trolley.messages.request_params import Named, Nothing

from .conftest import START, open_page, open_viewer
from .seeing import count_seen, is_blue, pixel_of, poll, undrawn, wait_for_frames
from .test_viewer import FAR, button, field, goal_state, place_of

if TYPE_CHECKING:
    from .conftest import Shown

pytestmark = pytest.mark.browser

COUNT = """addEventListener("pointerdown", (event) => {
  if (event.isTrusted) top.numPressed = (top.numPressed ?? 0) + 1;
}, { capture: true })"""
KITCHEN, CORRIDOR = "kitchen", "corridor"
STARTING = (START.x, START.y)
SPOT = (1.6, 0.7)
"""Open floor [m] where nothing is drawn."""
MIRROR = ((3.1, 0.5), (3.1, -0.3))
"""Along a wall [m] whose face is at `WALL_X_M`."""
WALL_X_M = 3.2
ROBOT_REACH_M, ROBOT_PIXELS = 0.35, 15
"""A robot covers more pixels than this around where it is."""


class Presser:
    """One page, pressed with a mouse or with fingers."""

    def __init__(self, page: Page, *, is_phone: bool) -> None:
        self.page = page
        self._is_phone = is_phone
        self._fingers: CDPSession | None = None
        self._before = self._count()

    def _count(self) -> int:
        return self.page.evaluate("window.numPressed ?? 0")

    @property
    def presses(self) -> int:
        """How often something was pressed."""
        return self._count() - self._before

    def press(self, what: Locator) -> None:
        """Press something, after scrolling to it, which is no press."""
        expect(what).to_be_enabled()
        what.scroll_into_view_if_needed()
        if self._is_phone:
            what.tap()
        else:
            what.click()

    def press_floor(self, point: tuple[float, float]) -> None:
        wait_for_frames(self.page)
        at = pixel_of(self.page, point)
        if self._is_phone:
            self.page.touchscreen.tap(*at)
        else:
            self.page.mouse.click(*at)

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        wait_for_frames(self.page)
        first, last = np.array(pixel_of(self.page, start)), np.array(pixel_of(self.page, end))
        between = [first + share * (last - first) for share in (0.2, 0.4, 0.6, 0.8, 1.0)]
        if not self._is_phone:
            self.page.mouse.move(*first)
            self.page.mouse.down()
            for at in between:
                self.page.mouse.move(*at)
            self.page.mouse.up()
            return
        self._touch("touchStart", first)
        for at in between:
            self._touch("touchMove", at)
        self._touch("touchEnd")

    def _touch(self, kind: str, *points: np.ndarray) -> None:
        self._fingers = self._fingers or self.page.context.new_cdp_session(self.page)
        at = [{"x": float(x), "y": float(y)} for x, y in points]
        self._fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": at})


@pytest.fixture(params=["desktop", "phone"])
def hand(request: pytest.FixtureRequest, shown: "Shown", browser: Browser) -> Iterator[Presser]:
    """A page that has just been opened."""
    is_phone = request.param == "phone"
    size = (390, 844) if is_phone else (1350, 640)
    page = open_page(browser, *size, has_touch=is_phone, is_mobile=is_phone)
    page.add_init_script(COUNT)
    open_viewer(page, shown.url)
    yield Presser(page, is_phone=is_phone)
    page.context.close()


def zones_of(shown: "Shown") -> dict[str, Zone]:
    zones = shown.robot.latest(topics.ZONES)
    return {} if zones is None else {one.name: one for one in zones.zones}


def tours_of(shown: "Shown") -> dict[str, Tour]:
    tours = shown.robot.latest(topics.TOURS)
    return {} if tours is None else {one.name: one for one in tours.tours}


def exploring(shown: "Shown") -> str:
    mapping = shown.robot.latest(topics.MAPPING)
    return "" if mapping is None else mapping.exploring


def test_three_rows_of_lines_are_seen_without_scrolling(hand: Presser) -> None:
    is_all_seen = """(lines) => {
      lines.innerHTML = "<li>Paused on the way to kitchen</li>".repeat(3);
      return lines.scrollHeight <= lines.clientHeight;
    }"""
    assert hand.page.locator("#lines").evaluate(is_all_seen)


def test_where_it_is_is_seen_and_it_is_sent_stopped_and_sent_on_by_one_press_each(
    hand: Presser, shown: "Shown"
) -> None:
    page = hand.page
    with undrawn(page):
        shown.settle()  # it was called back nearer to the kitchen
    sentence, lines = page.locator("#sentence"), page.locator("#lines")
    for shows in (sentence, lines):
        expect(shows).to_be_in_viewport(ratio=1)
    expect(lines).to_contain_text("Localized")
    here = shown.known(topics.SIM_TRUTH)
    at = (here.pose.x, here.pose.y)
    poll(
        page,
        lambda: count_seen(page, at, is_blue, ROBOT_REACH_M) > ROBOT_PIXELS,
        "the robot is seen on the map",
    )
    expect(button(page, "Drive by hand")).to_be_enabled()
    for name in (KITCHEN, "STOP", "Drive on"):
        expect(button(page, name)).to_be_in_viewport(ratio=0.9)
    assert hand.presses == 0

    with undrawn(page):
        hand.press(button(page, KITCHEN))
        expect(sentence).to_contain_text(f"It is on its way to {KITCHEN}")
        assert hand.presses == 1

        hand.press(button(page, "STOP"))
        expect(page.locator("#stop-line")).to_contain_text("Stopped")
        assert hand.presses == 2
        # Why it stands, and what to do about it, without another press.
        expect(sentence).to_have_text(f"Stopped. Press “Drive on” to let it go on to {KITCHEN}.")
        expect(sentence).to_be_in_viewport(ratio=1)
        assert hand.presses == 2

        hand.press(button(page, "Drive on"))
        wait_until(lambda: goal_state(shown) == "driving", "it goes on to the kitchen")
        expect(sentence).to_contain_text(f"It is on its way to {KITCHEN}")
        assert hand.presses == 3
        hand.press(button(page, "Cancel"))
        wait_until(lambda: goal_state(shown) == "canceled", "it is called back")


@pytest.mark.slow
def test_a_place_is_saved_by_two_presses_and_its_name(hand: Presser, shown: "Shown") -> None:
    page = hand.page
    hand.press(page.get_by_role("tab", name="Map"))
    name = field(page, "Name").first
    expect(name).to_be_in_viewport()
    name.fill("reading chair")
    hand.press(button(page, "Save where the robot is"))
    wait_until(lambda: place_of(shown, "reading chair") is not None, "it is saved")
    assert hand.presses == 2
    shown.robot.ask(requests.POSES_DELETE, Named(name="reading chair"))


@pytest.mark.slow
def test_a_spot_is_saved_by_two_presses_and_its_name(hand: Presser, shown: "Shown") -> None:
    page = hand.page
    shown.settle()  # it may have been called back just where it stood on the spot
    hand.press_floor(SPOT)
    card = page.locator("#over")
    expect(card.get_by_label("Name", exact=True)).to_be_in_viewport()
    card.get_by_label("Name", exact=True).fill("lamp")
    hand.press(card.get_by_role("button", name="Save place"))
    wait_until(lambda: place_of(shown, "lamp") is not None, "it is saved")
    saved = place_of(shown, "lamp")
    assert saved is not None
    assert math.dist((saved.pose.x, saved.pose.y), SPOT) < 0.15
    assert hand.presses == 2
    shown.robot.ask(requests.POSES_DELETE, Named(name="lamp"))
    page.keyboard.press("Escape")


@pytest.mark.slow
def test_a_tour_of_three_is_made_by_six_presses(hand: Presser, shown: "Shown") -> None:
    page = hand.page
    before = set(tours_of(shown))
    hand.press(page.get_by_role("tab", name="Tours"))
    hand.press(button(page, "New tour"))
    for count, point in enumerate((SPOT, FAR, (2.2, 0.1)), 1):
        hand.press_floor(point)
        expect(page.get_by_role("button", name=re.compile(rf"^{count} "))).to_have_count(1)
    hand.press(button(page, "Save"))
    wait_until(lambda: len(tours_of(shown)) > len(before), "the tour is saved")
    (added,) = set(tours_of(shown)) - before
    assert len(tours_of(shown)[added].stops) == 3
    assert hand.presses == 6
    shown.robot.ask(requests.TOURS_DELETE, Named(name=added))


@pytest.mark.slow
def test_a_mirror_is_marked_by_three_presses(hand: Presser, shown: "Shown") -> None:
    page = hand.page
    before = set(zones_of(shown))
    hand.press(page.get_by_role("tab", name="Map"))
    hand.press(button(page, "Mirror"))
    expect(page.locator("#hint")).to_be_visible()
    hand.drag(*MIRROR)
    wait_until(lambda: len(zones_of(shown)) > len(before), "the mirror is stored")
    (added,) = set(zones_of(shown)) - before
    mirror = zones_of(shown)[added]
    assert mirror.kind == "mirror"
    assert [x for x, _ in mirror.points] == pytest.approx([WALL_X_M] * 2, abs=0.05)
    assert hand.presses == 3
    shown.robot.ask(requests.ZONES_DELETE, Named(name=added))


@pytest.mark.slow
def test_a_new_map_is_begun_by_exploring_with_three_presses(hand: Presser, shown: "Shown") -> None:
    page = hand.page
    hand.press(page.get_by_role("tab", name="Map"))
    hand.press(button(page, "New map"))
    hand.press(button(page, "Explore by itself"))
    wait_until(lambda: exploring(shown) == "exploring", "it explores")
    assert hand.presses == 3
    with undrawn(page):
        before = shown.robot.latest(topics.SIM_TRUTH)
        assert before is not None

        def moved() -> bool:
            now = shown.robot.latest(topics.SIM_TRUTH)
            return now is not None and now.pose.distance_to(before.pose) > 0.3

        wait_until(moved, "it drives by itself")
        shown.robot.ask(requests.MAP_CANCEL, Nothing())
        wait_until(shown.is_ready, "it is on its map again")
        expect(page.get_by_text("Localized").first).to_be_visible()
    shown.settle()
