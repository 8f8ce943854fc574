"""What an engineer looks at, and what is seen in the picture itself."""

import math
import os
import re
import signal
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from playwright.sync_api import Page, expect
from support.waiting import wait_until

from trolley import topics
from trolley.geometry import Pose2D
from trolley.messages import Marker, Overlay, OverlayRule

from .seeing import Colour, is_blue, is_green, is_magenta, picture, poll, share_seen
from .test_viewer import button, drag, field, goal_state

if TYPE_CHECKING:
    from .conftest import Shown

pytestmark = [pytest.mark.slow, pytest.mark.browser]

AWAY, BEYOND = (5.9, 0.3), (5.9, -0.4)
"""A place on open floor [m] with nothing drawn there, and where to look from it."""
MAGENTA = (1.0, 0.0, 1.0, 1.0)


def num_magenta(page: Page) -> int:
    return int(is_magenta(picture(page)).sum())


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
    expect(page.locator("#hint")).to_contain_text("Press where the robot is")
    drag(page, (x, y), (x + 0.8 * math.cos(yaw), y + 0.8 * math.sin(yaw)))
    expect(page.get_by_role("button", name="Undo: Set pose")).to_be_visible()
    wait_until(lambda: pose_error(shown) < 0.2, "it is localized from a rough arrow")
    button(page, "Find position").click()
    wait_until(lambda: pose_error(shown) < 0.2, "it finds itself with no arrow at all")
    expect(page.get_by_text("Localized").first).to_be_visible()


def test_the_footprint_is_seen_where_the_robot_is_and_where_it_goes(
    page: Page, shown: "Shown", pictures: Path
) -> None:
    robot, here = shown.robot.latest(topics.ROBOT), shown.robot.latest(topics.POSE)
    assert robot is not None
    assert here is not None
    assert here.pose is not None
    start = here.pose
    corners = np.array(robot.footprint)
    outline = np.concatenate([corners, 0.5 * (corners + np.roll(corners, -1, axis=0))])

    def seen(pose: Pose2D, colour: Colour) -> float:
        points = pose.transform_points(outline).tolist()
        return share_seen(page, points, colour)

    poll(page, lambda: seen(start, is_blue) > 0.6, "the footprint where it stands")
    button(page, "Go to …").click()
    expect(page.locator("#hint")).to_contain_text("Press where it should go")
    drag(page, AWAY, BEYOND)

    def truth() -> Pose2D:
        found = shown.robot.latest(topics.SIM_TRUTH)
        assert found is not None
        return found.pose

    wait_until(lambda: truth().distance_to(start) > 1.0, "it is on its way")
    button(page, "Pause").click()
    wait_until(lambda: goal_state(shown) == "paused", "it stands on its way")
    goal = shown.robot.latest(topics.GOAL)
    assert goal is not None
    aim = goal.pose
    assert aim is not None
    poll(page, lambda: seen(aim, is_green) > 0.7, "the footprint at the goal")
    poll(page, lambda: seen(truth(), is_blue) > 0.6, "the footprint came along")
    assert seen(start, is_blue) < 0.5  # the way that is left begins here, in blue as well
    page.screenshot(path=pictures / "footprints.png")
    button(page, "Cancel").click()
    poll(page, lambda: seen(aim, is_green) < 0.2, "there is no goal any more")


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

    def says_the_distance() -> bool:
        found = re.search(r"\d+\.\d+", row.inner_text())
        return found is not None and abs(float(found[0]) - distance) < 0.05

    poll(page, says_the_distance, "the distance is that of the robot")
    page.get_by_text("Layers: Sensing", exact=True).click()
    particles = page.get_by_label("Particles")
    expect(particles).to_be_checked()
    particles.uncheck()
    page.screenshot(path=pictures / "more.png")
    page.reload()
    page.get_by_text("Localized").first.wait_for()
    page.get_by_role("tab", name="More").click()
    expect(page.get_by_label("Particles")).not_to_be_checked()  # the folder is still open, too
    page.get_by_label("Particles").check()
    for folder in ("Layers: Sensing", "Distance and angle", "Frames"):
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
    page.screenshot(path=pictures / "cube.png")
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
    expect(page.locator(".plot polyline").first).to_be_attached()
    page.screenshot(path=pictures / "plot.png")
    page.get_by_text("Plot", exact=True).click()
    page.get_by_role("tab", name="Go").click()


def test_a_part_that_hangs_is_named_and_nothing_is_made_up(page: Page, shown: "Shown") -> None:
    services = shown.demo.children()
    button(page, "start").click()
    wait_until(lambda: goal_state(shown) == "arrived", "it is at the start")
    os.kill(services["localizer"], signal.SIGSTOP)
    try:
        expect(page.get_by_text("The robot does not know where it is").first).to_be_visible()
        page.get_by_role("tab", name="Map").click()
        field(page, "Name").fill("nowhere")
        button(page, "Save where the robot is").click()
        expect(page.get_by_text("Not saved")).to_be_visible()
    finally:
        os.kill(services["localizer"], signal.SIGCONT)
    expect(page.get_by_text("Localized").first).to_be_visible()
    field(page, "Name").fill("")
    page.get_by_role("tab", name="Go").click()
    saved = shown.robot.latest(topics.POSES)
    assert saved is not None
    assert "nowhere" not in {one.name for one in saved.poses}
    os.kill(services["planner"], signal.SIGSTOP)
    try:
        expect(page.get_by_text("the planner is not running").first).to_be_visible()
        expect(button(page, "kitchen")).to_be_disabled()
    finally:
        os.kill(services["planner"], signal.SIGCONT)
    expect(button(page, "kitchen")).to_be_enabled()


def test_a_localizer_that_died_comes_back_where_it_was(page: Page, shown: "Shown") -> None:
    dead = shown.demo.children()["localizer"]
    shown.demo.kill_service("localizer")
    wait_until(lambda: shown.demo.children().get("localizer", dead) != dead, "it was started again")
    expect(page.get_by_text("Localized").first).to_be_visible()
    wait_until(lambda: pose_error(shown) < 0.2, "it is where it was, and has checked it")
