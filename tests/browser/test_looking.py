"""What an engineer looks at, and what is seen in the picture itself."""

import io
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Page, expect
from support.waiting import wait_until

from trolley import topics
from trolley.geometry import Pose2D
from trolley.messages import Marker, Overlay, OverlayRule

from .test_viewer import button, drag, field

if TYPE_CHECKING:
    from .conftest import Shown

pytestmark = [pytest.mark.slow, pytest.mark.browser]

MAGENTA = (1.0, 0.0, 1.0, 1.0)


def num_magenta(page: Page) -> int:
    """How many pixels of the page are as no part of it is."""
    picture = Image.open(io.BytesIO(page.screenshot(timeout=60_000))).convert("RGB")
    red, green, blue = np.asarray(picture).astype(int).transpose(2, 0, 1)
    return int(((red > 120) & (blue > 120) & (green < 0.4 * red)).sum())


def poll(page: Page, happened: Callable[[], bool], what: str) -> None:
    """As `wait_until`, but leaves the browser time to draw."""
    for _ in range(40):
        if happened():
            return
        page.wait_for_timeout(250)
    raise AssertionError(what)


def pose_error(shown: "Shown") -> float:
    """How far the robot is from where it thinks it is [m], turning counted at 0.3 m."""
    truth, estimate = shown.robot.latest(topics.SIM_TRUTH), shown.robot.latest(topics.POSE)
    assert truth is not None
    if estimate is None or estimate.pose is None or estimate.state != "localized":
        return math.inf
    away = truth.pose.inverse() @ estimate.pose
    return math.hypot(away.x, away.y) + 0.3 * abs(away.yaw)


def test_a_pose_is_set_with_an_arrow_and_found_without(page: Page, shown: "Shown") -> None:
    truth = shown.robot.latest(topics.SIM_TRUTH)
    assert truth is not None
    x, y, yaw = truth.pose.x, truth.pose.y, truth.pose.yaw + 0.15
    button(page, "Set pose …").click()
    expect(page.locator("#trolley-hint")).to_contain_text("Press where the robot is")
    drag(page, (x, y), (x + 0.8 * math.cos(yaw), y + 0.8 * math.sin(yaw)))
    expect(page.get_by_role("button", name="Undo: Set pose")).to_be_visible()
    wait_until(lambda: pose_error(shown) < 0.2, 30.0, "it is localized from a rough arrow")
    button(page, "Find yourself").click()
    wait_until(lambda: pose_error(shown) < 0.2, 60.0, "it finds itself with no arrow at all")
    expect(page.get_by_text("Localized").first).to_be_visible()


def test_frames_distances_and_layers(page: Page, shown: "Shown", pictures: Path) -> None:
    page.get_by_role("tab", name="More").click()
    page.get_by_text("Frames", exact=True).click()
    expect(page.get_by_label("base_link")).to_be_visible()
    expect(page.get_by_role("cell", name="odom").first).to_be_visible()
    page.get_by_text("Distance and angle", exact=True).click()
    here = shown.robot.latest(topics.POSE)
    assert here is not None
    assert here.pose is not None
    distance = math.hypot(here.pose.x, here.pose.y)
    row = page.get_by_role("row", name="Distance").first
    expect(row).to_be_visible()
    assert float(row.inner_text().split()[1]) == pytest.approx(distance, abs=0.05)
    page.get_by_text("Layers: Senses", exact=True).click()
    particles = page.get_by_label("Particles")
    expect(particles).to_be_checked()
    particles.uncheck()
    page.screenshot(path=pictures / "more.png", timeout=60_000)
    page.reload()
    page.get_by_text("Localized").first.wait_for()
    page.get_by_role("tab", name="More").click()
    expect(page.get_by_label("Particles")).not_to_be_checked()  # the folder is still open, too
    page.get_by_label("Particles").check()
    for folder in ("Layers: Senses", "Distance and angle", "Frames"):
        page.get_by_text(folder, exact=True).click()
    page.get_by_role("tab", name="Go").click()


def test_markers_are_in_the_picture_until_they_are_deleted(
    page: Page, shown: "Shown", pictures: Path
) -> None:
    before = num_magenta(page)
    cube = Marker(
        kind="cube", pose=Pose2D(2.0, 0.0, 0.0), z=0.3, size=(1.0, 1.0, 0.6), color=MAGENTA
    )
    shown.robot.put_marker("seen", "cube", cube)
    poll(page, lambda: num_magenta(page) > before + 500, "the cube is seen")
    page.screenshot(path=pictures / "cube.png", timeout=60_000)
    shown.robot.delete_marker("seen")
    poll(page, lambda: num_magenta(page) < before + 50, "the cube is gone")


def test_a_rule_over_distance_and_signed_bearing_says_how_things_are(
    page: Page, shown: "Shown"
) -> None:
    rules = [
        OverlayRule(bearing_min=math.pi / 10, bearing_max=-math.pi / 10, text="OtherWayRound"),
        OverlayRule(distance_min=10.0, text="FarAway"),
        OverlayRule(distance_max=10.0, text="CloseBy, {distance} m"),
    ]
    source = "tf:base_link/place:kitchen:distance"
    shown.robot.put_overlay("rule", Overlay(kind="text", source=source, rules=rules))
    text = page.locator(".ov-card[data-name=rule] .ov-text")
    here, place = shown.robot.latest(topics.POSE), shown.robot.latest(topics.POSES)
    assert here is not None
    assert here.pose is not None
    assert place is not None
    kitchen = next(one.pose for one in place.poses if one.name == "kitchen")
    seen = here.pose.inverse() @ kitchen
    is_ahead = abs(math.atan2(seen.y, seen.x)) < math.pi / 10
    expect(text).to_contain_text("CloseBy" if is_ahead else "OtherWayRound")
    shown.robot.delete_overlay("rule")
    expect(text).to_have_count(0)


def test_a_number_of_any_topic_is_plotted(page: Page, pictures: Path) -> None:
    page.get_by_role("tab", name="More").click()
    page.get_by_text("Plot", exact=True).click()
    field(page, "Value").fill("odom:twist.vx")
    field(page, "Value").press("Enter")
    expect(page.locator(".trolley-plot polyline").first).to_be_attached()
    page.screenshot(path=pictures / "plot.png", timeout=60_000)
    page.get_by_text("Plot", exact=True).click()
    page.get_by_role("tab", name="Go").click()
