"""A map that is being made while somebody carries the robot off: joined or removed at the page."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect
from support.processes import Process, find_free_port, write_config
from support.waiting import PATIENCE_S, wait_until

from trolley import Robot, requests, topics, worlds
from trolley.geometry import Pose2D, Twist2D
from trolley.gridmap.wire import grid_of
from trolley.messages import MappingStatus
from trolley.messages.request_params import MapNamed
from trolley_base.emulators import EmulatedRobot, RobotInWorld
from trolley_base.world.world_file import load_world

from .conftest import open_page
from .seeing import pixel_of, wait_for_frames
from .test_viewer import button

pytestmark = [pytest.mark.slow, pytest.mark.browser]

BOARD, LIDAR = "linorobot", "ld19"
START, ELSEWHERE = Pose2D(0.549, 0.218, 0.0), Pose2D(5.2, 1.3, 2.0)
DEVICES = """
[base]
driver = "hardware"
[base.chassis]
board = "{board}"
port = "{ports}/{board}"
[base.lidar]
model = "{lidar}"
port = "{ports}/{lidar}"
[viz]
port = {viewer}
"""


@pytest.fixture(scope="module", autouse=True)
def settled() -> None:
    """The demo of the other files is not needed here: nobody can carry its robot."""


class House:
    """A robot that can be carried, and that makes a map."""

    def __init__(self, folder: Path, emulated: EmulatedRobot) -> None:
        self.emulated = emulated
        self.viewer = find_free_port()
        endpoint = f"tcp/127.0.0.1:{find_free_port()}"
        more = DEVICES.format(board=BOARD, lidar=LIDAR, ports=folder / "ports", viewer=self.viewer)
        config = write_config(folder / "robot.toml", endpoint, more=more)
        self.up = Process(
            ["-m", "trolley.cli", "up", "--without", "planner", "--config", str(config)],
            folder / "up.log",
            {"TROLLEY_STATE": str(folder / "state")},
        )
        self.robot = Robot("tester", endpoint, connect_timeout=PATIENCE_S)

    @property
    def status(self) -> MappingStatus:
        status = self.robot.latest(topics.MAPPING)
        assert status is not None
        return status

    def begin_map(self) -> None:
        wait_until(lambda: self.robot.latest(topics.MAPPING), lambda: f"it runs: {self.up.log}")
        wait_until(lambda: self.robot.latest(topics.SCAN), "it sees")
        self.robot.ask(requests.MAP_NEW, MapNamed(name="home"))
        wait_until(lambda: self.status.state == "mapping", "it maps")
        wait_until(lambda: self.status.scans > 0, lambda: f"it has seen some: {self.status}")

    def close(self) -> None:
        self.robot.close()
        if self.up.is_running:
            self.up.terminate()

    def drive_until_it_has(self, scans: int) -> None:
        """Turn on the spot, so that scans are kept."""

        def has_them() -> bool:
            self.robot.drive(Twist2D(0.0, 0.0, 0.6), valid_for=0.3)
            return self.status.scans >= scans

        wait_until(has_them, lambda: f"it has seen enough: {self.status}")

    def carry_off(self, there: Pose2D) -> None:
        """Carry the robot elsewhere until a part hangs loose."""
        self.emulated.carry(there)

        def hangs_loose() -> bool:
            self.robot.drive(Twist2D(0.0, 0.0, 0.6), valid_for=0.3)
            return self.status.loose > 0

        wait_until(hangs_loose, lambda: f"a part hangs loose: {self.status}")


@pytest.fixture
def house(tmp_path: Path) -> Iterator[House]:
    world = load_world(worlds.find("apartment.toml"))
    body = RobotInWorld(world, 3, start=START)
    with EmulatedRobot([f"{BOARD}:quiet,exact", LIDAR], body, tmp_path / "ports") as emulated:
        house = House(tmp_path, emulated)
        try:
            house.begin_map()
            yield house
        finally:
            house.close()


def open_map(browser: Browser, house: House, width: int, height: int, **options: bool) -> Page:
    page = open_page(browser, width, height, **options)
    page.goto(f"http://127.0.0.1:{house.viewer}/?fixedDpr=0.5")
    page.locator("#scene-wait").wait_for(state="hidden")
    page.get_by_role("tab", name="Map").click()
    return page


def drag_finger(phone: Page, *way: tuple[float, float]) -> None:
    """Press, drag along these points [px] and let go."""
    fingers = phone.context.new_cdp_session(phone)
    for number, (x, y) in enumerate(way):
        kind = "touchMove" if number else "touchStart"
        fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [{"x": x, "y": y}]})
    fingers.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})


def test_a_part_that_hangs_loose_is_removed_and_another_one_joined(
    house: House, browser: Browser, pictures: Path
) -> None:
    house.drive_until_it_has(5)
    desk = open_map(browser, house, 1350, 640)
    remove = button(desk, "Remove loose part")
    expect(button(desk, "Save map")).to_be_visible()
    expect(remove).to_be_hidden()
    house.carry_off(ELSEWHERE)
    scans = house.status.scans
    expect(desk.get_by_text(re.compile("scans? hangs? loose"))).to_be_visible()
    remove.click()
    expect(desk.get_by_text(re.compile("hung loose ha(s|ve) been removed"))).to_be_visible()
    desk.screenshot(path=pictures / "loose-removed.png")
    assert house.status.scans == scans
    # What it sees from now on hangs loose again, as it stands where the map shows nothing.
    house.carry_off(ELSEWHERE)
    expect(remove).to_be_visible()
    desk.context.close()

    phone = open_map(browser, house, 390, 844, has_touch=True, is_mobile=True)
    button(phone, "Show the whole map").tap()
    button(phone, "Set pose …").tap()
    expect(phone.locator("#hint")).to_contain_text("Press where the robot is")
    wait_for_frames(phone)
    here = START.inverse() @ house.emulated.truth().pose
    ahead = here @ Pose2D(0.7, 0.0, 0.0)
    known = house.robot.latest(topics.MAP)
    assert known is not None
    start, middle, end = (
        pixel_of(phone, (at.x, at.y), grid_of(known))
        for at in (here, here @ Pose2D(0.3, 0.0, 0.0), ahead)
    )
    phone.screenshot(path=pictures / "loose-phone.png")
    drag_finger(phone, start, middle, end)
    wait_until(lambda: house.status.loose == 0, lambda: f"it is joined: {house.status}")
    expect(button(phone, "Remove loose part")).to_be_hidden()
    expect(phone.get_by_text("Mapping", exact=True)).to_be_visible()
    phone.screenshot(path=pictures / "loose-joined.png")
    assert house.status.scans > scans
    pose = house.robot.latest(topics.POSE)
    assert pose is not None
    assert pose.pose is not None
    assert pose.pose.distance_to(START.inverse() @ house.emulated.truth().pose) < 0.1
    phone.context.close()
