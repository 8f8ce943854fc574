"""The map being edited, shown in one browser's scene in place of the stored one."""

import numpy as np
import viser
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.gridmap.wire import map_message
from trolley_viz.pointing.picture import Picture
from trolley_viz.pointing.sketch import Point
from trolley_viz.scene.layer import WALL_HEIGHT
from trolley_viz.scene.map_layers import DrawnMap, MapModel

MERGED_COLOUR = (150, 60, 190)
STROKE_COLOURS = {"erase": (214, 30, 30), "wall": (0, 140, 40), "crop": (30, 100, 255)}
Z_STROKE = WALL_HEIGHT + 0.04


def model_of(grid: GridMap) -> MapModel:
    """Make a grid ready for drawing (to be run aside)."""
    return MapModel.of(map_message(0, grid))


class MapPreview:
    """Draws the map being edited in one browser's scene, in place of the stored one."""

    def __init__(self, picture: Picture) -> None:
        self._picture = picture
        self._map: DrawnMap | None = None
        self._origin = Pose2D.identity()
        self._merged: viser.PointCloudHandle | None = None
        self._stroke: viser.LineSegmentsHandle | None = None

    @property
    def is_shown(self) -> bool:
        """Whether it stands in place of the stored map."""
        return self._map is not None and bool(self._map.nodes)

    def show(
        self, model: MapModel, origin: Pose2D, merged: NDArray[np.float64], now_ns: int
    ) -> None:
        """Show a map, and points of the walls that a merge brings along."""
        client = self._picture.client
        if client is None:
            return
        scene = client.scene
        with client.atomic():
            self._clear_sketch()
            self._map = self._map or DrawnMap(scene, "/map_editing")
            if origin != self._origin:  # it was turned or moved
                self._map.clear()
            self._origin = origin
            self._map.show(model, origin, now_ns)
            if len(merged):
                points = np.column_stack([merged, np.full(len(merged), Z_STROKE)])
                self._merged = scene.add_point_cloud(
                    "/map_editing/merged",
                    points.astype(np.float32),
                    MERGED_COLOUR,
                    point_size=0.06,
                )

    def show_stroke(self, points: list[Point], width: float, kind: str) -> None:
        """Show a stroke under way, as wide as it will be [m]; none with fewer than two points."""
        if self._stroke is not None:
            self._stroke.remove()
            self._stroke = None
        scene = self._picture.scene
        if len(points) < 2 or scene is None:
            return
        line = np.column_stack([np.array(points), np.full(len(points), Z_STROKE)])
        self._stroke = scene.add_line_segments(
            "/map_editing/stroke",
            np.stack([line[:-1], line[1:]], axis=1).astype(np.float32),
            STROKE_COLOURS[kind],
            thickness=max(width, 0.03),
        )

    def update(self, now_ns: int) -> None:
        """Take away what another map has taken the place of."""
        if self._map is not None:
            self._map.update(now_ns)

    def clear(self) -> None:
        """Take everything away."""
        if self._map is not None:
            self._map.clear()
        self._clear_sketch()

    def _clear_sketch(self) -> None:
        if self._merged is not None:
            self._merged.remove()
            self._merged = None
        self.show_stroke([], 0.0, "")
