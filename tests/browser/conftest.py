"""The demo with its viewer, and Debian's Chromium looking at it."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect, sync_playwright
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
PATIENCE_MS = 60_000.0


class Shown:
    """A demo with its viewer, and a client on its bus."""

    def __init__(self, folder: Path) -> None:
        self.viz_port = find_free_port()
        self.demo = Demo(folder, "--viz-port", str(self.viz_port), "--seed", "3")
        self.robot = Robot(self.demo.name, [self.demo.endpoint])

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.viz_port}"

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
        wait_until(shown.is_ready, 90.0, "the demo's robot is localized")
        yield shown
    finally:
        shown.robot.close()
        shown.demo.end()


@pytest.fixture(scope="module")
def page(shown: Shown) -> Iterator[Page]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=str(CHROMIUM), args=ARGUMENTS)
        page = browser.new_page(viewport={"width": 1000, "height": 640})
        page.set_default_timeout(PATIENCE_MS)
        expect.set_options(timeout=PATIENCE_MS)
        page.goto(shown.url)
        page.get_by_text("Localized").wait_for()
        yield page
        browser.close()


@pytest.fixture(scope="session")
def pictures(request: pytest.FixtureRequest) -> Path:
    """Where screenshots are kept: `out/browser` in the workspace."""
    folder = request.config.rootpath / "out" / "browser"
    folder.mkdir(parents=True, exist_ok=True)
    return folder
