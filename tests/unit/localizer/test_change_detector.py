"""What has come or gone is proposed; people, doors, mirrors and errors of the pose are not."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D
from trolley.gridmap import FREE, OCCUPIED, GridMap, cast_rays
from trolley.map_editing import apply
from trolley.map_editing.proposals import ops_of
from trolley.scanning import ScanInput
from trolley_localizer.change_proposals import change_message
from trolley_localizer.changes.change_detector import Change, ChangeDetector
from trolley_localizer.changes.change_file import from_file, to_file, unpack
from trolley_localizer.changes.shapes import box_of, convex_hull, runs_of, shared
from trolley_localizer.kernels.changes import APPEARED, GONE, TILE_CELLS
from trolley_localizer.kernels.layout import Lines
from trolley_localizer.kernels.matching import BEHIND_MIRROR, explain_beams
from trolley_localizer.matching.likelihood_field import build_field
from trolley_localizer.matching.map_matcher import read_beams

BEAMS = 360
RANGE_MAX = 8.0
SURE = np.diag([1e-4, 1e-4, 1e-5])
CONFIG = LocalizerConfig(propose_changes=True, change_after_s=60.0)
# Once round the middle of the room, which takes 20 s.
ROUND = [
    Pose2D(2.5 + math.cos(a), 2.0 + 0.6 * math.sin(a), 1.3 * a)
    for a in np.arange(40) * (math.tau / 40)
]
STEP_NS = 500_000_000
# Rows and columns [cells]: a wardrobe at the upper wall, and where a box comes.
WARDROBE = (slice(70, 82), slice(20, 40))
BOX = (slice(10, 16), slice(70, 78))
DOOR = (slice(30, 46), slice(100, 102))


def room() -> GridMap:
    """A room of 5 x 4 m with a wardrobe, beside another one of 3 x 4 m."""
    cells = np.full((84, 168), OCCUPIED, np.int8)
    cells[2:82, 2:100] = FREE
    cells[2:82, 102:166] = FREE
    cells[WARDROBE] = OCCUPIED
    return GridMap("room", 0.05, Pose2D(1.0, -2.0, 0.3), cells)


def changed(grid: GridMap, part: tuple[slice, slice], value: int) -> GridMap:
    """The same map with a rectangle of other cells."""
    cells = grid.cells.copy()
    cells[part] = value
    return GridMap(grid.name, grid.resolution, grid.origin, cells)


class Watcher:
    """Drives round and round in one world with the map of another."""

    def __init__(self, grid: GridMap) -> None:
        self.grid = grid
        self.field = build_field(grid, CONFIG)
        self.changes = ChangeDetector(self.field, CONFIG)
        self.stamp_ns = 0
        self.rng = np.random.default_rng(0)

    def ranges(self, world: GridMap, pose: Pose2D) -> NDArray[np.float32]:
        angles = pose.yaw - math.pi + np.arange(BEAMS) * (math.tau / BEAMS)
        reached = cast_rays(world.occupied_mask(), 0.05, (pose.x, pose.y), angles, RANGE_MAX)
        return (reached + self.rng.normal(0.01, 0.01, BEAMS)).astype(np.float32)

    def look(
        self, world: GridMap, pose: Pose2D, off: Pose2D, covariance: NDArray[np.float64] = SURE
    ) -> None:
        """Take one scan at a pose that is believed to be `off` from there."""
        self.stamp_ns += STEP_NS
        scan = ScanInput(
            stamp_ns=self.stamp_ns,
            ranges=self.ranges(world, pose),
            angle_min=-math.pi,
            angle_increment=math.tau / BEAMS,
            range_min=0.1,
            range_max=RANGE_MAX,
            base_T_laser=Pose2D.identity(),
            odom_T_base=Pose2D.identity(),
            odom_T_base_end=Pose2D.identity(),
        )
        believed = pose @ off
        cells = np.array([believed.x / 0.05, believed.y / 0.05, believed.yaw])
        beams = read_beams(scan, 0.05, 60.0)
        classes = beams.classes.copy()
        explain_beams(classes, cells, beams.end, self.field.distance, 3.0)
        self.changes.update(self.stamp_ns, cells, covariance, beams, classes)

    def drive(
        self,
        worlds: Sequence[GridMap],
        off: Pose2D | None = None,
        covariance: NDArray[np.float64] = SURE,
    ) -> list[Change]:
        """Drive one round in each world; return what is proposed then."""
        for world in worlds:
            for pose in ROUND:
                self.look(world, pose, off or Pose2D.identity(), covariance)
        return self.proposed()

    def proposed(self) -> list[Change]:
        self.changes.propose(())
        return self.changes.proposed


@pytest.fixture(scope="module")
def grid() -> GridMap:
    return room()


def is_within(change: Change, part: tuple[slice, slice], margin: int = 1) -> bool:
    """Whether a change lies in a rectangle, and covers half of its longer side."""
    rows, cols = part
    low_row, low_col, high_row, high_col = change.box
    return (
        low_row >= rows.start - margin
        and high_row < rows.stop + margin
        and low_col >= cols.start - margin
        and high_col < cols.stop + margin
        and max(high_row - low_row, high_col - low_col)
        >= 0.5 * max(rows.stop - rows.start, cols.stop - cols.start) - 1
    )


def test_nothing_is_proposed_where_nothing_changed(grid: GridMap) -> None:
    watcher = Watcher(grid)
    assert watcher.drive([grid] * 6) == []


def test_a_box_that_came_is_proposed_once_it_has_lasted(grid: GridMap) -> None:
    watcher = Watcher(grid)
    world = changed(grid, BOX, OCCUPIED)
    assert watcher.drive([world] * 2) == []  # 40 s
    (change,) = watcher.drive([world] * 3)
    assert change.kind == "appeared"
    assert is_within(change, BOX)
    assert 80 <= change.seconds <= 100
    assert change.id == "appeared-1"


def test_a_wardrobe_that_went_is_proposed_and_the_wall_behind_it_stays(grid: GridMap) -> None:
    watcher = Watcher(grid)
    (change,) = watcher.drive([changed(grid, WARDROBE, FREE)] * 5)
    assert change.kind == "gone"
    assert is_within(change, WARDROBE)
    share = len(change.cells) / (12 * 20)
    assert 0.6 < share <= 1.0


def test_accepting_puts_it_on_the_map_and_leaves_nothing_to_propose(grid: GridMap) -> None:
    watcher = Watcher(grid)
    world = changed(changed(grid, WARDROBE, FREE), BOX, OCCUPIED)
    proposed = watcher.drive([world] * 5)
    assert sorted(one.kind for one in proposed) == ["appeared", "gone"]
    edited = grid
    for op in ops_of([change_message(one, watcher.field) for one in proposed]):
        edited, moved = apply(edited, op)
        assert moved == Pose2D.identity()
    differs = {(row, col) for row, col in np.argwhere(edited.cells != grid.cells).tolist()}
    assert differs == {(row, col) for one in proposed for row, col in one.cells.tolist()}
    again = Watcher(edited)
    from_file(again.changes, to_file(watcher.changes, grid))
    assert again.proposed() == []
    assert [one for one in again.drive([world] * 2) if one.kind == "appeared"] == []


def test_a_sofa_that_was_moved_by_less_than_its_size_is_both(grid: GridMap) -> None:
    before = changed(grid, (slice(20, 44), slice(2, 16)), OCCUPIED)
    after = changed(grid, (slice(34, 58), slice(2, 16)), OCCUPIED)
    found = {one.kind: one for one in Watcher(before).drive([after] * 5)}
    assert found.keys() == {"appeared", "gone"}
    assert is_within(found["gone"], (slice(20, 34), slice(2, 16)))
    assert is_within(found["appeared"], (slice(44, 58), slice(2, 17)))


def test_someone_who_walks_about_is_not_proposed(grid: GridMap) -> None:
    watcher = Watcher(grid)
    for k in range(5 * len(ROUND)):
        col = 12 + (3 * k) % 80
        world = changed(grid, (slice(8, 13), slice(col, col + 5)), OCCUPIED)
        watcher.look(world, ROUND[k % len(ROUND)], Pose2D.identity())
    assert watcher.proposed() == []


def test_a_door_that_opens_and_shuts_is_not_proposed(grid: GridMap) -> None:
    opened = changed(grid, DOOR, FREE)
    assert Watcher(grid).drive([opened, grid, grid, opened, grid, opened, grid]) == []


def test_a_box_that_goes_again_is_not_proposed_any_more(grid: GridMap) -> None:
    watcher = Watcher(grid)
    assert watcher.drive([changed(grid, BOX, OCCUPIED)] * 5)
    assert watcher.drive([grid] * 2) == []


@pytest.mark.parametrize("off", [Pose2D(0.03, -0.03, 0.01), Pose2D(-0.04, 0.02, -0.015)])
def test_an_error_of_the_pose_changes_nothing(grid: GridMap, off: Pose2D) -> None:
    watcher = Watcher(grid)
    assert watcher.drive([grid] * 5, off) == []
    assert len(watcher.drive([changed(grid, BOX, OCCUPIED)] * 5, off)) == 1


def test_an_unsure_pose_is_not_believed(grid: GridMap) -> None:
    world = changed(grid, BOX, OCCUPIED)
    for covariance in (np.diag([0.01, 1e-4, 1e-5]), np.diag([1e-4, 1e-4, 1e-3])):
        watcher = Watcher(grid)
        assert watcher.drive([world] * 5, covariance=covariance) == []
        assert watcher.changes.change_grid.changed()[0].size == 0


def test_a_robot_that_stands_still_proposes_nothing(grid: GridMap) -> None:
    watcher = Watcher(grid)
    world = changed(grid, BOX, OCCUPIED)
    for _ in range(600):
        watcher.look(world, ROUND[0], Pose2D.identity())
    assert watcher.proposed() == []


def test_what_is_gone_at_a_mirror_is_its_doing(grid: GridMap) -> None:
    watcher = Watcher(grid)
    assert watcher.drive([changed(grid, WARDROBE, FREE)] * 5)
    y, x0, x1 = 70.0, 20.0, 40.0
    mirror = Lines(*(np.array([value]) for value in (x0, y, x1, y)))
    watcher.changes.propose((mirror,))
    assert watcher.changes.proposed == []


def test_beams_behind_mirrors_say_nothing(grid: GridMap) -> None:
    watcher = Watcher(grid)
    pose = np.array([50.0, 40.0, 0.0])
    world = changed(grid, BOX, OCCUPIED)
    for k in range(300):
        watcher.stamp_ns += STEP_NS
        ranges = watcher.ranges(world, ROUND[k % 40])
        scan = ScanInput(
            watcher.stamp_ns, ranges, -math.pi, math.tau / BEAMS, 0.1, RANGE_MAX,
            *[Pose2D.identity()] * 3,
        )  # fmt: skip
        beams = read_beams(scan, 0.05, 60.0)
        classes = np.full(BEAMS, BEHIND_MIRROR, np.uint8)
        watcher.changes.update(watcher.stamp_ns, pose, SURE, beams, classes)
    assert watcher.changes.change_grid.changed()[0].size == 0


def test_what_was_dismissed_is_not_proposed_again(grid: GridMap) -> None:
    watcher = Watcher(grid)
    world = changed(grid, BOX, OCCUPIED)
    (change,) = watcher.drive([world] * 5)
    watcher.changes.dismiss(change)
    assert watcher.changes.proposed == []
    assert watcher.drive([world] * 2) == []
    again = Watcher(grid)
    from_file(again.changes, to_file(watcher.changes, grid))
    assert again.drive([world]) == []


def test_a_restart_forgets_nothing(grid: GridMap) -> None:
    watcher = Watcher(grid)
    world = changed(grid, BOX, OCCUPIED)
    watcher.drive([world] * 3)
    again = Watcher(grid)
    from_file(again.changes, to_file(watcher.changes, grid))
    assert again.changes.clock_s == watcher.changes.clock_s
    (change,) = again.drive([world] * 2)
    once_more = Watcher(grid)
    from_file(once_more.changes, to_file(again.changes, grid))
    (same,) = once_more.proposed()
    assert (same.id, same.box, same.seconds) == (change.id, change.box, change.seconds)


def test_a_file_is_only_for_the_map_whose_cells_lie_where_they_lay(grid: GridMap) -> None:
    file = to_file(Watcher(grid).changes, grid)
    assert file.is_of(grid)
    moved = GridMap(grid.name, grid.resolution, Pose2D(1.0, -2.0, 0.31), grid.cells)
    assert not file.is_of(moved)
    with pytest.raises(ValueError, match="unpacked"):
        unpack("nonsense")


def test_the_ledger_grows_and_forgets_what_says_nothing(grid: GridMap) -> None:
    large = GridMap("large", 0.05, Pose2D.identity(), np.zeros((1600, 1600), np.int8))
    evidence = ChangeDetector(build_field(large, CONFIG), CONFIG).change_grid
    places = np.argwhere(np.ones((100, 100))) * 16
    rows = np.zeros((len(places), 13), np.int32)
    rows[:, 0], rows[::5, 4] = APPEARED, 2  # a kind; visits for a fifth of them
    evidence.restore(places, rows)
    kept, _ = evidence.changed()
    assert len(evidence.arrays.table) <= 2200 * TILE_CELLS
    told = {(row, col) for row, col in places[::5].tolist()}
    assert told & {(row, col) for row, col in kept.tolist()} == told
    evidence.forget_empty()
    assert {(row, col) for row, col in evidence.changed()[0].tolist()} == told


def test_cells_that_the_map_has_taken_up_are_left_out(grid: GridMap) -> None:
    evidence = ChangeDetector(build_field(grid, CONFIG), CONFIG).change_grid
    wall, floor = (0, 0), (10, 10)
    places = np.array([wall, floor, wall, floor, (-1, 5), (500, 5)])
    rows = np.zeros((6, 13), np.int32)
    rows[:, 0] = APPEARED, APPEARED, GONE, GONE, GONE, GONE
    evidence.restore(places, rows)
    where, kept = evidence.changed()
    assert {(r, c, int(k)) for (r, c), k in zip(where.tolist(), kept[:, 0], strict=True)} == {
        (*wall, GONE),
        (*floor, APPEARED),
    }


def test_shapes_of_cells() -> None:
    cells = np.argwhere(np.ones((2, 5))) + np.array([3, 7])
    assert box_of(cells) == (3, 7, 4, 11)
    hull = convex_hull(cells)
    assert {(x, y) for x, y in hull.tolist()} == {(7, 3), (12, 3), (12, 5), (7, 5)}
    strokes = runs_of(cells)
    assert strokes.tolist() == [[[7.5, 3.5], [11.5, 3.5]], [[7.5, 4.5], [11.5, 4.5]]]
    upright = runs_of(cells[:, ::-1])
    assert upright.tolist() == [[[3.5, 7.5], [3.5, 11.5]], [[4.5, 7.5], [4.5, 11.5]]]
    assert shared((0, 0, 3, 3), (2, 2, 9, 9)) == 0.25
    assert shared((0, 0, 1, 1), (2, 2, 3, 3)) == 0.0
