"""The viewer as people use it: a real browser, a mouse, and the demo's robot."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from playwright.sync_api import Page, expect
from support.waiting import wait_until

from trolley import topics
from trolley.geometry import wrap_angle
from trolley.gridmap import load_map
from trolley_viz.camera import FIELD_OF_VIEW, PANEL_PIXELS, bounds_of, stand

if TYPE_CHECKING:
    from .conftest import Shown

pytestmark = [pytest.mark.slow, pytest.mark.browser]

WORLDS = Path(__file__).parents[2] / "worlds"
PLACE, TOWARDS = (1.6, 0.7), (2.2, 1.3)
"""Where the mouse presses and where it is dragged to [m]: open floor near the demo's start."""


def pixel_of(page: Page, point: tuple[float, float]) -> tuple[float, float]:
    """Where a point of the floor is seen, with the camera that the viewer gives a new browser."""
    grid = load_map(WORLDS / "apartment.yaml")
    known = np.argwhere(grid.cells >= 0)
    low, high = known.min(axis=0), known.max(axis=0) + 1
    corners = np.array([low, high])[:, ::-1] * grid.resolution
    size = page.viewport_size
    assert size is not None
    aspect = (size["width"] - PANEL_PIXELS) / size["height"]
    position, look_at = stand(bounds_of(grid.origin.transform_points(corners)), aspect)
    forward = (look_at - position) / np.linalg.norm(look_at - position)
    right = np.array([1.0, 0.0, 0.0])
    ray = np.array([*point, 0.0]) - position
    box = page.locator("canvas[data-engine]").bounding_box()
    assert box is not None
    scale = 0.5 * box["height"] / math.tan(0.5 * FIELD_OF_VIEW) / float(ray @ forward)
    up = float(ray @ np.cross(right, forward))
    return (
        box["x"] + 0.5 * box["width"] + scale * float(ray @ right),
        box["y"] + 0.5 * box["height"] - scale * up,
    )


def drag(page: Page, start: tuple[float, float], end: tuple[float, float]) -> None:
    """Press, drag and release between two points of the floor, as slowly as a person."""
    page.mouse.move(*pixel_of(page, start))
    page.mouse.down()
    page.mouse.move(*pixel_of(page, end), steps=12)
    page.mouse.up()


def test_go_to_with_the_mouse_and_the_robot_arrives(
    page: Page, shown: "Shown", pictures: Path
) -> None:
    page.get_by_role("button", name="Go to …").click()
    expect(page.get_by_text("Press where to go")).to_be_visible()
    drag(page, PLACE, TOWARDS)

    def goal_state() -> str:
        goal = shown.robot.latest(topics.GOAL)
        return "" if goal is None else goal.state

    wait_until(lambda: goal_state() == "driving", 20.0, "the robot sets off")
    page.screenshot(path=pictures / "driving.png", timeout=60_000)
    wait_until(lambda: goal_state() in ("arrived", "failed"), 60.0, "the robot gets there")
    expect(page.get_by_text("It is at the place that was pointed out")).to_be_visible()
    page.screenshot(path=pictures / "arrived.png", timeout=60_000)
    truth = shown.robot.latest(topics.SIM_TRUTH)
    assert truth is not None
    assert truth.collisions == 0
    assert math.dist((truth.pose.x, truth.pose.y), PLACE) < 0.15
    assert abs(wrap_angle(truth.pose.yaw - math.pi / 4)) < 0.15


def test_stop_is_in_sight_whatever_tab_is_open(page: Page) -> None:
    for tab in ("Tours", "Map", "More", "Go"):
        page.get_by_role("tab", name=tab).click()
        expect(page.get_by_role("button", name="STOP")).to_be_in_viewport(ratio=1)
        expect(page.get_by_role("button", name="Resume")).to_be_in_viewport(ratio=1)


def test_stop_stops_and_resume_lets_it_drive_again(page: Page, shown: "Shown") -> None:
    def mode() -> str:
        base = shown.robot.latest(topics.BASE)
        return "" if base is None else base.mode

    page.get_by_role("button", name="STOP").click()
    wait_until(lambda: mode() == "stopped", 10.0, "base is stopped")
    expect(page.get_by_text("It is stopped. Press Resume to let it drive again.")).to_be_visible()
    page.get_by_role("button", name="Resume").click()
    wait_until(lambda: mode() == "ok", 10.0, "base may drive again")


def test_a_stop_that_nobody_answers_is_repeated_and_says_so(page: Page, shown: "Shown") -> None:
    shown.demo.kill_service("base")
    page.get_by_role("button", name="STOP").click()
    expect(page.get_by_text("NOT STOPPED: no connection")).to_be_visible()

    def is_stopped() -> bool:
        base = shown.robot.latest(topics.BASE)
        return base is not None and base.mode == "stopped"

    wait_until(is_stopped, 30.0, "base is back, and stopped")
    expect(page.get_by_text("NOT STOPPED")).to_have_count(0)
