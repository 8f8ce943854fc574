"""The table of lidars: complete, and each model has a page."""

from pathlib import Path
from typing import get_args

import pytest

from trolley.config.hardware import LidarModel
from trolley_base.drivers.lidars import FAMILIES, MODELS
from trolley_base.emulators.catalogue import LIDARS

PAGES = Path(__file__).parents[5] / "docs/hardware"


def test_every_model_that_settings_may_name_has_one_driver() -> None:
    assert set(MODELS) == set(get_args(LidarModel))
    assert len(MODELS) == sum(len(family.DRIVERS) for family in FAMILIES)


def test_every_model_can_be_emulated() -> None:
    assert set(LIDARS) == set(MODELS)


@pytest.mark.parametrize("model", MODELS)
def test_a_page_of_the_docs_shows_its_settings(model: str) -> None:
    pages = [page.name for page in PAGES.glob("*.md") if f'\nmodel = "{model}"' in page.read_text()]
    assert len(pages) == 1
