"""A page and a viewer that only plays its part; there is no robot."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page

from trolley_viz.server import web_server

from .viewer import Viewer, page_of, scripted_viewer


@pytest.fixture(scope="module", autouse=True)
def settled() -> None:
    """No demo is started: nothing has to be settled."""


@pytest.fixture(scope="session")
def patient_frontend(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page's files, for one that does not give up a viewer that is silent for a while.

    It is this very process, and nobody greets the page again when it calls again.
    """
    folder = tmp_path_factory.mktemp("page") / "frontend"
    shutil.copytree(web_server.PAGE, folder)
    worker = folder / "line-worker.js"
    text = worker.read_text(encoding="utf-8")
    assert "SILENCE_MS = 1350" in text
    worker.write_text(text.replace("SILENCE_MS = 1350", "SILENCE_MS = 60000"), encoding="utf-8")
    return folder


@pytest.fixture
def viewer(patient_frontend: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Viewer]:
    monkeypatch.setattr(web_server, "PAGE", patient_frontend)
    with scripted_viewer() as viewer:
        yield viewer


@pytest.fixture
def page(browser: Browser, viewer: Viewer) -> Iterator[Page]:
    """A page that has called the viewer, and was told nothing yet."""
    with page_of(browser, viewer) as page:
        yield page
