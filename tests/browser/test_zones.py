"""Zones drawn with mouse, keys and fingers in a real browser, and what the robot makes of them."""

import itertools
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from playwright.sync_api import Browser, Locator, Page, expect
from support.waiting import wait_until

from trolley import requests, topics
from trolley.geometry import Pose2D
from trolley.geometry.polygon import polygon_contains
from trolley.messages import Path as Way
from trolley.messages import SuspectLine, Suspects, Zone, floats_from_bytes
from trolley.messages.request_params import Named, SendGoal

from .conftest import open_page, open_viewer
from .seeing import pixel_of, wait_for_frames

if TYPE_CHECKING:
    from .conftest import Shown

pytestmark = [pytest.mark.slow, pytest.mark.browser]

GOAL = Pose2D(2.4, 0.4, 0.0)
"""In the room where the robot stands; the straight way there leads through `ACROSS`."""
ACROSS = [(1.4, 0.0), (1.7, 0.0), (1.7, 0.6), (1.4, 0.6)]


def open_map(browser: Browser, url: str, *, touch: bool) -> Page:
    """A page with the tab of the map open; small, as it is drawn in software."""
    page = open_page(browser, 1120, 640, has_touch=touch)
    page.bring_to_front()  # one in the background draws no frames
    open_viewer(page, url)
    page.get_by_role("tab", name="Map").click()
    expect(page.get_by_role("button", name="Mirror")).to_be_visible()
    page.wait_for_timeout(2500)  # by then the view is mended if the page was laid out late
    return page


@pytest.fixture(scope="module")
def page(shown: "Shown", browser: Browser) -> Iterator[Page]:
    page = open_map(browser, shown.url, touch=False)
    yield page
    page.context.close()


def zones(shown: "Shown") -> dict[str, Zone]:
    message = shown.robot.latest(topics.ZONES)
    return {} if message is None else {zone.name: zone for zone in message.zones}


def way(shown: "Shown") -> np.ndarray:
    """The way that the planner would drive now (n, 2) [m]."""
    reply: Way = shown.robot.ask(requests.GOAL_PREVIEW, SendGoal(pose=GOAL))
    return floats_from_bytes(reply.poses, 3)[:, :2]


def crosses(points: np.ndarray) -> bool:
    fine = np.concatenate([np.linspace(a, b, 20) for a, b in itertools.pairwise(points)])
    return bool(polygon_contains(np.array(ACROSS), fine).any())


def name_field(page: Page) -> Locator:
    """The field of the name of the zone that is drawn or changed."""
    return page.locator(".control.folder", has=page.get_by_text("Zones")).get_by_label("Name")


def near(points: list[tuple[float, float]], wanted: list[tuple[float, float]]) -> None:
    np.testing.assert_allclose(points, wanted, atol=0.08)


def test_a_no_go_area_drawn_across_the_way_is_driven_round(
    page: Page, shown: "Shown", pictures: Path
) -> None:
    assert crosses(way(shown))
    page.get_by_role("button", name="No-go").click()
    expect(page.get_by_text("Tap the corners one by one")).to_be_visible()
    wait_for_frames(page)
    for corner in ACROSS:
        page.mouse.click(*pixel_of(page, corner))
        wait_for_frames(page)
    page.screenshot(path=pictures / "zone-drawn.png")
    page.keyboard.press("Enter")
    wait_until(lambda: "no-go area 1" in zones(shown), "the zone is stored")
    near(zones(shown)["no-go area 1"].points, ACROSS)
    wait_until(lambda: not crosses(way(shown)), "the planner goes round")


def test_it_is_picked_moved_renamed_and_all_of_it_undone(
    page: Page, shown: "Shown", pictures: Path
) -> None:
    before = zones(shown)["no-go area 1"]
    page.get_by_role("button", name="Choose on the map").click()
    expect(page.get_by_text("Tap a zone on the map")).to_be_visible()
    wait_for_frames(page)
    page.mouse.click(*pixel_of(page, (1.6, 0.45)))
    expect(page.get_by_role("button", name="Save", exact=True)).to_be_visible()
    page.screenshot(path=pictures / "zone-selected.png")
    wait_for_frames(page)
    # The handle stands above the floor, which is seen a little from the south.
    page.mouse.move(*pixel_of(page, (1.55, 0.37)))
    page.mouse.down()
    page.mouse.move(*pixel_of(page, (1.55, 1.37)), steps=10)
    page.mouse.up()
    moved = [(x, y + 1.0) for x, y in ACROSS]
    wait_until(lambda: zones(shown)["no-go area 1"] != before, "the zone is moved")
    near(zones(shown)["no-go area 1"].points, moved)
    name_field(page).fill("cat's <b>bed</b>")
    page.get_by_role("button", name="Save", exact=True).click()
    expect(page.get_by_text("may not contain")).to_be_visible()
    name_field(page).fill("Katzenkörbchen")
    page.get_by_role("button", name="Save", exact=True).click()
    wait_until(lambda: "Katzenkörbchen" in zones(shown), "the zone is renamed")
    page.get_by_role("button", name="Delete", exact=True).click()
    wait_until(lambda: "Katzenkörbchen" not in zones(shown), "the zone is deleted")
    for name in ("Katzenkörbchen", "no-go area 1"):
        page.get_by_role("button", name="Undo: ").click()
        wait_until(lambda name=name: name in zones(shown), f"{name} is back")
    page.get_by_role("button", name="Undo: ").click()
    wait_until(lambda: zones(shown)["no-go area 1"] == before, "it is where it was")
    page.get_by_role("button", name="Undo: ").click()
    wait_until(lambda: "no-go area 1" not in zones(shown), "it is gone")
    assert crosses(way(shown))


def test_escape_leaves_the_drawing(page: Page, shown: "Shown") -> None:
    page.get_by_role("button", name="Slow").click()
    expect(page.get_by_text("Tap the corners one by one")).to_be_visible()
    wait_for_frames(page)
    page.mouse.click(*pixel_of(page, ACROSS[0]))
    page.keyboard.press("Escape")
    expect(page.get_by_text("Tap the corners one by one")).to_have_count(0)
    assert "slow area 1" not in zones(shown)


def test_a_suspected_mirror_is_added_by_one_click(
    page: Page, shown: "Shown", pictures: Path
) -> None:
    robot = shown.robot
    points = [(3.1, 1.6), (3.1, 1.0)]
    with suspecting(shown, [SuspectLine(points=points, score=0.9)]):
        expect(page.get_by_text("There seems to be a mirror")).to_be_visible()
        page.screenshot(path=pictures / "suspect.png")
        before = zones(shown)
        page.get_by_role("button", name="Yes, add it").click()
        wait_until(lambda: len(zones(shown)) > len(before), "it is a zone now")
    (added,) = [zone for name, zone in zones(shown).items() if name not in before]
    robot.ask(requests.ZONES_DELETE, Named(name=added.name))
    assert added.kind == "mirror"
    near(added.points, points)
    with suspecting(shown, []):
        expect(page.get_by_text("There seems to be a mirror")).to_be_hidden()


@contextmanager
def suspecting(shown: "Shown", lines: list[SuspectLine]) -> Iterator[None]:
    """Suspect mirrors as the localizer would, which thinks otherwise now and then."""
    robot, is_over = shown.robot, threading.Event()

    def suspect() -> None:
        while not is_over.wait(0.05):
            suspects = Suspects(stamp_ns=robot.now_ns() or 0, lines=lines)
            robot.connection.publish(robot.name, topics.SUSPECTS, suspects)

    thread = threading.Thread(target=suspect)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()


def test_fingers_draw_a_mirror_on_the_wall(shown: "Shown", browser: Browser) -> None:
    page = open_map(browser, shown.url, touch=True)
    page.get_by_role("button", name="Mirror").tap()
    expect(page.get_by_text("Drag from one end to the other")).to_be_visible()
    wait_for_frames(page)
    # The wall at the right of the room has its face at x = 3.2.
    for corner in ((3.1, 0.5), (3.1, -0.3), (3.1, -0.3)):
        page.touchscreen.tap(*pixel_of(page, corner))
        wait_for_frames(page)
    wait_until(lambda: "mirror 1" in zones(shown), "the mirror is stored")
    start, end = zones(shown)["mirror 1"].points
    assert start[0] == pytest.approx(end[0], abs=1e-9)  # both on the face of the wall
    assert start[0] == pytest.approx(3.2, abs=0.03)
    page.context.close()
