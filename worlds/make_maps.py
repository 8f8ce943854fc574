"""Draws the maps of the worlds in this folder: `python worlds/make_maps.py`.

The floor plans are this file; the maps are made from it and kept beside it, so that nobody has to
run it unless a plan is to be changed. All numbers are metres in frame `map`; rooms, doors and
furniture are rectangles x from, x to, y from, y to, on a grid of 5 cm.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap, save_map

RESOLUTION = 0.05
WALL_M = 0.1

Rectangle = tuple[float, float, float, float]


class Plan(NamedTuple):
    """A floor plan.

    Attributes:
        name: of the map.
        extent: of the map, margins included.
        rooms: what a robot has seen of the floor; walls are drawn around each.
        doors: openings in the walls.
        furniture: what stands on the floor at the height of a low lidar.
    """

    name: str
    extent: Rectangle
    rooms: dict[str, Rectangle]
    doors: dict[str, Rectangle]
    furniture: dict[str, list[Rectangle]]


# The demo's flat. The storeroom's door was shut when the map was made: it is unknown.
APARTMENT = Plan(
    name="apartment",
    extent=(-1.5, 7.5, -4.25, 2.75),
    rooms={
        "living room": (-1.0, 3.2, -0.95, 2.2),
        "corridor": (3.3, 6.95, 0.65, 2.2),
        "hall": (4.65, 6.95, -2.4, 0.55),
        "hall, in front of the kitchen": (3.45, 4.65, -3.65, -0.95),
        "kitchen": (-1.0, 3.35, -3.65, -1.05),
        "bathroom": (4.75, 6.95, -3.65, -2.5),
    },
    doors={
        "living room to corridor": (3.2, 3.3, 0.9, 1.8),
        "corridor to hall": (5.2, 6.1, 0.55, 0.65),
        "hall to kitchen": (3.35, 3.45, -3.3, -2.4),
        "hall to bathroom": (4.9, 5.6, -2.5, -2.4),
    },
    furniture={
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
    },
)

OFFICE = Plan(
    name="office",
    extent=(-0.5, 12.5, -0.5, 9.5),
    rooms={
        "corridor": (0.1, 11.9, 3.8, 5.4),
        "workshop": (0.1, 4.4, 0.1, 3.7),
        "store": (4.5, 7.4, 0.1, 3.7),
        "kitchenette": (7.5, 11.9, 0.1, 3.7),
        "north office": (0.1, 3.9, 5.5, 8.9),
        "meeting room": (4.0, 8.4, 5.5, 8.9),
        "east office": (8.5, 11.9, 5.5, 8.9),
    },
    doors={
        "workshop": (1.6, 2.5, 3.7, 3.8),
        "store": (5.4, 6.3, 3.7, 3.8),
        "kitchenette": (9.2, 10.1, 3.7, 3.8),
        "north office": (2.2, 3.1, 5.4, 5.5),
        "meeting room, with the pane beside the door": (4.2, 7.2, 5.4, 5.5),
        "east office": (9.8, 10.7, 5.4, 5.5),
    },
    furniture={
        "work benches": [(0.1, 0.8, 0.1, 3.0), (3.2, 4.4, 0.1, 0.8)],
        "shelves": [(4.5, 5.0, 0.1, 3.2), (6.9, 7.4, 0.1, 3.2)],
        "counter": [(11.2, 11.9, 0.1, 2.6)],
        "desks": [(0.1, 1.6, 8.1, 8.9), (0.1, 0.9, 6.4, 7.6), (11.1, 11.9, 6.6, 8.2)],
        "meeting table's legs": [
            (5.3, 5.35, 6.8, 6.85),
            (7.1, 7.15, 6.8, 6.85),
            (5.3, 5.35, 7.7, 7.75),
            (7.1, 7.15, 7.7, 7.75),
        ],
        "column": [(6.8, 7.1, 4.9, 5.2)],
    },
)

ROOM = Plan(
    name="room",
    extent=(-3.25, 3.25, -2.75, 2.75),
    rooms={"room": (-3.0, 3.0, -2.5, 2.5)},
    doors={},
    furniture={"column": [(1.5, 1.8, 1.0, 1.3)], "cupboard": [(-3.0, -2.5, -2.5, -1.5)]},
)

# For several robots: two of them do not fit through a door side by side, nor past the cupboards.
HOUSE = Plan(
    name="house",
    extent=(-0.5, 14.5, -0.5, 10.0),
    rooms={
        "corridor": (0.1, 13.9, 4.2, 5.3),
        "kitchen": (0.1, 3.9, 0.1, 4.1),
        "dining room": (4.0, 7.4, 0.1, 4.1),
        "office": (7.5, 10.4, 0.1, 4.1),
        "bedroom": (10.5, 13.9, 0.1, 4.1),
        "living room": (0.1, 5.4, 5.4, 9.4),
        "bathroom": (5.5, 7.4, 5.4, 9.4),
        "study": (7.5, 10.4, 5.4, 9.4),
        "guest room": (10.5, 13.9, 5.4, 9.4),
    },
    doors={
        "kitchen": (2.0, 2.8, 4.1, 4.2),
        "dining room": (4.6, 5.4, 4.1, 4.2),
        "kitchen to dining room": (3.9, 4.0, 1.4, 2.2),
        "office": (8.6, 9.4, 4.1, 4.2),
        "bedroom": (11.0, 11.8, 4.1, 4.2),
        "living room": (3.2, 4.0, 5.3, 5.4),
        "bathroom": (5.8, 6.5, 5.3, 5.4),
        "study": (8.0, 8.8, 5.3, 5.4),
        "guest room": (12.2, 13.0, 5.3, 5.4),
    },
    furniture={
        "cupboards in the corridor": [(6.7, 8.0, 4.2, 4.6)],
        "kitchen counter": [(0.1, 0.7, 0.1, 3.0)],
        "sideboard": [(4.4, 6.4, 0.1, 0.5)],
        "desks": [(7.5, 8.1, 0.1, 1.5), (9.8, 10.4, 7.0, 8.6)],
        "beds": [(12.2, 13.9, 0.9, 2.5), (10.5, 12.1, 8.0, 9.4)],
        "sofa": [(0.1, 0.9, 6.2, 8.2)],
        "bathtub": [(6.6, 7.4, 7.6, 9.4)],
        "coffee table's legs": [
            (2.0, 2.05, 7.0, 7.05),
            (2.0, 2.05, 7.5, 7.55),
            (2.7, 2.75, 7.0, 7.05),
            (2.7, 2.75, 7.5, 7.55),
        ],
    },
)

PLANS = (APARTMENT, OFFICE, ROOM, HOUSE)


def draw(plan: Plan) -> GridMap:
    """Return the map of a plan: rooms, the walls around them, doors and furniture."""
    x0, x1, y0, y1 = plan.extent
    shape = (round((y1 - y0) / RESOLUTION), round((x1 - x0) / RESOLUTION))
    cells = np.full(shape, UNKNOWN, dtype=np.int8)
    grid = GridMap(plan.name, RESOLUTION, Pose2D(x0, y0, 0.0), cells)
    for left, right, low, high in plan.rooms.values():
        fill(grid, (left - WALL_M, right + WALL_M, low - WALL_M, high + WALL_M), OCCUPIED)
    for floor in (*plan.rooms.values(), *plan.doors.values()):
        fill(grid, floor, FREE)
    for pieces in plan.furniture.values():
        for piece in pieces:
            fill(grid, piece, OCCUPIED)
    return grid


def fill(grid: GridMap, rectangle: Rectangle, value: int) -> None:
    """Set all cells of a rectangle."""
    x0, x1, y0, y1 = rectangle
    cells: NDArray[np.int8] = grid.cells
    rows = slice(round((y0 - grid.origin.y) / RESOLUTION), round((y1 - grid.origin.y) / RESOLUTION))
    cols = slice(round((x0 - grid.origin.x) / RESOLUTION), round((x1 - grid.origin.x) / RESOLUTION))
    cells[rows, cols] = value


if __name__ == "__main__":
    for each in PLANS:
        save_map(draw(each), Path(__file__).with_name(f"{each.name}.yaml"))
