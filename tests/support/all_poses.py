"""All poses that a robot can reach, found by trying all: slow, plain, and nothing of the planner.

Poses lie on a grid of points and 32 headings, each of which leads from point to point. A pose is
free if no cell that is occupied comes within a margin of the outline.
"""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.gridmap import FREE, OCCUPIED, GridMap

PARTS = 4
"""Parts of a cell's edge."""
STEP_PARTS = 2
"""Parts between two poses."""
QUARTER = [(1, 0), (3, 1), (2, 1), (3, 2), (1, 1), (2, 3), (1, 2), (1, 3)]
STEPS = QUARTER + [(-y, x) for x, y in QUARTER]
STEPS += [(-x, -y) for x, y in STEPS]
"""Columns and rows of the step along each heading, counter-clockwise."""
YAWS = np.unwrap([math.atan2(y, x) for x, y in STEPS])


class AllPoses:
    """Where an outline can be on a map, and what it can reach from where.

    Args:
        grid: the map, its origin at (0, 0, 0).
        corners: of the outline, convex.
        margin_m: to keep from occupied cells.
    """

    def __init__(self, grid: GridMap, corners: list[tuple[float, float]], margin_m: float) -> None:
        self._edge_m = STEP_PARTS * grid.resolution / PARTS
        between = 0.5 * (YAWS + np.append(YAWS[1:], YAWS[0] + 2.0 * math.pi))
        occupied = np.kron(grid.cells != FREE, np.ones((PARTS, PARTS)))
        edge = grid.resolution / PARTS
        outline = np.array(corners)
        self.free = np.array([_free(occupied, outline, yaw, margin_m, edge) for yaw in YAWS])
        self._can_turn = np.array(
            [_free(occupied, outline, yaw, margin_m, edge) for yaw in between]
        )

    def cell(self, pose: Pose2D) -> tuple[int, int, int]:
        """Heading, row and column nearest to a pose."""
        heading = int(np.argmin(np.abs(np.angle(np.exp(1j * (YAWS - pose.yaw))))))
        return heading, math.floor(pose.y / self._edge_m), math.floor(pose.x / self._edge_m)

    def pose(self, cell: tuple[int, int, int]) -> Pose2D:
        """The pose of heading, row and column."""
        heading, row, col = (int(part) for part in cell)
        yaw = math.remainder(float(YAWS[heading]), 2.0 * math.pi)
        return Pose2D((col + 0.5) * self._edge_m, (row + 0.5) * self._edge_m, yaw)

    def reached(self, start: tuple[int, int, int]) -> NDArray[np.bool_]:
        """What can be reached from a pose: (headings, rows, cols)."""
        reached = np.zeros_like(self.free)
        reached[start] = self.free[start]
        count = 0
        while np.count_nonzero(reached) != count:
            count = np.count_nonzero(reached)
            for heading, (cols, rows) in enumerate(STEPS):
                for _ in range(12):
                    for sign in (1, -1):
                        moved = _shifted(reached[heading], sign * rows, sign * cols)
                        reached[heading] |= moved & self.free[heading]
            for order in (range(len(STEPS)), range(len(STEPS) - 1, -1, -1)):
                for heading in order:
                    after = (heading + 1) % len(STEPS)
                    turns = self._can_turn[heading] & (reached[heading] | reached[after])
                    reached[heading] |= turns & self.free[heading]
                    reached[after] |= turns & self.free[after]
        return reached


def _free(
    occupied: NDArray[np.float64],
    outline: NDArray[np.float64],
    yaw: float,
    margin_m: float,
    edge_m: float,
) -> NDArray[np.bool_]:
    """Where the outline's origin may be, at one heading: (rows, cols) of poses."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    turned = outline @ np.array([[cos, sin], [-sin, cos]])
    reach = math.ceil((np.hypot(*outline.T).max() + margin_m) / edge_m) + 2
    offsets = np.arange(-reach, reach + 1) * edge_m
    # Poses lie in the corners between parts; to these the parts' centres are half a part off.
    x, y = np.meshgrid(offsets + 0.5 * edge_m, offsets + 0.5 * edge_m)
    within = np.full(x.shape, -np.inf)
    for a, b in zip(turned, np.roll(turned, -1, axis=0), strict=True):
        normal = np.array([b[1] - a[1], a[0] - b[0]]) / math.hypot(*(b - a))
        within = np.maximum(within, (x - a[0]) * normal[0] + (y - a[1]) * normal[1])
    # Half the diagonal of a part, so that no part of it comes nearer.
    kernel = within < margin_m + 0.71 * edge_m
    size = [a + b for a, b in zip(occupied.shape, kernel.shape, strict=True)]
    # Correlation: what stands at an offset of the kernel from the pose.
    product = np.fft.rfft2(occupied, size) * np.fft.rfft2(kernel[::-1, ::-1].astype(float), size)
    hits = np.fft.irfft2(product, size)[
        reach : reach + occupied.shape[0], reach : reach + occupied.shape[1]
    ]
    free = hits < 0.5
    free[:reach] = free[-reach:] = False
    free[:, :reach] = free[:, -reach:] = False
    return free[STEP_PARTS // 2 :: STEP_PARTS, STEP_PARTS // 2 :: STEP_PARTS]


def _shifted(mask: NDArray[np.bool_], rows: int, cols: int) -> NDArray[np.bool_]:
    moved = np.zeros_like(mask)
    height, width = mask.shape
    moved[max(rows, 0) : height + min(rows, 0), max(cols, 0) : width + min(cols, 0)] = mask[
        max(-rows, 0) : height + min(-rows, 0), max(-cols, 0) : width + min(-cols, 0)
    ]
    return moved


def box(length_m: float, width_m: float, axle_m: float) -> list[tuple[float, float]]:
    """A rectangle with the axle so far from its rear."""
    front, side = length_m - axle_m, 0.5 * width_m
    return [(front, side), (-axle_m, side), (-axle_m, -side), (front, -side)]


FOOTPRINTS = [
    box(0.35, 0.30, 0.175),
    box(0.60, 0.60, 0.30),
    box(0.60, 0.42, 0.08),
    box(0.60, 0.30, 0.30),
    box(0.46, 0.42, 0.23),
]
"""A small robot, a large one, one with its axle at the rear, a long one, one nearly square."""


def random_corridors(rng: np.random.Generator) -> GridMap:
    """Rooms joined by a corridor with one or two bends, or by a door at its side."""
    cells = np.full((90, 110), OCCUPIED, dtype=np.int8)
    width, second = (int(rng.integers(9, 16)) for _ in range(2))
    cells[4:34, 4:34] = FREE
    row = int(rng.integers(6, 30 - width))
    bend = int(rng.integers(52, 70))
    cells[row : row + width, 30:bend] = FREE
    end = int(rng.integers(row + width + 8, 84 - second))
    cells[row : end + second, bend - width : bend] = FREE
    match int(rng.integers(3)):
        case 0:  # it ends there
            pass
        case 1:  # another bend
            cells[end : end + second, bend - width : 104] = FREE
        case _:  # a room behind a door at its side
            cells[end : end + second, bend : bend + 2] = FREE
            cells[max(4, end - 12) : end + second + 4, bend + 2 : 104] = FREE
    return GridMap("corridors", 0.05, Pose2D.identity(), cells)


def random_home(rng: np.random.Generator) -> GridMap:
    """Four rooms with doors between them, and furniture."""
    cells = np.full((110, 130), FREE, dtype=np.int8)
    cells[:2] = cells[-2:] = cells[:, :2] = cells[:, -2:] = OCCUPIED
    wall_row, wall_col = int(rng.integers(45, 65)), int(rng.integers(55, 75))
    cells[wall_row : wall_row + 2] = OCCUPIED
    cells[:, wall_col : wall_col + 2] = OCCUPIED
    for first, last in ((4, wall_col - 20), (wall_col + 4, 110)):
        door, at = int(rng.integers(8, 17)), int(rng.integers(first, last))
        cells[wall_row : wall_row + 2, at : at + door] = FREE
    for first, last in ((4, wall_row - 20), (wall_row + 4, 90)):
        door, at = int(rng.integers(8, 17)), int(rng.integers(first, last))
        cells[at : at + door, wall_col : wall_col + 2] = FREE
    for _ in range(int(rng.integers(6, 14))):
        height, width = rng.integers(4, 20, 2)
        row, col = int(rng.integers(2, 108 - height)), int(rng.integers(2, 128 - width))
        # Not right in a door.
        if abs(row + height / 2 - wall_row) > height / 2 + 8 and (
            abs(col + width / 2 - wall_col) > width / 2 + 8
        ):
            cells[row : row + height, col : col + width] = OCCUPIED
    return GridMap("home", 0.05, Pose2D.identity(), cells)
