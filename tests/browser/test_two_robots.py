"""Two robots, each with services of its own, on one router and in one viewer."""

import signal
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import tomli_w
import trimesh
from playwright.sync_api import Page, expect
from support.processes import Process
from support.waiting import PATIENCE_S, wait_until
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from trolley import requests, topics
from trolley.cli.demo_robot import Choices, settings
from trolley.client import Robot
from trolley.geometry import Pose2D
from trolley.messages import floats_from_bytes
from trolley.messages.request_params import SendGoal

from .conftest import run_demo
from .seeing import count_seen, is_purple, poll
from .test_viewer import button

if TYPE_CHECKING:
    from .conftest import Shown

pytestmark = [pytest.mark.slow, pytest.mark.browser]

START = Pose2D(1.65, 0.55, 0.0)
"""Between the first robot and `BEHIND`, where the first one sees it."""
BEHIND = Pose2D(2.7, 0.9, 0.0)
KEPT_AWAY_M = 0.4


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
        self.robot = Robot("b", [shown.demo.endpoint], connect_timeout=PATIENCE_S)

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
def shown(tmp_path_factory: pytest.TempPathFactory) -> "Iterator[Shown]":
    """A demo of its own: a second robot is not forgotten."""
    yield from run_demo(tmp_path_factory.mktemp("two"))


@pytest.fixture(scope="module")
def second(shown: "Shown", tmp_path_factory: pytest.TempPathFactory) -> Iterator[Second]:
    second = Second(shown, tmp_path_factory.mktemp("second"))
    try:
        wait_until(second.is_ready, "the second robot is localized")
        yield second
    finally:
        second.robot.close()
        if second.process.is_running:
            second.process.terminate()


def nearest(shown: "Shown") -> float:
    """How near the way to `BEHIND` passes by the second robot [m]."""
    reply = shown.robot.ask(requests.GOAL_PREVIEW, SendGoal(pose=BEHIND))
    points = floats_from_bytes(reply.poses, 3)[:, :2]
    return float(np.linalg.norm(points - (START.x, START.y), axis=1).min())


def test_what_is_not_on_the_map_is_marked_and_driven_round(
    page: Page, shown: "Shown", second: Second, pictures: Path
) -> None:
    """The second robot stands for whatever is left on the floor."""
    assert second.is_ready()

    def num_marked() -> int:
        return count_seen(page, (START.x, START.y), is_purple, 0.35)

    page.get_by_role("tab", name="More").click()
    page.get_by_text("Layers: Robot", exact=True).click()
    page.get_by_label("Other robots").uncheck()  # it would hide its own echoes
    page.get_by_text("Layers: Robot", exact=True).click()
    page.get_by_text("Layers: Sensing", exact=True).click()
    expect(page.get_by_text("not on the map", exact=True)).to_be_visible()
    poll(page, lambda: num_marked() > 10, "its echoes are as those of what is not on the map")
    wait_until(lambda: nearest(shown) > KEPT_AWAY_M, "the way leads round it")
    page.screenshot(path=pictures / "not-on-the-map.png")
    page.get_by_label("Laser scan").uncheck()
    poll(page, lambda: num_marked() == 0, "they are echoes")
    page.get_by_label("Laser scan").check()
    poll(page, lambda: num_marked() > 10, "they are back")
    page.get_by_text("Layers: Sensing", exact=True).click()
    page.get_by_role("tab", name="Go").click()


def test_one_viewer_shows_and_stops_two_robots(
    page: Page, shown: "Shown", second: Second, pictures: Path
) -> None:
    def first_mode() -> str:
        base = shown.robot.latest(topics.BASE)
        return "" if base is None else base.mode

    page.get_by_text("All robots", exact=True).click()
    expect(page.get_by_text("Bertha: Standing by")).to_be_visible()
    button(page, "Stop all robots").click()
    wait_until(lambda: (first_mode(), second.mode) == ("stopped", "stopped"), "both stop")
    expect(page.get_by_text("Bertha: Stopped")).to_be_visible()
    button(page, "Drive on").click()
    wait_until(lambda: first_mode() == "ok", "the one that is followed goes on")
    assert second.mode == "stopped"
    page.screenshot(path=pictures / "two-robots.png")
    button(page, "Follow Bertha").click()
    expect(page.locator("#sentence")).to_contain_text(
        "Stopped. Press “Drive on” to let it drive again."
    )
    button(page, "Drive on").click()
    wait_until(lambda: second.mode == "ok", "it is the second one's now")
    assert page.get_by_text("outline is shown").count() == 0  # nothing is amiss with its body
    page.screenshot(path=pictures / "second-robot.png")
    second.process.send(signal.SIGTERM)
    second.process.wait()
    expect(page.get_by_text("Bertha: Away")).to_be_visible()
    expect(page.get_by_text("No contact with the robot").first).to_be_visible()
    page.screenshot(path=pictures / "second-away.png")
    button(page, "STOP").click()
    expect(page.locator("#stop-line")).to_contain_text("NOT STOPPED")
    button(page, "Follow Demo robot").click()
    expect(page.get_by_text("Localized").first).to_be_visible()
    page.get_by_text("All robots", exact=True).click()
    poll(page, lambda: count_seen(page, (START.x, START.y), is_purple, 0.35) == 0, "no echoes")
