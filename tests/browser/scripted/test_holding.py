"""The joystick by keys, and what it shows of who drives."""

import re

import pytest
from playwright.sync_api import Page, expect
from support.waiting import wait_until

from trolley_viz.joystick.joystick import Grip
from trolley_viz.joystick.teleop import PadState
from trolley_viz.server.messages import PROTOCOL, Hello, Told
from trolley_viz.server.web_server import BUILD

from .viewer import NOW_MS, Viewer

pytestmark = pytest.mark.browser


def tell_pad(viewer: Viewer, *, is_mine: bool) -> None:
    pad = PadState(can=True, mine=is_mine, max_speed=0.5, text="", tone="idle")
    viewer.lines[-1].send(Told(pad=pad))


def hold_arrow_up(page: Page, viewer: Viewer) -> None:
    """Open the joystick and hold a key, as nobody drives."""
    viewer.greet()
    viewer.tell()
    tell_pad(viewer, is_mine=False)
    expect(page.locator(".hand-card")).not_to_have_class(re.compile("hand-off"))
    page.keyboard.press("j")
    expect(page.locator(".hand-pad")).to_be_focused()
    page.keyboard.down("ArrowUp")
    wait_until(lambda: grips(viewer) and grips(viewer)[-1].held, "it is held")


def grips(viewer: Viewer) -> list[Grip]:
    return [said.grip for _, said in viewer.said if said.grip is not None]


def test_an_arrow_key_whose_release_the_system_swallows_does_not_drive_on(
    page: Page, viewer: Viewer
) -> None:
    """A Mac does not tell of a key that comes up while Command is held."""
    hold_arrow_up(page, viewer)
    page.keyboard.down("Meta")
    page.keyboard.up("Meta")
    wait_until(lambda: not grips(viewer)[-1].held, "it counts as let go")
    num_said = len(grips(viewer))
    page.keyboard.up("ArrowUp")
    page.keyboard.down("Meta")
    page.keyboard.down("ArrowUp")
    page.keyboard.up("Meta")
    page.wait_for_timeout(500)
    assert not any(grip.held for grip in grips(viewer)[num_said:])


def test_any_other_key_lets_go_of_an_arrow_key(page: Page, viewer: Viewer) -> None:
    """Firefox tells no page of keys that come up while its menu bar is open, after Alt or F10."""
    hold_arrow_up(page, viewer)
    for key in ("Alt", "F10"):
        page.keyboard.press(key)
        wait_until(lambda: not grips(viewer)[-1].held, "it counts as let go")
        page.keyboard.up("ArrowUp")
        page.keyboard.down("ArrowUp")
        wait_until(lambda: grips(viewer)[-1].held, "it is held anew")


def test_the_pad_is_green_only_while_the_viewer_says_that_it_drives(
    page: Page, viewer: Viewer
) -> None:
    card = page.locator(".hand-card")
    hold_arrow_up(page, viewer)
    expect(card).not_to_have_class(re.compile("hand-held"))
    tell_pad(viewer, is_mine=True)
    expect(card).to_have_class(re.compile("hand-held"))
    tell_pad(viewer, is_mine=False)  # as where somebody was faster
    expect(card).not_to_have_class(re.compile("hand-held"))


def test_who_may_only_look_opens_no_joystick_by_its_key(page: Page, viewer: Viewer) -> None:
    hello = Hello(protocol=PROTOCOL, build=BUILD, may_drive=False)
    viewer.lines[-1].send(Told(hello=hello, beat_ms=NOW_MS))
    viewer.tell_state(is_stopped=True)
    line = page.locator("#stop-line")
    expect(line).to_be_visible()
    before = line.bounding_box()
    page.keyboard.press("j")
    expect(page.locator(".hand-card")).to_be_hidden()
    assert line.bounding_box() == before
