"""Mirrors that are not on the map are suspected; gaps, panes and moved things are not."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D
from trolley.gridmap import FREE, OCCUPIED, GridMap, cast_rays
from trolley.scanning import ScanInput
from trolley_localizer.changes.mirror_detector import MirrorDetector
from trolley_localizer.core import Localizer
from trolley_localizer.estimate import Estimate
from trolley_localizer.kernels.layout import Lines
from trolley_localizer.kernels.matching import BEHIND_MIRROR, SUSPECTED, mark_crossing
from trolley_localizer.matching.likelihood_field import build_field
from trolley_localizer.matching.map_matcher import BeamSet, read_beams

BEAMS = 360
RANGE_MAX = 10.0
BODY_M = 0.12
# The wall between the two rooms has its left face here, and a mirror, a door or a pane there [m].
WALL_X = 5.0
LOW, HIGH = 1.2, 2.4
NO_LINES = Lines(*(np.empty(0) for _ in range(4)))


def two_rooms() -> GridMap:
    """Two rooms of 5 x 4 m and 3 x 4 m with furniture, and the wall between them."""
    cells = np.full((84, 168), OCCUPIED, np.int8)
    cells[2:82, 2:100] = FREE
    cells[2:82, 102:166] = FREE
    cells[60:82, 20:50] = OCCUPIED
    cells[2:12, 60:80] = OCCUPIED
    cells[30:40, 2:10] = OCCUPIED
    cells[20:30, 140:150] = OCCUPIED
    cells[64:82, 120:130] = OCCUPIED
    return GridMap("rooms", 0.05, Pose2D(0.0, 0.0, 0.0), cells)


def changed(grid: GridMap, part: tuple[slice, slice], value: int) -> GridMap:
    """The same map with a rectangle of other cells."""
    cells = grid.cells.copy()
    cells[part] = value
    return GridMap(grid.name, grid.resolution, grid.origin, cells)


def opened(grid: GridMap) -> GridMap:
    """The rooms with a door in the wall between them."""
    return changed(grid, (slice(round(LOW / 0.05), round(HIGH / 0.05)), slice(100, 102)), FREE)


def ranges_in(world: GridMap, pose: Pose2D, *, mirror: bool) -> NDArray[np.float32]:
    """What a lidar in the middle of the robot sees, to the border of cells [m]."""
    angles = pose.yaw - math.pi + np.arange(BEAMS) * (2.0 * math.pi / BEAMS)
    mask = world.occupied_mask()
    plain = cast_rays(mask, 0.05, (pose.x, pose.y), angles, RANGE_MAX)
    if not mirror:
        return plain.astype(np.float32)
    for i, angle in enumerate(angles):
        to_wall = (WALL_X - 1e-3 - pose.x) / max(math.cos(angle), 1e-9)
        y = pose.y + to_wall * math.sin(angle)
        if math.cos(angle) < 0.05 or not LOW < y < HIGH or plain[i] < to_wall - 0.05:
            continue
        back = math.pi - angle
        seen = cast_rays(mask, 0.05, (WALL_X - 1e-3, y), np.array([back]), RANGE_MAX)[0]
        # The robot itself is a disc about the lidar.
        dx, dy = pose.x - WALL_X, pose.y - y
        along = dx * math.cos(back) + dy * math.sin(back)
        off = abs(dx * math.sin(back) - dy * math.cos(back))
        if off < BODY_M and along > 0.0:
            seen = min(seen, along - math.sqrt(BODY_M**2 - off**2))
        plain[i] = to_wall + seen
    return plain.astype(np.float32)


def make_scan(ranges: NDArray[np.float32], odom: Pose2D, stamp_ns: int) -> ScanInput:
    return ScanInput(
        stamp_ns=stamp_ns,
        ranges=ranges,
        angle_min=-math.pi,
        angle_increment=2.0 * math.pi / BEAMS,
        range_min=0.1,
        range_max=RANGE_MAX,
        base_T_laser=Pose2D(0.0, 0.0, 0.0),
        odom_T_base=odom,
        odom_T_base_end=odom,
    )


# Through the left room, past the middle of the wall between.
WAY = [Pose2D(1.2 + 0.11 * k, 1.0 + 0.06 * k, 0.02 * k) for k in range(26)]


class Observer:
    """Looks at a world with the map of another."""

    def __init__(self, grid: GridMap) -> None:
        self.grid = grid
        self.field = build_field(grid, LocalizerConfig())
        self.detector = MirrorDetector(self.field)
        self.changes = 0

    def beams(self, ranges: NDArray[np.float32]) -> BeamSet:
        return read_beams(make_scan(ranges, Pose2D.identity(), 1), 0.05, 60.0)

    def drive(
        self,
        world: GridMap,
        *,
        mirror: bool = False,
        off: Pose2D | None = None,
        echo_share: float = 0.0,
        known: Lines = NO_LINES,
    ) -> None:
        """Drive along `WAY`; the pose is believed `off` from the truth."""
        rng = np.random.default_rng(0)
        for pose in WAY:
            ranges = ranges_in(world, pose, mirror=mirror)
            if echo_share:
                shut = ranges_in(self.grid, pose, mirror=False)
                ranges = np.where(rng.random(BEAMS) < echo_share, shut, ranges)
            believed = self.field.to_cells(pose @ (off or Pose2D.identity()))
            beams = self.beams(ranges)
            classes = beams.classes.copy()
            mark_crossing(classes, believed, beams.end, beams.start, known, 2.0, BEHIND_MIRROR)
            self.changes += self.detector.update(believed, beams, classes, known)


@pytest.fixture(scope="module")
def rooms() -> GridMap:
    return two_rooms()


def assert_is_the_mirror(points_m: NDArray[np.float64]) -> None:
    """The line lies on the mirror and covers half of it."""
    assert np.all(np.abs(points_m[:, 0] - WALL_X) <= 0.06)
    assert np.all((points_m[:, 1] >= LOW - 0.1) & (points_m[:, 1] <= HIGH + 0.1))
    assert np.ptp(points_m[:, 1]) >= 0.5 * (HIGH - LOW)


def test_a_mirror_on_a_wall_is_suspected(rooms: GridMap) -> None:
    observer = Observer(rooms)
    observer.drive(rooms, mirror=True)
    (suspect,) = observer.detector.suspects
    assert_is_the_mirror(np.array([suspect.start, suspect.end]) * 0.05)
    assert 0.5 <= suspect.score <= 1.0


def test_it_is_still_suspected_with_the_pose_a_little_off(rooms: GridMap) -> None:
    observer = Observer(rooms)
    observer.drive(rooms, mirror=True, off=Pose2D(0.03, -0.03, 0.01))
    (suspect,) = observer.detector.suspects
    assert_is_the_mirror(np.array([suspect.start, suspect.end]) * 0.05)


def test_a_robot_that_stands_still_suspects_nothing(rooms: GridMap) -> None:
    observer = Observer(rooms)
    beams = observer.beams(ranges_in(rooms, WAY[10], mirror=True))
    pose = observer.field.to_cells(WAY[10])
    for _ in range(100):
        observer.detector.update(pose, beams, beams.classes, NO_LINES)
    assert observer.detector.suspects == []


def test_an_open_door_to_a_known_room_is_no_mirror(rooms: GridMap) -> None:
    observer = Observer(rooms)
    observer.drive(opened(rooms))
    assert observer.detector.suspects == []
    assert observer.changes == 0


def test_an_open_door_to_an_unknown_room_is_no_mirror(rooms: GridMap) -> None:
    observer = Observer(changed(rooms, (slice(0, 84), slice(102, 168)), FREE))
    observer.drive(opened(rooms))
    assert observer.detector.suspects == []


def test_an_open_door_to_a_bare_room_as_deep_as_this_one_is_no_mirror(rooms: GridMap) -> None:
    # Its walls lie where a mirror would show those of this room; only the furniture is missing.
    cells = np.full((84, 200), OCCUPIED, np.int8)
    cells[:, :102] = rooms.cells[:, :102]
    cells[:, 102:] = FREE
    observer = Observer(GridMap("one", 0.05, rooms.origin, cells))
    world = cells.copy()
    world[:2], world[-2:], world[:, -2:] = OCCUPIED, OCCUPIED, OCCUPIED
    observer.drive(opened(GridMap("two", 0.05, rooms.origin, world)))
    assert observer.detector.suspects == []


def test_a_pane_is_no_mirror(rooms: GridMap) -> None:
    observer = Observer(rooms)
    observer.drive(opened(rooms), echo_share=0.1)
    assert observer.detector.suspects == []


@pytest.mark.parametrize("depth_cells", [8, 12, 18])
def test_a_wardrobe_that_was_moved_is_no_mirror(rooms: GridMap, depth_cells: int) -> None:
    wardrobe = (slice(30, 60), slice(100 - depth_cells, 100))
    observer = Observer(changed(rooms, wardrobe, OCCUPIED))
    observer.drive(rooms)
    assert observer.detector.suspects == []


@pytest.mark.parametrize("off", [Pose2D(0.35, 0.0, 0.0), Pose2D(0.1, -0.3, 0.05)])
def test_a_wrong_pose_makes_no_mirrors(rooms: GridMap, off: Pose2D) -> None:
    observer = Observer(rooms)
    observer.drive(rooms, off=off)
    assert observer.detector.suspects == []


def test_a_mirror_that_was_taken_down_is_forgotten(rooms: GridMap) -> None:
    observer = Observer(rooms)
    observer.drive(rooms, mirror=True)
    assert observer.detector.suspects
    for _ in range(2):
        observer.drive(rooms)
    assert observer.detector.suspects == []


def test_a_mirror_on_the_map_is_not_suspected(rooms: GridMap) -> None:
    ends = np.array([[WALL_X, LOW], [WALL_X, HIGH]]) / 0.05
    known = Lines(*(np.array([value]) for value in ends.ravel()))
    observer = Observer(rooms)
    observer.drive(rooms, mirror=True, known=known)
    assert observer.detector.suspects == []
    # Nor beside a line that is a little too short.
    short = known._replace(ay=known.ay + 8.0)
    observer.drive(rooms, mirror=True, known=short)
    for suspect in observer.detector.suspects:
        assert suspect.end[1] < short.ay[0]


def test_the_localizer_leaves_the_beams_out_and_tells_the_line_in_the_map_frame(
    rooms: GridMap,
) -> None:
    origin = Pose2D(3.0, -1.0, 0.7)
    turned = GridMap("turned", 0.05, origin, rooms.cells)
    localizer = Localizer(turned, [], LocalizerConfig(), 0)
    localizer.set_pose(origin @ WAY[0])
    estimates: list[Estimate] = []
    for number, pose in enumerate(WAY):
        scan = make_scan(ranges_in(rooms, pose, mirror=True), pose, number * 100_000_000 + 1)
        estimate = localizer.step(scan)
        assert isinstance(estimate, Estimate)
        estimates.append(estimate)
    ((points, score),) = localizer.map_watch.suspects()
    assert_is_the_mirror(origin.inverse().transform_points(points))
    assert 0.5 <= score <= 1.0
    assert not np.any(estimates[3].beam_classes == SUSPECTED)
    assert np.count_nonzero(estimates[-1].beam_classes == SUSPECTED) >= 20
    found = estimates[-1].map_T_base
    assert found is not None
    assert found.distance_to(origin @ WAY[-1]) < 0.05
    localizer.set_mirrors([points])
    assert localizer.map_watch.suspects() == []
