"""Screens of all sizes: the joystick covers neither Stop nor what became of it."""

import pytest
from playwright.sync_api import Page, expect

from trolley_viz.controls.controls import Controls
from trolley_viz.robots.stop_presses import StopLine

from .test_holding import tell_pad
from .viewer import Viewer

pytestmark = pytest.mark.browser

UNSEEN = """names => names.filter((name) => {
  const it = document.querySelector(name), box = it.getBoundingClientRect(), inset = 8;
  const x = (box.left + box.right) / 2, y = (box.top + box.bottom) / 2;
  const points = [[x, y], [box.left + inset, y], [box.right - inset, y],
    [x, box.top + inset], [x, box.bottom - inset]];
  const isWhole = it.scrollWidth <= it.clientWidth && box.left >= 0 && box.top >= 0
    && box.right <= innerWidth && box.bottom <= innerHeight;
  return !isWhole || !points.every(([x, y]) => it.contains(document.elementFromPoint(x, y)));
})"""
"""Which elements do not lie whole in the window, or have something over them."""
SCREENS = {
    "computer": (1280, 800),
    "tablet, upright": (820, 1180),
    "phone, upright": (375, 812),
    "phone, lying": (844, 390),
    "small phone, upright": (320, 568),
    "small phone, lying": (568, 320),
}
BAR = ["#stop", "#resume", ".hand-open"]
JOYSTICK = [".hand-pad", ".hand-close"]


def test_stop_and_what_became_of_it_are_in_sight_beside_the_joystick(
    page: Page, viewer: Viewer
) -> None:
    viewer.greet()
    viewer.tell()
    tell_pad(viewer, is_mine=False)
    alarm = StopLine("NOT STOPPED: no connection", is_alarm=True)
    wrong: dict[str, list[str]] = {}
    for language in ("en", "de"):
        for screen, (width, height) in SCREENS.items():
            name = f"{screen}, {language}"
            page.set_viewport_size({"width": width, "height": height})
            viewer.tell_state(language=language, is_stopped=True)
            expect(page.locator("html")).to_have_attribute("lang", language)
            expect(page.locator("#stop-line")).not_to_have_attribute("data-alarm", "true")
            wrong[name] = page.evaluate(UNSEEN, BAR)
            page.locator(".hand-open").press("Enter")
            wrong[name] += page.evaluate(UNSEEN, [*BAR, *JOYSTICK, "#stop-line"])
            pad_at = page.locator(".hand-pad").bounding_box()
            viewer.tell_state(language=language, stop=alarm)
            expect(page.locator("#stop-line")).to_have_attribute("data-alarm", "true")
            wrong[name] += page.evaluate(UNSEEN, [*BAR, *JOYSTICK, "#stop-line"])
            if page.locator(".hand-pad").bounding_box() != pad_at:
                wrong[name].append("it moves under the thumb")
            page.locator(".hand-close").press("Enter")
    assert {name: those for name, those in wrong.items() if those} == {}


def test_a_phone_that_lies_hides_nothing_by_its_camera_or_its_rim(
    page: Page, viewer: Viewer
) -> None:
    width, height = SCREENS["phone, lying"]
    camera, rim = 47, 21  # as on an iPhone, left and right, and below
    page.set_viewport_size({"width": width, "height": height})
    insets = {"left": camera, "right": camera, "bottom": rim}
    session = page.context.new_cdp_session(page)
    session.send("Emulation.setSafeAreaInsetsOverride", {"insets": insets})
    controls = Controls()
    with controls.add_bar():
        view = [controls.add_button(name) for name in ("Show the whole map", "Past")]
    viewer.greet()
    viewer.tell_controls(controls)
    expect(page.locator(".bar button")).to_have_count(len(view))
    shown = [*BAR, ".bar button", "#title", "#controls"]
    outside = page.evaluate(
        """([names, left, right, bottom]) => names.filter((name) => {
          const box = document.querySelector(name).getBoundingClientRect();
          const isLow = name !== "#controls" && box.bottom > bottom; // those are scrolled
          return box.left < left || box.right > right || isLow;
        })""",
        [shown, camera, width - camera, height - rim],
    )
    assert outside == []
    assert page.evaluate(UNSEEN, [*BAR, ".bar button"]) == []


def test_the_past_that_is_opened_on_a_phone_is_not_behind_the_joystick(
    page: Page, viewer: Viewer
) -> None:
    width, height = SCREENS["phone, upright"]
    page.set_viewport_size({"width": width, "height": height})
    controls = Controls()
    strip = controls.add_strip()
    with strip:
        controls.add_timeline("Time of day")
        controls.add_button("Now", colour="green")
    strip.visible = False
    viewer.greet()
    viewer.tell()
    viewer.tell_controls(controls)
    page.locator(".hand-open").press("Enter")
    expect(page.locator(".hand-pad")).to_be_visible()
    strip.visible = True
    viewer.tell_controls(controls)
    expect(page.locator(".strip")).to_be_visible()
    assert page.evaluate(UNSEEN, [*BAR, ".strip"]) == []
    page.locator(".hand-open").press("Enter")  # who drives after all sees the pad
    assert page.evaluate(UNSEEN, [*BAR, *JOYSTICK]) == []
