"""Cards over the map on a phone: seen whole, and without covering the buttons over the map."""

import pytest
from playwright.sync_api import FloatRect, Locator, Page, ViewportSize, expect

from browser.seeing import poll
from trolley_viz.controls.controls import Controls
from trolley_viz.features.people.links import TO_DRIVE, TO_LOOK, LinkCard
from trolley_viz.robots.stop_presses import StopLine
from trolley_viz.server.links import Links
from trolley_viz.words.sentences import StatusLine

from .viewer import Viewer

pytestmark = pytest.mark.browser

PHONE: ViewportSize = {"width": 390, "height": 844}
LINK = f"http://raspberrypi.fritz.box:8080/?token={'x' * 22}"


def box_of(seen: Locator) -> FloatRect:
    box = seen.bounding_box()
    assert box is not None
    return box


@pytest.mark.parametrize("what", [TO_DRIVE, TO_LOOK])
def test_the_code_of_a_link_is_seen_whole_without_scrolling(
    page: Page, viewer: Viewer, what: str
) -> None:
    page.set_viewport_size(PHONE)
    controls = Controls()
    card = LinkCard(controls, Links(LINK, LINK, is_reachable=True))
    card.show(what)
    viewer.greet()
    viewer.tell_controls(controls)
    code = page.get_by_role("img", name="QR code of the link")
    expect(code).to_be_in_viewport(ratio=1.0)
    assert box_of(code)["width"] >= 200.0  # a camera reads it from an arm's length
    for name in ("STOP", "Close"):
        expect(page.get_by_role("button", name=name)).to_be_in_viewport(ratio=1.0)


def test_a_card_leaves_the_buttons_over_the_map_free(page: Page, viewer: Viewer) -> None:
    page.set_viewport_size(PHONE)
    page.emulate_media(reduced_motion="reduce")  # the sheet is at once as high as it is to be
    controls = Controls()
    with controls.add_bar():
        controls.add_button("Show the whole map", icon="maximize")
    card = controls.add_card()
    with card:
        for i in range(7):
            controls.add_button(f"button {i}")
    viewer.greet()
    viewer.tell_controls(controls)
    bar = page.get_by_role("toolbar")
    before = box_of(bar)
    card.visible = True
    region = page.locator("section.card")
    for handle_key in (None, "ArrowDown"):  # the sheet as it is, and down
        if handle_key is not None:
            page.locator("#handle").press(handle_key)
        viewer.tell_controls(controls)
        expect(region).to_be_visible()
        poll(
            page,
            lambda: box_of(bar)["y"] + box_of(bar)["height"] <= box_of(region)["y"],
            "they are free",
        )
        expect(bar).to_be_in_viewport(ratio=1.0)
    page.locator("#handle").press("ArrowUp")
    card.visible = False
    viewer.tell_controls(controls)
    expect(region).to_be_hidden()
    poll(page, lambda: box_of(bar) == before, "they are where they were")


def test_the_last_control_can_be_pressed_while_the_strip_of_the_past_is_open(
    page: Page, viewer: Viewer
) -> None:
    page.set_viewport_size(PHONE)
    controls = Controls()
    strip = controls.add_strip()
    with strip:
        controls.add_timeline("Time of day")
        controls.add_button("Now", colour="green")
        controls.add_html("The last 10 minutes. Past trips are in the “Tours” tab.")
    for i in range(30):
        controls.add_button(f"button {i}")
    strip.visible = True
    viewer.greet()
    viewer.tell_controls(controls)
    expect(page.get_by_role("button", name="Now")).to_be_visible()
    last = page.get_by_role("button", name="button 29")
    page.locator("#panel").evaluate("it => it.scrollTop = it.scrollHeight")
    below, top = box_of(last), box_of(page.locator(".strip"))["y"]
    assert below["y"] + below["height"] <= top


@pytest.mark.parametrize(("width", "num_rows"), [(844, 1), (740, 2)])
def test_on_a_phone_on_its_side_what_closes_the_past_is_beside_what_returns_to_now(
    page: Page, viewer: Viewer, width: int, num_rows: int
) -> None:
    page.set_viewport_size({"width": width, "height": 390})
    controls = Controls()
    strip = controls.add_strip()
    with strip:
        controls.add_timeline("Time of day")
        for name in ("Play", "Play 8 times as fast"):
            controls.add_button(name, icon="player-play")
        controls.add_button("Now", colour="green")
        controls.add_button("Close the past", icon="x")
    strip.visible = True
    viewer.greet()
    viewer.tell_controls(controls)
    expect(page.get_by_role("button", name="Now")).to_be_visible()
    rows = page.locator(".strip > .control").evaluate_all(
        "all => all.map(one => one.getBoundingClientRect().top)"
    )
    assert len(set(rows)) == num_rows
    assert rows[-1] == rows[-2]
    assert box_of(page.get_by_role("slider"))["width"] > 100.0


def test_the_sheet_is_opened_and_closed_by_who_has_no_finger_on_it(
    page: Page, viewer: Viewer
) -> None:
    """A screen reader, or a voice, presses without a pointer."""
    page.set_viewport_size(PHONE)
    viewer.greet()
    viewer.tell("start")
    panel, handle = page.locator("#panel"), page.locator("#handle")
    expect(panel).to_have_attribute("data-step", "1")
    for step in ("0", "1"):
        handle.evaluate("it => it.click()")
        expect(panel).to_have_attribute("data-step", step)
        expect(handle).to_have_attribute("aria-expanded", "true" if step == "1" else "false")
    handle.click()  # once, though a finger both presses and clicks
    expect(panel).to_have_attribute("data-step", "0")


@pytest.mark.parametrize("stop", [None, StopLine("NOT STOPPED: no connection", is_alarm=True)])
def test_stop_and_the_sentence_are_in_sight_however_high_the_controls_are(
    page: Page, viewer: Viewer, stop: StopLine | None
) -> None:
    controls = Controls()
    for i in range(30):
        controls.add_button(f"button {i}")
    viewer.greet()
    viewer.tell_controls(controls)
    sentence = StatusLine(
        "It waits because something stands in its way, and goes on by itself.", "warn"
    )
    viewer.tell_state(sentence=sentence, stop=stop)
    last = page.get_by_role("button", name="button 29")
    page.emulate_media(reduced_motion="reduce")  # the sheet is at once as high as it is to be
    unseen: list[tuple[int, int]] = []
    for height in (568, 667, 844):
        page.set_viewport_size({"width": 375, "height": height})
        for step in (1, 2):
            if step == 2:
                page.locator("#handle").press("ArrowUp")
            expect(page.locator("#panel")).to_have_attribute("data-step", str(step))
            last.focus()
            expect(last).to_be_in_viewport(ratio=1.0)
            seen = ("#sentence", "#stop", "#resume")
            tops = [box_of(page.locator(name)) for name in seen]
            if not all(0.0 <= box["y"] <= height - box["height"] for box in tops):
                unseen.append((height, step))
        page.locator("#handle").press("ArrowDown")
    assert unseen == []
