"""The page in German, as it is shown while a robot is sent and stopped: no English is left."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from playwright.sync_api import Browser, Page, expect
from support.waiting import wait_until

from trolley import topics
from trolley_viz.languages.catalogue import catalogues
from trolley_viz.languages.translator import translator_of

from .conftest import open_page
from .seeing import undrawn
from .test_for_everybody import open_folders
from .test_viewer import button, goal_state

if TYPE_CHECKING:
    from .conftest import Shown

pytestmark = [pytest.mark.slow, pytest.mark.browser]

TABS = ("Fahren", "Touren", "Karte", "Mehr")
SHOWN = """(apart) => {
  const isApart = (node) => node.closest(apart) !== null, found = [];
  const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (texts.nextNode()) {
    const { data, parentElement: parent } = texts.currentNode;
    const isSeen = parent.checkVisibility({ visibilityProperty: true });
    if (isSeen && data.trim() && !isApart(parent)) found.push(data.trim());
  }
  for (const one of document.querySelectorAll("[aria-label], [title], [placeholder]")) {
    if (isApart(one) || !one.checkVisibility({ visibilityProperty: true })) continue;
    for (const name of ["aria-label", "title", "placeholder"])
      if (one.getAttribute(name)) found.push(one.getAttribute(name).trim());
  }
  return found;
}"""
"""All texts that are seen or read out, but for those in elements that are set apart."""
APART = "[translate=no], script, style, noscript, kbd"
ENGLISH = re.compile(
    r"\b(the|is|its?|of|to|and|with|where|from|this|not|your?|by|at|has|are|for|on the|robot)\b",
    re.IGNORECASE,
)
"""Words that no German sentence has."""


@pytest.fixture(scope="module")
def page(shown: "Shown", browser: Browser) -> Iterator[Page]:
    page = open_page(browser, 1350, 640, locale="de-DE")
    page.goto(shown.url)
    expect(page.locator("html")).to_have_attribute("lang", "de")
    page.locator("#scene-wait").wait_for(state="hidden")
    yield page
    page.context.close()


def english_in(page: Page, names: set[str]) -> list[str]:
    """What is shown in English though the catalogue has German for it, or by its words."""
    german, known = translator_of("de"), set(catalogues()["de"].all_texts().values())
    assert german is not None
    shown: set[str] = set(page.evaluate(SHOWN, APART)) - names - known
    apart = re.compile("|".join(map(re.escape, sorted({*names, "robot.toml"}, key=len)[::-1])))
    return sorted(
        one for one in shown if german.text(one) != one or ENGLISH.search(apart.sub("", one))
    )


def names_of(shown: "Shown") -> set[str]:
    """What people called their things."""
    poses, tours = shown.robot.latest(topics.POSES), shown.robot.latest(topics.TOURS)
    zones, robot = shown.robot.latest(topics.ZONES), shown.robot.latest(topics.ROBOT)
    names = {"trolley", "English"}
    for saved in (poses and poses.poses, tours and tours.tours, zones and zones.zones):
        names |= {one.name for one in saved or ()}  # pyrefly: ignore[not-iterable]
    return names | ({robot.name, robot.title} if robot is not None else set())


def test_nothing_is_left_in_english_on_any_tab(page: Page, shown: "Shown") -> None:
    found: dict[str, list[str]] = {}
    with undrawn(page):
        for tab in TABS:
            page.get_by_role("tab", name=tab, exact=True).click()
            open_folders(page)
            found[tab] = english_in(page, names_of(shown))
    assert found == {tab: [] for tab in TABS}


def test_nothing_is_left_in_english_while_it_is_sent_stopped_and_out_of_reach(
    page: Page, shown: "Shown", pictures: Path
) -> None:
    names = names_of(shown)
    page.get_by_role("tab", name="Fahren", exact=True).click()
    with undrawn(page):
        button(page, "kitchen").click()
        wait_until(lambda: goal_state(shown) == "driving", "it sets off")
        expect(page.locator("#sentence")).to_contain_text("kitchen")
        assert english_in(page, names) == []
        button(page, "STOP").click()
        expect(page.locator("#stop-line")).to_contain_text("Angehalten")
        expect(page.locator("#sentence")).to_contain_text("Angehalten")
        page.screenshot(path=pictures / "german.png")
        assert english_in(page, names) == []
        page.context.set_offline(True)
        expect(page.locator("#lost-title")).to_have_text("KEINE VERBINDUNG, NICHT ANGEHALTEN")
        assert english_in(page, names) == []
        page.context.set_offline(False)
        expect(page.locator("#lost")).to_be_hidden()
        button(page, "Weiterfahren").click()
        wait_until(lambda: goal_state(shown) == "driving", "it goes on")
        button(page, "Abbrechen").click()
        wait_until(lambda: goal_state(shown) == "canceled", "it is called back")
        assert english_in(page, names) == []
