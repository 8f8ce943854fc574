"""A list whose entries are dragged to another place."""

import pytest
from playwright.sync_api import Page, expect
from support.waiting import wait_until

from trolley_viz.controls.controls import Controls

from .viewer import Viewer

pytestmark = pytest.mark.browser
NAMES = ("1  hall", "2  kitchen", "3  porch")


@pytest.fixture
def shown_list(page: Page, viewer: Viewer) -> dict[str, int]:
    """The numbers of the entries, below a button that is none."""
    controls = Controls()
    controls.add_button("Add")
    entries = {name: controls.add_button(name) for name in NAMES}
    for entry in entries.values():
        entry.on_move(lambda by: None)
    viewer.greet()
    viewer.tell_controls(controls)
    expect(page.get_by_role("button", name=NAMES[-1])).to_be_visible()
    expect(page.locator("body")).to_have_attribute("data-line", "open")
    return {name: entry.id for name, entry in entries.items()}


def grip_at(page: Page, name: str) -> tuple[float, float]:
    box = page.get_by_role("button", name=name).locator(".grip").bounding_box()
    assert box is not None
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def drag(page: Page, name: str, onto: str, past_px: float) -> None:
    x, y = grip_at(page, name)
    to_y = grip_at(page, onto)[1] + past_px
    page.mouse.move(x, y)
    page.mouse.down()
    for share in (0.3, 0.6, 1.0):
        page.mouse.move(x, y + share * (to_y - y))
    page.mouse.up()


def moves(viewer: Viewer) -> list[tuple[int, object]]:
    pressed = [said.press for _, said in viewer.said if said.press is not None]
    return [(press.control, press.value) for press in pressed]


@pytest.mark.parametrize(
    ("name", "onto", "past_px", "by"),
    [
        (NAMES[2], NAMES[0], -4.0, -2),
        (NAMES[2], NAMES[1], -4.0, -1),
        (NAMES[0], NAMES[2], 40.0, 2),
    ],
)
def test_an_entry_goes_where_it_is_dragged(
    page: Page,
    viewer: Viewer,
    shown_list: dict[str, int],
    name: str,
    onto: str,
    past_px: float,
    by: int,
) -> None:
    drag(page, name, onto, past_px)
    wait_until(lambda: bool(moves(viewer)), "it is told")
    assert moves(viewer) == [(shown_list[name], by)]


def test_an_entry_that_comes_back_is_neither_moved_nor_pressed(
    page: Page, viewer: Viewer, shown_list: dict[str, int]
) -> None:
    drag(page, NAMES[1], NAMES[1], 10.0)
    page.get_by_role("button", name=NAMES[0]).click(position={"x": 20.0, "y": 12.0})
    wait_until(lambda: bool(moves(viewer)), "the press is told")
    assert moves(viewer) == [(shown_list[NAMES[0]], None)]


def test_an_entry_is_moved_by_keys(page: Page, viewer: Viewer, shown_list: dict[str, int]) -> None:
    page.get_by_role("button", name=NAMES[1]).press("Alt+ArrowUp")
    wait_until(lambda: bool(moves(viewer)), "it is told")
    assert moves(viewer) == [(shown_list[NAMES[1]], -1)]
