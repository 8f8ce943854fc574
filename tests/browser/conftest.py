"""The demo with its viewer, and Debian's Chromium looking at it."""

import contextlib
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any, cast

import pytest
from playwright.sync_api import Browser, Page, expect, sync_playwright
from playwright.sync_api import Error as PlaywrightError
from support.demo import Demo
from support.processes import find_free_port
from support.waiting import PATIENCE_S, wait_until

from trolley import requests, topics
from trolley.client import Refused
from trolley.geometry import Pose2D, wrap_angle
from trolley.messages.request_params import Named
from trolley.topics import M, Topic

CHROMIUM = Path("/usr/bin/chromium")
# Rendered in software: slow, but it needs no graphics card. No sandbox: containers forbid it.
ARGUMENTS = [
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-gpu-compositing",
    "--no-sandbox",
]
AGAIN = pytest.mark.again("a page that is late drops presses and lets go of what is held")
START = Pose2D(0.549, 0.218, 0.2579)
"""Where the demo's robot begins."""
DELETES = {
    "zones": requests.ZONES_DELETE,
    "poses": requests.POSES_DELETE,
    "tours": requests.TOURS_DELETE,
}
PATIENCE_MS = 1000.0 * PATIENCE_S
# The scene is drawn with a quarter of the pixels and at most four times a second: that is what a
# processor has left for it beside the robot, and a tablet's graphics card does no better. Where
# nobody looks at it, `undrawn` in `seeing.py` makes that once a second.
SCENE = "?fixedDpr=0.5"
SLOW_FRAMES = """(() => {
  const draw = window.requestAnimationFrame.bind(window);
  window.framePeriod = 250;
  const waiting = new Map();
  let last = 0, number = 0, isDue = false;
  window.requestAnimationFrame = (callback) => {
    waiting.set(++number, callback);
    if (!isDue) {
      isDue = true;
      const now = performance.now(), next = Math.max(last + framePeriod, now);
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
# What is pressed counts from when the page hears of it: without a graphics card it is busy for
# seconds, and what is pressed earlier than 2 s ago is refused.
PROMPT = """Object.defineProperty(Event.prototype, "timeStamp",
  { configurable: true, get: () => performance.now() })"""


class Shown:
    """A demo with its viewer, and a client on its bus."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.viz_port = find_free_port()
        self.demo = Demo(folder, "--viz-port", str(self.viz_port), "--seed", "3")
        self.robot = self.demo.client()
        self._first: dict[str, set[str]] = {}

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.viz_port}/{SCENE}"

    def known(self, topic: Topic[M]) -> M:
        """The newest message of a topic, however late whoever has it answers."""
        found = wait_until(lambda: self.robot.latest(topic), f"{topic.name} is known")
        assert found is not None
        return found

    def is_ready(self) -> bool:
        """Localized, with its places saved and a planner that knows them."""
        pose, poses = self.robot.latest(topics.POSE), self.robot.latest(topics.POSES)
        goal = self.robot.latest(topics.GOAL)
        has_places = poses is not None and len(poses.poses) > 0
        return has_places and goal is not None and pose is not None and pose.state == "localized"

    def settle(self) -> None:
        """Bring the robot back to where it began, with nothing drawn or stored besides."""
        robot = self.robot
        wait_until(self.is_ready, "the demo's robot is localized")
        robot.delete_marker()
        robot.delete_overlay()
        stored = self._stored()
        self._first = self._first or stored
        for request, names in stored.items():
            for name in names - self._first[request]:
                robot.ask(DELETES[request], Named(name=name))  # pyrefly: ignore[bad-argument-type]
        with contextlib.suppress(Refused):  # none is under way
            robot.ask(requests.TOUR_STOP)
        robot.resume()
        truth = self.known(topics.SIM_TRUTH)
        if truth.pose.distance_to(START) > 0.1 or abs(wrap_angle(truth.pose.yaw - START.yaw)) > 0.2:
            wait_until(self._has_come_back, "it is back at the start")

    def _has_come_back(self) -> bool:
        """Drive to the start; base or localizer may have been killed just before."""
        try:
            return self.robot.go_to("start", timeout=60.0).state == "arrived"
        except Refused:
            return False

    def _stored(self) -> dict[str, set[str]]:
        return {
            "zones": {one.name for one in self.known(topics.ZONES).zones},
            "poses": {one.name for one in self.known(topics.POSES).poses},
            "tours": {one.name for one in self.known(topics.TOURS).tours},
        }


def pytest_itemcollected(item: pytest.Item) -> None:
    """Run a test of a page again where it fails."""
    item.add_marker(AGAIN)


@pytest.fixture(scope="session")
def chromium() -> Path:
    """Debian's Chromium; without it the test is skipped."""
    if not CHROMIUM.exists():
        pytest.skip(f"{CHROMIUM} is not installed")
    return CHROMIUM


def run_demo(folder: Path) -> Iterator[Shown]:
    """A demo of one's own."""
    shown = Shown(folder)
    try:
        wait_until(shown.is_ready, "the demo's robot is localized")
        yield shown
    finally:
        shown.robot.close()
        shown.demo.end()


@pytest.fixture(scope="package")
def shown(tmp_path_factory: pytest.TempPathFactory, chromium: Path) -> Iterator[Shown]:
    """The demo that all files share: to start one takes most of a minute of a processor."""
    yield from run_demo(tmp_path_factory.mktemp("viewer"))


@pytest.fixture(scope="module", autouse=True)
def settled(shown: Shown) -> None:
    """Each file finds the demo as it began, but for the trips that were driven."""
    shown.settle()


@pytest.fixture(scope="package")
def browser(chromium: Path) -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=str(chromium), args=ARGUMENTS)
        expect.set_options(timeout=PATIENCE_MS)
        yield browser
        browser.close()


FAILED = pytest.StashKey[bool]()
of_file: list[pytest.FixtureDef[Any]] = []
"""What the tests of a file share, in the order in which it was made."""


@pytest.hookimpl
def pytest_fixture_setup(fixturedef: pytest.FixtureDef[Any]) -> None:
    if fixturedef.scope == "module" and fixturedef not in of_file:
        of_file.append(fixturedef)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item,
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    if report.failed:
        item.stash[FAILED] = True
        for name, page in cast("pytest.Function", item).funcargs.items():
            if isinstance(page, Page) and not page.is_closed():
                report.sections.append((f"what `{name}` showed", kept_picture(page, item)))
    return report


def kept_picture(page: Page, item: pytest.Item) -> str:
    """Keep a picture of a page whose test failed; its words, and where the picture is."""
    path = item.config.rootpath / "out" / "browser" / "failed" / f"{item.name}.png"
    try:
        page.screenshot(path=path, timeout=10_000)
        return f"{path}\n{page.inner_text('body', timeout=10_000)}"
    except PlaywrightError as error:
        return f"No picture: {error}"


@pytest.fixture(autouse=True)
def begun_anew(request: pytest.FixtureRequest) -> Iterator[None]:
    """After a test that failed its file begins anew: what it left behind is not the next one's."""
    yield
    if FAILED in request.node.stash:
        for fixture in reversed(of_file):
            fixture.finish(cast(Any, request))
        of_file.clear()


def open_page(browser: Browser, width: int, height: int, **options: Any) -> Page:
    """A page of a context of its own, patient and drawn seldom."""
    page = browser.new_page(viewport={"width": width, "height": height}, **options)
    page.add_init_script(SLOW_FRAMES)
    page.add_init_script(PROMPT)
    page.set_default_timeout(PATIENCE_MS)
    return page


def open_viewer(page: Page, url: str) -> None:
    """Open the viewer, until it knows where the robot is and shows the map."""
    page.goto(url)
    expect(page.get_by_text("Localized").first).to_be_visible()
    expect(page.locator("#scene-wait")).to_be_hidden()


@pytest.fixture(scope="module")
def page(shown: Shown, browser: Browser) -> Iterator[Page]:
    page = open_page(browser, 1350, 640)  # the map is 1000 wide
    open_viewer(page, shown.url)
    yield page
    page.context.close()


@pytest.fixture(scope="session")
def pictures(request: pytest.FixtureRequest) -> Path:
    """Where screenshots are kept: `out/browser` in the workspace."""
    folder = request.config.rootpath / "out" / "browser"
    folder.mkdir(parents=True, exist_ok=True)
    return folder
