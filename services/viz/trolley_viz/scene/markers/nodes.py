"""The scene nodes of groups of markers: solids, lines, labels."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import viser

from trolley.messages import Marker
from trolley_viz.scene.markers.solids import Placed, within_reach

MAX_TEXT = 200
MIN_WIDTH, MAX_WIDTH = 0.004, 1.0
"""Least and greatest width of lines [m]."""
MIN_HEIGHT, MAX_HEIGHT = 0.03, 2.0
"""Least and greatest height of letters [m]."""


class MarkerNodes(Protocol):
    """What draws a group."""

    def show(self, markers: Sequence[Placed], /) -> None:
        """Draw exactly these."""
        ...


class Lines:
    """Polylines of one width."""

    def __init__(self, scene: viser.SceneApi, path: str, width: float) -> None:
        self._scene, self._path = scene, path
        self._width = min(max(width, MIN_WIDTH), MAX_WIDTH)
        self._node: viser.LineSegmentsHandle | None = None

    def show(self, markers: Sequence[Placed]) -> None:
        """Draw exactly these."""
        pieces = [(segments(one.marker), one.marker.color) for one in markers]
        pieces = [(piece, colour) for piece, colour in pieces if len(piece)]
        if self._node is not None:
            self._node.remove()
            self._node = None
        if pieces:
            colours = [
                np.broadcast_to(np.rint(255.0 * np.array(colour[:3])), piece.shape)
                for piece, colour in pieces
            ]
            self._node = self._scene.add_line_segments(
                self._path,
                np.concatenate([piece for piece, _ in pieces]),
                np.concatenate(colours).astype(np.uint8),
                thickness=self._width,
            )


class Labels:
    """Texts; the letters are the page's own, so they have its colour."""

    def __init__(self, scene: viser.SceneApi, path: str) -> None:
        self._scene, self._path = scene, path
        self._nodes: list[viser.LabelHandle] = []

    def show(self, markers: Sequence[Placed]) -> None:
        """Draw exactly these."""
        while len(self._nodes) > len(markers):
            self._nodes.pop().remove()
        for i, one in enumerate(markers):
            if i == len(self._nodes):
                node = self._scene.add_label(
                    f"{self._path}/{i}",
                    "",
                    anchor="center-center",
                    font_size_mode="scene",
                )
                self._nodes.append(node)
            marker, node = one.marker, self._nodes[i]
            node.text = marker.text[:MAX_TEXT]
            node.font_scene_height = min(max(marker.size[2], MIN_HEIGHT), MAX_HEIGHT)
            node.position = within_reach((marker.pose.x, marker.pose.y, marker.z))


def segments(marker: Marker) -> np.ndarray:
    """A line's points in its frame as segments (n, 2, 3) [m]; none for fewer than two points."""
    points = np.array(marker.points, np.float64).reshape(-1, 3)
    points[:, :2] = marker.pose.transform_points(points[:, :2])
    points[:, 2] += marker.z
    return within_reach(np.stack([points[:-1], points[1:]], axis=1))
