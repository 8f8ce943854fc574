"""Two people at one viewer: what each is called, who sent the robot, and who stopped it."""

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from playwright.sync_api import Browser, Page, expect

from .conftest import open_page

if TYPE_CHECKING:
    from .conftest import Shown

pytestmark = [pytest.mark.slow, pytest.mark.browser]


@pytest.fixture
def guest(shown: "Shown", browser: Browser) -> Iterator[Page]:
    """The page of somebody who was given the lesser link, on a phone."""
    (path,) = shown.folder.glob("state/**/viewer_access.toml")
    token = tomllib.loads(path.read_text())["viewer"]
    guest = open_page(browser, 390, 844)
    guest.goto(shown.url + f"&token={token}")
    guest.get_by_text("You may look, but not drive. STOP works.").wait_for()
    yield guest
    guest.context.close()


def open_people(page: Page) -> None:
    page.get_by_role("tab", name="More").click()
    page.locator("summary", has_text="People").click()


def call(page: Page, name: str) -> None:
    """Give the browser a name."""
    open_people(page)
    page.get_by_label("Name of this browser").fill(name)
    page.get_by_role("button", name="Use this name").click()
    expect(page.locator("#notices")).to_contain_text(f"This browser is called {name}.")


def test_both_see_who_sent_the_robot_and_who_stopped_it(
    page: Page, guest: Page, shown: "Shown", pictures: Path
) -> None:
    # Each browser as it is, reloaded: the cookie that it was given is its name to the viewer.
    for one, name in ((page, "Anna's phone"), (guest, "<b>Ben</b> 🤖")):
        one.reload()
        call(one, name)
    for one in (page, guest):
        expect(one.get_by_text("<b>Ben</b> 🤖", exact=True)).to_be_visible()
    page.get_by_role("tab", name="Go").click()
    page.get_by_role("button", name="kitchen").click()
    for one in (page, guest):
        expect(one.locator("#lines")).to_contain_text("Sent by Anna's phone")
    guest.locator("#stop").click()
    for one in (page, guest):
        expect(one.locator("#stop-line")).to_have_text("Stopped by <b>Ben</b> 🤖")
    expect(guest.locator("#resume")).to_be_hidden()
    expect(guest.get_by_text("Let somebody in")).to_have_count(0)
    guest.screenshot(path=pictures / "people-guest.png")
    page.get_by_role("tab", name="More").click()
    page.locator("summary", has_text="Let somebody in").click()
    expect(page.get_by_text("nobody else can reach it")).to_be_visible()
    page.screenshot(path=pictures / "people.png")
    page.locator("#resume").click()
    expect(page.locator("#stop-line")).to_be_hidden()
