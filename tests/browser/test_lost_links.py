"""A page that stays open while the router is cut, the viewer is upgraded, or its phone sleeps."""

import shutil
import socket
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect
from support.processes import Process, find_free_port
from support.waiting import PATIENCE_S, wait_until

import trolley_viz
from trolley import topics
from trolley.cli.demo_robot import Choices, write_settings
from trolley.client import Robot
from trolley.runtime.zenoh_bus import open_router

from .conftest import open_page

pytestmark = [pytest.mark.slow, pytest.mark.browser]

NAME = "kiwi"
NOT_STOPPED = "NOT STOPPED: no connection"
A_DAY_OFF = """{
  const Plain = Date, now = () => Plain.now() + self.aDayOff;
  self.aDayOff = -24 * 3600 * 1000;
  self.Date = new Proxy(Plain, {
    construct: (plain, given) => given.length ? new plain(...given) : new plain(now()),
    apply: () => new Plain(now()).toString(),
    get: (plain, name) => name === "now" ? now : Reflect.get(plain, name),
  });
}
"""
"""The phone's clock."""


class House:
    """A router, a simulated robot's base and a viewer, each of which can go and come back."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self._folder, self._stack = folder, stack
        choices = Choices(name=NAME, port=find_free_port(), viz_port=find_free_port())
        self._config = write_settings(choices, folder)
        self._endpoint = choices.endpoint
        self._viz_port = choices.viz_port
        self.url = f"http://127.0.0.1:{choices.viz_port}/"
        self._router = ExitStack()
        stack.callback(self._router.close)
        self.open_router()
        self._start("base")
        self.viewer = self._start("viz")
        self.robot = Robot(NAME, [self._endpoint], connect_timeout=PATIENCE_S)
        stack.callback(self.robot.close)

    def _start(self, service: str, code: Path | None = None) -> Process:
        environment = {"TROLLEY_STATE": str(self._folder / "state")}
        if code is not None:
            environment["PYTHONPATH"] = str(code)
        process = Process(
            ["-P", "-m", f"trolley_{service}", "--config", str(self._config)],
            self._folder / f"{service}.log",
            environment,
        )
        self._stack.callback(process.kill)
        return process

    def open_router(self) -> None:
        self._router.enter_context(open_router([self._endpoint]))

    def cut_router(self) -> None:
        self._router.close()

    def restart_viewer(self, code: Path | None = None) -> None:
        """As an upgrade does, to the package in a folder."""
        self.viewer.terminate()
        self.viewer = self._start("viz", code)

    def has_viewer(self) -> bool:
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self._viz_port)) == 0

    def base_mode(self) -> str:
        base = self.robot.latest(topics.BASE)
        return "" if base is None else base.mode


@pytest.fixture(scope="module", autouse=True)
def settled() -> None:
    """The shared demo is not needed here."""


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory, chromium: Path) -> Iterator[House]:
    with ExitStack() as stack:
        yield House(tmp_path_factory.mktemp("house"), stack)


@pytest.fixture
def page(house: House, browser: Browser) -> Iterator[Page]:
    """A phone; without the scene, which would take most of a processor."""
    page = open_page(browser, 390, 844, has_touch=True, is_mobile=True)
    page.route("**/scene/**", lambda route: route.abort())
    yield page
    page.context.close()


def open_house(page: Page, house: House) -> None:
    wait_until(house.has_viewer, "the viewer listens")
    page.goto(house.url)
    expect(page.locator("body")).to_have_attribute("data-line", "open")


def stop_and_drive_on(page: Page, house: House) -> None:
    """Stop counts, and so does what has a time of its own."""
    page.locator("#stop").click()
    wait_until(lambda: house.base_mode() == "stopped", "base is stopped")
    expect(page.locator("#resume")).to_be_enabled()
    page.locator("#resume").click()
    wait_until(lambda: house.base_mode() == "ok", "base may drive again")
    expect(page.locator("#stop-line")).to_be_hidden()


def test_a_router_that_is_cut_is_said_and_stop_is_repeated_until_it_is_back(
    page: Page, house: House, pictures: Path
) -> None:
    open_house(page, house)
    wait_until(lambda: house.base_mode() == "ok", "base is there")
    house.cut_router()
    expect(page.locator("#sentence")).to_contain_text("No contact with the robot")
    page.locator("#stop").click()
    expect(page.locator("#stop-line")).to_have_text(NOT_STOPPED)
    page.screenshot(path=pictures / "router-cut.png")
    expect(page.locator("body")).to_have_attribute("data-line", "open")  # the viewer is there
    house.open_router()
    wait_until(lambda: house.base_mode() == "stopped", "the press of Stop arrives")
    expect(page.locator("#stop-line")).to_contain_text("Stopped")
    expect(page.locator("#resume")).to_be_enabled()
    page.locator("#resume").click()
    wait_until(lambda: house.base_mode() == "ok", "it may drive again")


def test_a_page_whose_phone_is_a_day_late_or_early_is_obeyed_all_the_same(
    page: Page, house: House
) -> None:
    page.add_init_script(A_DAY_OFF)
    open_house(page, house)
    for days in (-1, 1):
        page.evaluate("days => { aDayOff = days * 24 * 3600 * 1000 }", days)
        stop_and_drive_on(page, house)


def test_a_browser_that_cannot_draw_the_map_says_so_and_stops_the_robot_all_the_same(
    house: House, browser: Browser, pictures: Path
) -> None:
    page = open_page(browser, 390, 844, has_touch=True, is_mobile=True)
    page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    open_house(page, house)
    expect(page.get_by_text("it has no WebGL")).to_be_visible()
    page.screenshot(path=pictures / "no-webgl.png")
    stop_and_drive_on(page, house)
    page.context.close()


def test_a_picture_that_the_browser_took_back_is_drawn_anew(house: House, browser: Browser) -> None:
    page = open_page(browser, 390, 844, has_touch=True, is_mobile=True)
    open_house(page, house)
    expect(page.locator("#scene-wait")).to_be_hidden()
    context = """document.getElementById("scene").contentDocument
      ?.querySelector("canvas[data-engine]")?.getContext("webgl2")"""
    page.evaluate(f'{context}.getExtension("WEBGL_lose_context").loseContext()')
    is_back = f"{context}?.isContextLost() === false"
    wait_until(lambda: page.evaluate(is_back), "the map is drawn again")
    expect(page.locator("#scene-wait")).to_be_hidden()
    page.context.close()


def build_of(page: Page) -> str:
    build = page.locator("meta[name=build]").get_attribute("content")
    assert build is not None
    return build


def upgraded(folder: Path) -> Path:
    """Another release of the viewer: its page looks a little different."""
    (source,) = trolley_viz.__path__
    shutil.copytree(source, folder / "trolley_viz", ignore=shutil.ignore_patterns("__pycache__"))
    with (folder / "trolley_viz" / "frontend" / "page.css").open("a", encoding="utf-8") as file:
        file.write(f"/* {folder} */\n")
    return folder


def wait_for_another_build(page: Page, before: str) -> None:
    """The page loads itself anew without being asked, and shows what there is."""
    expect(page.locator("meta[name=build]")).not_to_have_attribute("content", before)
    expect(page.locator("body")).to_have_attribute("data-line", "open")


def test_an_open_page_loads_itself_anew_from_a_viewer_that_was_upgraded(
    page: Page, house: House, tmp_path_factory: pytest.TempPathFactory
) -> None:
    open_house(page, house)
    before = build_of(page)
    house.restart_viewer(upgraded(tmp_path_factory.mktemp("upgraded")))
    wait_for_another_build(page, before)
    stop_and_drive_on(page, house)


def test_a_page_that_slept_since_yesterday_wakes_to_a_viewer_that_was_upgraded(
    page: Page, house: House, tmp_path_factory: pytest.TempPathFactory
) -> None:
    page.add_init_script(A_DAY_OFF)
    open_house(page, house)
    before = build_of(page)
    sleeping = page.context.new_cdp_session(page)
    sleeping.send("Page.setWebLifecycleState", {"state": "frozen"})
    house.restart_viewer(upgraded(tmp_path_factory.mktemp("upgraded")))
    wait_until(house.has_viewer, "the new viewer listens")
    page.evaluate("aDayOff = 0")  # its clock has gone on by a day
    sleeping.send("Page.setWebLifecycleState", {"state": "active"})
    wait_for_another_build(page, before)
    stop_and_drive_on(page, house)
