"""A drag on the map during which the connection is lost: it sends no robot off afterwards."""

from typing import TYPE_CHECKING

import pytest
from playwright.sync_api import Page, expect

from .seeing import pixel_of, wait_for_frames
from .test_life_line import NO_CONNECTION, frozen
from .test_viewer import FAR, FROM_FAR, button, goal_id, goal_state

if TYPE_CHECKING:
    from .conftest import Shown

pytestmark = [pytest.mark.slow, pytest.mark.browser]


def begin_drag(page: Page) -> None:
    button(page, "Go to …").click()
    expect(page.locator("#hint")).to_contain_text("Press where it should go")
    wait_for_frames(page)
    page.mouse.move(*pixel_of(page, FAR))
    page.mouse.down()
    page.mouse.move(*pixel_of(page, FROM_FAR), steps=4)


def check_that_nothing_moves_it(page: Page, shown: "Shown", before: str | None) -> None:
    """What is pressed afterwards is answered after whatever the drag would have done."""
    if button(page, "Press again to cancel").is_visible():
        button(page, "Press again to cancel").click()
    expect(page.get_by_text("Press where it should go")).to_have_count(0)
    button(page, "STOP").click()
    expect(page.locator("#stop-line")).to_contain_text("Stopped")
    page.locator("#resume").click()
    expect(page.locator("#stop-line")).to_be_hidden()
    assert goal_id(shown) == before
    assert goal_state(shown) not in ("planning", "driving")


@pytest.mark.parametrize("when", ["while it is lost", "once it is back"])
def test_a_drag_that_is_let_go_after_the_connection_was_lost_sends_no_robot(
    page: Page, shown: "Shown", when: str
) -> None:
    before = goal_id(shown)
    begin_drag(page)
    with frozen(shown):
        expect(page.get_by_text(NO_CONNECTION)).to_be_visible()
        if when == "while it is lost":
            page.mouse.up()
    expect(page.get_by_text(NO_CONNECTION)).to_be_hidden()
    if when == "once it is back":
        page.mouse.up()
    check_that_nothing_moves_it(page, shown, before)
