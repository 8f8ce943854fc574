"""The map changed with mouse and fingers in a real browser, and what the robot makes of it."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect
from support.waiting import wait_until

from trolley import topics

from .seeing import wait_for_frames
from .test_viewer import pixel_of
from .test_zones import open_map

if TYPE_CHECKING:
    from .conftest import Shown

pytestmark = [pytest.mark.slow, pytest.mark.browser]


def walls(shown: "Shown", name: str) -> int:
    """How many cells of the map are wall; 0 while the robot is on another one."""
    grid = shown.robot.latest(topics.MAP)
    if grid is None or grid.name != name:
        return 0
    return int((np.frombuffer(grid.cells, np.int8) == 100).sum())


@pytest.fixture
def page(shown: "Shown", browser: Browser) -> Iterator[Page]:
    page = open_map(browser, shown.url, touch=True)
    yield page
    page.context.close()


def test_a_wall_is_drawn_seen_stored_and_taken_back(
    page: Page, shown: "Shown", pictures: Path
) -> None:
    before = walls(shown, "apartment")
    page.get_by_text("Edit map").tap()
    page.get_by_role("button", name="Change this map").tap()
    page.get_by_role("button", name="Wall", exact=True).tap()
    expect(page.get_by_text("Drag from one end of the wall")).to_be_visible()
    wait_for_frames(page)
    page.mouse.move(*pixel_of(page, (1.4, 0.9)))
    page.mouse.down()
    page.mouse.move(*pixel_of(page, (2.4, 0.9)), steps=6)
    page.mouse.up()
    expect(page.get_by_text("1 step")).to_be_visible()
    page.screenshot(path=pictures / "map-wall.png")
    save = page.get_by_role("button", name="Save as new version")
    save.tap()
    expect(page.get_by_text("which is never overwritten")).to_be_visible()
    save.tap()
    wait_until(lambda: walls(shown, "apartment-2") > 0, "the robot is on the new map")
    assert walls(shown, "apartment-2") > before + 15
    page.get_by_role("button", name="Back to the previous version").tap()
    wait_until(lambda: walls(shown, "apartment") == before, "the robot is on the old map")
