"""Where the camera stands for pages of all shapes."""

import contextlib
from types import SimpleNamespace

import numpy as np
import pytest

from trolley_viz.graphics.camera import fit, stands

BOUNDS = (-4.0, -3.0, 4.0, 3.0)


@pytest.mark.parametrize("aspect", [0.3, 1.0, 3.0])
def test_a_camera_that_nobody_moved_stands_where_it_was_put(aspect: float) -> None:
    page = SimpleNamespace(camera=SimpleNamespace(), atomic=contextlib.nullcontext)
    fit(page, BOUNDS, aspect)  # type: ignore[arg-type]
    assert stands(page, BOUNDS, aspect)  # type: ignore[arg-type]
    page.camera.position = page.camera.position + np.array([0.1, 0.0, 0.0])
    assert not stands(page, BOUNDS, aspect)  # type: ignore[arg-type]
