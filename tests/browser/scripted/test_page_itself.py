"""The page with a viewer that only plays its part: long names, letter keys, another release."""

from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect
from support.waiting import wait_until

from browser.conftest import ARGUMENTS, CHROMIUM
from browser.seeing import canvas, scene
from trolley_viz.controls.controls import Controls
from trolley_viz.controls.markup import heading
from trolley_viz.robots.stop_presses import StopLine

from .viewer import Viewer

pytestmark = pytest.mark.browser

LONG = "Raum mit sehr langem Namen " * 2 + "am Ende"


def test_a_long_name_makes_no_tall_button(page: Page, viewer: Viewer) -> None:
    names, controls = (LONG, "x" * 64), Controls()
    with controls.add_tiles():
        for name in names:
            controls.add_button(name, is_name=True)
    viewer.greet()
    viewer.tell_controls(controls)
    for name in names:
        button = page.get_by_role("button", name=name)
        expect(button).to_have_attribute("title", name)
        box = button.bounding_box()
        assert box is not None
        assert box["height"] <= 80.0


def test_without_letter_keys_only_space_stops(page: Page, viewer: Viewer) -> None:
    controls = Controls()
    controls.add_command("Go to …", "g", lambda: None)
    viewer.greet()
    viewer.tell_controls(controls)
    viewer.tell_state(has_letters=False, hint="a hint")
    expect(page.locator("#hint")).to_be_visible()
    for key in ("g", "j", "Shift+S", "Space"):
        page.keyboard.press(key)
    wait_until(lambda: any(said.stop is not None for _, said in viewer.said), "it stops")
    assert viewer.pressed() == []
    assert sum(said.stop is not None for _, said in viewer.said) == 1
    expect(page.get_by_role("button", name="Close the joystick")).to_be_hidden()


def num_stops(viewer: Viewer) -> int:
    return sum(said.stop is not None for _, said in viewer.said)


def test_stop_is_pressed_while_the_list_of_all_commands_is_open(page: Page, viewer: Viewer) -> None:
    controls = Controls()
    for i in range(30):
        controls.add_command(f"command {i}", f"f{i}", lambda: None)
    viewer.greet()
    viewer.tell_controls(controls)
    expect(page.locator("body")).to_have_attribute("data-line", "open")
    palette, stop = page.locator("#palette"), page.locator("#stop")
    page.keyboard.press("Control+k")
    expect(palette.get_by_role("button")).to_have_count(31)
    bottom = palette.evaluate("it => it.getBoundingClientRect().bottom")
    assert bottom < stop.evaluate("it => it.getBoundingClientRect().top")
    assert palette.evaluate("it => getComputedStyle(it).overflowY") == "auto"
    stop.click()
    wait_until(lambda: num_stops(viewer) == 1, "Stop is heard")
    expect(palette).to_be_hidden()
    page.keyboard.press("Control+k")
    expect(page.get_by_label("Find a command")).to_be_focused()
    palette.get_by_role("button").first.focus()
    page.keyboard.press("Space")
    wait_until(lambda: num_stops(viewer) == 2, "Space is Stop, there as well")
    page.keyboard.press("Escape")
    expect(palette).to_be_hidden()


def test_space_stops_while_a_slider_has_the_focus(page: Page, viewer: Viewer) -> None:
    viewer.greet()
    viewer.tell()
    expect(page.locator("body")).to_have_attribute("data-line", "open")
    page.locator(".hand-open").click()
    speed = page.get_by_role("slider", name="Speed")
    speed.press("ArrowLeft")
    expect(speed).to_have_value("0.2")
    speed.press("Space")
    wait_until(lambda: num_stops(viewer) == 1, "Stop is heard")


def test_arrow_keys_point_only_while_something_is_to_be_pointed_out(
    page: Page, viewer: Viewer
) -> None:
    controls = Controls()
    up, turn, take, done = (
        controls.add_command(key, key, lambda: None).id for key in ("↑", "⇧←", "⏎", "enter")
    )
    keys = ("ArrowUp", "Shift+ArrowLeft", "Enter")
    viewer.greet()
    viewer.tell_controls(controls)
    expect(page.locator("#sentence")).to_have_text("Ready.")
    expect(page.locator("body")).to_have_attribute("data-line", "open")
    for key in keys:
        page.keyboard.press(key)
    wait_until(lambda: viewer.pressed() == [done], "Enter is what it was")
    for has_cursor, number in ((False, done), (True, take)):
        viewer.said.clear()
        viewer.tell_state(is_pointing=True, has_cursor=has_cursor, hint=f"{has_cursor}")
        expect(page.locator("#hint")).to_have_text(f"{has_cursor}")
        for key in keys:
            page.keyboard.press(key)
        wait_until(lambda: len(viewer.pressed()) == 3, "the keys are heard")
        assert viewer.pressed() == [up, turn, number]


def test_enter_presses_the_button_that_has_the_focus_though_a_point_is_set(
    page: Page, viewer: Viewer
) -> None:
    """Who goes from the point to the button that cancels does not want to set off."""
    controls = Controls()
    right, take = (controls.add_command(key, key, lambda: None).id for key in ("→", "⏎"))
    cancel = controls.add_button("Press again to cancel").id
    tabs = controls.add_tabs()
    for name in ("Go", "Map"):
        tabs.add_tab(name, "map")
    viewer.greet()
    viewer.tell_controls(controls)
    viewer.tell_state(is_pointing=True, has_cursor=True, hint="0.1 m")
    expect(page.locator("#hint")).to_be_visible()
    page.keyboard.press("ArrowRight")
    button, tab = page.get_by_role("button", name="cancel"), page.get_by_role("tab", name="Go")
    button.press("Enter")
    tab.press("ArrowRight")  # to the next tab
    button.press("ArrowRight")
    button.press("Enter")
    wait_until(lambda: take in viewer.pressed(), "the point is taken where it was moved last")
    assert viewer.pressed() == [right, cancel, tabs.id, right, take]


def test_a_page_of_another_release_loads_itself_anew_once_and_then_says_so(
    page: Page, viewer: Viewer
) -> None:
    for _ in range(2):
        known = len(viewer.lines)
        viewer.greet("another")
        if known == 1:
            wait_until(lambda: len(viewer.lines) > 1, "the page is loaded anew")
    expect(page.get_by_text("This page is out of date")).to_be_visible()
    assert len(viewer.lines) == 2


def test_what_ends_an_edit_is_always_in_view(page: Page, viewer: Viewer) -> None:
    controls = Controls()
    with controls.add_tabs().add_tab("Map", "map"), controls.add_folder():
        for i in range(30):
            controls.add_text(f"field {i}", "")
        with controls.add_actions():
            controls.add_button("Save")
            controls.add_button("Cancel")
    viewer.greet()
    viewer.tell_controls(controls)
    save = page.get_by_role("button", name="Save")
    expect(save).to_be_in_viewport(ratio=1.0)
    page.get_by_label("field 29").scroll_into_view_if_needed()
    expect(save).to_be_in_viewport(ratio=1.0)
    for i in range(30):  # nor does it cover what has the focus
        page.get_by_label(f"field {i}", exact=True).focus()
        field, row = page.locator(":focus").bounding_box(), save.bounding_box()
        assert field is not None
        assert row is not None
        assert field["y"] + field["height"] <= row["y"]
    tabs = page.get_by_role("tablist").bounding_box()
    assert tabs is not None
    for i in reversed(range(30)):  # nor do the tabs, for who goes back
        page.get_by_label(f"field {i}", exact=True).focus()
        field = page.locator(":focus").bounding_box()
        assert field is not None
        assert field["y"] >= tabs["y"] + tabs["height"]


def test_buttons_icons_and_the_open_tab_are_seen_in_the_colours_of_the_system(
    page: Page, viewer: Viewer
) -> None:
    """As Windows has them for people who see little contrast."""
    controls = Controls()
    tabs = controls.add_tabs()
    with tabs.add_tab("Go", "map"):
        controls.add_button("kitchen", icon="map-pin")
    tabs.add_tab("Map", "map")
    viewer.greet()
    viewer.tell_controls(controls)
    expect(page.get_by_role("button", name="kitchen")).to_be_visible()
    page.emulate_media(forced_colors="active")

    def style(selector: str, name: str) -> str:
        return page.locator(selector).evaluate("(it, name) => getComputedStyle(it)[name]", name)

    button, colour = ".control.button", "backgroundColor"
    assert style(f"{button} > .icon", colour) != style(button, colour)
    assert style(button, "borderTopWidth") == style("#stop", "borderTopWidth") == "1px"
    assert style("#stop", colour) == "rgb(210, 31, 31)"
    opened, other = (f"[role=tab][aria-selected={is_open}]" for is_open in ("true", "false"))
    assert style(opened, colour) not in (style(other, colour), style(opened, "color"))


def test_on_an_enlarged_page_what_stop_did_is_seen_and_the_joystick_is_put_away(
    page: Page, viewer: Viewer
) -> None:
    page.set_viewport_size({"width": 320, "height": 256})  # 1280 by 1024 pixels at 400 %
    viewer.greet()
    viewer.tell_state(is_stopped=True, stopped_by="Stopped from this computer")
    seen = [page.locator(one) for one in ("#stop", "#resume", "#stop-line")]
    page.locator(".hand-open").press("Enter")
    for one in (*seen, page.locator(".hand-close")):
        expect(one).to_be_in_viewport(ratio=1.0)
    width = seen[2].evaluate("it => it.clientWidth")
    assert width > 250


def test_a_screen_reader_finds_headings_and_hears_of_no_valid_number_that_it_is_invalid(
    page: Page, viewer: Viewer
) -> None:
    controls = Controls()
    controls.add_html(heading("Go to"))
    controls.add_number("x (m)", 0.549, step=0.01)
    controls.add_slider("Brush (m)", 0.1, min=0.0, max=1.0, step=0.1)
    viewer.greet()
    viewer.tell_controls(controls)
    expect(page.get_by_role("heading", name="Go to")).to_be_visible()
    reader = page.context.new_cdp_session(page)
    heard: dict[tuple[str, str], dict[str, object]] = {}
    for node in reader.send("Accessibility.getFullAXTree")["nodes"]:
        role, name = (node.get(one, {}).get("value", "") for one in ("role", "name"))
        properties = {one["name"]: one["value"].get("value") for one in node.get("properties", ())}
        if not node["ignored"]:
            heard[role, name] = properties
    assert heard["spinbutton", "x (m)"]["invalid"] == "false"
    assert ("slider", "Brush (m)") in heard
    outputs = page.locator("#controls output").all()
    assert [one.get_attribute("aria-live") for one in outputs] == ["off"]


def test_texts_are_as_large_as_the_browser_is_set_to(
    browser: Browser, viewer: Viewer, tmp_path: Path
) -> None:
    (tmp_path / "Default").mkdir()
    preferences = '{"webkit": {"webprefs": {"default_font_size": 24}}}'
    (tmp_path / "Default" / "Preferences").write_text(preferences, encoding="utf-8")
    context = browser.browser_type.launch_persistent_context(
        tmp_path, executable_path=CHROMIUM, args=ARGUMENTS, viewport={"width": 900, "height": 700}
    )
    page = context.new_page()
    page.goto(viewer.url, wait_until="domcontentloaded")
    size = "(it) => parseFloat(getComputedStyle(it).fontSize)"
    assert page.locator("body").evaluate(size) == 24.0
    for name in ("sentence", "stop", "resume"):
        assert page.locator(f"#{name}").evaluate(size) >= 24.0
    context.close()


def test_nothing_flashes_or_slides_for_who_asks_for_less_motion(page: Page, viewer: Viewer) -> None:
    viewer.greet()
    viewer.tell_state(stop=StopLine("NOT STOPPED: no connection", is_alarm=True))
    expect(page.locator("#stop-line")).to_be_visible()
    running = "() => document.getAnimations().filter((one) => one.playState === 'running').length"
    assert page.evaluate(running) > 0
    page.emulate_media(reduced_motion="reduce")
    assert page.evaluate(running) == 0


def sizes(viewer: Viewer) -> list[tuple[float, float]]:
    """What the page has told of the size of its picture."""
    told = (said.gesture for _, said in viewer.said if said.gesture is not None)
    return [gesture.size for gesture in told if gesture.size is not None]


def test_the_viewer_hears_of_a_size_that_the_picture_takes_late_or_while_the_line_is_lost(
    page: Page, viewer: Viewer
) -> None:
    """Where something is touched would else be taken for elsewhere."""
    viewer.greet()
    viewer.tell()
    page.frame_locator("#scene").locator("canvas[data-engine]").wait_for()
    add_secret = "document.body.innerHTML += '<i id=trolley-scene data-secret=x></i>'"
    scene(page).evaluate(add_secret)
    wait_until(lambda: len(sizes(viewer)) > 0, "the page has a picture")
    viewer.tell_state(has_scene=True)
    resize = "(one, height) => { one.style.height = `${height}px` }"
    canvas(page).evaluate(resize, 123)
    wait_until(lambda: sizes(viewer)[-1][1] == 123.0, "the new size is told")
    known = len(viewer.lines)
    viewer.lines[-1].close()
    canvas(page).evaluate(resize, 99)
    wait_until(lambda: len(viewer.lines) > known, "the page calls again")
    viewer.greet()
    viewer.tell_state(has_scene=True)
    wait_until(lambda: sizes(viewer)[-1][1] == 99.0, "it is told again")


HASTEN = "{ const now = performance.now.bind(performance); performance.now = () => 20 * now() }"
"""Lets the time of the page pass 20 times as fast."""


def test_a_browser_that_cannot_draw_is_asked_again_but_loads_no_scene_for_ever(
    page: Page, viewer: Viewer
) -> None:
    viewer.greet()
    viewer.tell()
    page.frame_locator("#scene").locator("canvas[data-engine]").wait_for()
    scene(page).wait_for_load_state()
    page.evaluate("""() => {
      window.asked = window.loads = 0;
      HTMLCanvasElement.prototype.getContext = () => { asked += 1; return null };
      document.getElementById("scene").addEventListener("load", () => { loads += 1 });
    }""")
    page.evaluate(HASTEN)  # last: what draws is asked for at once then
    wait_until(lambda: page.evaluate("asked") > 1, "it was asked again")
    assert page.evaluate("loads") == 0
    expect(page.get_by_text("it has no WebGL")).to_be_visible()
    # Once there is a picture, the next wait is for another reason.
    viewer.tell_state(has_scene=True)
    loading = page.locator("#scene-wait [data-why=loading]")
    expect(loading).to_have_js_property("hidden", False)
    viewer.tell_state(has_scene=False)
    expect(page.locator("#scene-wait")).to_have_text("The map is loading …", use_inner_text=True)


def test_a_scene_whose_picture_is_lost_each_time_is_loaded_once_a_minute(
    page: Page, viewer: Viewer
) -> None:
    """A phone that is short of memory would be kept busy with nothing else."""
    viewer.greet()
    viewer.tell()
    page.frame_locator("#scene").locator("canvas[data-engine]").wait_for()
    viewer.tell_state(has_scene=True)
    expect(page.locator("#scene-wait")).to_be_hidden()
    page.evaluate(HASTEN)
    page.evaluate("""() => {
      window.loads = [];
      new MutationObserver(() => loads.push(performance.now()))
        .observe(document.getElementById("scene"), { attributeFilter: ["src"] });
    }""")
    lose = "WebGL2RenderingContext.prototype.isContextLost = () => true"
    page.add_init_script(lose)
    scene(page).evaluate(lose)
    wait_until(lambda: page.evaluate("loads.length") > 1, "it is loaded again")
    assert page.evaluate("loads[1] - loads[0]") > 59_000
