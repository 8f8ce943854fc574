"""A page whose viewer comes back as another: what it shows is old until it was told anew."""

import socket
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field

import pytest
from playwright.sync_api import Browser, Page, expect
from support.waiting import wait_until

from trolley.config import VizConfig
from trolley_viz.controls.controls import Controls
from trolley_viz.sentences import StatusLine
from trolley_viz.server.access import AccessControl, AccessTokens
from trolley_viz.server.lines import Line, Lines
from trolley_viz.server.messages import PROTOCOL, Hello, PageState, Said, Told
from trolley_viz.server.web_server import BUILD, WebServer, close_scene, open_scene

from .conftest import open_page

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module", autouse=True)
def settled() -> None:
    """No robot is here."""


@dataclass
class Viewer:
    """A viewer that tells a page what a test wants."""

    url: str
    lines: list[Line] = field(default_factory=list)
    said: list[tuple[Line, Said]] = field(default_factory=list)

    def greet(self) -> None:
        """Open the newest line, and tell nothing yet."""
        hello = Hello(protocol=PROTOCOL, build=BUILD, may_drive=True)
        self.lines[-1].send(Told(hello=hello, beat_ms=1000.0))

    def tell(self, *names: str) -> list[int]:
        """Tell everything anew, with a button for each name; return their numbers."""
        controls = Controls()
        buttons = [controls.add_button(name) for name in names]
        state = PageState(robot="r", title="r", sentence=StatusLine("Ready.", "good"), lines=[])
        self.lines[-1].send(Told(state=state, controls=controls.take_changes()))
        return [button.id for button in buttons]

    def is_heard(self) -> bool:
        """Whether the page has answered on the newest line."""
        return any(line is self.lines[-1] for line, _ in self.said)

    def pressed(self) -> list[int]:
        return [said.press.control for _, said in self.said if said.press is not None]

    def beat(self, is_over: threading.Event) -> None:
        """Let the page know all the time that it lives."""
        while not is_over.wait(0.3):
            for line in self.lines[-1:]:
                line.send(Told(beat_ms=1000.0))


@pytest.fixture
def viewer() -> Iterator[Viewer]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    viewer = Viewer(f"http://127.0.0.1:{port}/")
    scene = open_scene()
    access = AccessControl(port, (), always_ask=False, tokens=AccessTokens.new())
    lines = Lines(
        lambda call: call(),
        viewer.lines.append,
        lambda line, said: viewer.said.append((line, said)),
        lambda _: None,
    )
    web = WebServer(VizConfig(port=port), access, lines, scene)
    is_over = threading.Event()
    beats = threading.Thread(target=viewer.beat, args=(is_over,))
    beats.start()
    yield viewer
    is_over.set()
    beats.join()
    web.close()
    close_scene(scene)


@pytest.fixture
def page(browser: Browser, viewer: Viewer) -> Iterator[Page]:
    page = open_page(browser, 1000, 600)
    page.goto(viewer.url)
    wait_until(lambda: bool(viewer.lines), "the page calls")
    yield page
    page.context.close()


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
