"""Visits on maps that somebody mixed up, and with a lidar that goes blind."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from bench.harness.houses import Plan
from bench.harness.second_visits import CASES, NOWHERE, Visit, Visits

from trolley.geometry import Pose2D
from trolley.gridmap import FREE, OCCUPIED, UNKNOWN

ROOM_M = 5.0
EMPTY_S = (40.0, 100.0)
SHIFT_CELLS = 20
"""A door that is bricked up opens again so far along its wall."""


def on_unknown(visit: Visit, visits: Visits, number: int) -> Visit:
    """A map on which nothing is known."""
    cells = np.full(visit.grid.cells.shape, UNKNOWN, np.int8)
    return _nowhere(replace(visit, grid=replace(visit.grid, cells=cells)))


def on_one_room(visit: Visit, visits: Visits, number: int) -> Visit:
    """A map of the room where the robot starts, and of nothing else."""
    grid, start = visit.grid, visit.truths[0]
    row, col = grid.world_to_cell(np.array([[start.x, start.y]]))[0]
    half = round(0.5 * ROOM_M / grid.resolution)
    cells = np.full(grid.cells.shape, UNKNOWN, np.int8)
    part = (slice(max(row - half, 0), row + half), slice(max(col - half, 0), col + half))
    cells[part] = grid.cells[part]
    return replace(visit, grid=replace(grid, cells=cells))


def on_wrong_floor(visit: Visit, visits: Visits, number: int) -> Visit:
    """The map of another floor between the same outer walls."""
    return _nowhere(replace(visit, grid=visits.plan(visits.seed_of(number) + 1000).built()))


def before_rebuilding(visit: Visit, visits: Visits, number: int) -> Visit:
    """A map from when the doors were elsewhere in their walls and the furniture was another."""
    seed = visits.seed_of(number)
    now, other = visits.plan(seed), visits.plan(seed + 2000)
    cells = now.walls.copy()
    for r0, r1, c0, c1 in now.doors:
        cells[r0:r1, c0:c1] = OCCUPIED
        along = (SHIFT_CELLS, 0) if r1 - r0 > c1 - c0 else (0, SHIFT_CELLS)
        for sign in (1, -1):
            dr, dc = sign * along[0], sign * along[1]
            moved = cells[r0 + dr : r1 + dr, c0 + dc : c1 + dc]
            if moved.shape == (r1 - r0, c1 - c0) and np.all(moved == OCCUPIED):
                moved[:] = FREE
                break
        else:
            cells[r0:r1, c0:c1] = FREE
    stands = [
        (box, shape)
        for box, shape in zip(other.furniture, other.shapes, strict=True)
        if np.all(cells[box[0] : box[1], box[2] : box[3]] == FREE)
    ]
    boxes, shapes = zip(*stands, strict=True) if stands else ((), ())
    return replace(visit, grid=Plan(cells, now.doors, boxes, shapes).built())


def on_turned(visit: Visit, visits: Visits, number: int) -> Visit:
    """A map that was turned by 90 degrees since the pose was saved."""
    turn = Pose2D(0.0, 0.0, 0.5 * math.pi)
    grid = replace(visit.grid, origin=turn @ visit.grid.origin)
    return replace(visit, grid=grid, truths=[turn @ truth for truth in visit.truths])


def in_twin_flats(visit: Visit, visits: Visits, number: int) -> Visit:
    """A map of two flats that are the same; the robot is in the first."""
    grid = visit.grid
    return replace(visit, grid=replace(grid, cells=np.hstack([grid.cells, grid.cells])))


def with_empty_minute(visit: Visit, visits: Visits, number: int) -> Visit:
    """The lidar sees nothing for a minute while the robot drives on."""
    scans = [
        replace(scan, ranges=np.full_like(scan.ranges, np.inf))
        if EMPTY_S[0] <= scan.stamp_ns * 1e-9 < EMPTY_S[1]
        else scan
        for scan in visit.scans
    ]
    return replace(visit, scans=scans)


BAD_INPUTS: dict[str, Callable[[Visit, Visits, int], Visit]] = {
    "map all unknown": on_unknown,
    "map of one room": on_one_room,
    "map of the wrong floor": on_wrong_floor,
    "map from before rebuilding": before_rebuilding,
    "map turned by 90°": on_turned,
    "two identical flats": in_twin_flats,
    "nothing seen for a minute": with_empty_minute,
}


def spoil(name: str, visits: Visits, number: int, *, is_told: bool) -> Visit:
    """A visit with one of the bad inputs, from the pose of the start or from nothing."""
    visit = BAD_INPUTS[name](visits.make(CASES[1], number), visits, number)
    return visit if is_told else replace(visit, told=None)


def _nowhere(visit: Visit) -> Visit:
    return replace(visit, truths=[NOWHERE] * len(visit.truths))
