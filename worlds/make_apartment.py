"""Draws the map of the demo's apartment: `python worlds/make_apartment.py`.

The floor plan is this file; `apartment.yaml` and `apartment.pgm` are made from it and kept, so that
nobody has to run it unless the flat is to be changed. All numbers are metres in frame `map`; walls
and furniture are rectangles x from, x to, y from, y to, on a grid of 5 cm.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap, save_map

RESOLUTION = 0.05
ORIGIN = Pose2D(-1.5, -4.25, 0.0)
SIZE_M = (9.0, 7.0)

Rectangle = tuple[float, float, float, float]

# What a robot has seen of the floor, room by room. The storeroom's door was shut: it is unknown.
ROOMS: dict[str, Rectangle] = {
    "living room": (-1.0, 3.2, -0.95, 2.2),
    "corridor": (3.3, 6.95, 0.65, 2.2),
    "hall": (4.65, 6.95, -2.4, 0.55),
    "hall, in front of the kitchen": (3.45, 4.65, -3.65, -0.95),
    "kitchen": (-1.0, 3.35, -3.65, -1.05),
    "bathroom": (4.75, 6.95, -3.65, -2.5),
}

DOORS: dict[str, Rectangle] = {
    "living room to corridor": (3.2, 3.3, 0.9, 1.8),
    "corridor to hall": (5.2, 6.1, 0.55, 0.65),
    "hall to kitchen": (3.35, 3.45, -3.3, -2.4),
    "hall to bathroom": (4.9, 5.6, -2.5, -2.4),
}

WALL_M = 0.1

FURNITURE: dict[str, list[Rectangle]] = {
    "sofa": [(-0.95, -0.1, 0.35, 2.0)],
    "coffee table's legs": [
        (0.45, 0.5, 1.2, 1.25),
        (0.45, 0.5, 1.7, 1.75),
        (0.95, 1.0, 1.2, 1.25),
        (0.95, 1.0, 1.7, 1.75),
    ],
    "bookshelf": [(1.5, 2.7, 1.9, 2.2)],
    "television": [(1.0, 2.3, -0.95, -0.6)],
    "flower pot": [(2.9, 3.15, -0.9, -0.65)],
    "wardrobe in the corridor": [(5.95, 6.95, 1.85, 2.2)],
    "coats": [(6.5, 6.95, 0.25, 0.55)],
    "chest in the hall": [(5.8, 6.6, -2.4, -2.1)],
    "kitchen counter and cooker": [(-1.0, -0.4, -3.65, -1.05)],
    "refrigerator": [(-0.4, 0.25, -1.7, -1.05)],
    "kitchen table's legs": [
        (0.3, 0.35, -3.4, -3.35),
        (0.3, 0.35, -2.75, -2.7),
        (1.0, 1.05, -3.4, -3.35),
        (1.0, 1.05, -2.75, -2.7),
    ],
    "chair's legs": [
        (0.85, 0.9, -3.25, -3.2),
        (0.85, 0.9, -2.9, -2.85),
        (1.2, 1.25, -3.25, -3.2),
        (1.2, 1.25, -2.9, -2.85),
    ],
    "radiator": [(1.6, 2.8, -3.65, -3.55)],
    "bathtub": [(6.2, 6.95, -3.65, -2.5)],
    "washing machine": [(4.75, 5.35, -3.65, -3.1)],
}


def draw() -> GridMap:
    """Return the map: rooms, the walls around them, doors and furniture."""
    width, height = SIZE_M
    cells = np.full((round(height / RESOLUTION), round(width / RESOLUTION)), UNKNOWN, np.int8)
    for room in ROOMS.values():
        x0, x1, y0, y1 = room
        fill(cells, (x0 - WALL_M, x1 + WALL_M, y0 - WALL_M, y1 + WALL_M), OCCUPIED)
    for room in (*ROOMS.values(), *DOORS.values()):
        fill(cells, room, FREE)
    for pieces in FURNITURE.values():
        for piece in pieces:
            fill(cells, piece, OCCUPIED)
    return GridMap("apartment", RESOLUTION, ORIGIN, cells)


def fill(cells: NDArray[np.int8], rectangle: Rectangle, value: int) -> None:
    """Set all cells of a rectangle."""
    x0, x1, y0, y1 = rectangle
    rows = slice(round((y0 - ORIGIN.y) / RESOLUTION), round((y1 - ORIGIN.y) / RESOLUTION))
    cols = slice(round((x0 - ORIGIN.x) / RESOLUTION), round((x1 - ORIGIN.x) / RESOLUTION))
    cells[rows, cols] = value


if __name__ == "__main__":
    save_map(draw(), Path(__file__).with_name("apartment.yaml"))
