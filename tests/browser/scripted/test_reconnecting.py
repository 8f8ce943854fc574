"""A page whose viewer comes back as another: what it shows is old until it was told anew."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Browser, Page, expect
from support.waiting import wait_until

from trolley_viz.controls.controls import Controls

from .test_page_itself import num_stops
from .viewer import NOW_MS, Viewer, page_of, scripted_viewer

pytestmark = pytest.mark.browser


def come_back_as_another(page: Page, viewer: Viewer) -> None:
    """Hang up and greet it when it calls again."""
    known = len(viewer.lines)
    viewer.lines[-1].close()
    expect(page.locator("body")).to_have_attribute("data-line", "lost")
    wait_until(lambda: len(viewer.lines) > known, "the page calls again")
    viewer.greet()
    wait_until(viewer.is_heard, "the page has heard the greeting")


def test_what_the_viewer_before_offered_cannot_be_pressed(page: Page, viewer: Viewer) -> None:
    viewer.greet()
    first = viewer.tell("start", "kitchen")
    expect(page.get_by_role("button", name="kitchen")).to_be_enabled()
    expect(page.locator("body")).to_have_attribute("data-line", "open")
    viewer.said.clear()
    come_back_as_another(page, viewer)
    # The same number means another place now.
    page.get_by_role("button", name="start", include_hidden=True).evaluate("it => it.click()")
    second = viewer.tell("kitchen", "start")
    assert first == second
    expect(page.locator("body")).to_have_attribute("data-line", "open")
    page.get_by_role("button", name="start").click()
    wait_until(lambda: bool(viewer.pressed()), "what is pressed arrives")
    assert viewer.pressed() == second[1:]


def test_a_robot_that_was_stopped_meanwhile_may_drive_on(page: Page, viewer: Viewer) -> None:
    """It was told before the page knew that the connection is back; the button stayed grey."""
    viewer.greet()
    viewer.tell_state()
    expect(page.locator("body")).to_have_attribute("data-line", "open")
    expect(page.locator("#resume")).to_be_disabled()
    viewer.said.clear()
    come_back_as_another(page, viewer)
    viewer.tell_state(is_stopped=True)
    expect(page.locator("#stop-line")).to_contain_text("Stopped")
    expect(page.locator("#resume")).to_be_enabled()
    viewer.lines[-1].close()
    expect(page.locator("body")).to_have_attribute("data-line", "lost")
    expect(page.locator("#resume")).to_be_disabled()


def test_a_number_that_means_another_kind_of_control_is_drawn_as_that(
    page: Page, viewer: Viewer
) -> None:
    viewer.greet()
    (number,) = viewer.tell("start")
    expect(page.get_by_role("button", name="start")).to_be_visible()
    expect(page.locator("body")).to_have_attribute("data-line", "open")
    viewer.said.clear()
    come_back_as_another(page, viewer)
    controls = Controls()
    assert controls.add_text("Name", "hall").id == number
    viewer.tell_controls(controls)
    expect(page.get_by_role("textbox", name="Name")).to_have_value("hall")
    expect(page.locator("#controls button")).to_have_count(0)


def test_a_screen_reader_is_not_told_each_second_how_long_nothing_was_heard(
    page: Page, viewer: Viewer
) -> None:
    viewer.greet()
    viewer.tell()
    expect(page.locator("body")).to_have_attribute("data-line", "open")
    said = page.locator("#lost-said")
    viewer.lines[-1].close()
    expect(said).to_contain_text("1 s ago")
    page.evaluate(
        """() => {
          window.told = 0;
          new MutationObserver((changes) => changes.forEach(({ target }) => {
            const it = target instanceof Element ? target : target.parentElement;
            const around = it.closest("[role=alert], [aria-live]");
            if (around.getAttribute("aria-live") !== "off") told += 1;
          })).observe(document.getElementById("lost"),
            { childList: true, characterData: true, subtree: true });
        }"""
    )
    expect(said).to_contain_text("3 s ago")
    assert page.evaluate("told") == 0


def test_stop_does_not_wait_for_what_the_viewer_has_to_tell(page: Page, viewer: Viewer) -> None:
    viewer.greet()
    viewer.tell("start")
    expect(page.locator("body")).to_have_attribute("data-line", "open")
    viewer.said.clear()
    come_back_as_another(page, viewer)
    known = len(viewer.lines)
    page.locator("#stop").click()
    wait_until(lambda: any(said.stop is not None for _, said in viewer.said), "Stop arrives")
    assert len(viewer.lines) == known


def test_a_press_counts_from_when_the_finger_came_down(page: Page, viewer: Viewer) -> None:
    viewer.greet()
    viewer.tell("start")
    start = page.get_by_role("button", name="start")
    expect(start).to_be_visible()
    # As if the page had been busy for three seconds.
    page.evaluate(
        """Object.defineProperty(Event.prototype, "timeStamp",
          { get: () => performance.now() - 3000 })"""
    )
    start.click()
    wait_until(lambda: bool(viewer.pressed()), "the press arrives")
    (press,) = [said.press for _, said in viewer.said if said.press is not None]
    assert press.at_ms < NOW_MS - 2000.0


def test_stop_is_no_reason_to_call_anew_while_the_page_calls(page: Page, viewer: Viewer) -> None:
    """On a slow link whoever pressed it again and again never got through."""
    viewer.greet()
    viewer.tell()
    expect(page.locator("body")).to_have_attribute("data-line", "open")
    known = len(viewer.lines)
    viewer.lines[-1].close()
    wait_until(lambda: len(viewer.lines) > known, "the page calls again")
    page.locator("#stop").evaluate("stop => { for (let i = 0; i < 3; i++) stop.click() }")
    viewer.greet()
    wait_until(viewer.is_heard, "the page has heard the greeting")
    assert len(viewer.lines) == known + 1
    wait_until(lambda: num_stops(viewer) == 3, "all of them arrive")


@contextmanager
def unavailable(url: str) -> Iterator[list[str]]:
    """A viewer that cannot be had, as behind a proxy; yields what it is asked for."""
    asked: list[str] = []

    class Refusal(BaseHTTPRequestHandler):
        """Knows no method, and says so with a 501."""

        def log_request(self, code: int | str = "-", size: int | str = "-") -> None:
            asked.append(f"{self.command} {urlsplit(self.path).path}")

        def log_message(self, format: str, *args: object) -> None:
            """Say nothing."""

    with ThreadingHTTPServer(("127.0.0.1", urlsplit(url).port or 0), Refusal) as server:
        thread = Thread(target=server.serve_forever)
        thread.start()
        yield asked
        server.shutdown()
        thread.join()


def test_a_socket_is_opened_only_once_the_viewer_is_there_again(browser: Browser) -> None:
    """Firefox lets sockets that fail wait, up to a minute, and a press of Stop with them."""
    with ExitStack() as stack:
        with scripted_viewer() as viewer:
            page = stack.enter_context(page_of(browser, viewer))
            viewer.greet()
            viewer.tell()
            expect(page.locator("body")).to_have_attribute("data-line", "open")
        with unavailable(viewer.url) as asked:
            wait_until(lambda: asked.count("HEAD /") > 2, "it is asked whether it is there")
    assert "GET /line" not in asked


def test_photos_that_do_not_come_keep_no_page_from_connecting_again(
    page: Page, viewer: Viewer
) -> None:
    """A browser asks a host for six things at once, sockets aside, and no more until one comes."""
    viewer.greet()
    viewer.tell()
    expect(page.locator("body")).to_have_attribute("data-line", "open")
    viewer.has_photos.clear()
    page.evaluate(
        """() => {
          for (let i = 0; i < 6; i++) new Image().src = `/photo/r/${i}`;
        }"""
    )
    wait_until(lambda: len(viewer.asked) == 6, "they are asked for")
    known = len(viewer.lines)
    viewer.lines[-1].close()
    wait_until(lambda: len(viewer.lines) > known, "the page calls again")
    viewer.has_photos.set()
