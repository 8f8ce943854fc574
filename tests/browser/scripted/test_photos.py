"""Photos of stops among the past trips: seen where a trip is opened, and not loaded before."""

import io
from pathlib import Path

import pytest
from PIL import Image
from playwright.sync_api import Page, expect
from support.waiting import wait_until

from trolley.messages import PastTrip, StopResult
from trolley_viz.controls.controls import Controls
from trolley_viz.features.tours.past_trips import trips_html
from trolley_viz.robots.past_trips import PastTrips

from .viewer import Viewer

pytestmark = pytest.mark.browser

SIZES = {"desktop": (1280, 800), "phone": (390, 844)}


def jpeg(colour: tuple[int, int, int]) -> bytes:
    """A picture of 640 x 480 with a box before a wall."""
    picture = Image.new("RGB", (640, 480), colour)
    picture.paste((230, 220, 200), (0, 300, 640, 480))
    picture.paste((120, 80, 40), (220, 200, 420, 400))
    data = io.BytesIO()
    picture.save(data, "JPEG")
    return data.getvalue()


def trip() -> PastTrip:
    return PastTrip(
        trip="t1",
        name="evening",
        state="done",
        map="home",
        planned=3,
        reached=2,
        missed=1,
        seconds=75.0,
        results=[
            StopResult(stop=0, name="hall", state="reached"),
            StopResult(stop=1, name="cellar", state="skipped", code="blocked"),
            StopResult(stop=2, name="kitchen", state="reached"),
        ],
        photos=["t1-0", "", "t1-2"],
    )


def show(viewer: Viewer) -> None:
    past = PastTrips(lambda *_: None)
    past.trips = (trip(),)
    controls = Controls()
    with controls.add_tabs().add_tab("Tours", "route"):
        controls.add_html(trips_html(past, past.trips, robot="r"))
    viewer.photos = {"t1-0": jpeg((90, 120, 160)), "t1-2": jpeg((150, 170, 120))}
    viewer.greet()
    viewer.tell_controls(controls)


def width_of(page: Page, number: int) -> int:
    return page.locator(".photo img").nth(number).evaluate("one => one.naturalWidth")


def test_photos_are_loaded_when_their_trip_is_opened(page: Page, viewer: Viewer) -> None:
    show(viewer)
    summary = page.locator("summary", has_text="evening")
    expect(summary).to_be_visible()
    assert viewer.asked == []
    summary.click()
    photos = page.get_by_role("link", name="Photo of the stop")
    expect(photos).to_have_count(2)
    for number in range(2):
        photos.nth(number).scroll_into_view_if_needed()
        wait_until(lambda number=number: width_of(page, number) == 640, "it is loaded")
    assert sorted(viewer.asked) == ["t1-0", "t1-2"]
    with page.expect_popup() as opened:
        photos.first.click()
    assert opened.value.url.endswith("/photo/r/t1-0")


@pytest.mark.parametrize("look", ["light", "dark"])
@pytest.mark.parametrize("size", SIZES)
def test_a_photo_fits_into_its_panel(
    page: Page, viewer: Viewer, pictures: Path, size: str, look: str
) -> None:
    width, height = SIZES[size]
    page.set_viewport_size({"width": width, "height": height})
    show(viewer)
    viewer.tell_state(dark=look == "dark")
    page.locator("summary", has_text="evening").click()
    expect(page.locator("html")).to_have_attribute("data-look", look)
    photo = page.locator(".photo").first
    photo.scroll_into_view_if_needed()
    wait_until(lambda: width_of(page, 0) == 640, "it is loaded")
    box = photo.bounding_box()
    assert box is not None
    assert box["x"] >= 0.0
    assert box["x"] + box["width"] <= width
    assert 200.0 <= box["width"] <= 320.0
    assert box["width"] / box["height"] == pytest.approx(4 / 3, rel=0.02)
    page.screenshot(path=pictures / f"photos-{size}-{look}.png")
