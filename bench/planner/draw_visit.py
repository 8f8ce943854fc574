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
CELL, WALL, GOAL, CONTACT = (225, 225, 235), (150, 150, 150), (0, 160, 0), (0, 0, 0)


def draw(visit: Visit, file: Path) -> None:
    """Draw a drive into a PNG file."""
    scene = visit.scene
    corners = visit.scene.body.array
    grid = scene.map()
    low = np.array([grid.origin.x, grid.origin.y]) - MARGIN_M
    high = low + np.array([grid.cols, grid.rows]) * grid.resolution + 2.0 * MARGIN_M
    scale = min(PIXELS_PER_M, MOST_PIXELS / float((high - low).max()))
    size = np.ceil((high - low) * scale).astype(int).tolist()
    image = Image.new("RGB", (size[0], size[1]), (255, 255, 255))
    pen = ImageDraw.Draw(image)

    def pixels(points: NDArray[np.float64]) -> list[tuple[float, float]]:
        return [((x - low[0]) * scale, (high[1] - y) * scale) for x, y in points.tolist()]

    def outline(pose: Pose2D, colour: tuple[int, int, int], width: int) -> None:
        points = pixels(pose.transform_points(corners))
        pen.line([*points, points[0]], fill=colour, width=width)
        # The front is thicker.
        front = pixels(pose.transform_points(corners[[0, 3]])) if len(corners) == 4 else points[:2]
        pen.line(front, fill=colour, width=width + 2)

    def box(x: float, y: float, length: float, width: float, colour: tuple[int, int, int]) -> None:
        half = 0.5 * np.array([length, width])
        (left, bottom), (right, top) = pixels(np.array([x, y]) + np.array([-half, half]))
        pen.rectangle((left, top, right, bottom), fill=colour)

    for solid in scene.boxes:
        box(*solid, WALL)
    rows, cols = np.nonzero(grid.occupied_mask())
    for x, y in grid.cell_to_world(np.column_stack([rows, cols])).tolist():
        box(x, y, 0.6 * grid.resolution, 0.6 * grid.resolution, CELL)
    due, total = -np.inf, max(visit.seconds, EVERY_S)
    began = visit.trace[0][0] if visit.trace else 0.0
    for seconds, pose in visit.trace:
        if seconds >= due:
            due = seconds + EVERY_S
            late = min(1.0, (seconds - began) / total)
            outline(pose, (round(230 * late), 60, round(230 * (1.0 - late))), 1)
    outline(scene.start, (90, 90, 200), 2)
    for goal in scene.goals:
        outline(goal, GOAL, 2)
    for x, y in visit.contacts:
        (px, py), *_ = pixels(np.array([(x, y)]))
        pen.ellipse((px - 6, py - 6, px + 6, py + 6), outline=CONTACT, width=3)
    image.save(file)
