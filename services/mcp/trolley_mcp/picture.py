"""The map as a picture: walls, places, the robot, and what its lidar sees."""

import io
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from trolley.geometry import Pose2D
from trolley.gridmap import OCCUPIED_FROM, GridMap
from trolley.messages import SavedPose, Scan

MOST_PIXELS = 1024
"""Longest side of a picture."""
MOST_BYTES = 1_000_000
"""Largest picture; one that is larger is drawn again at half the size."""
MOST_PLACES = 100
MARGIN_CELLS = 10
WALL, FLOOR, UNKNOWN = (40, 40, 40), (255, 255, 255), (205, 210, 215)
SEEN, PLACE, ROBOT = (220, 40, 40), (20, 90, 200), (0, 140, 60)


class Scene(NamedTuple):
    """What is drawn; None and empty where it is unknown."""

    grid: GridMap
    places: Sequence[SavedPose] = ()
    robot: Pose2D | None = None
    seen_map: NDArray[np.float64] = np.empty((0, 2))
    """(n, 2) points [m] in `map`."""


def seen_points(scan: Scan, map_T_laser: Pose2D) -> NDArray[np.float64]:
    """Where the beams of a scan end, (n, 2) [m] in `map`; beams without an echo are left out."""
    ranges = np.frombuffer(scan.ranges, np.float32).astype(np.float64)
    has_echo = (ranges >= scan.range_min) & (ranges <= scan.range_max) & (ranges > 0.0)
    angles = scan.angle_min + scan.angle_increment * np.flatnonzero(has_echo)
    ends = ranges[has_echo, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return map_T_laser.transform_points(ends)


def draw(scene: Scene, side: int = 768) -> bytes:
    """Draw a scene as a PNG, `side` pixels long at most, +y up."""
    side = min(max(side, 64), MOST_PIXELS)
    while len(png := _draw(scene, side)) > MOST_BYTES and side > 64:
        side //= 2
    return png


def _draw(scene: Scene, side: int) -> bytes:
    grid = scene.grid
    first, last = _known(grid.cells)
    cells = grid.cells[first[0] : last[0], first[1] : last[1]]
    step = math.ceil(max(cells.shape) / side)
    shades = _thinned(cells, step)
    zoom = max(1, side // max(shades.shape))
    image = Image.fromarray(np.repeat(np.repeat(shades[::-1], zoom, 0), zoom, 1))
    pixel_m = grid.resolution * step / zoom

    def at(points_map: NDArray[np.float64]) -> list[tuple[float, float]]:
        points_grid = grid.world_to_grid(points_map) - first[::-1] * grid.resolution
        return [(x / pixel_m, image.height - y / pixel_m) for x, y in points_grid.tolist()]

    pen = ImageDraw.Draw(image)
    for x, y in at(scene.seen_map):
        pen.rectangle((x - 1, y - 1, x + 1, y + 1), fill=SEEN)
    font = ImageFont.load_default(14)
    for place in scene.places[:MOST_PLACES]:
        ((x, y),) = at(np.array([[place.pose.x, place.pose.y]]))
        pen.ellipse((x - 4, y - 4, x + 4, y + 4), fill=PLACE)
        pen.text((x + 6, y - 8), place.name, fill=PLACE, font=font)
    if scene.robot is not None:
        nose = max(0.3, 12 * pixel_m)
        corners = np.array([[nose, 0.0], [-0.6 * nose, 0.6 * nose], [-0.6 * nose, -0.6 * nose]])
        pen.polygon(at(scene.robot.transform_points(corners)), fill=ROBOT)
    buffer = io.BytesIO()
    image.quantize(64).save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def _known(cells: NDArray[np.int8]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The rectangle of cells that holds all that is known, from the first to past the last."""
    rows, cols = (np.flatnonzero((cells >= 0).any(axis)) for axis in (1, 0))
    if not len(rows):
        return np.zeros(2, np.int64), np.array(cells.shape)
    first = np.array([rows[0], cols[0]]) - MARGIN_CELLS
    last = np.array([rows[-1], cols[-1]]) + 1 + MARGIN_CELLS
    return np.maximum(first, 0), np.minimum(last, cells.shape)


def _thinned(cells: NDArray[np.int8], step: int) -> NDArray[np.uint8]:
    """Colours (rows, cols, 3) of blocks of cells; a wall in a block shows, then floor."""
    rows, cols = (math.ceil(size / step) * step for size in cells.shape)
    padded = np.full((rows, cols), -1, np.int8)
    padded[: cells.shape[0], : cells.shape[1]] = cells
    most = padded.reshape(rows // step, step, cols // step, step).max(axis=(1, 3))
    colours = np.full((*most.shape, 3), UNKNOWN, np.uint8)
    colours[(most >= 0) & (most < OCCUPIED_FROM)] = FLOOR
    colours[most >= OCCUPIED_FROM] = WALL
    return colours
