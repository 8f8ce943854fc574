"""Two robots, each with services of its own, on one router and in one viewer."""

import signal
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import tomli_w
import trimesh
from playwright.sync_api import Page, expect
from support.processes import Process
from support.waiting import wait_until
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from trolley import topics
from trolley.cli.demo_robot import Choices, settings
from trolley.client import Robot
from trolley.geometry import Pose2D

from .test_viewer import button

if TYPE_CHECKING:
    from .conftest import Shown

pytestmark = [pytest.mark.slow, pytest.mark.browser]

START = Pose2D(4.6, 1.2, 0.0)
PATIENCE_S = 60.0


class Second:
    """Another robot on the demo's router, with a body of its own."""

    def __init__(self, shown: "Shown", folder: Path) -> None:
        port = int(shown.demo.endpoint.rpartition(":")[2])
        plain = settings(Choices(name="b", port=port, seed=4, start=START))
        plain["robot"] |= {"title": "Bertha", "mesh": "body.glb"}
        (folder / "body.glb").write_bytes(body())
        (folder / "robot.toml").write_text(tomli_w.dumps(plain), encoding="utf-8")
        arguments = ["up", "--no-router", "--no-viz", "--config", str(folder / "robot.toml")]
        self.process = Process(
            ["-c", "from trolley.cli import main; main()", *arguments],
            folder / "up.log",
            {"TROLLEY_STATE": str(folder / "state")},
        )
        self.robot = Robot("b", [shown.demo.endpoint])

    def is_ready(self) -> bool:
        pose = self.robot.latest(topics.POSE)
        return pose is not None and pose.state == "localized"

    @property
    def mode(self) -> str:
        base = self.robot.latest(topics.BASE)
        return "" if base is None else base.mode


def body() -> bytes:
    """A long box with a cabin at its back and a red nose, +y up and +z ahead as glTF has it."""
    scene = trimesh.Scene()
    for size, middle, colour in (
        ((0.34, 0.10, 0.40), (0.0, 0.08, 0.0), (40, 120, 60, 255)),
        ((0.28, 0.22, 0.14), (0.0, 0.23, -0.10), (230, 230, 230, 255)),
        ((0.10, 0.05, 0.06), (0.0, 0.155, 0.15), (220, 30, 30, 255)),
    ):
        box = trimesh.creation.box(size)
        box.apply_translation(middle)
        material = PBRMaterial(baseColorFactor=colour, metallicFactor=0.0)
        box.visual = TextureVisuals(material=material)
        scene.add_geometry(box)
    glb = scene.export(file_type="glb")
    assert isinstance(glb, bytes)
    return glb


@pytest.fixture(scope="module")
def second(shown: "Shown", tmp_path_factory: pytest.TempPathFactory) -> Iterator[Second]:
    second = Second(shown, tmp_path_factory.mktemp("second"))
    try:
        wait_until(second.is_ready, 90.0, "the second robot is localized")
        yield second
    finally:
        second.robot.close()
        if second.process.is_running:
            second.process.terminate()


def test_one_viewer_shows_and_stops_two_robots(
    page: Page, shown: "Shown", second: Second, pictures: Path
) -> None:
    def first_mode() -> str:
        base = shown.robot.latest(topics.BASE)
        return "" if base is None else base.mode

    page.get_by_text("All robots", exact=True).click()
    expect(page.get_by_text("Bertha: Standing by")).to_be_visible()
    button(page, "Stop all robots").click()
    wait_until(lambda: (first_mode(), second.mode) == ("stopped", "stopped"), 10.0, "both stop")
    expect(page.get_by_text("Bertha: Stopped")).to_be_visible()
    button(page, "Resume").click()
    wait_until(lambda: first_mode() == "ok", 10.0, "the one that is followed goes on")
    assert second.mode == "stopped"
    page.screenshot(path=pictures / "two-robots.png", timeout=60_000)
    button(page, "Follow Bertha").click()
    expect(page.get_by_text("It is stopped. Press Resume to let it drive again.")).to_be_visible()
    button(page, "Resume").click()
    wait_until(lambda: second.mode == "ok", 10.0, "it is the second one's now")
    assert page.get_by_text("outline is shown").count() == 0  # nothing is amiss with its body
    page.screenshot(path=pictures / "second-robot.png", timeout=60_000)
    second.process.send(signal.SIGTERM)
    second.process.wait(30.0)
    expect(page.get_by_text("Bertha: Away")).to_be_visible()
    expect(page.get_by_text("Nothing is heard of the robot").first).to_be_visible()
    page.screenshot(path=pictures / "second-away.png", timeout=60_000)
    button(page, "STOP").click()
    expect(page.get_by_text("NOT STOPPED")).to_be_visible()
    button(page, "Follow Demo robot").click()
    expect(page.get_by_text("Localized").first).to_be_visible()
    page.get_by_text("All robots", exact=True).click()
