"""Presses while the viewer changes what is pressed."""

import pytest
from playwright.sync_api import Page, expect

from trolley_viz.controls.controls import Controls
from trolley_viz.controls.markup import lead, note
from trolley_viz.server.messages import Told

from .viewer import Viewer

pytestmark = pytest.mark.browser


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
    pressed = [said.press for _, said in viewer.said if said.press is not None]
    assert [(one.control, one.value) for one in pressed] == [(listed.id, "t1")]
    assert other.id != listed.id
