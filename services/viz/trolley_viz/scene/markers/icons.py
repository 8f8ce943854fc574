"""Pictograms that face the viewer: each browser has them in its own scene, turned to its camera."""

import itertools
from typing import NamedTuple

import numpy as np
import viser
from numpy.typing import NDArray

from trolley.messages.types import Colour
from trolley_viz.graphics.glb import icon_glb
from trolley_viz.graphics.icons import icon_png
from trolley_viz.graphics.shapes import is_near
from trolley_viz.scene.markers.solids import Quaternion, multiplied, within_reach

MAX_PICTURES = 64
"""Different ones, by name and colour."""
FLOOR_GAP = 0.02
"""By how much the lower edge stays above the floor [m]."""
MIN_SIZE, MAX_SIZE = 0.02, 20.0

_UPRIGHT: Quaternion = (0.5, 0.5, 0.5, 0.5)
"""Turns a picture in the plane x, y so that it stands and looks along +x."""
_AROUND_X: Quaternion = (0.0, 1.0, 0.0, 0.0)


class Icon(NamedTuple):
    """A pictogram in the world."""

    name: str
    color: Colour
    size: float
    """[m]."""
    position: tuple[float, float, float]
    """Position of its middle [m]."""
    yaw: float = 0.0
    """Heading of its marker [rad]; seen only while it turns."""
    turn: Quaternion | None = None
    """What its motion adds; None: it faces the viewer."""


class _Picture(NamedTuple):
    name: str
    rgb: tuple[int, int, int]
    opacity: float


class Icons:
    """The pictograms of one browser."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._nodes: dict[_Picture, viser.BatchedGlbHandle] = {}
        self._shown: tuple[list[Icon], NDArray[np.float64]] = ([], np.zeros(4))
        self._paths = itertools.cycle([f"/icons/{i}" for i in range(2 * MAX_PICTURES)])
        """Each comes round again, since viser keeps for ever that a name was taken away; but late:
        a glb in the place of one of the same name is shown at the origin at first."""

    def show(self, icons: list[Icon], camera_wxyz: NDArray[np.float64]) -> None:
        """Draw exactly these, turned to a camera (w, x, y, z, as viser has it)."""
        icons_before, camera_before = self._shown
        if icons == icons_before and is_near(camera_wxyz, camera_before):
            return
        self._shown = list(icons), camera_wxyz
        by_picture: dict[_Picture, list[Icon]] = {}
        for icon in icons:
            by_picture.setdefault(_picture(icon), []).append(icon)
        by_picture = dict(list(by_picture.items())[:MAX_PICTURES])
        for picture in self._nodes.keys() - by_picture.keys():
            self._nodes.pop(picture).remove()
        for picture, alike in by_picture.items():
            self._show_alike(picture, alike, camera_wxyz)

    def _show_alike(
        self, picture: _Picture, icons: list[Icon], camera_wxyz: NDArray[np.float64]
    ) -> None:
        sizes = np.clip(within_reach([one.size for one in icons]), MIN_SIZE, MAX_SIZE)
        wxyzs = np.array([orientation(one, camera_wxyz) for one in icons], np.float32)
        positions = within_reach([one.position for one in icons])
        lowest = 0.5 * sizes * _upness(wxyzs) + FLOOR_GAP
        positions[:, 2] = np.maximum(positions[:, 2], lowest)
        node = self._nodes.get(picture)
        if node is None:
            png = icon_png(picture.name, picture.rgb, opacity=picture.opacity)
            used = {other.name for other in self._nodes.values()}
            self._nodes[picture] = self._scene.add_batched_glb(
                next(path for path in self._paths if path not in used),
                icon_glb(png),
                wxyzs,
                positions,
                batched_scales=sizes,
                lod="off",
                cast_shadow=False,
                receive_shadow=False,
            )
            return
        node.batched_wxyzs = wxyzs
        node.batched_scales = sizes
        node.batched_positions = positions


def orientation(icon: Icon, camera_wxyz: NDArray[np.float64]) -> Quaternion:
    """How a picture in the plane x, y, with up +y, is turned: to the camera, or by its motion."""
    if icon.turn is not None:
        heading = (float(np.cos(0.5 * icon.yaw)), 0.0, 0.0, float(np.sin(0.5 * icon.yaw)))
        return multiplied(multiplied(heading, icon.turn), _UPRIGHT)
    w, x, y, z = camera_wxyz.tolist()
    return multiplied((w, x, y, z), _AROUND_X)  # a camera looks along its +z, with up -y


def _upness(wxyzs: NDArray[np.float32]) -> NDArray[np.float32]:
    """How upright pictures stand: 1 on edge, 0 flat on the floor."""
    w, x, y, z = wxyzs.T
    return np.abs(2.0 * (y * z + w * x)).astype(np.float32)


def _picture(icon: Icon) -> _Picture:
    red, green, blue = (round(255 * part) for part in icon.color[:3])
    return _Picture(icon.name, (red, green, blue), round(icon.color[3], 2))
