"""Many markers of one kind as one scene node: meshes whose places, sizes and colours are lists."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, cast

import numpy as np
import viser
from numpy.typing import ArrayLike, NDArray

from trolley.messages import Marker
from trolley_viz.graphics.shapes import Mesh

Solid = Literal["sphere", "cube", "cylinder", "arrow"]
SOLIDS: tuple[Solid, ...] = ("sphere", "cube", "cylinder", "arrow")
REACH = 1e5
"""Where the scene ends [m], since graphics use single precision."""
MIN_SIZE = 1e-4
"""[m]."""

Quaternion = tuple[float, float, float, float]
"""w, x, y, z."""


@lru_cache(maxsize=8)
def unit_mesh(kind: Solid, *, fine: bool = True) -> Mesh:
    """The shape of a marker of size 1 m around its pose; an arrow begins there and points to +x."""
    sections = 16 if fine else 8
    match kind:
        case "sphere":
            angles = np.linspace(-0.5 * np.pi, 0.5 * np.pi, sections // 2 + 1)
            return _turned(np.stack([0.5 * np.cos(angles), 0.5 * np.sin(angles)], axis=1), sections)
        case "cube":
            side = math.sqrt(0.5)
            return _turned([(0, -0.5), (side, -0.5), (side, 0.5), (0, 0.5)], 4)
        case "cylinder":
            return _turned([(0, -0.5), (0.5, -0.5), (0.5, 0.5), (0, 0.5)], sections)
        case "arrow":
            profile = [(0, 0), (0.22, 0), (0.22, 0.7), (0.5, 0.7), (0, 1)]
            vertices, faces = _turned(profile, sections)
            return np.ascontiguousarray(vertices[:, [2, 0, 1]]), faces  # z becomes x


@dataclass(frozen=True)
class Placed:
    """A marker with the lift and turn that its animation adds at this moment."""

    marker: Marker
    lift: float = 0.0
    """[m]."""
    turn: Quaternion | None = None


class Batch:
    """One scene node for up to some hundred solids of one kind."""

    def __init__(self, scene: viser.SceneApi, path: str, kind: Solid, *, fine: bool) -> None:
        self._scene, self._path = scene, path
        self._mesh = unit_mesh(kind, fine=fine)
        self._is_flat = kind != "sphere"
        self._node: viser.BatchedMeshHandle | None = None

    def show(self, solids: Sequence[Placed]) -> None:
        """Draw exactly these."""
        if not solids:
            self.remove()
            return
        markers = [one.marker for one in solids]
        positions = within_reach(
            [(one.marker.pose.x, one.marker.pose.y, one.marker.z + one.lift) for one in solids]
        )
        wxyzs = orientations(solids)
        scales = np.maximum(within_reach([one.size for one in markers]), MIN_SIZE)
        colours = np.rint(255.0 * np.array([one.color for one in markers])).astype(np.uint8)
        opacities = (colours[:, 3] / 255.0).astype(np.float32)
        see_through = bool((opacities < 1.0).any())
        if self._node is None or see_through != (self._node.batched_opacities is not None):
            self._node = self._scene.add_batched_meshes_simple(
                self._path,
                *self._mesh,
                wxyzs,
                positions,
                batched_scales=scales,
                batched_colors=colours[:, :3],
                batched_opacities=opacities if see_through else None,
                flat_shading=self._is_flat,
                lod="off",
                cast_shadow=False,
                receive_shadow=False,
            )
            return
        self._node.batched_wxyzs = wxyzs
        self._node.batched_scales = scales
        self._node.batched_colors = colours[:, :3]
        if see_through:
            self._node.batched_opacities = opacities
        self._node.batched_positions = positions  # viser's page goes by the number of these

    def remove(self) -> None:
        """Take it out of the scene."""
        if self._node is not None:
            self._node.remove()
            self._node = None


def within_reach(values: ArrayLike) -> NDArray[np.float32]:
    """Limit coordinates or sizes [m] to what the scene can show."""
    return np.clip(np.asarray(values, np.float64), -REACH, REACH).astype(np.float32)


def orientations(solids: Sequence[Placed]) -> NDArray[np.float32]:
    """The quaternions (n, 4) w, x, y, z of markers that stand on the floor, and of their turns."""
    half = 0.5 * np.array([one.marker.pose.yaw for one in solids])
    zeros = np.zeros_like(half)
    wxyzs = np.stack([np.cos(half), zeros, zeros, np.sin(half)], axis=1)
    for i, one in enumerate(solids):
        if one.turn is not None:
            wxyzs[i] = multiplied(cast("Quaternion", tuple(wxyzs[i].tolist())), one.turn)
    return wxyzs.astype(np.float32)


def multiplied(a: Quaternion, b: Quaternion) -> Quaternion:
    """Turn by b, then by a."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def _turned(profile: ArrayLike, sections: int) -> Mesh:
    """Turn a profile (n, 2) of radius and height, from below to above, about the z axis."""
    radii, heights = np.asarray(profile, np.float64).T
    angles = 2.0 * np.pi * (np.arange(sections) + 0.5) / sections
    rings = np.stack(
        [
            np.outer(radii, np.cos(angles)),
            np.outer(radii, np.sin(angles)),
            np.outer(heights, np.ones(sections)),
        ],
        axis=-1,
    )
    low = (np.arange(len(radii) - 1)[:, None] * sections + np.arange(sections)).ravel()
    beside = low - low % sections + (low + 1) % sections
    faces = np.concatenate(
        [
            np.stack([low, beside, beside + sections], axis=1),
            np.stack([low, beside + sections, low + sections], axis=1),
        ]
    )
    return rings.reshape(-1, 3).astype(np.float32), faces.astype(np.uint32)
