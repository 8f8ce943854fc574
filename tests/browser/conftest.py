"""The demo with its viewer, and Debian's Chromium looking at it."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, expect, sync_playwright
from support.demo import Demo
from support.processes import find_free_port
from support.waiting import wait_until

from trolley import topics
from trolley.client import Robot

CHROMIUM = Path("/usr/bin/chromium")
# Rendered in software: slow, but it needs no graphics card. No sandbox: containers forbid it.
ARGUMENTS = [
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--no-sandbox",
]
PATIENCE_MS = 180_000.0
# The scene is drawn with a quarter of the pixels and at most ten times a second: that is what a
# processor has left for it beside the robot, and a tablet's graphics card does no better.
SCENE = "?fixedDpr=0.5"
SLOW_FRAMES = """(() => {
  const draw = window.requestAnimationFrame.bind(window), period = 100;
  const waiting = new Map();
  let last = 0, number = 0, isDue = false;
  window.requestAnimationFrame = (callback) => {
    waiting.set(++number, callback);
    if (!isDue) {
      isDue = true;
      const now = performance.now(), next = Math.max(last + period, now);
      setTimeout(() => draw((time) => {
        last = performance.now();
        isDue = false;
        const callbacks = [...waiting.values()];
        waiting.clear();
        for (const callback of callbacks) {
          try { callback(time); } catch (error) { reportError(error); }
        }
      }), next - now);
    }
    return number;
  };
  window.cancelAnimationFrame = (number) => waiting.delete(number);
})()"""


class Shown:
    """A demo with its viewer, and a client on its bus."""

    def __init__(self, folder: Path) -> None:
        self.viz_port = find_free_port()
        self.demo = Demo(folder, "--viz-port", str(self.viz_port), "--seed", "3")
        self.robot = Robot(self.demo.name, [self.demo.endpoint])

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.viz_port}/{SCENE}"

    def is_ready(self) -> bool:
        """Localized, with its places saved and a planner that knows them."""
        pose, poses = self.robot.latest(topics.POSE), self.robot.latest(topics.POSES)
        goal = self.robot.latest(topics.GOAL)
        has_places = poses is not None and len(poses.poses) > 0
        return has_places and goal is not None and pose is not None and pose.state == "localized"


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shown]:
    if not CHROMIUM.exists():
        pytest.skip(f"{CHROMIUM} is not installed")
    shown = Shown(tmp_path_factory.mktemp("viewer"))
    try:
        wait_until(shown.is_ready, 180.0, "the demo's robot is localized")
        yield shown
    finally:
        shown.robot.close()
        shown.demo.end()


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=str(CHROMIUM), args=ARGUMENTS)
        expect.set_options(timeout=PATIENCE_MS)
        yield browser
        browser.close()


def open_page(browser: Browser, width: int, height: int, **options: Any) -> Page:
    """A page of a context of its own, patient and drawn seldom."""
    page = browser.new_page(viewport={"width": width, "height": height}, **options)
    page.add_init_script(SLOW_FRAMES)
    page.set_default_timeout(PATIENCE_MS)
    return page


@pytest.fixture(scope="module")
def page(shown: Shown, browser: Browser) -> Iterator[Page]:
    page = open_page(browser, 1000, 640)
    page.goto(shown.url)
    page.get_by_text("Localized").first.wait_for()
    yield page
    page.context.close()


@pytest.fixture(scope="session")
def pictures(request: pytest.FixtureRequest) -> Path:
    """Where screenshots are kept: `out/browser` in the workspace."""
    folder = request.config.rootpath / "out" / "browser"
    folder.mkdir(parents=True, exist_ok=True)
    return folder
