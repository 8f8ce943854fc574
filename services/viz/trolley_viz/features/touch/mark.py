"""A ring around what was touched on the map, for whoever touched it."""

import viser

from trolley.geometry import Pose2D
from trolley_viz.features.touch.touched import Touched
from trolley_viz.graphics.shapes import circle, closed_segments, place
from trolley_viz.scene.layer import Z_LABEL

COLOUR = (29, 95, 208)
RADIUS_M = 0.16


class TouchMark:
    """Draws the ring in one browser's scene."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._ring: viser.LineSegmentsHandle | None = None
        self._drawn: Touched | None = None

    def draw(self, touched: Touched | None) -> None:
        """Show where something was touched."""
        if touched == self._drawn:
            return
        self._drawn = touched
        if self._ring is not None:
            self._ring.remove()
            self._ring = None
        if touched is not None:
            self._ring = self._scene.add_line_segments(
                "/touched",
                closed_segments(circle(RADIUS_M), 0.0),
                COLOUR,
                thickness=5.0,
                thickness_units="screen",
            )
            place(self._ring, Pose2D(touched.x, touched.y, 0.0), Z_LABEL)
