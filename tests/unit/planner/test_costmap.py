"""Weights, distances and costs of the costmap, kept up to date."""

import math

import numpy as np
from support.flatland import empty_room, with_block

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D
from trolley.gridmap import UNKNOWN, GridMap
from trolley.messages import Zone
from trolley_planner.costmap.costmap import Costmap
from trolley_planner.costmap.footprint import Footprint
from trolley_planner.costmap.inflation import LETHAL, WEIGHT_UNIT
from trolley_planner.sensing.beams import ScanShape, Sweep

FOOTPRINT = Footprint.from_polygon([(0.15, 0.12), (-0.15, 0.12), (-0.15, -0.12), (0.15, -0.12)])


def make(grid: GridMap) -> Costmap:
    return Costmap(grid, FOOTPRINT, PlannerConfig(), unknown_is_free=False)


def scan_at(x: float, y: float, ranges: np.ndarray) -> Sweep:
    shape = ScanShape(0.0, 2.0 * math.pi / len(ranges), 0.05, 8.0)
    pose = Pose2D(x, y, 0.2)
    return Sweep(ranges.astype(np.float32), shape, pose, pose, FOOTPRINT.polygon)


def test_updating_what_changed_gives_the_same_as_computing_all() -> None:
    rng = np.random.default_rng(3)
    grid = make(with_block(empty_room(), 4.0, 1.0, 0.3, 2.0))
    for number in range(15):
        x, y = rng.uniform(0.5, 3.5), rng.uniform(0.5, 5.5)
        grid.add_scan(scan_at(x, y, rng.uniform(0.3, 5.0, 180)), number * 10**8)
        grid.refresh()
        weights, distance = grid.weights.copy(), grid.distance_m.copy()
        grid.recompute()
        np.testing.assert_array_equal(weights, grid.weights)
        np.testing.assert_array_equal(distance, grid.distance_m)


def test_costs_are_as_the_wire_says() -> None:
    cells = empty_room(4.0, 4.0).cells.copy()
    cells[20:30, 20:30] = UNKNOWN
    costs = make(GridMap("m", 0.05, Pose2D(0.0, 0.0, 0.0), cells)).costs()
    assert costs[0, 40] == 100
    assert costs[4, 60] == 99
    assert 0 < costs[8, 60] < 99
    assert costs[8, 60] > costs[10, 60] > costs[14, 60]
    assert costs[60, 60] == 0
    # Unknown cells may not be passed here, but that nothing is known of them rules.
    assert costs.min() == -1 or costs[25, 25] == 100


def test_a_beam_makes_unknown_cells_passable() -> None:
    cells = empty_room(4.0, 4.0).cells.copy()
    cells[30:50, 40:60] = UNKNOWN
    grid = make(GridMap("m", 0.05, Pose2D(0.0, 0.0, 0.0), cells))
    assert grid.weights[40, 50] == LETHAL
    for number in range(3):
        grid.add_scan(scan_at(1.0, 2.0, np.full(3600, np.inf)), number)
    grid.refresh()
    assert grid.weights[40, 50] != LETHAL


def test_maps_of_one_cell_and_of_nothing_known_are_no_trouble() -> None:
    one = make(GridMap("m", 0.05, Pose2D(0.0, 0.0, 0.0), np.zeros((1, 1), dtype=np.int8)))
    assert one.costs().shape == (1, 1)
    unknown = make(GridMap("m", 0.05, Pose2D(0.0, 0.0, 0.0), np.full((20, 20), -1, np.int8)))
    assert (unknown.weights == LETHAL).all()


def test_keep_out_zones_open_for_who_is_inside_only() -> None:
    grid = make(empty_room())
    corners = [(2.0, 2.0), (4.0, 2.0), (4.0, 4.0), (2.0, 4.0)]
    grid.set_zones([Zone(name="z", kind="keepout", points=corners)])
    assert grid.weights[60, 60] == LETHAL
    assert [zone.name for zone in grid.static.keepouts_at(3.0, 3.0)] == ["z"]
    grid.set_position(3.0, 3.0)
    assert grid.weights[60, 60] != LETHAL
    assert grid.static.leaving is not None
    grid.set_position(1.0, 1.0)
    assert grid.weights[60, 60] == LETHAL
    assert grid.static.leaving is None


def test_the_lowest_speed_of_overlapping_zones_counts() -> None:
    grid = make(empty_room())
    grid.set_zones(
        [
            Zone(name="a", kind="speed", points=[(1, 1), (3, 1), (3, 3), (1, 3)], speed=0.3),
            Zone(name="b", kind="speed", points=[(2, 2), (4, 2), (4, 4), (2, 4)], speed=0.1),
        ]
    )
    assert grid.static.speed_limits[30, 30] == np.float32(0.3)
    assert grid.static.speed_limits[50, 50] == np.float32(0.1)
    assert math.isinf(grid.static.speed_limits[100, 100])


def test_the_limit_falls_before_a_speed_zone() -> None:
    grid = make(empty_room())
    corners = [(2.0, 1.0), (3.0, 1.0), (3.0, 3.0), (2.0, 3.0)]
    grid.set_zones([Zone(name="a", kind="speed", points=corners, speed=0.1)])
    row = grid.static.speed_limits[40]
    assert row[40] == row[39] == np.float32(0.1)
    assert np.all(np.diff(row[20:40]) <= 0.0)
    speeds = row[20:40].astype(float)
    braking = (speeds[:-1] ** 2 - speeds[1:] ** 2) / (2 * 0.05)
    assert braking.max() < 0.6
    assert speeds[0] > 0.9


def person_at(x: float) -> np.ndarray:
    """Ranges of 360 beams from (1, 3) with somebody of 0.2 m at (x, 3) in an empty room."""
    angles = 0.2 + np.arange(360) * (2.0 * math.pi / 360)
    ranges = np.full(360, np.inf)
    ahead = np.abs(np.remainder(angles + math.pi, 2.0 * math.pi) - math.pi) < 0.1 / (x - 1.0)
    ranges[ahead] = x - 1.0
    return ranges


def test_the_way_ahead_of_who_walks_is_dear_but_open() -> None:
    grid = make(empty_room())
    for number in range(6):
        grid.add_scan(scan_at(1.0, 3.0, person_at(3.0 - 0.1 * number)), number * 10**8)
        grid.refresh()
    assert len(grid.moving.people) == 1
    assert -1.3 < grid.moving.people[0].velocity[0] < -0.7
    ahead, behind, beside = (60, 36), (60, 66), (88, 36)
    assert grid.weights[ahead] > 2 * grid.weights[behind]
    assert grid.weights[ahead] > 2 * grid.weights[beside]
    assert grid.weights[beside] == WEIGHT_UNIT
    assert 0 < grid.costs()[ahead] < 99
    # Gone again: three scans that see through are enough.
    for number in range(6, 9):
        grid.add_scan(scan_at(1.0, 3.0, np.full(360, np.inf)), number * 10**8)
    grid.refresh()
    assert grid.moving.people == []
    np.testing.assert_array_equal(grid.weights[20:100, 20:140], grid.static.weights[20:100, 20:140])


def test_who_walks_is_no_obstacle_but_right_beside_the_robot() -> None:
    for start, is_obstacle in ((3.5, False), (1.78, True)):
        grid = make(empty_room())
        for number in range(6):
            sweep = scan_at(1.0, 3.0, person_at(start - 0.1 * number))
            grid.add_scan(sweep, number * 10**8)
        assert [mover.is_seen for mover in grid.moving.people] == [True]
        assert bool(np.count_nonzero(grid.obstacle_layer.grid.evidence)) == is_obstacle


def test_who_stands_is_remembered_longer_than_who_walks() -> None:
    def left_after(positions: list[float]) -> int:
        grid = make(empty_room())
        for number, x in enumerate(positions):
            grid.add_scan(scan_at(1.0, 3.0, person_at(x)), number * 10**8)
        for number in range(len(positions), len(positions) + 4):
            grid.add_scan(scan_at(1.0, 3.0, np.full(360, np.inf)), number * 10**8)
        return int(np.count_nonzero(grid.obstacle_layer.grid.evidence))

    assert left_after([2.5] * 10) > 0
    assert left_after([3.5 - 0.1 * step for step in range(10)]) == 0


def test_what_is_closed_is_open_again_after_a_minute() -> None:
    grid = make(empty_room())
    before = grid.weights.copy()
    grid.close(4.0, 3.0, 0.2, 5 * 10**9)
    assert grid.refresh()
    assert grid.weights[60, 80] == LETHAL
    assert grid.costs()[60, 80] == 100
    grid.forget_old(60 * 10**9)
    assert not grid.refresh()
    grid.forget_old(66 * 10**9)
    assert grid.refresh()
    np.testing.assert_array_equal(grid.weights, before)
