"""What programs draw, in a real browser: panels over the scene, clicks on them, markers in it."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from playwright.sync_api import Browser, Page, expect
from support.waiting import PATIENCE_S

from trolley import topics
from trolley.geometry import Pose2D
from trolley.messages import Marker, Overlay, Transform

from .conftest import open_page, open_viewer
from .seeing import undrawn
from .test_for_everybody import SMALL_TARGETS, SMALLEST_PX

if TYPE_CHECKING:
    from .conftest import Shown

pytestmark = [pytest.mark.slow, pytest.mark.browser]

FRAME, CHILD = "nowhere", "test"
NUM_FAST = 200
COUNT_CHANGES = """() => {
  window.changes = 0;
  const fast = document.querySelector('.ov-card[data-name=fast] .ov-value').parentElement;
  new MutationObserver(() => window.changes++).observe(fast, {childList: true});
}"""
IS_ON_TOP = """(one) => {
  const { left, top, width, height } = one.getBoundingClientRect();
  one.style.pointerEvents = "auto";
  const seen = document.elementFromPoint(left + width / 2, top + height / 2);
  one.style.pointerEvents = "";
  return seen === one;
}"""
ARE_APART = """() => {
  const top = document.querySelector(".control.strip").getBoundingClientRect().top;
  const columns = [...document.querySelectorAll("#overlays .ov-column")];
  return columns.every((one) => one.getBoundingClientRect().bottom <= top);
}"""
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
    open_viewer(page, shown.url)
    page.locator(".ov-card").first.wait_for()
    yield page
    page.context.close()


def card(page: Page, name: str):
    return page.locator(f".ov-card[data-name={name}]")


def test_text_is_shown_and_what_it_smuggles_in_does_nothing(page: Page) -> None:
    expect(card(page, "text").locator("b")).to_have_text("Hello")
    expect(card(page, "text").locator(".ov-title")).to_have_text(ATTACK)
    assert page.locator("#overlays").locator("img, script").count() == 0
    assert page.evaluate("window.hacked") is None


def test_a_click_on_a_menu_reaches_the_program(page: Page, shown: "Shown") -> None:
    with shown.robot.subscribe(topics.CHOICE, "mode") as choices:
        card(page, "mode").get_by_role("button", name="Search").click()
        heard = choices.next(PATIENCE_S)
    assert heard is not None
    assert (heard.message.index, heard.message.item) == (1, "Search")
    expect(card(page, "mode").locator("[aria-pressed=true]")).to_have_text("Search")


def test_gauge_and_plot_show_where_the_robot_is(page: Page, shown: "Shown", pictures: Path) -> None:
    expect(card(page, "gauge").locator(".ov-big")).to_contain_text("°")
    expect(card(page, "plot").locator("polyline").first).to_be_attached()
    expect(card(page, "plot").locator(".ov-value")).to_contain_text(" m")
    page.screenshot(path=pictures / "drawings.png")
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
    stop = page.get_by_role("button", name="STOP").bounding_box()
    assert stop is not None
    bottoms = page.evaluate(
        "[...document.querySelectorAll('.ov-card')].map((c) => c.getBoundingClientRect().bottom)"
    )
    assert len(bottoms) == 4
    assert max(bottoms) <= stop["y"]


def test_panels_have_large_targets_and_lie_below_the_hint(page: Page) -> None:
    assert page.evaluate(SMALL_TARGETS, SMALLEST_PX) == []
    page.get_by_role("button", name="Set pose …").click()
    expect(page.locator("#hint")).to_contain_text("Press where the robot is")
    assert page.locator("#hint").evaluate(IS_ON_TOP)
    page.keyboard.press("Escape")
    expect(page.locator("#hint")).to_be_hidden()


def test_panels_leave_the_past_free_on_a_tablet(page: Page) -> None:
    size = page.viewport_size
    assert size is not None
    page.set_viewport_size({"width": 1024, "height": 768})
    with undrawn(page):
        page.get_by_role("button", name="Past", exact=True).click()
        slider = page.get_by_label("Time of day")
        expect(slider).to_be_visible()
        assert slider.evaluate(IS_ON_TOP)
        assert page.evaluate(ARE_APART)
        page.get_by_role("button", name="Close the past").click()
        expect(slider).to_be_hidden()
    page.set_viewport_size(size)


def test_a_menu_marks_what_the_robot_is_doing(page: Page, shown: "Shown", pictures: Path) -> None:
    robot = shown.robot
    states = ["idle", "driving", "arrived", "canceled"]
    before = robot.latest(topics.GOAL)
    assert before is not None
    robot.put_overlay(
        "state", Overlay(kind="menu", title="The robot", source="goal:state", items=states)
    )
    marked = card(page, "state").locator("[aria-pressed=true]")
    expect(marked).to_have_text(before.state)
    robot.go_to("kitchen", wait=False)
    expect(marked).to_have_text("driving")
    page.screenshot(path=pictures / "state-panel.png")
    robot.cancel()
    expect(marked).to_have_text("canceled")
    robot.delete_overlay("state")


def test_every_message_counts_but_the_page_is_brought_up_to_date_seldom(
    page: Page, shown: "Shown"
) -> None:
    robot = shown.robot

    def tell(value: int) -> None:
        stamp_ns = robot.now_ns() or 0
        pose = Pose2D(float(value), 0.0, 0.0)
        link = Transform(stamp_ns=stamp_ns, parent=FRAME, child=CHILD, pose=pose)
        robot.connection.publish(robot.name, topics.TF, link, CHILD)

    robot.put_overlay("fast", Overlay(kind="plot", source=f"tf/{CHILD}:pose.x", place="bottom"))
    robot.put_overlay("lost", Overlay(kind="text", source=f"tf:map/{CHILD}:distance"))
    value = card(page, "fast").locator(".ov-value")
    expect(card(page, "fast")).to_contain_text("No data yet")
    for first in range(round(10 * PATIENCE_S)):  # until it is listened to
        tell(-first)
        if value.is_visible() and value.inner_text().strip():
            break
        page.wait_for_timeout(100)
    expect(card(page, "lost")).to_contain_text(FRAME)  # it is named as what is missing
    page.evaluate(COUNT_CHANGES)
    started_s = time.monotonic()
    for i in range(1, NUM_FAST + 1):
        tell(i)
        time.sleep(max(0.0, started_s + 0.01 * i - time.monotonic()))
    expect(value).to_contain_text(f"{NUM_FAST}")
    seconds = time.monotonic() - started_s
    assert page.evaluate("window.changes") <= 5.5 * seconds + 2.0
    with page.expect_download() as download:
        card(page, "fast").get_by_role("button", name="CSV").click()
    rows = download.value.path().read_text(encoding="utf-8").splitlines()[1:]
    heard = [float(row.split(",")[1]) for row in rows]
    assert [one for one in heard if one > 0.0] == list(range(1, NUM_FAST + 1))


def test_what_is_deleted_goes(page: Page, shown: "Shown") -> None:
    shown.robot.delete_overlay("mode")
    expect(card(page, "mode")).to_have_count(0)
    shown.robot.delete_overlay()
    expect(page.locator(".ov-card")).to_have_count(0)
    shown.robot.delete_marker()
