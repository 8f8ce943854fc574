"""What one scan does to the costmap."""

import math
from dataclasses import replace

import numpy as np
import pytest
from support.flatland import empty_room, with_block

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.messages import Zone
from trolley_planner.costmap.costmap import Costmap
from trolley_planner.costmap.footprint import Footprint
from trolley_planner.sensing.beams import ScanShape, Sweep

BEAMS = 360
SHAPE = ScanShape(0.0, 2.0 * math.pi / BEAMS, 0.05, 8.0)
FOOTPRINT = Footprint.from_polygon([(0.15, 0.12), (-0.15, 0.12), (-0.15, -0.12), (0.15, -0.12)])
HERE = Pose2D(3.0, 3.0, 0.0)
SECOND_NS = 1_000_000_000


def costmap(grid: GridMap | None = None, zones: list[Zone] | None = None) -> Costmap:
    made = Costmap(grid or empty_room(), FOOTPRINT, PlannerConfig(), unknown_is_free=False)
    made.set_zones(zones or [])
    return made


def sweep(ranges: dict[int, float], start: Pose2D = HERE, end: Pose2D | None = None) -> Sweep:
    """A scan of which only some beams (by degree) say anything."""
    values = np.zeros(BEAMS, dtype=np.float32)
    for degree, value in ranges.items():
        values[degree] = value
    return Sweep(values, SHAPE, start, end or start, FOOTPRINT.polygon)


def marked(grid: Costmap) -> set[tuple[int, int]]:
    rows, cols = np.nonzero(grid.obstacle_layer.grid.evidence)
    return set(zip(rows.tolist(), cols.tolist(), strict=True))


def test_an_echo_is_marked_where_it_lies() -> None:
    grid = costmap()
    grid.add_scan(sweep({0: 1.02, 90: 1.52}), 0)
    assert marked(grid) == {(60, 80), (90, 60)}


def test_each_beam_has_the_pose_of_its_own_time() -> None:
    grid = costmap()
    # The last beam is measured half a metre further on.
    grid.add_scan(sweep({0: 1.02, 359: 1.02}, HERE, Pose2D(3.5, 3.0, 0.0)), 0)
    assert marked(grid) == {(60, 80), (59, 90)}


@pytest.mark.parametrize("through", [2.5, math.inf])
def test_beams_that_go_on_clear_also_without_an_echo(through: float) -> None:
    grid = costmap()
    for _ in range(3):
        grid.add_scan(sweep({0: 1.02}), 0)
    assert (60, 80) in marked(grid)
    for _ in range(12):
        grid.add_scan(sweep({0: through}), 0)
    assert (60, 80) not in marked(grid)


def test_a_thin_leg_that_some_scans_miss_stays() -> None:
    grid = costmap()
    for scan in range(60):
        grid.add_scan(sweep({0: 1.02 if scan % 3 == 0 else math.inf}), scan)
        assert (60, 80) in marked(grid)


def test_a_lone_outlier_goes_after_three_scans() -> None:
    grid = costmap()
    grid.add_scan(sweep({0: 1.02}), 0)
    for _ in range(3):
        grid.add_scan(sweep({0: 2.5}), 0)
    assert (60, 80) not in marked(grid)


def test_walls_of_the_map_are_never_cleared() -> None:
    grid = costmap(with_block(empty_room(), 4.0, 2.5, 0.2, 1.0))
    before = grid.weights.copy()
    for scan in range(20):
        grid.add_scan(sweep({0: math.inf, 1: 4.5}), scan)
    grid.refresh()
    np.testing.assert_array_equal(grid.weights, before)


def test_nothing_is_marked_or_cleared_behind_a_wall() -> None:
    grid = costmap(with_block(empty_room(), 4.0, 2.5, 0.1, 1.0))
    grid.add_scan(sweep({0: 2.52}, Pose2D(4.5, 3.0, 0.0)), 0)
    behind = marked(grid)
    assert behind
    for scan in range(20):
        # A reflection seems to see through the wall, and things in the room behind.
        grid.add_scan(sweep({0: math.inf, 2: 2.0, 358: 3.0}), scan)
    assert marked(grid) == behind


def mirror() -> Zone:
    return Zone(name="mirror", kind="mirror", points=[(4.0, 2.0), (4.0, 4.0)])


@pytest.mark.parametrize("kind", ["mirror", "glass"])
@pytest.mark.parametrize("echo", [0.95, 1.0, 1.05, 1.5, 3.0])
def test_nothing_is_marked_behind_a_mirror_line(kind, echo: float) -> None:
    grid = costmap(zones=[Zone(name="m", kind=kind, points=[(4.0, 2.0), (4.0, 4.0)])])
    for scan in range(5):
        grid.add_scan(sweep({degree % 360: echo for degree in range(-20, 21)}), scan)
    assert all(col * 0.05 < 4.0 for _, col in marked(grid))
    if echo >= 1.0:
        assert marked(grid) == set()


def test_a_mirror_line_is_a_wall_and_what_is_before_it_counts() -> None:
    grid = costmap(zones=[mirror()])
    assert grid.static.walls[60, 80]
    for scan in range(3):
        grid.add_scan(sweep({0: 0.6}), scan)
    assert marked(grid) == {(60, 72)}


def test_the_own_body_is_not_marked() -> None:
    grid = costmap()
    grid.add_scan(sweep({0: 0.14, 90: 0.11, 180: 0.22}), 0)
    assert marked(grid) <= {(60, 55), (59, 55)}
    assert marked(grid)


@pytest.mark.parametrize("value", [0.0, math.nan, -1.0, 0.03])
def test_invalid_beams_do_nothing(value: float) -> None:
    grid = costmap()
    grid.add_scan(sweep(dict.fromkeys(range(BEAMS), value)), 0)
    assert marked(grid) == set()
    # Nothing is known but the place of the robot itself.
    rows, cols = np.nonzero(grid.obstacle_layer.grid.observed)
    assert len(rows) > 0
    assert np.hypot(0.05 * (cols + 0.5) - 3.0, 0.05 * (rows + 0.5) - 3.0).max() < 0.3


def test_what_was_seen_once_fades_sooner_than_what_was_seen_often() -> None:
    grid = costmap()
    for scan in range(50):
        grid.add_scan(
            sweep({0: 1.02, **({90: 1.02} if scan == 49 else {})}), scan * SECOND_NS // 10
        )
    grid.obstacle_layer.forget_old(10 * SECOND_NS)
    assert marked(grid) == {(60, 80)}
    grid.obstacle_layer.forget_old(100 * SECOND_NS)
    assert marked(grid) == set()


def test_far_echoes_are_not_marked_but_clear() -> None:
    grid = costmap(empty_room(16.0, 6.0))
    grid.add_scan(sweep({0: 7.5}), 0)
    assert marked(grid) == set()
    assert grid.obstacle_layer.grid.observed[60, 100]


def test_beams_outside_the_grid_are_harmless() -> None:
    grid = costmap()
    everywhere = sweep(dict.fromkeys(range(BEAMS), 2.0), Pose2D(-0.5, 7.0, 0.3))
    grid.add_scan(everywhere, 0)
    grid.add_scan(sweep(dict.fromkeys(range(BEAMS), 2.0), Pose2D(1e7, -1e7, 0.3)), 0)
    grid.refresh()


def test_cells_between_far_beams_are_cleared_where_both_go_on() -> None:
    grid = costmap(empty_room(16.0, 6.0))
    start = Pose2D(1.0, 3.0, 0.0)
    here = Pose2D(1.0, 3.0, math.radians(0.5))
    # Seen from a heading in between: at 6 m the beams of 1 degree are two cells apart.
    for _ in range(3):
        grid.add_scan(sweep({0: 6.02 - 0.07}, here), 0)
    assert len(marked(grid)) == 1
    for _ in range(12):
        grid.add_scan(sweep({0: 7.0, 1: math.inf}, start), 0)
    assert marked(grid) == set()


@pytest.mark.parametrize("beams", [{0: 7.0, 1: 5.5}, {0: 7.0}, {0: 7.0, 1: 0.0, 2: 7.0}])
def test_cells_beside_a_beam_stay_where_its_neighbour_ends_before(beams) -> None:
    grid = costmap(empty_room(16.0, 6.0))
    for _ in range(3):
        grid.add_scan(sweep({0: 5.95}, Pose2D(1.0, 3.0, math.radians(0.5))), 0)
    [cell] = marked(grid)
    for _ in range(12):
        grid.add_scan(sweep(beams, Pose2D(1.0, 3.0, 0.0)), 0)
    assert cell in marked(grid)


def test_where_the_robot_is_nothing_else_is() -> None:
    grid = costmap()
    for _ in range(5):
        grid.add_scan(sweep({0: 1.02, 180: 1.02}), 0)
    assert marked(grid) == {(60, 80), (60, 39)}
    # It backs over the place behind it, which its lidar does not see.
    grid.add_scan(sweep({0: 2.07}, Pose2D(1.95, 3.0, 0.0)), 0)
    assert marked(grid) == {(60, 80)}


def test_nothing_is_marked_behind_a_suspected_mirror() -> None:
    grid = costmap()
    grid.set_suspects([[(4.0, 2.0), (4.0, 4.0)]])
    for scan in range(5):
        grid.add_scan(sweep({degree % 360: 1.5 for degree in range(-20, 21)}), scan)
    assert marked(grid) == set()
    assert not grid.static.walls[60, 80]
    grid.set_suspects([])
    grid.add_scan(sweep({0: 1.5}), 9)
    assert marked(grid)


@pytest.mark.parametrize(
    ("corner", "size"),
    [
        ((0.0, 0.0), 6.0),
        ((1.0, -2.0), 6.0),
        ((-1.5, 0.5), 9.0),
        ((2.5, 2.5), 2.0),
        ((20.0, 0.0), 4.0),
    ],
)
def test_another_costmap_takes_over_what_was_seen(corner: tuple[float, float], size: float) -> None:
    before = costmap()
    ranges = {degree: 0.5 + 0.012 * (degree % 150) for degree in range(0, 360, 7)}
    before.add_scan(sweep(ranges), SECOND_NS)
    count = round(size / 0.05)
    cells = np.zeros((count, count), dtype=np.int8)
    after = costmap(GridMap("after", 0.05, Pose2D(*corner, 0.0), cells))
    after.take_over(before)
    down, left = round(corner[1] / 0.05), round(corner[0] / 0.05)
    moved = {(row - down, col - left) for row, col in marked(before)}
    kept = {cell for cell in moved if 0 <= cell[0] < count and 0 <= cell[1] < count}
    assert marked(after) == kept
    for row, col in kept:
        x, y = before.obstacle_layer.grid.points[row + down, col + left].tolist()
        assert after.obstacle_layer.grid.points[row, col].tolist() == pytest.approx(
            [x - corner[0], y - corner[1]], abs=1e-5
        )
    # Where it lies on both, what beams see through is cleared as it would have been there.
    through = sweep(dict.fromkeys(ranges, 2.5))
    for grid in (before, after):
        for number in range(3):
            grid.add_scan(through, (2 + number) * SECOND_NS)
    if corner == (0.0, 0.0):
        assert marked(after) == marked(before)


def test_where_it_stood_before_it_forgot_everything_is_no_longer_known_to_be_free() -> None:
    # As base, which begins anew without a memory, and would hold it there.
    ahead = ScanShape(-0.5 * math.pi, math.pi / BEAMS, 0.05, 8.0)
    grid, there, elsewhere = costmap(), np.array([60]), Pose2D(4.5, 3.0, 0.0)
    for number, pose in enumerate((HERE, elsewhere)):
        grid.add_scan(replace(sweep({180: 1.02}, pose), shape=ahead), (1 + number) * SECOND_NS)
    assert grid.obstacle_layer.is_known_free(there, there, 0.1).all()
    grid.forget_all()
    grid.add_scan(replace(sweep({180: 1.02}, elsewhere), shape=ahead), 3 * SECOND_NS)
    assert not grid.obstacle_layer.is_known_free(there, there, 0.1).any()
