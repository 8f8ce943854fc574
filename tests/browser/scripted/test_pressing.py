"""Presses while the viewer changes what is pressed."""

import pytest
from playwright.sync_api import Locator, Page, expect
from support.waiting import wait_until

from trolley_viz.controls.controls import Controls
from trolley_viz.controls.markup import details, lead, note
from trolley_viz.server.messages import Told
from trolley_viz.words.sentences import StatusLine

from .test_holding import tell_pad
from .test_page_itself import num_stops
from .viewer import Viewer

pytestmark = pytest.mark.browser


def middle(seen: Locator) -> tuple[float, float]:
    box = seen.bounding_box()
    assert box is not None
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def test_what_is_written_anew_between_press_and_release_is_pressed(
    page: Page, viewer: Viewer
) -> None:
    controls = Controls()
    listed = controls.add_html(note("1 trip") + lead("t1", "Look at it"))
    viewer.greet()
    viewer.tell_controls(controls)
    page.get_by_role("button", name="Look at it").hover()
    page.mouse.down()
    listed.content = note("2 trips") + lead("t1", "Look at it")
    other = controls.add_html(note("Written later"))
    viewer.lines[-1].send(Told(controls=controls.take_changes()))
    expect(page.get_by_text("Written later")).to_be_visible()  # so the first is known, too
    page.mouse.up()
    expect(page.get_by_text("2 trips")).to_be_visible()
    wait_until(viewer.presses, "it is pressed")
    assert [(one.control, one.value) for one in viewer.presses()] == [(listed.id, "t1")]
    assert other.id != listed.id


def test_what_is_refused_shows_again_what_was_taken_last(page: Page, viewer: Viewer) -> None:
    controls = Controls()
    controls.add_check("Repeat forever", False)
    viewer.greet()
    viewer.tell_controls(controls)
    box = page.get_by_label("Repeat forever")

    def press(number: int, *, is_done: bool) -> None:
        box.click()
        wait_until(lambda: len(viewer.presses()) == number, "it is pressed")
        viewer.answer(is_done=is_done, text="It was pressed 3 s ago.")

    press(1, is_done=True)
    expect(box).to_be_checked()
    press(2, is_done=False)
    expect(page.get_by_text("It was pressed 3 s ago.")).to_be_visible()
    expect(box).to_be_checked()  # as the viewer has it


def test_a_press_holds_against_what_was_said_before_it_was_heard(
    page: Page, viewer: Viewer
) -> None:
    controls = Controls()
    check = controls.add_check("Particles", False)
    viewer.greet()
    viewer.tell_controls(controls)
    box = page.get_by_label("Particles")
    box.click()
    wait_until(viewer.presses, "it is pressed")
    check.label = "Particles · now"
    viewer.lines[-1].send(Told(controls=controls.take_changes()))
    expect(page.get_by_text("Particles · now")).to_be_visible()
    expect(box).to_be_checked()
    viewer.answer(is_done=True)
    check.handle(True)
    check.label = "Particles"
    viewer.lines[-1].send(Told(controls=controls.take_changes()))
    expect(page.get_by_text("Particles", exact=True)).to_be_visible()
    expect(box).to_be_checked()
    check.value = False  # somebody else
    viewer.lines[-1].send(Told(controls=controls.take_changes()))
    expect(box).not_to_be_checked()


def test_what_is_written_anew_keeps_the_focus_and_what_was_opened(
    page: Page, viewer: Viewer
) -> None:
    def trip(name: str) -> str:
        return details(StatusLine(name, "good"), lead(name, "Look at it"))

    controls = Controls()
    listed = controls.add_html(trip("one"))
    viewer.greet()
    viewer.tell_controls(controls)
    page.get_by_text("one").click()
    page.get_by_role("button", name="Look at it").focus()
    listed.content = trip("two") + trip("one")
    viewer.lines[-1].send(Told(controls=controls.take_changes()))
    expect(page.get_by_text("two")).to_be_visible()
    look = page.get_by_role("button", name="Look at it")
    expect(look).to_have_count(1)  # that of the trip that was opened
    expect(look).to_be_focused()
    expect(look).to_have_attribute("data-press", "one")


def test_a_second_press_counts_for_nothing_where_another_button_has_come_under_it(
    page: Page, viewer: Viewer
) -> None:
    """Hands that shake press twice."""
    controls = Controls()
    pause, go_on = controls.add_button("Pause"), controls.add_button("Continue", visible=False)
    other = controls.add_button("Other")
    viewer.greet()
    viewer.tell_controls(controls)
    spot = middle(page.get_by_role("button", name="Pause"))

    def press(at_s: float) -> None:
        """Press when the page's clock says so: the presses follow each other as a person's."""
        page.evaluate(f"performance.now = () => {1000 * at_s}")
        page.mouse.click(*spot)

    press(100.0)
    press(100.3)
    wait_until(lambda: viewer.pressed() == [pause.id] * 2, "the same button counts again")
    pause.visible, go_on.visible = False, True
    viewer.lines[-1].send(Told(controls=controls.take_changes()))
    expect(page.get_by_role("button", name="Continue")).to_be_visible()
    press(100.6)
    press(100.65)  # a third time
    page.get_by_role("button", name="Other").click()
    press(100.7)
    wait_until(lambda: go_on.id in viewer.pressed(), "what was seen for a while is pressed")
    assert viewer.pressed() == [pause.id, pause.id, other.id, go_on.id]


def test_a_second_tap_on_the_map_presses_no_button_of_the_card_that_has_come_there(
    page: Page, viewer: Viewer
) -> None:
    """On a phone a card covers the lower part of the map."""
    controls = Controls()
    card = controls.add_card(of_spot=True)
    with card:
        go, save = controls.add_button("Go"), controls.add_button("Save place")
    viewer.greet()
    viewer.tell_controls(controls)
    page.frame_locator("#scene").locator("canvas[data-engine]").wait_for()
    viewer.tell_state(has_scene=True)
    expect(page.locator("#scene-wait")).to_be_hidden()
    page.set_viewport_size({"width": 390, "height": 844})
    page.locator("#handle").press("ArrowDown")
    card.visible = True
    viewer.lines[-1].send(Told(controls=controls.take_changes()))
    spot = middle(page.get_by_role("button", name="Go"))
    card.visible = False
    viewer.lines[-1].send(Told(controls=controls.take_changes()))
    expect(page.get_by_role("button", name="Go")).to_be_hidden()
    page.evaluate("performance.now = () => 100000")
    page.mouse.click(*spot)
    wait_until(lambda: any(said.gesture for _, said in viewer.said), "the map is tapped")
    card.visible = True
    viewer.lines[-1].send(Told(controls=controls.take_changes()))
    expect(page.get_by_role("button", name="Go")).to_be_visible()
    page.evaluate("performance.now = () => 100300")
    page.mouse.click(*spot)
    page.get_by_role("button", name="Save place").press("Enter")
    page.evaluate("performance.now = () => 100500")
    page.mouse.click(*spot)
    wait_until(lambda: go.id in viewer.pressed(), "what was seen for a while is pressed")
    assert viewer.pressed() == [save.id, go.id]


def test_stop_counts_from_when_it_is_touched_whatever_the_finger_does_then(
    page: Page, viewer: Viewer
) -> None:
    """Of a finger that slides, or that comes beside another, no browser makes a click."""
    viewer.greet()
    viewer.tell()
    tell_pad(viewer, is_mine=False)
    expect(page.locator("body")).to_have_attribute("data-line", "open")
    page.locator(".hand-open").click()
    fingers = page.context.new_cdp_session(page)

    def touch(kind: str, *at: tuple[float, float]) -> None:
        points = [{"x": x, "y": y, "id": i} for i, (x, y) in enumerate(at)]
        fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    thumb, stop = middle(page.locator(".hand-pad")), middle(page.locator("#stop"))
    touch("touchStart", stop)
    touch("touchMove", (stop[0] + 40.0, stop[1] + 5.0))
    touch("touchEnd")
    wait_until(lambda: num_stops(viewer) == 1, "it stops under a finger that slides")
    touch("touchStart", thumb)
    touch("touchStart", thumb, stop)
    touch("touchEnd", thumb)
    wait_until(lambda: num_stops(viewer) == 2, "it stops while the other hand drives")
    touch("touchEnd")
    page.locator("#stop").press("Enter")
    wait_until(lambda: num_stops(viewer) == 3, "it stops by a key, which points at nothing")


def test_stop_counts_beside_a_mouse_button_that_is_held(page: Page, viewer: Viewer) -> None:
    """A second button that comes down is no pointer that comes down."""
    viewer.greet()
    viewer.tell()
    expect(page.locator("body")).to_have_attribute("data-line", "open")
    page.locator("#stop").click()
    page.mouse.move(*middle(page.locator("#title")))
    page.mouse.down(button="right")
    page.mouse.move(*middle(page.locator("#stop")))
    page.mouse.down()
    page.mouse.up()
    wait_until(lambda: num_stops(viewer) == 2, "it stops")
