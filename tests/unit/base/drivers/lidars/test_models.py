"""The table of lidars: complete, and each model has a page."""

from pathlib import Path

import pytest

from trolley_base.drivers.lidars import MODELS
from trolley_base.emulators.catalogue import LIDARS

PAGES = Path(__file__).parents[5] / "docs/hardware"


def test_every_model_that_is_declared_has_a_driver() -> None:
    assert tuple(MODELS) == MODELS.names
    assert MODELS.refused() == []


def test_every_model_can_be_emulated() -> None:
    assert set(LIDARS) == set(MODELS)


@pytest.mark.parametrize("model", MODELS)
def test_a_page_of_the_docs_shows_its_settings(model: str) -> None:
    pages = [page.name for page in PAGES.glob("*.md") if f'\nmodel = "{model}"' in page.read_text()]
    assert pages == [MODELS[model].page.partition("#")[0]]
