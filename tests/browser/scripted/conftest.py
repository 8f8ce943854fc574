"""A page and a viewer that only plays its part; there is no robot."""

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page

from .viewer import Viewer, page_of, scripted_viewer


@pytest.fixture(scope="module", autouse=True)
def settled() -> None:
    """No demo is started: nothing has to be settled."""


@pytest.fixture
def viewer() -> Iterator[Viewer]:
    with scripted_viewer() as viewer:
        yield viewer


@pytest.fixture
def page(browser: Browser, viewer: Viewer) -> Iterator[Page]:
    """A page that has called the viewer, and was told nothing yet."""
    with page_of(browser, viewer) as page:
        yield page
