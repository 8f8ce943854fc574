"""Houses by other rules than `houses`: nothing in them needs to be square.

Rooms of many forms hang on a corridor that bends by any angle: L-shaped, round, octagonal and
oblong ones, turned any way. Furniture stands close: round tables, tables and chairs on legs, corner
sofas, cupboards askew. The localizer's numbers were not found in these houses.
"""

import math

import numpy as np
from bench.harness.houses import RESOLUTION, WALL_CELLS, Plan, Rect
from numpy.typing import NDArray
from scipy import ndimage

from trolley.gridmap import FREE, OCCUPIED, UNKNOWN

CORRIDOR_M = (1.1, 1.8)
DOOR_M = (0.8, 1.1)
FLOOR_PER_PIECE_M2 = 4.0
"""Floor to each piece of furniture [m^2]."""
TRIES = 60
"""So often a room is tried to be joined before the house is left smaller."""

Cells = NDArray[np.bool_]


class Sheet:
    """Cells to draw forms on."""

    def __init__(self, cells: int) -> None:
        self.y, self.x = (np.mgrid[:cells, :cells] + 0.5) * RESOLUTION

    def local(self, x: float, y: float, yaw: float) -> tuple[NDArray, NDArray]:
        """Coordinates of all cells seen from a pose [m]."""
        dx, dy = self.x - x, self.y - y
        cos, sin = math.cos(yaw), math.sin(yaw)
        return cos * dx + sin * dy, cos * dy - sin * dx

    def stroke(self, x0: float, y0: float, x1: float, y1: float, width: float) -> Cells:
        """A line of some width with round ends."""
        length = math.hypot(x1 - x0, y1 - y0)
        u, v = self.local(x0, y0, math.atan2(y1 - y0, x1 - x0))
        return np.hypot(u - np.clip(u, 0.0, length), v) <= 0.5 * width

    def box(self, x: float, y: float, yaw: float, length: float, width: float) -> Cells:
        """A box turned any way."""
        u, v = self.local(x, y, yaw)
        return (np.abs(u) <= 0.5 * length) & (np.abs(v) <= 0.5 * width)

    def disc(self, x: float, y: float, radius: float) -> Cells:
        """A disc."""
        return np.hypot(self.x - x, self.y - y) <= radius


def plan_odd_house(size_m: float, seed: int) -> Plan:
    """A house of at most this square."""
    rng = np.random.default_rng([seed, 20])
    sheet = Sheet(round(size_m / RESOLUTION))
    floor = _corridor(sheet, size_m, rng)
    doors: list[Rect] = []
    wanted = 0.5 * (size_m / RESOLUTION) ** 2
    for _ in range(TRIES):
        if floor.sum() >= wanted:
            break
        _join_room(floor, doors, sheet, size_m, rng)
    cells = np.full(floor.shape, UNKNOWN, np.int8)
    cells[ndimage.binary_dilation(floor, _square(WALL_CELLS))] = OCCUPIED
    cells[floor] = FREE
    boxes, shapes = _furnish(floor, doors, sheet, rng)
    return Plan(cells, tuple(doors), tuple(boxes), tuple(shapes))


def _square(cells: int) -> Cells:
    return np.ones((2 * cells + 1, 2 * cells + 1), bool)


def _corridor(sheet: Sheet, size_m: float, rng: np.random.Generator) -> Cells:
    """A corridor that bends by any angle, inside a margin."""
    width = rng.uniform(*CORRIDOR_M)
    low, high = 0.22 * size_m, 0.78 * size_m
    x, y = rng.uniform(low, high, 2)
    yaw = rng.uniform(-math.pi, math.pi)
    floor = np.zeros(sheet.x.shape, bool)
    for _ in range(int(rng.integers(2, 4))):
        length = rng.uniform(0.25, 0.45) * size_m
        for _ in range(50):
            to_x, to_y = x + length * math.cos(yaw), y + length * math.sin(yaw)
            if low <= to_x <= high and low <= to_y <= high:
                break
            yaw = rng.uniform(-math.pi, math.pi)
            length *= 0.95
        floor |= sheet.stroke(x, y, to_x, to_y, width)
        x, y = to_x, to_y
        yaw += rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 2.0)
    return floor


def _room(sheet: Sheet, x: float, y: float, rng: np.random.Generator) -> Cells:
    """A room of any form about a place."""
    yaw = rng.uniform(-math.pi, math.pi)
    length, width = rng.uniform(2.4, 5.0), rng.uniform(2.2, 3.6)
    form = rng.integers(4)
    if form == 0:
        return sheet.disc(x, y, 0.5 * width + 0.3)
    box = sheet.box(x, y, yaw, length, width)
    if form == 1:  # L-shaped: a corner is missing.
        u, v = sheet.local(x, y, yaw)
        return box & ~((u > 0.1 * length) & (v > rng.uniform(-0.1, 0.1) * width))
    if form == 2:  # Octagonal.
        u, v = sheet.local(x, y, yaw)
        return box & (np.abs(u) + np.abs(v) <= 0.38 * (length + width))
    # A bay at one end.
    end = 0.5 * length
    return box | sheet.disc(x + end * math.cos(yaw), y + end * math.sin(yaw), 0.4 * width)


def _join_room(
    floor: Cells, doors: list[Rect], sheet: Sheet, size_m: float, rng: np.random.Generator
) -> None:
    """Put a room beside what there is, and a door between the two, if there is space."""
    near = ndimage.binary_dilation(floor, _square(WALL_CELLS))
    away = ndimage.distance_transform_edt(~floor) * RESOLUTION
    ring = np.argwhere((away > 1.4) & (away < 2.6))
    row, col = ring[rng.integers(len(ring))]
    room = _room(sheet, (col + 0.5) * RESOLUTION, (row + 0.5) * RESOLUTION, rng)
    margin = 12
    inside = np.zeros_like(room)
    inside[margin:-margin, margin:-margin] = True
    room &= inside & ~ndimage.binary_dilation(near, _square(1))
    labels, count = ndimage.label(room)
    if count == 0:
        return
    room = labels == 1 + int(np.argmax(np.bincount(labels.ravel())[1:]))
    if room.sum() * RESOLUTION**2 < 4.0:
        return
    # The door is where the two come nearest, and a step further along the wall at random.
    gap = np.where(room, away, np.inf)
    close = np.argwhere(gap < gap.min() + 0.15)
    row, col = close[rng.integers(len(close))]
    _, (rows, cols) = ndimage.distance_transform_edt(~floor, return_indices=True)
    x0, y0 = (col + 0.5) * RESOLUTION, (row + 0.5) * RESOLUTION
    x1, y1 = (cols[row, col] + 0.5) * RESOLUTION, (rows[row, col] + 0.5) * RESOLUTION
    length = max(math.hypot(x1 - x0, y1 - y0), RESOLUTION)
    ahead_x, ahead_y = 0.3 * (x1 - x0) / length, 0.3 * (y1 - y0) / length
    door = sheet.stroke(
        x0 - ahead_x, y0 - ahead_y, x1 + ahead_x, y1 + ahead_y, rng.uniform(*DOOR_M)
    )
    opening = np.argwhere(door & ~room & ~floor)
    if len(opening) == 0 or length > 0.8:
        return
    (r0, c0), (r1, c1) = opening.min(axis=0), opening.max(axis=0) + 1
    doors.append((int(r0), int(r1), int(c0), int(c1)))
    floor |= room | door


def _piece(sheet: Sheet, x: float, y: float, yaw: float, rng: np.random.Generator) -> Cells:
    """What a lidar sees of a piece of furniture."""
    form = rng.integers(5)
    if form == 0:
        return sheet.disc(x, y, rng.uniform(0.15, 0.55))
    length, width = rng.uniform(0.5, 1.8), rng.uniform(0.3, 0.7)
    if form == 1:  # A cupboard askew.
        return sheet.box(x, y, yaw, length, width)
    if form == 2:  # A corner sofa.
        u, v = sheet.local(x, y, yaw)
        whole = (np.abs(u) <= 0.8) & (np.abs(v) <= 0.8)
        return whole & ~((u > -0.1) & (v > -0.1))
    # The legs of a table, or of a chair.
    half_u, half_v = (0.5 * length, 0.35) if form == 3 else (0.2, 0.2)
    u, v = sheet.local(x, y, yaw)
    return np.hypot(np.abs(u) - half_u, np.abs(v) - half_v) <= 0.04


def _furnish(
    floor: Cells, doors: list[Rect], sheet: Sheet, rng: np.random.Generator
) -> tuple[list[Rect], list[Cells]]:
    """Put pieces on the floor, in front of no door."""
    taken = ~floor
    for r0, r1, c0, c1 in doors:
        taken[max(r0 - 12, 0) : r1 + 12, max(c0 - 12, 0) : c1 + 12] = True
    boxes: list[Rect] = []
    shapes: list[Cells] = []
    places = np.argwhere(floor)
    wanted = round(floor.sum() * RESOLUTION**2 / FLOOR_PER_PIECE_M2)
    for _ in range(TRIES * wanted):
        if len(boxes) == wanted:
            break
        row, col = places[rng.integers(len(places))]
        yaw = rng.uniform(-math.pi, math.pi)
        x, y = (col + 0.5) * RESOLUTION, (row + 0.5) * RESOLUTION
        piece = _piece(sheet, x, y, yaw, rng)
        if not piece.any() or (piece & taken).any():
            continue
        (r0, c0), (r1, c1) = np.argwhere(piece).min(axis=0), np.argwhere(piece).max(axis=0) + 1
        boxes.append((int(r0), int(r1), int(c0), int(c1)))
        shapes.append(piece[r0:r1, c0:c1].copy())
        taken |= piece
    return boxes, shapes
