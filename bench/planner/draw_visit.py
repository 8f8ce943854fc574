"""A picture of a drive: what is solid, the map, the robot once a second, its goals, contacts."""

from pathlib import Path

import numpy as np
from bench.planner.visit import Visit
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from trolley.geometry import Pose2D

PIXELS_PER_M = 120
MOST_PIXELS = 2400
EVERY_S = 1.0
MARGIN_M = 0.3
Colour = tuple[int, int, int]
CELL, WALL, START, GOAL = (225, 225, 235), (150, 150, 150), (90, 90, 200), (0, 160, 0)
CONTACT = (0, 0, 0)


class _Canvas:
    """A picture of the rectangle between two corners [m]."""

    def __init__(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> None:
        self._left, self._top = float(low[0]), float(high[1])
        self._scale = min(PIXELS_PER_M, MOST_PIXELS / float((high - low).max()))
        width, height = np.ceil((high - low) * self._scale).astype(int).tolist()
        self.image = Image.new("RGB", (width, height), (255, 255, 255))
        self._pen = ImageDraw.Draw(self.image)

    def _pixels(self, points: NDArray[np.float64]) -> list[tuple[float, float]]:
        return [
            ((x - self._left) * self._scale, (self._top - y) * self._scale)
            for x, y in points.tolist()
        ]

    def box(self, x: float, y: float, length: float, width: float, colour: Colour) -> None:
        half = 0.5 * np.array([length, width])
        (left, low), (right, top) = self._pixels(np.array([x, y]) + np.array([-half, half]))
        self._pen.rectangle((left, top, right, low), fill=colour)

    def robot(self, corners: NDArray[np.float64], pose: Pose2D, colour: Colour, width: int) -> None:
        """An outline whose first corner and last are the front, which is thicker."""
        points = self._pixels(pose.transform_points(corners))
        self._pen.line([*points, points[0]], fill=colour, width=width)
        self._pen.line([points[0], points[-1]], fill=colour, width=width + 2)

    def dots(self, points: NDArray[np.float64], radius: float, colour: Colour) -> None:
        for x, y in self._pixels(points):
            self._pen.ellipse((x - radius, y - radius, x + radius, y + radius), fill=colour)

    def rings(self, points: NDArray[np.float64], colour: Colour) -> None:
        for x, y in self._pixels(points):
            self._pen.ellipse((x - 7, y - 7, x + 7, y + 7), outline=colour, width=3)


def draw(visit: Visit, file: Path) -> None:
    """Draw a drive into a PNG file."""
    scene, grid = visit.scene, visit.scene.map()
    low = np.array([grid.origin.x, grid.origin.y])
    high = low + np.array([grid.cols, grid.rows]) * grid.resolution
    canvas = _Canvas(low - MARGIN_M, high + MARGIN_M)
    for solid in scene.boxes:
        canvas.box(*solid, WALL)
    rows, cols = np.nonzero(grid.occupied_mask())
    edge = 0.6 * grid.resolution
    for x, y in grid.cell_to_world(np.column_stack([rows, cols])).tolist():
        canvas.box(x, y, edge, edge, CELL)
    corners = scene.body.array
    total = max(visit.seconds, EVERY_S)
    for seconds, places in visit.people:
        canvas.dots(places, 3.0, (round(230 * min(1.0, seconds / total)), 160, 60))
    due, began = -np.inf, visit.trace[0][0] if visit.trace else 0.0
    for seconds, pose in visit.trace:
        if seconds >= due:
            due = seconds + EVERY_S
            late = min(1.0, (seconds - began) / total)
            canvas.robot(corners, pose, (round(230 * late), 60, round(230 * (1.0 - late))), 1)
    canvas.robot(corners, scene.start, START, 2)
    for goal in scene.goals:
        canvas.robot(corners, goal, GOAL, 2)
    places = [*visit.contacts, *(hit.at for hit in visit.hits)]
    canvas.rings(np.array(places).reshape(-1, 2), CONTACT)
    canvas.image.save(file)
