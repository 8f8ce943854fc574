"""What programs draw, in a real browser: panels over the scene, clicks on them, markers in it."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from playwright.sync_api import Browser, Page, expect

from trolley import topics
from trolley.geometry import Pose2D
from trolley.messages import Marker, Overlay

from .conftest import open_page

if TYPE_CHECKING:
    from .conftest import Shown

pytestmark = [pytest.mark.slow, pytest.mark.browser]

ATTACK = '<img src=x onerror="window.hacked = 1"><script>window.hacked = 2</script>'


@pytest.fixture(scope="module")
def page(shown: "Shown", browser: Browser) -> Iterator[Page]:
    """A phone: the fewer pixels to draw in software, the more time for the rest."""
    robot = shown.robot
    robot.put_overlay("text", Overlay(kind="text", title=ATTACK, text=f"<b>Hello</b> you{ATTACK}"))
    robot.put_overlay("mode", Overlay(kind="menu", title="Mode", items=["Sleep", "Search", ATTACK]))
    distance = "tf:base_link/map:distance"
    robot.put_overlay("plot", Overlay(kind="plot", title="Distance", source=distance, unit="m"))
    bearing = "tf:base_link/map:bearing"
    robot.put_overlay("gauge", Overlay(kind="gauge", source=bearing, unit="°", min=-180, max=180))
    robot.put_marker("test", "ball", Marker(kind="sphere", pose=Pose2D(2.0, 1.0, 0.0), z=0.2))
    robot.put_marker("test", "icon", Marker(kind="icon", icon="fa-robot", frame="base_link", z=0.5))
    page = open_page(browser, 390, 844)
    page.goto(shown.url)
    page.get_by_role("alert").get_by_role("button").click()  # viser's word on slow graphics
    page.locator(".ov-card").first.wait_for()
    yield page
    page.context.close()


def card(page: Page, name: str):
    return page.locator(f".ov-card[data-name={name}]")


def test_text_is_shown_and_what_it_smuggles_in_does_nothing(page: Page) -> None:
    expect(card(page, "text").locator("b")).to_have_text("Hello")
    expect(card(page, "text").locator(".ov-title")).to_have_text(ATTACK)
    assert page.locator("#trolley-overlays").locator("img, script").count() == 0
    assert page.evaluate("window.hacked") is None


def test_a_click_on_a_menu_reaches_the_program(page: Page, shown: "Shown") -> None:
    with shown.robot.subscribe(topics.CHOICE, "mode") as choices:
        card(page, "mode").get_by_role("button", name="Search").click()
        heard = choices.next(180.0)
    assert heard is not None
    assert (heard.message.index, heard.message.item) == (1, "Search")
    expect(card(page, "mode").locator("[aria-pressed=true]")).to_have_text("Search")


def test_gauge_and_plot_show_where_the_robot_is(page: Page, shown: "Shown", pictures: Path) -> None:
    expect(card(page, "gauge").locator(".ov-big")).to_contain_text("°")
    expect(card(page, "plot").locator("polyline").first).to_be_attached()
    expect(card(page, "plot").locator(".ov-value")).to_contain_text(" m")
    page.screenshot(path=pictures / "drawings.png", timeout=60_000)
    with page.expect_download() as download:
        card(page, "plot").get_by_role("button", name="CSV").click()
    assert download.value.suggested_filename == "trolley-plot.csv"
    first, *rows = download.value.path().read_text(encoding="utf-8").splitlines()
    assert first == "stamp_ns,value"
    distance = shown.robot.pose().pose
    assert distance is not None
    assert float(rows[-1].split(",")[1]) == pytest.approx(
        (distance.x**2 + distance.y**2) ** 0.5, abs=0.05
    )


def test_panels_leave_stop_and_the_controls_free(page: Page) -> None:
    stop = page.get_by_role("button", name="STOP")
    for name in ("text", "mode", "plot", "gauge"):
        box = card(page, name).bounding_box()
        other = stop.bounding_box()
        assert box is not None
        assert other is not None
        assert box["y"] >= other["y"] + other["height"]


def test_what_is_deleted_goes(page: Page, shown: "Shown") -> None:
    shown.robot.delete_overlay("mode")
    expect(card(page, "mode")).to_have_count(0)
    shown.robot.delete_overlay()
    expect(page.locator(".ov-card")).to_have_count(0)
    shown.robot.delete_marker()
