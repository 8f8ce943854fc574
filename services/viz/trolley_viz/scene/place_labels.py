"""The names of saved places in one browser: as many as can be read beside one another.

Names keep their size on the screen. On a phone, or seen from afar, they would lie on top of each
other; whoever zooms in sees the others.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import viser
from numpy.typing import NDArray
from viser.transforms import SO3

from trolley_viz.graphics.shapes import is_near
from trolley_viz.scene.layer import Z_LABEL

HEIGHT_PX, LETTER_PX, PADDING_PX = 20.0, 7.0, 12.0
"""Size of a name as viser writes it, and of its letters on average."""
MAX_NAMES = 300
MAX_LETTERS = 28
"""Number of letters of a name that are written on the map: a longer one would cover it."""


class PlaceName(NamedTuple):
    """A name, and the middle of its lower edge on the floor [m]."""

    text: str
    x: float
    y: float


class Eye(NamedTuple):
    """A camera, as viser has it: it looks along its +z, with up -y."""

    position: NDArray[np.float64]
    wxyz: NDArray[np.float64]
    fov: float
    """From the lower to the upper edge [rad]."""
    size: tuple[float, float]
    """Width and height of the picture [px] in the measure in which the names are so large."""

    def direction(self, at: tuple[float, float]) -> NDArray[np.float64]:
        """Return in which direction (3,) something is seen.

        Args:
            at: shares of the picture's width and height, from its upper left corner.
        """
        up = math.tan(0.5 * self.fov)
        width, height = self.size
        right = (2.0 * at[0] - 1.0) * up * width / max(height, 1.0)
        ahead = np.array([right, (2.0 * at[1] - 1.0) * up, 1.0])
        return SO3(self.wxyz).apply(ahead).astype(np.float64)


class PlaceLabels:
    """The names in one browser's scene."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._labels: list[viser.LabelHandle] = []
        self._names: list[PlaceName] = []
        self._asked: tuple[Sequence[PlaceName], str] = ([], "")
        self._eye: Eye | None = None

    def show(self, names: Sequence[PlaceName], first: str, eye: Eye) -> None:
        """Show the names that do not lie over one before them.

        Args:
            names: all, the more important before.
            first: one that comes before all others.
            eye: from where they are seen.
        """
        asked = names, first
        if asked == self._asked and self._eye is not None and _is_same(eye, self._eye):
            return
        self._asked = list(names), first
        names = sorted(names[:MAX_NAMES], key=lambda one: one.text != first)
        names = [one._replace(text=_shortened(one.text)) for one in names]
        if names != self._names:
            self._write(names)
        self._eye = eye
        for label, is_clear in zip(self._labels, clear_of_others(names, eye), strict=True):
            if label.visible != is_clear:
                label.visible = is_clear

    def _write(self, names: list[PlaceName]) -> None:
        for label in self._labels:
            label.remove()
        self._names = names
        self._labels = [
            self._scene.add_label(
                f"/names/{i}",
                one.text,
                position=(one.x, one.y, Z_LABEL),
                anchor="bottom-center",
                depth_test=False,
                visible=False,
            )
            for i, one in enumerate(names)
        ]


def clear_of_others(names: Sequence[PlaceName], eye: Eye) -> list[bool]:
    """Say of each name whether it is in the picture and clear of all that were before it."""
    points = np.array([(one.x, one.y, Z_LABEL) for one in names], np.float64).reshape(-1, 3)
    width, height = eye.size
    seen = (points - eye.position) @ SO3(eye.wxyz).as_matrix()  # in the axes of the camera
    depths = np.maximum(seen[:, 2], 1e-6)
    focal = 0.5 * height / np.tan(0.5 * eye.fov)
    across = 0.5 * width + focal * seen[:, 0] / depths
    down = 0.5 * height + focal * seen[:, 1] / depths
    half = 0.5 * (LETTER_PX * np.array([len(one.text) for one in names]) + PADDING_PX)
    is_seen = (seen[:, 2] > 0.0) & (across >= 0.0) & (across <= width)
    is_seen &= (down >= 0.0) & (down <= height)
    clear = np.zeros(len(names), np.bool_)
    for i in np.flatnonzero(is_seen):
        is_over = np.abs(across - across[i]) < half + half[i]
        is_over &= np.abs(down - down[i]) < HEIGHT_PX
        clear[i] = not (clear & is_over).any()
    return clear.tolist()


def _shortened(name: str) -> str:
    return name if len(name) <= MAX_LETTERS else f"{name[: MAX_LETTERS - 1].rstrip()}…"


def _is_same(one: Eye, other: Eye) -> bool:
    return (
        one.size == other.size
        and one.fov == other.fov
        and is_near(one.position, other.position)
        and is_near(one.wxyz, other.wxyz)
    )
