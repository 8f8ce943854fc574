"""A new robot is set up at the page alone: answered, stopped, left alone, taken back."""

import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect
from support.metal import make_hall
from support.processes import Process, find_free_port
from support.waiting import PATIENCE_S, wait_until

from trolley.config import load_config
from trolley.geometry import Pose2D
from trolley_base.emulators import EmulatedRobot, Mount, RobotInWorld
from trolley_base.world.world_file import load_world

from .conftest import PATIENCE_MS, open_page

pytestmark = [pytest.mark.slow, pytest.mark.browser]

MOUNT = Pose2D(0.08, -0.03, 2.0)
BOARD, LIDAR = "linorobot", "ld19"
FILE = """\
# My robot.
[robot]
name = "tester"
footprint = {{ length_m = 0.4, width_m = 0.3 }}  # with the bumper

[zenoh]
connect = ["tcp/127.0.0.1:{router}"]

[viz]
port = {viewer}
"""
TRIES = 5
ARE_THESE_ITS_DEVICES = "Are these the devices of this robot?"
MAY_IT_DRIVE = "Is the floor free, and may it drive?"
DRIVES_MS = 3.0 * PATIENCE_MS
# Counts what keeps the screen on.
COUNT_LOCKS = """() => {
  const ask = WakeLock.prototype.request;
  window.locks = [];
  WakeLock.prototype.request = async function (kind) {
    const lock = await ask.call(this, kind);
    window.locks.push(lock);
    return lock;
  };
}"""
IS_KEPT_ON = "window.locks.filter((one) => !one.released).length === 1"
MAY_GO_DARK = "window.locks.every((one) => one.released)"


@pytest.fixture(scope="module", autouse=True)
def settled() -> None:
    """The demo of the other files is not needed here."""


class Rig:
    """An emulated robot, its robot.toml, and `trolley setup --page` with its viewer."""

    def __init__(self, folder: Path, robot: EmulatedRobot, browser: Browser) -> None:
        self.folder = folder
        self.robot = robot
        self._browser = browser
        self.config = folder / "robot.toml"
        self.viewer = find_free_port()
        self.before = FILE.format(router=find_free_port(), viewer=self.viewer)
        self.config.write_text(self.before)
        ports = [str(folder / "ports" / name) for name in (BOARD, LIDAR)]
        self.command = Process(
            [
                *("-m", "trolley.cli", "setup", "--page", "--short"),
                *ports,
                *("--config", str(self.config)),
            ],
            folder / "setup.log",
            {"TROLLEY_STATE": str(folder / "state")},
        )

    def open(self, width: int, height: int, token: str = "", **options: str) -> Page:
        page = open_page(self._browser, width, height, **options)
        page.set_default_timeout(DRIVES_MS)
        page.goto(f"http://127.0.0.1:{self.viewer}/?{token and f'token={token}'}")
        return page

    def wait_for_viewer(self) -> None:
        wait_until(
            lambda: "Open the page" in self.command.log or not self.command.is_running,
            lambda: f"the viewer is there: {self.command.log}",
        )
        assert self.command.is_running, self.command.log
        assert "The viewer listens on its own host only" in self.command.log
        assert "Open the page on this computer, and follow it." in self.command.log

    def token_to_look(self) -> str:
        (path,) = self.folder.glob("state/**/viewer_access.toml")
        return str(tomllib.loads(path.read_text())["viewer"])

    def drives(self) -> bool:
        return abs(self.robot.truth().twist.wz) > 0.1

    def stands(self) -> bool:
        twist = self.robot.truth().twist
        return abs(twist.vx) < 0.005 and abs(twist.wz) < 0.01


@pytest.fixture
def rig(tmp_path: Path, browser: Browser) -> Iterator[Rig]:
    world = load_world(make_hall(tmp_path))
    body = RobotInWorld(world, 3, start=Pose2D(0.3, 0.1, 0.4), mount=Mount(MOUNT, reversed=True))
    with EmulatedRobot([f"{BOARD}:quiet,exact", LIDAR], body, tmp_path / "ports") as robot:
        robot.fault(f"{BOARD}:lifted")
        rig = Rig(tmp_path, robot, browser)
        try:
            rig.wait_for_viewer()
            yield rig
        finally:
            if rig.command.is_running:
                rig.command.terminate()


def asked(page: Page, question: str) -> None:
    expect(page.get_by_text(question)).to_be_visible(timeout=DRIVES_MS)


def answer(page: Page, question: str, label: str) -> None:
    asked(page, question)
    page.get_by_role("button", name=label, exact=True).click()


def try_wheels(page: Page) -> None:
    reach(page, ARE_THESE_ITS_DEVICES)
    answer(page, ARE_THESE_ITS_DEVICES, "Yes")
    answer(page, "Do the wheels hang free?", "Yes")
    answer(page, "The wheels were told to go ahead.", "both forward")
    answer(page, "told to turn to the left.", "the right one forward, the left one back")


def try_again(page: Page) -> None:
    answer(page, "What next?", "Try this step again")
    expect(page.get_by_text("What next?")).to_be_hidden()


def reach(page: Page, question: str) -> None:
    """Wait for a question; on a busy computer the emulated robot stutters, so it may try again."""
    wanted, again = page.get_by_text(question), page.get_by_text("What next?")
    for _ in range(TRIES):
        expect(wanted.or_(again)).to_be_visible(timeout=DRIVES_MS)
        if wanted.is_visible():
            return
        try_again(page)
        if question not in {ARE_THESE_ITS_DEVICES, MAY_IT_DRIVE}:
            reach(page, MAY_IT_DRIVE)
            answer(page, MAY_IT_DRIVE, "Yes")
    raise AssertionError(f"it never asks {question!r}")


def test_a_phone_sets_a_robot_up_and_starts_it(rig: Rig, pictures: Path) -> None:
    phone = rig.open(390, 844)
    try_wheels(phone)
    # A second page of somebody who may drive looks on; a guest is offered nothing to answer.
    desk, guest = rig.open(1440, 900), rig.open(390, 844, rig.token_to_look())
    asked(guest, MAY_IT_DRIVE)
    asked(guest, "Somebody who may drive has to answer.")
    expect(guest.get_by_role("button", name="Yes")).to_have_count(0)
    assert tomllib.loads(rig.config.read_text())["base"]["chassis"]["board"] == BOARD
    rig.robot.fault(f"{BOARD}:ok")
    for page in (phone, desk, guest):
        expect(page.locator("#stop")).to_be_in_viewport()
        expect(page.locator("#map")).to_be_hidden()
    answer(phone, MAY_IT_DRIVE, "Yes")
    asked(desk, "Another page has its hand on Stop.")
    desk.close()
    guest.close()
    reach(phone, "Write this to robot.toml?")
    expect(phone.get_by_role("button", name="Yes", exact=True)).to_be_in_viewport()
    phone.screenshot(path=pictures / "setup-phone-measured.png")
    answer(phone, "Write this to robot.toml?", "Yes")
    asked(phone, "All is written.")
    base = load_config(rig.config).base
    found = base.lidar.pose.as_pose()
    assert found.distance_to(MOUNT) < 0.01
    assert abs(found.yaw - MOUNT.yaw) < 0.01
    assert base.lidar.upside_down
    written = rig.config.read_text()
    assert written.startswith("# My robot.\n")
    assert "# with the bumper" in written
    assert rig.robot.truth().collisions == 0
    answer(phone, "What next?", "Start the robot")
    # The same page, with the robot that runs now.
    expect(phone.locator("#sentence")).to_contain_text("It has no map yet.", timeout=DRIVES_MS)
    expect(phone.locator("#map")).to_be_visible()
    expect(phone.get_by_role("tab", name="Map")).to_be_visible()
    assert rig.command.terminate() == 0, rig.command.log


def test_a_page_that_is_out_of_sight_stops_the_robot_and_takes_it_all_back(rig: Rig) -> None:
    phone = rig.open(390, 844)
    try_wheels(phone)
    reach(phone, MAY_IT_DRIVE)
    rig.robot.fault(f"{BOARD}:ok")
    other = rig.open(390, 844)
    # Closed: the other page looks on all the time, which is no hand on Stop.
    answer(phone, MAY_IT_DRIVE, "Yes")
    wait_until(rig.drives, "it turns")
    phone.close()
    wait_until(rig.stands, "it stands")
    asked(other, "closed or hidden")
    # Its script hangs: nobody could press Stop there.
    try_again(other)
    reach(other, MAY_IT_DRIVE)
    answer(other, MAY_IT_DRIVE, "Yes")
    wait_until(rig.drives, "it turns")
    other.evaluate("const end = performance.now() + 3000; while (performance.now() < end);")
    wait_until(rig.stands, "it stands")
    asked(other, "closed or hidden")
    # Hidden, as by the screen that is locked.
    try_again(other)
    reach(other, MAY_IT_DRIVE)
    answer(other, MAY_IT_DRIVE, "Yes")
    wait_until(rig.drives, "it turns")
    other.evaluate(
        "Object.defineProperty(document, 'hidden', { configurable: true, get: () => true })"
    )
    wait_until(rig.stands, "it stands")
    other.evaluate("delete document.hidden")
    # Stopped by a guest who may do nothing else.
    try_again(other)
    reach(other, MAY_IT_DRIVE)
    answer(other, MAY_IT_DRIVE, "Yes")
    wait_until(rig.drives, "it turns")
    guest = rig.open(390, 844, rig.token_to_look())
    guest.locator("#stop").click()
    wait_until(rig.stands, "it stands")
    expect(other.get_by_text("Stopped.", exact=True)).to_be_visible()
    assert rig.config.read_text() != rig.before  # the devices were found
    answer(other, "What next?", "Take everything back")
    expect(other.get_by_role("button", name="Begin anew")).to_be_visible()
    answer(other, "What next?", "End the setup")
    assert rig.command.wait(3 * PATIENCE_S) == 130, rig.command.log
    assert rig.config.read_text() == rig.before


def test_the_screen_stays_on_while_the_page_has_its_hand_on_stop(rig: Rig) -> None:
    phone = rig.open(390, 844)
    phone.evaluate(COUNT_LOCKS)
    try_wheels(phone)
    reach(phone, MAY_IT_DRIVE)
    rig.robot.fault(f"{BOARD}:ok")
    assert phone.evaluate(MAY_GO_DARK)
    answer(phone, MAY_IT_DRIVE, "Yes")
    wait_until(rig.drives, "it turns")
    wait_until(lambda: phone.evaluate(IS_KEPT_ON), "the screen is kept on")
    # A browser may let the screen go dark again at any time, as it does where a page was hidden.
    phone.evaluate("window.locks[0].release()")
    wait_until(lambda: phone.evaluate(IS_KEPT_ON), "the screen is kept on again")
    phone.locator("#stop").click()
    wait_until(rig.stands, "it stands")
    asked(phone, "What next?")
    wait_until(lambda: phone.evaluate(MAY_GO_DARK), "the screen may go dark")
