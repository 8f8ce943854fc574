"""A picture of the map from above, with what is on it; for notebooks, reports and chat."""

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.gridmap import OCCUPIED_FROM, GridMap
from trolley.messages import SavedPose, Zone
from trolley.zones import LINE_KINDS

if TYPE_CHECKING:
    from PIL.Image import Image as PillowImage
    from PIL.ImageDraw import ImageDraw as PillowDraw

FREE_GREY, UNKNOWN_GREY, WALL_GREY = 255, 214, 40
BLUE, RED, GREEN, BLACK, WHITE = "#1565c0", "#d32f2f", "#2e7d32", "#202020", "#ffffff"
ZONE_COLOURS = {
    "mirror": "#00838f",
    "glass": "#00acc1",
    "keepout": "#c62828",
    "speed": "#ef6c00",
    "room": "#9e9e9e",
}
MARGIN_M = 0.5
"""What is shown around the part of the map that is known [m]."""
MIN_SIDE, MAX_SIDE = 64, 4096
"""What the longer side of a picture may be [pixels]."""
FAR = 1e6
"""What lies farther outside is drawn as far [pixels]: Pillow fails at coordinates that are huge."""
NUM_COLOURS, MOST_BYTES = 64, 1_000_000
"""Of a PNG file; 64 colours are enough for what is drawn here."""


@dataclass(frozen=True, slots=True)
class MapPicture:
    """What is drawn on a map; positions are in its frame `map` [m]."""

    grid: GridMap
    pose: Pose2D | None = None
    """Where the robot is, if that is known."""
    footprint: Sequence[tuple[float, float]] = ()
    """The robot's outline in `base_link` [m]."""
    points: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 2)))
    """(k, 2) what the lidar sees."""
    path: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 2)))
    """(k, 2) where the robot is about to drive."""
    places: Sequence[SavedPose] = ()
    """Those of another map are left out."""
    zones: Sequence[Zone] = ()

    def draw(self, side: int = 800) -> "PillowImage":
        """Draw it; row 0 of the picture is the map's upper edge.

        Args:
            side: the longer side [pixels], 64 to 4096.

        Raises:
            ValueError: another side.
        """
        from PIL import ImageDraw

        if not MIN_SIDE <= side <= MAX_SIDE:
            raise ValueError(f"a picture is {MIN_SIDE} to {MAX_SIDE} pixels wide, not {side}")
        picture, view = _floor(self.grid, side)
        on = ImageDraw.Draw(picture)
        for zone in self.zones:
            corners = view.pixels(np.array(zone.points))
            if zone.kind not in LINE_KINDS:
                corners = [*corners, corners[0]]
            on.line(corners, ZONE_COLOURS[zone.kind], width=2)
        for x, y in view.pixels(self.points):
            on.rectangle((x - 1, y - 1, x + 1, y + 1), fill=RED)
        if len(self.path) > 1:
            on.line(view.pixels(self.path), BLUE, width=3, joint="curve")
        for place in self.places:
            if place.map == self.grid.name:
                _draw_place(on, view, place)
        if self.pose is not None:
            _draw_robot(on, view, self.pose, self.footprint)
        return picture

    def png(self, side: int, most_bytes: int = MOST_BYTES) -> bytes:
        """Draw it as a PNG file; smaller where the file would be too large.

        Args:
            side: the longer side [pixels].
            most_bytes: what the file may have.
        """
        while True:
            file = io.BytesIO()
            self.draw(side).quantize(NUM_COLOURS).save(file, "PNG", optimize=True)
            if file.tell() <= most_bytes or side < 2 * MIN_SIDE:
                return file.getvalue()
            side //= 2


@dataclass(frozen=True, slots=True)
class _View:
    """Where points of the map are in the picture."""

    grid: GridMap
    scale: float
    """Pixels per cell."""
    low: tuple[float, float]
    """Column and row of the picture's lower left corner."""
    height: int

    def pixels(self, points_map: NDArray[np.float64]) -> list[tuple[float, float]]:
        """Return points (k, 2) of the map as x, y in the picture, y down; others are left out."""
        with np.errstate(over="ignore"):
            cells = self.grid.world_to_grid(points_map.reshape(-1, 2)) / self.grid.resolution
            at = (cells[np.isfinite(cells).all(axis=1)] - self.low) * self.scale
        at = np.clip(at, -FAR, FAR)
        return [(x, self.height - y) for x, y in at.tolist()]


def _floor(grid: GridMap, side: int) -> "tuple[PillowImage, _View]":
    """The part of a map that is known, in grey, and where things lie in it."""
    from PIL import Image

    known = grid.cells >= 0
    rows, cols = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    margin = math.ceil(MARGIN_M / grid.resolution)
    row, end_row = _span(rows, grid.rows, margin)
    col, end_col = _span(cols, grid.cols, margin)
    cells = grid.cells[row:end_row, col:end_col]
    grey = np.full(cells.shape, UNKNOWN_GREY, np.uint8)
    grey[cells >= 0] = FREE_GREY
    grey[cells >= OCCUPIED_FROM] = WALL_GREY
    scale = side / max(cells.shape)
    size = max(1, round(scale * cells.shape[1])), max(1, round(scale * cells.shape[0]))
    # Walls are a cell thick: where pixels are larger than cells, they would be lost by picking.
    resample = Image.Resampling.NEAREST if scale >= 1.0 else Image.Resampling.BOX
    picture = Image.fromarray(grey[::-1]).resize(size, resample).convert("RGB")
    return picture, _View(grid, scale, (col, row), size[1])


def _span(known: NDArray[np.int64], end: int, margin: int) -> tuple[int, int]:
    """First and end index of what is known, with a margin; all of it if nothing is."""
    if not len(known):
        return 0, end
    return max(0, int(known[0]) - margin), min(end, int(known[-1]) + 1 + margin)


def _draw_robot(
    on: "PillowDraw", view: _View, pose: Pose2D, footprint: Sequence[tuple[float, float]]
) -> None:
    outline = np.array(footprint or [(0.15, 0.0), (-0.15, 0.1), (-0.15, -0.1)])
    front = max(0.1, float(outline[:, 0].max()))
    corners = view.pixels(pose.transform_points(outline))
    on.polygon(corners, fill=GREEN, outline=BLACK)
    on.line(view.pixels(pose.transform_points(np.array([(0.0, 0.0), (front, 0.0)]))), WHITE, 3)


def _draw_place(on: "PillowDraw", view: _View, place: SavedPose) -> None:
    from PIL import ImageFont

    ends = view.pixels(place.pose.transform_points(np.array([(0.0, 0.0), (0.25, 0.0)])))
    if len(ends) < 2:  # a place that is not finite is nowhere
        return
    (x, y), _ = ends
    on.line(ends, BLUE, width=2)
    on.ellipse((x - 4, y - 4, x + 4, y + 4), fill=BLUE)
    font = ImageFont.load_default(14)
    on.text((x + 7, y - 7), place.name, BLACK, font, stroke_width=2, stroke_fill=WHITE)
