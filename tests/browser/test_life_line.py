"""What a page says and does when the viewer hangs, dies, or comes back."""

import contextlib
import os
import re
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from playwright.sync_api import Page, expect
from support.waiting import wait_until

from trolley import topics

from .test_viewer import button, goal_state

if TYPE_CHECKING:
    from .conftest import Shown

pytestmark = pytest.mark.browser

NO_CONNECTION = "NO CONNECTION, NOT STOPPED"
LATE_S = 2.5
"""A press that waited for longer than 2 s is refused."""


@contextmanager
def frozen(shown: "Shown") -> Iterator[None]:
    """Let the viewer hang, as a telephone does that has lost its Wi-Fi."""
    viewer = shown.demo.children()["viz"]
    os.kill(viewer, signal.SIGSTOP)
    try:
        yield
    finally:
        with contextlib.suppress(ProcessLookupError):  # its supervisor may have had enough
            os.kill(viewer, signal.SIGCONT)


def base_mode(shown: "Shown") -> str:
    base = shown.robot.latest(topics.BASE)
    return "" if base is None else base.mode


PRESS_STOP = """() => {
  const text = (id) => document.getElementById(id).checkVisibility()
    ? document.getElementById(id).textContent : "";
  async function press() {
    const wasInert = ["panel", "scene", "over"].every((id) => document.getElementById(id).inert);
    const { disabled } = document.getElementById("resume");
    document.getElementById("stop").click();
    while (!text("stop-line") && document.body.dataset.line === "lost")
      await new Promise((done) => setTimeout(done, 10));
    return { wasInert, disabled, title: text("lost-title"), said: text("lost-said"),
      does: text("lost-does"), stop: text("stop-line") };
  }
  window.pressed = new Promise((done) => {
    const look = () => document.body.dataset.line === "lost" && (watch.disconnect(), done(press()));
    const watch = new MutationObserver(look);
    watch.observe(document.body, { attributes: true });
  });
}"""
"""As soon as the page knows, as its supervisor gives a viewer that hangs a few seconds only."""

NOTE_LOST = """() => {
  const title = document.getElementById("lost-title");
  window.noted = new Promise((done) => {
    const look = () => title.checkVisibility() && (watch.disconnect(), done(title.textContent));
    const watch = new MutationObserver(look);
    watch.observe(document.body, { attributes: true });
  });
}"""
"""In the page itself: on a busy machine the viewer may be back before anybody asks from outside."""


def test_a_viewer_that_hangs_is_said_at_once_and_only_stop_counts(
    page: Page, shown: "Shown", pictures: Path
) -> None:
    expect(button(page, "kitchen")).to_be_visible()
    page.evaluate(PRESS_STOP)
    with frozen(shown):
        # The page does not know yet: this press is under way when the viewer wakes up. On a page
        # that does it is dropped.
        button(page, "kitchen").evaluate("button => button.click()")
        seen = page.evaluate("() => window.pressed")
        page.screenshot(path=pictures / "lost.png")
        time.sleep(LATE_S)
    assert seen["title"] == NO_CONNECTION
    assert re.fullmatch(r"It last said: “.+” \d+ s ago\.", seen["said"])
    assert "STOP will be sent first" in seen["does"]
    assert seen["stop"] == "NOT STOPPED: no connection"
    assert seen["wasInert"]
    assert seen["disabled"]
    wait_until(lambda: base_mode(shown) == "stopped", "the press of Stop arrives")
    expect(page.get_by_text(NO_CONNECTION)).to_be_hidden()
    expect(page.locator("#stop-line")).to_contain_text("Stopped")
    button(page, "Drive on").click()
    wait_until(lambda: base_mode(shown) == "ok", "it may drive again")
    expect(page.locator("#stop-line")).to_be_hidden()
    assert goal_state(shown) not in ("planning", "driving")


def test_a_viewer_that_dies_and_comes_back_finds_the_page_waiting(
    page: Page, shown: "Shown"
) -> None:
    page.evaluate(NOTE_LOST)
    shown.demo.kill_service("viz")
    assert page.evaluate("() => window.noted") == NO_CONNECTION
    expect(page.get_by_text(NO_CONNECTION)).to_be_hidden()
    expect(page.get_by_text("Localized").first).to_be_visible()
    button(page, "start").click()
    expect(page.locator("#sentence")).to_have_text("It has arrived at start.")
