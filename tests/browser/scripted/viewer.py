"""A viewer that tells a page what a test wants, without a robot."""

import asyncio
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from msgspec import structs
from playwright.sync_api import Browser, Page
from support.processes import find_free_port
from support.waiting import wait_until

from browser.conftest import open_page
from trolley.config import VizConfig
from trolley_viz.controls.controls import Controls
from trolley_viz.server.access import AccessControl, AccessTokens
from trolley_viz.server.lines import Line, Lines
from trolley_viz.server.messages import PROTOCOL, Answer, Hello, PageState, Press, Said, Told
from trolley_viz.server.web_server import BUILD, WebServer, close_scene, open_scene
from trolley_viz.words.sentences import StatusLine

NOW_MS = 1e6
"""The viewer's time, which stands still."""
READY = PageState(robot="r", title="r", sentence=StatusLine("Ready.", "good"), lines=[])
"""What it says of its robot."""


@dataclass
class Viewer:
    """A viewer that tells a page what a test wants.

    Attributes:
        photos: those of robot `r`, by name.
        asked: names of photos that a page has asked for.
        has_photos: set while it can give any; until then pages wait for them.
    """

    url: str
    photos: dict[str, bytes] = field(default_factory=dict[str, bytes])
    asked: list[str] = field(default_factory=list[str])
    has_photos: threading.Event = field(default_factory=threading.Event)
    lines: list[Line] = field(default_factory=list)
    said: list[tuple[Line, Said]] = field(default_factory=list)

    def greet(self, build: str = BUILD) -> None:
        """Open the newest line, and tell nothing yet."""
        hello = Hello(protocol=PROTOCOL, build=build, may_drive=True)
        self.lines[-1].send(Told(hello=hello, beat_ms=NOW_MS))

    def tell(self, *names: str) -> list[int]:
        """Tell everything anew, with a button for each name; return their numbers."""
        controls = Controls()
        buttons = [controls.add_button(name) for name in names]
        self.tell_controls(controls)
        return [button.id for button in buttons]

    def tell_controls(self, controls: Controls) -> None:
        """Tell everything anew."""
        self.lines[-1].send(Told(state=READY, controls=controls.take_changes()))

    def tell_state(self, **fields: Any) -> None:
        """Tell another state."""
        self.lines[-1].send(Told(state=structs.replace(READY, **fields)))

    async def photo(self, robot: str, name: str) -> bytes | None:
        """A photo, as the robot would give it."""
        self.asked.append(name)
        while not self.has_photos.is_set():
            await asyncio.sleep(0.01)
        return self.photos.get(name) if robot == READY.robot else None

    def is_heard(self) -> bool:
        """Whether the page has answered on the newest line."""
        return any(line is self.lines[-1] for line, _ in self.said)

    def presses(self) -> list[Press]:
        return [said.press for _, said in self.said if said.press is not None]

    def pressed(self) -> list[int]:
        return [press.control for press in self.presses()]

    def answer(self, *, is_done: bool, text: str = "") -> None:
        """Answer the newest press."""
        answer = Answer(id=self.presses()[-1].id, is_done=is_done, text=text)
        self.lines[-1].send(Told(answer=answer))

    def beat(self, is_over: threading.Event) -> None:
        """Let the page know all the time that it lives."""
        while not is_over.wait(0.3):
            for line in self.lines[-1:]:
                line.send(Told(beat_ms=NOW_MS))


@contextmanager
def scripted_viewer() -> Iterator[Viewer]:
    """A viewer without a robot."""
    port = find_free_port()
    viewer = Viewer(f"http://127.0.0.1:{port}/")
    viewer.has_photos.set()
    scene = open_scene()
    access = AccessControl(port, (), always_ask=False, tokens=AccessTokens.new())
    lines = Lines(
        lambda call: call(),
        viewer.lines.append,
        lambda line, said: viewer.said.append((line, said)),
        lambda _: None,
    )
    web = WebServer(VizConfig(port=port), access, lines, scene, viewer.photo)
    is_over = threading.Event()
    beats = threading.Thread(target=viewer.beat, args=(is_over,))
    beats.start()
    yield viewer
    is_over.set()
    beats.join()
    web.close()
    close_scene(scene)


@contextmanager
def page_of(browser: Browser, viewer: Viewer) -> Iterator[Page]:
    """A page that has called it."""
    page = open_page(browser, 1000, 600)
    page.goto(viewer.url)
    wait_until(lambda: bool(viewer.lines), "the page calls")
    yield page
    page.context.close()
