"""Tours as people make and drive them: a real browser, a mouse, and the demo's robot."""

from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from playwright.sync_api import Page, expect
from support.waiting import wait_until

from trolley import topics

from .seeing import pixel_of, wait_for_frames
from .test_viewer import PLACE

if TYPE_CHECKING:
    from .conftest import Shown

pytestmark = [pytest.mark.slow, pytest.mark.browser]


def choose(page: Page, label: str, option: str) -> None:
    """Choose from a list."""
    page.get_by_label(label, exact=True).locator("visible=true").select_option(option)


def button(page: Page, name: str, *, exact: bool = True) -> None:
    """Press a button."""
    page.get_by_role("button", name=name, exact=exact).click()


def stored(shown: "Shown") -> list[str]:
    tours = shown.robot.latest(topics.TOURS)
    return sorted(one.name for one in (tours.tours if tours is not None else []))


def last_trip(shown: "Shown") -> tuple[str | None, str]:
    status = shown.robot.latest(topics.TOUR)
    return (None, "") if status is None else (status.name, status.state)


def test_a_tour_is_made_driven_and_found_in_the_history(
    page: Page, shown: "Shown", pictures: Path
) -> None:
    page.get_by_role("tab", name="Tours").click()
    button(page, "New tour")
    expect(page.get_by_text("Add at least one place.")).to_be_visible()
    expect(page.get_by_role("button", name="Save", exact=True)).to_be_disabled()
    page.get_by_label("Name", exact=True).locator("visible=true").fill("evening")
    button(page, "Point on the map")
    expect(page.get_by_text("Press where it should stop")).to_be_visible()
    wait_for_frames(page)
    page.mouse.click(*pixel_of(page, PLACE))
    expect(page.get_by_role("button", name="1 a point on the map")).to_be_visible()
    choose(page, "Add place", "start")
    expect(page.get_by_role("button", name="2 start", exact=True)).to_be_visible()
    page.get_by_label("Stay (s)").fill("1")
    expect(page.get_by_role("button", name="2 start · stays 1 s")).to_be_visible()
    page.screenshot(path=pictures / "tour-editor.png")
    button(page, "Save")
    wait_until(lambda: "evening" in stored(shown), "the tour is saved")

    starts = page.get_by_role("button", name="Start", exact=True)
    expect(starts).to_have_count(2)  # the other tour is the demo's own
    starts.last.click()
    wait_until(lambda: last_trip(shown) == ("evening", "done"), "the tour is driven")
    expect(page.get_by_text("stop 1 reached")).to_be_visible()
    expect(page.get_by_text("start reached")).to_be_visible()
    expect(page.get_by_text("Last tour: “evening”")).to_be_visible()

    button(page, "Past trips")
    trip = page.locator("summary", has_text="evening")
    expect(trip).to_contain_text("2 of 2 stops")
    trip.click()
    results = page.locator("details").filter(has=trip)  # other files drive trips, too
    expect(results.get_by_text("start reached")).to_be_visible()
    page.screenshot(path=pictures / "past-trips.png")


def test_a_deleted_tour_comes_back(page: Page, shown: "Shown") -> None:
    page.get_by_role("button", name="Delete", exact=True).last.click()
    wait_until(lambda: "evening" not in stored(shown), "the tour is deleted")
    button(page, "Undo: Delete the tour evening")
    wait_until(lambda: "evening" in stored(shown), "the tour is back")
