"""Where the camera stands for pages of all sizes."""

import contextlib
from types import SimpleNamespace
from typing import Any

import pytest

from trolley_viz.graphics.camera import PANEL_PIXELS, fit, seen_pixels

BOUNDS = (-4.0, -3.0, 4.0, 3.0)


def page(width: int, height: int) -> Any:
    camera = SimpleNamespace(image_width=width, image_height=height)
    return SimpleNamespace(camera=camera, atomic=contextlib.nullcontext)


@pytest.mark.parametrize("density", [1, 2, 3])
def test_a_phone_keeps_its_lower_part_free_whatever_its_pixels(density: int) -> None:
    phone = page(390 * density, 844 * density)
    assert seen_pixels(phone, is_new=True) == (390 * density, 844 * density)
    fit(phone, BOUNDS, seen_pixels(phone))
    assert phone.camera.look_at[1] < -2.0  # below the middle: the map is seen above it
    desk = page(1116 * density, 900 * density)
    fit(desk, BOUNDS, seen_pixels(desk))
    assert desk.camera.look_at[1] > -1.0


def test_a_new_page_has_no_panel_yet() -> None:
    assert seen_pixels(page(1440, 900), is_new=True) == (1440 - PANEL_PIXELS, 900)
    assert seen_pixels(page(1440, 900)) == (1440, 900)


def test_a_page_without_pixels_does_no_harm() -> None:
    empty = page(0, 0)
    for is_new in (True, False):
        fit(empty, BOUNDS, seen_pixels(empty, is_new=is_new))
