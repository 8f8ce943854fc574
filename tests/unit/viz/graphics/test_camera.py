"""Where the camera stands for pages of all shapes."""

import contextlib
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from viser import CameraHandle
from viser._messages import SetCameraPositionMessage

from trolley_viz.graphics.camera import fit, move, stands

BOUNDS = (-4.0, -3.0, 4.0, 3.0)


@pytest.mark.parametrize("aspect", [0.3, 1.0, 3.0])
def test_a_camera_that_nobody_moved_stands_where_it_was_put(aspect: float) -> None:
    page = SimpleNamespace(camera=SimpleNamespace(), atomic=contextlib.nullcontext)
    fit(page, BOUNDS, aspect)  # type: ignore[arg-type]
    assert stands(page, BOUNDS, aspect)  # type: ignore[arg-type]
    page.camera.position = page.camera.position + np.array([0.1, 0.0, 0.0])
    assert not stands(page, BOUNDS, aspect)  # type: ignore[arg-type]


class ReportingPage:
    """A page whose report of where its camera was comes in the middle of a move."""

    def __init__(self, position: tuple[float, float, float], look_at: tuple[float, float, float]):
        self.position, self.look_at = np.array(position), np.array(look_at)
        self.atomic = contextlib.nullcontext
        self._websock_connection = SimpleNamespace(queue_message=self._take)
        self._report = SimpleNamespace(
            position=self.position,
            look_at=self.look_at,
            up_direction=np.array([0.0, 0.0, 1.0]),
            update_timestamp=1.0,
        )
        self.camera = CameraHandle(self)  # type: ignore[arg-type]
        vars(self.camera._state).update(vars(self._report))

    def _take(self, message: Any) -> None:
        if isinstance(message, SetCameraPositionMessage):
            self.position = np.array(message.position)
        else:
            self.look_at = np.array(message.look_at)
            vars(self.camera._state).update(vars(self._report))


def test_a_report_in_the_middle_of_a_move_does_not_turn_the_camera_away() -> None:
    page = ReportingPage(position=(0.0, -4.0, 9.0), look_at=(0.0, 0.0, 0.0))
    move(page, np.array([0.0, -10.0, 22.0]), np.zeros(3))  # type: ignore[arg-type]
    assert page.position == pytest.approx([0.0, -10.0, 22.0])
    assert page.look_at == pytest.approx([0.0, 0.0, 0.0], abs=0.01)
