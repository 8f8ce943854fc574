"""The past in a real browser: a ghost where the robot was, and a failed stop's moment."""

from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from playwright.sync_api import Page, expect
from support.waiting import wait_until

from trolley import requests, topics
from trolley.geometry import Pose2D
from trolley.messages import Stop, Tour
from trolley.messages.request_params import StartTour

from .conftest import START
from .seeing import Pixels, count_seen, is_blue, np, poll
from .test_viewer import FAR, button

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .conftest import Shown

pytestmark = [pytest.mark.slow, pytest.mark.browser]

NOWHERE = Pose2D(40.0, 40.0, 0.0)
"""Far from the map: no robot gets there."""
REACH_M = 0.35
NUM_SEEN = 15
"""A robot or a ghost covers more pixels than this."""


def is_pink(pixels: Pixels) -> "NDArray[np.bool_]":
    """As the ghost and its scan."""
    red, green, blue = np.moveaxis(pixels, -1, 0)
    return (red > green + 60) & (red > blue + 25) & (blue > green + 20)


def num_pink(page: Page, point: tuple[float, float]) -> int:
    return count_seen(page, point, is_pink, REACH_M)


def truth(shown: "Shown") -> Pose2D:
    found = shown.robot.latest(topics.SIM_TRUTH)
    assert found is not None
    return found.pose


def test_who_looks_back_sees_where_the_robot_was(
    page: Page, shown: "Shown", pictures: Path
) -> None:
    start = (START.x, START.y)
    page.wait_for_timeout(3000)
    assert shown.robot.go_to(Pose2D(*FAR, 0.0), timeout=90.0).state == "arrived"
    button(page, "Past").click()
    slider = page.get_by_label("Time of day")
    expect(slider).to_be_visible()
    without, with_robot = num_pink(page, start), count_seen(page, FAR, is_blue, REACH_M)
    slider.focus()
    page.keyboard.press("Home")
    expect(page.locator("#sentence")).to_contain_text(" ago: ")
    expect(page.locator("#lines")).to_contain_text("Now: It has arrived")
    poll(
        page,
        lambda: num_pink(page, start) > without + NUM_SEEN,
        "the ghost stands where the robot began",
    )
    page.screenshot(path=pictures / "past.png")
    # What else is blue there stays.
    poll(
        page,
        lambda: count_seen(page, FAR, is_blue, REACH_M) < with_robot - NUM_SEEN,
        "the robot is not where it is now",
    )
    button(page, "Now").click()
    poll(
        page,
        lambda: count_seen(page, FAR, is_blue, REACH_M) > with_robot - NUM_SEEN,
        "the robot is seen",
    )
    poll(page, lambda: num_pink(page, start) < without + NUM_SEEN, "the ghost is gone")


def test_a_failed_stop_leads_to_its_moment(page: Page, shown: "Shown", pictures: Path) -> None:
    stops = [
        Stop(pose=Pose2D(*FAR, 0.0)),
        Stop(pose=NOWHERE, on_failure="skip"),
        Stop(name="start"),
    ]
    shown.robot.ask(requests.TOUR_START, StartTour(tour=Tour(stops=stops)))

    def is_done() -> bool:
        status = shown.robot.latest(topics.TOUR)
        return status is not None and (status.state, len(status.results)) == ("done", 3)

    wait_until(is_done, "the tour is driven")
    page.get_by_role("tab", name="Tours").click()
    button(page, "Past trips").click()
    page.locator("summary", has_text="2 of 3 stops").first.click()
    button(page, "Show the moment").first.click()
    expect(page.locator("#sentence")).to_contain_text("outside the map; skipped.")
    poll(page, lambda: num_pink(page, FAR) > NUM_SEEN, "the ghost stands where it failed")
    assert truth(shown).distance_to(Pose2D(*FAR, 0.0)) > 2.0
    page.screenshot(path=pictures / "past-moment.png")
    page.set_viewport_size({"width": 390, "height": 780})
    expect(page.get_by_label("Time of day")).to_be_visible()
    page.screenshot(path=pictures / "past-phone.png")
    button(page, "Close the past").click()
    expect(page.get_by_label("Time of day")).to_be_hidden()
