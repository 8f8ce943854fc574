"""Where the known floor ends: frontiers that a robot can drive to, and what each is worth."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.gridmap import distance_transform
from trolley.gridmap.kernels import spread_over
from trolley_mapper.explore.traversable_area import TraversableArea
from trolley_mapper.kernels.frontiers import (
    BLOCKED,
    FREE,
    NONE,
    STRAIGHT,
    UNKNOWN,
    UNREACHED,
    edge_into,
    fits_into,
    fitting_yaw,
    spread_into,
    unseen_from,
)


@dataclass(frozen=True, slots=True)
class FrontierParams:
    """How goals are found for frontiers, and compared. Set by hand."""

    max_distance_m: float = 2.0
    """Greatest distance from a goal to its frontier [m]."""
    view_m: float = 3.0
    """Distance from a goal within which it would show unknown floor [m]."""
    num_rays: int = 90
    """Number of rays, all round, that are cast to measure that floor."""
    small_m2: float = 1.0
    """Floor below which what a goal shows must be worth the way [m^2]."""
    min_gain_m: float = 0.12
    """Least floor for each metre of the way that is worth it [m^2/m]."""
    num_goals: int = 8
    """Goals that are compared for each frontier."""
    num_clearances: int = 3
    """Number of clearances, from standing down to passing, that goals are sought with one after
    the other: robots drive through corridors with less room than their goals have elsewhere."""
    num_turns: int = 32
    """Headings, all round, that are tried where a robot fits in some only."""
    max_step_aside_m: float = 0.6
    """Greatest distance to the begin of a path where the robot stands too near to an obstacle [m].
    """


PARAMS = FrontierParams()


@dataclass(frozen=True, slots=True, eq=False)
class Clearance:
    """How much room the robot needs.

    Attributes:
        outline: of the robot, (n, 2) corners in `base_link` [m].
        passing_m: from whatever it drives past [m].
        standing_m: from whatever is round its goals, where a frontier has such a place near it [m].
        squeezing_m: the least with which it may pass at all [m].
    """

    outline: NDArray[np.float64]
    passing_m: float
    standing_m: float
    squeezing_m: float

    def outline_cells(self, resolution_m: float) -> NDArray[np.float64]:
        """Return points (m, 2) all along the outline, half a cell apart at most [cells]."""
        corners = self.outline / resolution_m
        sides = np.roll(corners, -1, axis=0) - corners
        counts = np.ceil(2.0 * np.hypot(*sides.T)).astype(int)
        return np.concatenate(
            [
                corner + np.arange(count)[:, None] / count * side
                for corner, side, count in zip(corners, sides, counts, strict=True)
            ]
        )

    @property
    def squeezed(self) -> "Clearance":
        """The same where the robot squeezes through, as into a door hardly wider than it is."""
        return replace(self, passing_m=self.squeezing_m)

    @property
    def is_squeezed(self) -> bool:
        """Whether there is none tighter."""
        return self.passing_m <= self.squeezing_m

    @property
    def width_m(self) -> float:
        """The narrowest that matters: what is unknown there cannot be driven into."""
        return 2.0 * self.passing_m


@dataclass(frozen=True, slots=True)
class Frontier:
    """A piece of the border between free and unknown floor, and the best place to look from."""

    x: float
    """x of a place on it, in the map [m]."""
    y: float
    """y of that place [m]."""
    goal: Pose2D
    """Pose to drive to (`map_T_base`), with the unknown ahead."""
    distance_m: float
    """Length of the path to the goal [m]."""
    gain_m2: float
    """Most unknown floor that the goal would show [m^2]."""
    others: "tuple[Frontier, ...]" = ()
    """Other places along it, each with a goal: it may be long, and one place on it in vain."""
    nearer: "Frontier | None" = None
    """The same with goals that have less room: from nearer, as from within a door, more is seen."""

    @property
    def goals(self) -> "tuple[Frontier, ...]":
        """It and the others, each with its goal."""
        return self, *self.others

    @property
    def chain(self) -> "tuple[Frontier, ...]":
        """The same, and all that is nearer."""
        return self.goals if self.nearer is None else (*self.goals, *self.nearer.chain)

    @property
    def worth(self) -> float:
        """What it shows for its distance: the greater the better.

        Distance weighs more: going for the greatest gain makes the robot drive half as far again,
        since it must come back for what it left behind (bench/mapper/exploring.py).
        """
        return math.sqrt(self.gain_m2) / (self.distance_m + 1.0)

    @property
    def is_worth_squeezing(self) -> bool:
        """Whether it is more than a small corner, and worth the way."""
        return self.gain_m2 >= max(PARAMS.small_m2, PARAMS.min_gain_m * self.distance_m)

    @property
    def is_worth_the_way(self) -> bool:
        """Whether it is more than a small corner far away."""
        return self.gain_m2 >= min(PARAMS.small_m2, PARAMS.min_gain_m * self.distance_m)


@dataclass(frozen=True, slots=True)
class FrontierReport:
    """What is left to explore from where the robot is."""

    frontiers: list[Frontier]
    """Those that can be reached."""
    unreachable: list[tuple[float, float]]
    """Places in the map [m] where wide frontiers cannot be reached."""
    area_m2: float
    """Free floor connected with where the robot is [m^2]."""
    can_move: bool
    """Whether there is any floor near the robot that is wide enough for it."""


def find_frontiers(area: TraversableArea, here: Pose2D, clearance: Clearance) -> FrontierReport:
    """Find the frontiers, and a goal for each that can be reached.

    Args:
        area: as far as it is known.
        here: map_T_base.
        clearance: that the robot needs.
    """
    room_m, cost = _paths_from(area, here, clearance)
    is_reached = cost != UNREACHED
    near, goal = _empty(area), _empty(area)
    free = (area.kinds == FREE).astype(np.uint8)
    outline = clearance.outline_cells(area.resolution)
    room = _room_at_goals(area, room_m)
    frontiers: list[Frontier] = []
    left = _frontier_cells(area, free, clearance.width_m)
    chains: dict[int, list[Frontier]] = {}
    for least_m in np.linspace(clearance.standing_m, clearance.passing_m, PARAMS.num_clearances):
        standing = np.flatnonzero(is_reached & (room_m >= least_m)).astype(np.int32)
        if least_m < clearance.standing_m:
            does_fit = np.empty(len(standing), np.bool_)
            fits_into(does_fit, room, standing, outline, PARAMS.num_turns)
            standing = standing[does_fit]
        spread_into(near, goal, free, standing, _steps(area, PARAMS.max_distance_m))
        pieces, left = left, []
        for cells in pieces:
            if (goal.ravel()[cells] == NONE).all():
                left.append(cells)
                continue
            found = _best_goal(area, cells, near, goal, cost, beyond=clearance.is_squeezed)
            if least_m < clearance.standing_m:
                found = _turned_to_fit(found, area, room, outline)
            if clearance.is_squeezed:
                left.append(cells)
                chains.setdefault(int(cells[0]), []).append(found)
            elif found.gain_m2 >= clearance.width_m**2:
                frontiers.append(found)
    for chain in chains.values():
        if max(one.gain_m2 for one in chain) >= clearance.width_m**2:
            frontiers.append(_linked(chain))
    left = [cells for cells in left if int(cells[0]) not in chains]
    wide = [cells for cells in left if len(cells) * area.resolution >= 2.0 * clearance.width_m]
    places = [area.place(int(cells[len(cells) // 2])) for cells in wide]
    unreachable = [(place.x, place.y) for place in places]
    return FrontierReport(
        frontiers, unreachable, _connected_area(area, free, here), bool(is_reached.any())
    )


def path_length_to(
    area: TraversableArea, here: Pose2D, there: Pose2D, clearance: Clearance
) -> float | None:
    """Return the length of the path to a place [m], None if there is none."""
    _, cost = _paths_from(area, here, clearance)
    end = _nearest_passable(area, there, cost != UNREACHED)
    return float(cost.ravel()[end[0]]) * area.resolution / STRAIGHT if end.size else None


def _paths_from(
    area: TraversableArea, here: Pose2D, clearance: Clearance
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return how far each cell is from what is not free [m], and what the path to it costs."""
    room_m = distance_transform((area.kinds != FREE).astype(np.uint8), area.resolution)
    passable = room_m >= clearance.passing_m
    cost, seed = _empty(area), _empty(area)
    start = _nearest_passable(area, here, passable)
    spread_into(cost, seed, passable.astype(np.uint8), start, UNREACHED // 2)
    return room_m, cost


def _room_at_goals(area: TraversableArea, room_m: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return how far each cell is from what is not free [cells], walls taken half a cell thicker.

    As near to a wall as the map shows it the planner may take it for something on the goal.
    """
    walls = distance_transform((area.kinds == BLOCKED).astype(np.uint8), area.resolution)
    room = np.minimum(room_m / area.resolution, walls / area.resolution - 0.5)
    return room.astype(np.float32)


def _empty(area: TraversableArea) -> NDArray[np.int32]:
    return np.empty(area.kinds.shape, np.int32)


def _steps(area: TraversableArea, distance_m: float) -> int:
    return round(STRAIGHT * distance_m / area.resolution)


def _cell_of(area: TraversableArea, pose: Pose2D) -> int | None:
    """Return the number of the cell that a pose of the map lies in, None off the area."""
    rows, cols = area.kinds.shape
    x, y = area.in_cells(pose)
    return math.floor(y) * cols + math.floor(x) if 0 <= x < cols and 0 <= y < rows else None


def _nearest_passable(
    area: TraversableArea, place: Pose2D, passable: NDArray[np.bool_]
) -> NDArray[np.int32]:
    """Return the passable cell nearest to a place over free floor; none if it is boxed in."""
    cell = _cell_of(area, place)
    if cell is None:
        return np.empty(0, np.int32)
    cost, seed = _empty(area), _empty(area)
    free = (area.kinds == FREE).astype(np.uint8)
    spread_into(cost, seed, free, np.array([cell], np.int32), _steps(area, PARAMS.max_step_aside_m))
    reached = np.flatnonzero((cost != UNREACHED) & passable)
    if not reached.size:
        return np.empty(0, np.int32)
    return reached[[int(np.argmin(cost.ravel()[reached]))]].astype(np.int32)


def _frontier_cells(
    area: TraversableArea, free: NDArray[np.uint8], width_m: float
) -> list[NDArray[np.intp]]:
    """Return the cells of each frontier that is not narrower than the robot, as their numbers."""
    unknown = (area.kinds == UNKNOWN).astype(np.uint8)
    label = _empty(area)
    count = spread_over(label, unknown, unknown, 1)
    # Specks between beams and under furniture: the robot would not fit in.
    sizes = np.bincount(label.ravel(), minlength=count + 1)
    small = sizes * area.resolution**2 < width_m**2
    small[0] = True
    # What lies off the edge of the area's margin is unknown as well, so no group that touches it
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
    return [one for one in pieces if _extent(area, one) * area.resolution >= width_m]


def _extent(area: TraversableArea, cells: NDArray[np.intp]) -> float:
    """Return the length of the diagonal of the box round some cells [cells]."""
    rows, cols = np.divmod(cells, area.kinds.shape[1])
    return math.hypot(int(np.ptp(rows)) + 1, int(np.ptp(cols)) + 1)


def _best_goal(
    area: TraversableArea,
    cells: NDArray[np.intp],
    near: NDArray[np.int32],
    goal: NDArray[np.int32],
    cost: NDArray[np.int32],
    *,
    beyond: bool,
) -> Frontier:
    """Return a frontier with the best of a few goals spread along it; see `unseen_from`."""
    reached = cells[goal.ravel()[cells] >= 0]
    tried = reached[
        np.unique(np.linspace(0, len(reached) - 1, PARAMS.num_goals).round().astype(int))
    ]
    closest = reached[[int(np.argmin(near.ravel()[reached]))]]
    found: dict[int, Frontier] = {}
    for cell in np.concatenate([closest, tried]):
        place = int(goal.ravel()[cell])
        if place not in found:
            found[place] = _frontier(
                area, int(cell), place, int(cost.ravel()[place]), beyond=beyond
            )
    best, *others = sorted(found.values(), key=lambda one: -one.worth)
    return replace(best, others=tuple(others))


def _frontier(area: TraversableArea, cell: int, place: int, cost: int, *, beyond: bool) -> Frontier:
    """Return a frontier with one goal; both are numbers of cells."""
    row, col = divmod(place, area.kinds.shape[1])
    gain, along_x, along_y = unseen_from(
        area.kinds, col + 0.5, row + 0.5, PARAMS.view_m / area.resolution, PARAMS.num_rays, beyond
    )
    at = area.place(cell)
    distance_m = cost * area.resolution / STRAIGHT
    toward = math.atan2(along_y, along_x)
    goal = area.place(place, toward)
    return Frontier(at.x, at.y, goal, distance_m, gain * area.resolution**2)


def _turned_to_fit(
    frontier: Frontier,
    area: TraversableArea,
    room: NDArray[np.float32],
    outline: NDArray[np.float64],
) -> Frontier:
    """Return the same with goals turned as little as it takes that the robot fits there."""
    place = _cell_of(area, frontier.goal)
    if place is None:
        return frontier
    toward = (area.map_T_area.inverse() @ frontier.goal).yaw
    yaw = fitting_yaw(room, place, toward, outline, PARAMS.num_turns)
    others = tuple(_turned_to_fit(one, area, room, outline) for one in frontier.others)
    return replace(frontier, goal=area.place(place, yaw), others=others)


def _linked(chain: list[Frontier]) -> Frontier:
    """Return the first with the others as what is nearer."""
    first, *rest = chain
    return replace(first, nearer=_linked(rest)) if rest else first


def _connected_area(area: TraversableArea, free: NDArray[np.uint8], here: Pose2D) -> float:
    """Return the free floor connected with where the robot is [m^2]."""
    cell = _cell_of(area, here)
    if cell is None:
        return 0.0
    label = _empty(area)
    spread_over(label, free, free, 1)
    group = label.ravel()[cell]
    return 0.0 if group == 0 else float(np.count_nonzero(label == group)) * area.resolution**2
