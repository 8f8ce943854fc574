"""Where the known floor ends: frontiers that a robot can drive to, and what each is worth."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.gridmap import distance_transform
from trolley.gridmap.kernels import spread_over
from trolley_mapper.explore.traversable_area import Floor
from trolley_mapper.kernels.frontiers import (
    FREE,
    STRAIGHT,
    UNKNOWN,
    UNREACHED,
    edge_into,
    spread_into,
    unseen_from,
)

NEAR_M = 2.0
"""From a goal to the frontier that it belongs to, at most."""
VIEW_M = 3.0
"""Unknown floor within this distance of a goal counts as what it would show."""
RAYS = 90
SAMPLES = 8
"""Goals that are compared for each frontier."""
STEP_ASIDE_M = 0.6
"""Where the robot stands too near to something, its way begins this far away at most."""


@dataclass(frozen=True, slots=True)
class Body:
    """How much room the robot's centre needs.

    Attributes:
        passes_m: from whatever it drives past [m].
        stands_m: from whatever is round its goals [m].
    """

    passes_m: float
    stands_m: float

    @property
    def width_m(self) -> float:
        """The narrowest that matters: what is unknown there cannot be driven into."""
        return 2.0 * self.passes_m


@dataclass(frozen=True, slots=True)
class Frontier:
    """A piece of the border between free and unknown floor, and the best place to look from."""

    x: float
    """A place on it, in the map [m]."""
    y: float
    goal: Pose2D
    """map_T_base, with the unknown ahead."""
    way_m: float
    """From where the robot is."""
    gain_m2: float
    """Unknown floor that the goal would show at most."""

    @property
    def worth(self) -> float:
        """What it shows for the way: the greater the better.

        The way decides: who runs after the greatest gain drives half as far again, since what was
        left behind must be come back for (bench/exploring.py).
        """
        return math.sqrt(self.gain_m2) / (self.way_m + 1.0)


@dataclass(frozen=True, slots=True)
class Outlook:
    """What is to be seen from where the robot is."""

    frontiers: list[Frontier]
    """Those that can be reached."""
    unreachable: list[tuple[float, float]]
    """Places in the map [m] where wide frontiers cannot be reached."""
    area_m2: float
    """Free floor that hangs together with where the robot is."""
    can_move: bool
    """Whether there is any floor about the robot that is wide enough for it."""


def look_out(floor: Floor, here: Pose2D, body: Body) -> Outlook:
    """Find the frontiers of a floor.

    Args:
        floor: as far as it is known.
        here: map_T_base.
        body: of the robot.
    """
    room_m = distance_transform((floor.kinds != FREE).astype(np.uint8), floor.resolution)
    passable = (room_m >= body.passes_m).astype(np.uint8)
    cost, seed = _empty(floor), _empty(floor)
    start = _way_out(floor, here, passable)
    spread_into(cost, seed, passable, start, UNREACHED // 2)
    stands = np.flatnonzero((cost != UNREACHED) & (room_m >= body.stands_m)).astype(np.int32)
    near, goal = _empty(floor), _empty(floor)
    free = (floor.kinds == FREE).astype(np.uint8)
    spread_into(near, goal, free, stands, _steps(floor, NEAR_M))
    frontiers: list[Frontier] = []
    unreachable: list[tuple[float, float]] = []
    for cells in _borders(floor, free, body.width_m):
        places = np.unique(goal.ravel()[cells])
        places = places[places >= 0]
        if places.size:
            found = _best(floor, cells, near, goal, cost)
            if found.gain_m2 >= body.width_m**2:
                frontiers.append(found)
        elif len(cells) * floor.resolution >= 2.0 * body.width_m:
            at = floor.place(int(cells[len(cells) // 2]))
            unreachable.append((at.x, at.y))
    return Outlook(frontiers, unreachable, _area(floor, free, here), bool(start.size))


def way_to(floor: Floor, here: Pose2D, there: Pose2D, body: Body) -> float | None:
    """Return the length of the way to a place [m], None if there is none."""
    room_m = distance_transform((floor.kinds != FREE).astype(np.uint8), floor.resolution)
    passable = (room_m >= body.passes_m).astype(np.uint8)
    cost, seed = _empty(floor), _empty(floor)
    spread_into(cost, seed, passable, _way_out(floor, here, passable), UNREACHED // 2)
    ends = _way_out(floor, there, passable)
    reached = int(cost.ravel()[ends].min()) if ends.size else UNREACHED
    return None if reached == UNREACHED else reached * floor.resolution / STRAIGHT


def _empty(floor: Floor) -> NDArray[np.int32]:
    return np.empty(floor.kinds.shape, np.int32)


def _steps(floor: Floor, distance_m: float) -> int:
    return round(STRAIGHT * distance_m / floor.resolution)


def _cell_of(floor: Floor, pose: Pose2D) -> int | None:
    """Return the number of the cell that a pose of the map lies in, None off the floor."""
    rows, cols = floor.kinds.shape
    x, y = floor.in_cells(pose)
    return math.floor(y) * cols + math.floor(x) if 0 <= x < cols and 0 <= y < rows else None


def _way_out(floor: Floor, here: Pose2D, passable: NDArray[np.uint8]) -> NDArray[np.int32]:
    """Return the passable cell nearest to the robot over free floor; none if it is shut in."""
    cell = _cell_of(floor, here)
    if cell is None:
        return np.empty(0, np.int32)
    cost, seed = _empty(floor), _empty(floor)
    free = (floor.kinds == FREE).astype(np.uint8)
    spread_into(cost, seed, free, np.array([cell], np.int32), _steps(floor, STEP_ASIDE_M))
    reached = np.flatnonzero((cost != UNREACHED) & (passable != 0))
    if not reached.size:
        return np.empty(0, np.int32)
    return reached[[int(np.argmin(cost.ravel()[reached]))]].astype(np.int32)


def _borders(floor: Floor, free: NDArray[np.uint8], width_m: float) -> list[NDArray[np.intp]]:
    """Return the cells of each frontier that is not narrower than the robot, as their numbers."""
    unknown = (floor.kinds == UNKNOWN).astype(np.uint8)
    label = _empty(floor)
    count = spread_over(label, unknown, unknown, 1)
    # Specks between beams and under furniture: the robot would not fit in.
    sizes = np.bincount(label.ravel(), minlength=count + 1)
    small = sizes * floor.resolution**2 < width_m**2
    small[0] = True
    # What lies off the edge of the floor's margin is unknown as well, so no group that touches it
    # is small.
    for border in (label[0], label[-1], label[:, 0], label[:, -1]):
        small[border[border > 0]] = False
    unknown[small[label]] = 0
    edge = np.empty_like(free)
    edge_into(edge, free, unknown)
    groups = spread_over(label, edge, edge, 1)
    order = np.argsort(label.ravel(), kind="stable")
    bounds = np.searchsorted(label.ravel()[order], np.arange(1, groups + 2))
    pieces = [order[bounds[k] : bounds[k + 1]] for k in range(groups)]
    return [one for one in pieces if _extent(floor, one) * floor.resolution >= width_m]


def _extent(floor: Floor, cells: NDArray[np.intp]) -> float:
    """Return the length of the diagonal of the box round some cells [cells]."""
    rows, cols = np.divmod(cells, floor.kinds.shape[1])
    return math.hypot(int(np.ptp(rows)) + 1, int(np.ptp(cols)) + 1)


def _best(
    floor: Floor,
    cells: NDArray[np.intp],
    near: NDArray[np.int32],
    goal: NDArray[np.int32],
    cost: NDArray[np.int32],
) -> Frontier:
    """Return a frontier with the best of a few goals spread along it."""
    reached = cells[goal.ravel()[cells] >= 0]
    tried = reached[np.unique(np.linspace(0, len(reached) - 1, SAMPLES).round().astype(int))]
    closest = reached[[int(np.argmin(near.ravel()[reached]))]]
    found: dict[int, Frontier] = {}
    for cell in np.concatenate([closest, tried]):
        place = int(goal.ravel()[cell])
        if place not in found:
            found[place] = _frontier(floor, int(cell), place, int(cost.ravel()[place]))
    return max(found.values(), key=lambda one: one.worth)


def _frontier(floor: Floor, cell: int, place: int, cost: int) -> Frontier:
    """Return a frontier with one goal; both are numbers of cells."""
    row, col = divmod(place, floor.kinds.shape[1])
    area, along_x, along_y = unseen_from(
        floor.kinds, col + 0.5, row + 0.5, VIEW_M / floor.resolution, RAYS
    )
    at = floor.place(cell)
    way_m = cost * floor.resolution / STRAIGHT
    toward = math.atan2(along_y, along_x)
    goal = floor.place(place, toward)
    return Frontier(at.x, at.y, goal, way_m, area * floor.resolution**2)


def _area(floor: Floor, free: NDArray[np.uint8], here: Pose2D) -> float:
    """Return the free floor that hangs together with where the robot is [m^2]."""
    cell = _cell_of(floor, here)
    if cell is None:
        return 0.0
    label = _empty(floor)
    spread_over(label, free, free, 1)
    group = label.ravel()[cell]
    return 0.0 if group == 0 else float(np.count_nonzero(label == group)) * floor.resolution**2
