"""The viewer as people use it: a real browser, a mouse, and the demo's robot."""

import math
import os
import re
import signal
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from playwright.sync_api import Locator, Page, expect
from support.waiting import wait_until

from trolley import topics
from trolley.geometry import wrap_angle
from trolley.messages import SavedPose

from .conftest import open_page, open_viewer
from .seeing import canvas, pixel_of, press, undrawn, wait_for_frames

if TYPE_CHECKING:
    from .conftest import Shown

pytestmark = pytest.mark.browser

PLACE, TOWARDS = (1.6, 0.7), (2.2, 1.3)
BESIDE = (1.2, 0.1)
FAR, FROM_FAR = (5.2, 1.3), (4.0, 1.3)
"""Places on open floor [m], and where the pointer is dragged to from there."""


def drag(page: Page, start: tuple[float, float], end: tuple[float, float]) -> None:
    """Press, drag and release between two points of the floor, as slowly as a person."""
    wait_for_frames(page)
    page.mouse.move(*pixel_of(page, start))
    page.mouse.down()
    page.mouse.move(*pixel_of(page, end), steps=6)
    page.mouse.up()


def goal_state(shown: "Shown") -> str:
    goal = shown.robot.latest(topics.GOAL)
    return "" if goal is None else goal.state


def goal_id(shown: "Shown") -> str | None:
    """Of the newest goal."""
    return shown.known(topics.GOAL).id


def send(page: Page, shown: "Shown", push: Callable[[], object]) -> None:
    """Press what sends the robot to a goal, until there is a new one."""
    before = goal_id(shown)
    press(page, push, lambda: goal_id(shown) != before, "the goal is sent", again_s=10.0)


def place_of(shown: "Shown", name: str) -> SavedPose | None:
    saved = shown.known(topics.POSES)
    return next((one for one in saved.poses if one.name == name), None)


def field(page: Page, label: str) -> Locator:
    """The field behind a label."""
    return page.get_by_label(label, exact=True).filter(visible=True)


def choose(page: Page, label: str, option: str) -> None:
    field(page, label).select_option(option)


def button(page: Page, name: str) -> Locator:
    return page.get_by_role("button", name=name, exact=True)


def test_go_to_with_the_mouse_and_the_robot_arrives(
    page: Page, shown: "Shown", pictures: Path
) -> None:
    hint = page.get_by_text("Press where it should go")
    press(page, button(page, "Go to …").click, hint.is_visible, "it is to be pointed out")
    send(page, shown, lambda: drag(page, PLACE, TOWARDS))
    wait_until(lambda: goal_state(shown) in ("driving", "arrived"), "the robot sets off")
    page.screenshot(path=pictures / "driving.png")
    with undrawn(page):
        wait_until(lambda: goal_state(shown) in ("arrived", "failed"), "the robot gets there")
    expect(page.locator("#sentence")).to_contain_text("It has arrived at the place on the map")
    page.screenshot(path=pictures / "arrived.png")
    truth = shown.known(topics.SIM_TRUTH)
    assert truth.collisions == 0
    assert math.dist((truth.pose.x, truth.pose.y), PLACE) < 0.15
    assert abs(wrap_angle(truth.pose.yaw - math.pi / 4)) < 0.15


def test_a_finger_points_out_a_goal_and_sees_the_way(
    page: Page, shown: "Shown", pictures: Path
) -> None:
    assert page.context.browser is not None
    phone = open_page(page.context.browser, 390, 844, has_touch=True, is_mobile=True)
    context = phone.context
    open_viewer(phone, shown.url)
    fingers = context.new_cdp_session(phone)

    def touch(kind: str, *points: tuple[float, float]) -> None:
        at = [{"x": x, "y": y} for x, y in points]
        fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": at})

    hint = phone.locator("#hint")
    asks = hint.filter(has_text="Press where it should go")
    press(phone, button(phone, "Go to …").tap, asks.is_visible, "it is to be pointed out")
    wait_for_frames(phone)
    (x, y), (x1, y1) = pixel_of(phone, FAR), pixel_of(phone, FROM_FAR)

    def point_out() -> None:
        touch("touchStart", (x, y))
        for part in (0.3, 0.6, 1.0):
            touch("touchMove", (x + part * (x1 - x), y + part * (y1 - y)))
        expect(hint).to_have_text(re.compile(r"\d+\.\d m, about [\d.]+ s"))
        phone.screenshot(path=pictures / "pointing-phone.png")
        touch("touchEnd")

    send(phone, shown, point_out)
    wait_until(lambda: goal_state(shown) == "driving", "the robot sets off")
    phone.get_by_role("button", name="Undo: Go to").tap()
    goal = shown.known(topics.GOAL)
    assert goal.pose is not None
    assert math.dist((goal.pose.x, goal.pose.y), FAR) < 0.1
    assert abs(wrap_angle(goal.pose.yaw - math.pi)) < 0.15
    wait_until(lambda: goal_state(shown) == "canceled", "the goal is taken back")
    # Who vanishes in the middle of a drag has done nothing.
    press(phone, button(phone, "Go to …").tap, asks.is_visible, "it is to be pointed out again")
    wait_for_frames(phone)
    touch("touchStart", (x, y))
    touch("touchMove", (x1, y1))
    expect(hint).to_have_text(re.compile(r"\d+\.\d m, about [\d.]+ s"))
    context.close()
    assert goal_state(shown) == "canceled"


COUNT_LINKS = """async (canvas) => {
  const gl = canvas.getContext("webgl2");
  let links = 0, colours = 0;
  for (const name of ["bufferData", "bufferSubData", "linkProgram"]) {
    gl[name] = function (...given) {
      if (name === "linkProgram") links++;
      else if (given.some((one) => one instanceof Uint8Array)) colours++;
      return WebGL2RenderingContext.prototype[name].apply(gl, given);
    };
  }
  while (colours < 12) await new Promise((done) => setTimeout(done, 50));
  return links;
}"""
"""How many programs are linked while the colours of twelve scans are drawn."""


def test_the_browser_links_no_program_anew_for_each_scan(page: Page) -> None:
    assert canvas(page).evaluate(COUNT_LINKS) < 4


LOADS = """async () => {
  const { Scene } = await import("/page/scene.js");
  const loads = [], frame = { addEventListener() {}, set src(url) { loads.push(url); } };
  const seen = [];
  for (const hidden of [true, false]) {
    Object.defineProperty(document, "hidden", { configurable: true, get: () => hidden });
    new Scene(frame, { isOpen: true }).look();
    seen.push(loads.length > 0);
  }
  delete document.hidden;
  return seen;
}"""
"""Whether a picture is loaded by a page that is out of sight, and by one that is seen."""


def test_a_page_loads_the_picture_only_while_it_is_seen(page: Page) -> None:
    """Out of sight nothing is drawn: it would be loaded anew every 8 s, all night."""
    assert page.evaluate(LOADS) == [False, True]


def test_tools_are_taken_and_left_by_keys_and_by_buttons(page: Page) -> None:
    hint = page.locator("#hint")
    card = page.locator(".hand-card")

    def key(name: str) -> Callable[[], None]:
        return lambda: page.keyboard.press(name)

    press(page, button(page, "Set pose …").click, hint.is_visible, "the pose is to be set")
    expect(hint).to_contain_text("Press where the robot is")
    press(page, key("Escape"), hint.is_hidden, "it is left")
    press(page, key("g"), hint.is_visible, "a goal is to be set")
    expect(hint).to_contain_text("Press where it should go")
    press(page, button(page, "Press again to cancel").click, hint.is_hidden, "it is left")
    press(page, key("j"), card.is_visible, "it is driven by hand")
    press(page, key("j"), card.is_hidden, "it is not driven by hand any more")


def test_several_places_in_a_row_are_driven(page: Page, shown: "Shown", pictures: Path) -> None:
    page.get_by_text("Several places in a row").click()
    done = button(page, "Done choosing")
    press(page, button(page, "Choose places …").click, done.is_visible, "places are chosen")
    wait_for_frames(page)
    page.mouse.click(*pixel_of(page, BESIDE))
    button(page, "start").click()
    expect(page.locator("ol > li")).to_have_count(2)
    page.screenshot(path=pictures / "row.png")

    def trip_state() -> str:
        return shown.known(topics.TOUR).state

    press(page, button(page, "Start").click, lambda: trip_state() == "driving", "it sets off")
    with undrawn(page):
        wait_until(lambda: trip_state() == "done", "it has been at both")
    trip = shown.known(topics.TOUR)
    assert [result.state for result in trip.results] == ["reached", "reached"]
    expect(page.locator("#sentence")).to_contain_text("The tour is done.")
    expect(page.locator("ol > li")).to_have_count(0)
    page.get_by_text("Several places in a row").click()


def test_a_place_is_saved_changed_and_brought_back(
    page: Page, shown: "Shown", pictures: Path
) -> None:
    page.get_by_role("tab", name="Map").click()
    field(page, "Name").fill("<b>spot</b>")
    button(page, "Save where the robot is").click()
    expect(page.get_by_text("Not saved")).to_be_visible()
    field(page, "Name").fill("")
    field(page, "Name").press_sequentially("play corner")  # keys that would point, stop and cancel
    choose(page, "Icon", "children")
    button(page, "Save where the robot is").click()
    wait_until(lambda: place_of(shown, "play corner") is not None, "it is saved")
    expect(page.locator("#hint")).to_be_hidden()
    assert shown.known(topics.BASE).mode == "ok"
    choose(page, "Place", "play corner")
    expect(field(page, "Name")).to_have_value("play corner")  # else it comes while one types
    field(page, "Name").fill("toy corner")
    button(page, "Save changes").click()
    wait_until(lambda: place_of(shown, "toy corner") is not None, "it is renamed")
    wait_until(lambda: place_of(shown, "play corner") is None, "the old name is gone")
    renamed = place_of(shown, "toy corner")
    assert renamed is not None
    assert renamed.icon == "baby-carriage"
    for notice in ("Not saved", "This place is now called"):  # they lie where it is to be pressed
        expect(page.get_by_text(notice)).to_have_count(0)
    button(page, "Move on the map …").click()
    expect(page.locator("#hint")).to_contain_text("Press")
    expect(field(page, "Place")).to_have_value("toy corner")
    press(
        page,
        lambda: drag(page, PLACE, TOWARDS),
        lambda: place_of(shown, "toy corner") != renamed,
        "it is moved",
    )
    moved = place_of(shown, "toy corner")
    assert moved is not None
    assert math.dist((moved.pose.x, moved.pose.y), PLACE) < 0.1
    page.screenshot(path=pictures / "places.png")
    expect(page.get_by_role("button", name="Undo: Move")).to_be_visible()
    button(page, "Delete").click()
    wait_until(lambda: place_of(shown, "toy corner") is None, "it is deleted")
    page.get_by_role("button", name="Undo: Delete").click()
    wait_until(lambda: place_of(shown, "toy corner") == moved, "it is back")
    page.get_by_role("button", name="Undo: Move").click()
    wait_until(lambda: place_of(shown, "toy corner") == renamed, "it is where it was")
    page.get_by_role("tab", name="Go").click()


def test_a_button_drives_to_its_place(page: Page, shown: "Shown") -> None:
    send(page, shown, button(page, "start").click)
    with undrawn(page):
        expect(page.locator("#sentence")).to_contain_text("It has arrived at start.")
    send(page, shown, button(page, "corridor").click)
    expect(page.locator("#sentence")).to_contain_text("It is on its way to corridor")
    button(page, "Pause").click()
    expect(page.locator("#sentence")).to_contain_text("It is paused on its way to corridor")
    page.wait_for_timeout(500)  # pressed twice at one spot, another button does nothing yet
    button(page, "Continue").click()
    wait_until(lambda: goal_state(shown) == "driving", "it goes on")
    button(page, "Cancel").click()
    expect(page.locator("#sentence")).to_contain_text("Canceled. Ready.")


def test_stop_is_in_sight_whatever_tab_is_open(page: Page) -> None:
    for tab in ("Tours", "Map", "More", "Go"):
        page.get_by_role("tab", name=tab).click()
        expect(page.get_by_role("button", name="STOP")).to_be_in_viewport(ratio=1)
        expect(page.get_by_role("button", name="Drive on")).to_be_in_viewport(ratio=1)


def test_stop_stops_and_resume_lets_it_drive_again(page: Page, shown: "Shown") -> None:
    def mode() -> str:
        base = shown.robot.latest(topics.BASE)
        return "" if base is None else base.mode

    drive_on = button(page, "Drive on").click
    page.get_by_role("button", name="STOP").click()
    wait_until(lambda: mode() == "stopped", "base is stopped")
    expect(page.locator("#sentence")).to_contain_text(
        "Stopped. Press “Drive on” to let it drive again."
    )
    press(page, drive_on, lambda: mode() == "ok", "base may drive again")
    page.keyboard.press("Space")
    wait_until(lambda: mode() == "stopped", "a key stops it, too")
    press(page, drive_on, lambda: mode() == "ok", "base may drive again")


def test_a_stop_that_nobody_answers_is_repeated_and_says_so(page: Page, shown: "Shown") -> None:
    # Frozen first: killed, it would be back before a busy page has noticed.
    os.kill(shown.demo.children()["base"], signal.SIGSTOP)
    page.get_by_role("button", name="STOP").click()
    expect(page.get_by_text("NOT STOPPED: no connection")).to_be_visible()
    shown.demo.kill_service("base")

    def is_stopped() -> bool:
        base = shown.robot.latest(topics.BASE)
        return base is not None and base.mode == "stopped"

    wait_until(is_stopped, "base is back, and stopped")
    expect(page.locator("#stop-line")).to_contain_text("Stopped")
