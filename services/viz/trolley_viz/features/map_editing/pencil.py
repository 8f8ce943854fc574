"""What one browser draws on the map with its pointer: a tool, its widths, the stroke under way."""

import math
from collections.abc import Callable
from typing import Literal

from trolley.messages import Crop, DrawWall, EraseStroke, MapOp
from trolley_viz.features.map_editing.preview import MapPreview
from trolley_viz.pointing.canvas import Canvas, Phase, PointerHandlers
from trolley_viz.pointing.sketch import Point

Tool = Literal["look", "erase", "wall", "crop"]
HINTS: dict[Tool, str] = {
    "look": "",
    "erase": "Drag over what should be erased.",
    "wall": "Drag from one end of the wall to the other, or tap both ends.",
    "crop": "Drag from corner to corner of what should be kept.",
}
BRUSH_M, WALL_M = 0.25, 0.1
# A point of a stroke is taken when it is so far from the last [share of the brush's width].
_STEP_SHARE = 0.25
_MAX_STROKE = 2000


class Pencil:
    """The tool in one person's hand; turns its strokes into edits of the map.

    Args:
        canvas: what the browser takes.
        preview: shows the stroke under way.
        drawn: called with what a stroke does to the map, once it is at its end.
    """

    def __init__(self, canvas: Canvas, preview: MapPreview, drawn: Callable[[MapOp], None]) -> None:
        self._canvas, self._preview, self._drawn = canvas, preview, drawn
        self.tool: Tool = "look"
        self.brush_m = BRUSH_M
        self.wall_m = WALL_M
        self.to_unknown = False
        """Whether what is erased becomes unknown instead of free."""
        self._stroke: list[Point] = []
        self._anchor: Point | None = None

    def take(self, tool: Tool) -> None:
        """Take up a tool; with "look" drags turn the camera."""
        self.tool = tool
        self.put_down()
        if tool != "look":
            self._canvas.listen(PointerHandlers(self._tapped, self._dragged))

    def put_down(self) -> None:
        """Leave the floor, until the tool is taken up again."""
        self.drop()
        self._canvas.clear()

    def drop(self) -> None:
        """Forget the stroke under way."""
        self._stroke, self._anchor = [], None
        self._preview.show_stroke([], 0.0, "")

    def _tapped(self, point: Point, _reach_m: float) -> None:
        if self.tool == "erase":
            self._finish([point])
        elif self._anchor is None:
            self._anchor = point
            self._preview.show_stroke([point, (point[0] + 0.05, point[1])], 0.05, self.tool)
        else:
            self._finish([self._anchor, point])

    def _dragged(self, phase: Phase, start: Point, now: Point | None) -> None:
        if phase == "end" and now is None:  # called off
            self.drop()
            return
        if not self._stroke:
            self._stroke = [self._anchor or start]
        if now is not None and len(self._stroke) < _MAX_STROKE:
            if self.tool != "erase":
                self._stroke = [self._stroke[0], now]
            elif math.dist(self._stroke[-1], now) > _STEP_SHARE * self.brush_m or phase == "end":
                self._stroke.append(now)
        if phase == "end":
            self._finish(self._stroke)
        elif self.tool == "crop" and len(self._stroke) == 2:
            (x0, y0), (x1, y1) = self._stroke
            outline = [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)]
            self._preview.show_stroke(outline, 0.05, "crop")
        else:
            width = self.brush_m if self.tool == "erase" else self.wall_m
            self._preview.show_stroke(self._stroke, width, self.tool)

    def _finish(self, points: list[Point]) -> None:
        """Say what was drawn."""
        op: MapOp | None = None
        if self.tool == "erase":
            to: Literal["free", "unknown"] = "unknown" if self.to_unknown else "free"
            op = EraseStroke(points=points, width=self.brush_m, to=to)
        elif len(points) == 2 and math.dist(*points) > 0.0:
            if self.tool == "wall":
                op = DrawWall(points=points, width=self.wall_m)
            elif self.tool == "crop":
                op = Crop(corners=(points[0], points[1]))
        self.drop()
        if op is not None:
            self._drawn(op)
