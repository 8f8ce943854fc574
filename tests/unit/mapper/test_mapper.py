"""The mapper as a whole, in a simulated flat."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from trolley.config.mapper import MapperConfig
from trolley.geometry import Pose2D
from trolley.gridmap import FREE, OCCUPIED, GridMap, distance_transform
from trolley.scanning import Reject
from trolley.slices import is_left, whole
from trolley_mapper.slam.estimate import MapEstimate
from trolley_mapper.slam.mapper import Mapper
from trolley_mapper.slam.sentences import CUT, SLIPS
from trolley_mapper.slam.serialization import pack

from .conftest import START, Drive

MakeDrive = Callable[..., Drive]


pytestmark = pytest.mark.drives


def wall_error_m(found: GridMap, truth: GridMap, share: float = 0.95) -> float:
    """How far such a share of the walls of a map is from true ones at most."""
    away = distance_transform(truth.occupied_mask(), truth.resolution)
    points = found.cell_to_world(np.column_stack(np.nonzero(found.occupied_mask())))
    cells = truth.world_to_cell(points)
    inside = truth.contains_cell(cells)
    assert inside.mean() > 0.99
    return float(np.quantile(away[cells[inside, 0], cells[inside, 1]], share))


def test_the_map_shows_the_flat(make_drive: MakeDrive, flat: GridMap) -> None:
    drive = make_drive()
    drive.odometry_scale = 0.95
    drive.tour()
    assert drive.last is not None
    assert drive.last.state == "mapping"
    assert drive.error_m() < 0.05
    assert wall_error_m(drive.mapper.grid(), flat) <= 0.0708


def test_spinning_wheels_do_not_bend_the_map(make_drive: MakeDrive) -> None:
    drive = make_drive()
    for _ in range(20):
        drive.scan(0.3)
    before = drive.mapper.num_keyframes
    for _ in range(50):
        drive.odom = drive.odom @ Pose2D(0.05, 0.0, 0.05)
        drive.look()
    assert drive.error_m() < 0.05
    assert drive.mapper.num_keyframes <= before + 1
    assert drive.last is not None
    assert drive.last.message == SLIPS


@pytest.mark.parametrize("step", [Pose2D(0.03, 0.0, 0.0), Pose2D(0.0, 0.0, 0.08)])
def test_wheels_that_slip_are_told_of_while_they_do(make_drive: MakeDrive, step: Pose2D) -> None:
    drive = make_drive()
    drive.odometry_scale = 0.93
    driven = [drive.scan(0.3, wz).message for wz in (0.0, 0.5, -0.9) for _ in range(8)]
    assert set(driven) == {""}
    for _ in range(10):
        drive.odom = drive.odom @ step
        drive.look()
    assert drive.last is not None
    assert drive.last.message == SLIPS
    standing = [drive.look().message for _ in range(10)]
    assert standing[-1] == ""


@pytest.mark.parametrize(("pushed_rad", "told_rad"), [(0.15, -1.2), (0.3, -1.2), (-0.15, 1.2)])
def test_scans_taken_while_wheels_spin_are_not_bent(
    make_drive: MakeDrive, flat: GridMap, pushed_rad: float, told_rad: float
) -> None:
    drive = make_drive()
    for _ in range(20):
        drive.scan(0.3)
    # Against a chair: the wheels turn on, the robot is pushed aside little by little.
    drive.told_in_scan = Pose2D(0.04, 0.0, 0.1 * told_rad)
    for _ in range(120):
        drive.odom = drive.odom @ drive.told_in_scan
        drive.scan(0.0, pushed_rad)
    assert drive.last is not None
    assert drive.last.pose.yaw == pytest.approx(drive.pose.yaw, abs=0.01)
    # One cell in a hundred may stand for a single stray echo.
    assert wall_error_m(drive.mapper.grid(), flat, 0.99) <= 0.0708


CORRIDOR = np.full((44, 604), OCCUPIED, np.int8)
"""Two pillars in 30 m are all that tells how far along the robot is."""
CORRIDOR[2:-2, 2:-2] = FREE
CORRIDOR[30:42, 300:312] = OCCUPIED
CORRIDOR[2:8, 330:340] = OCCUPIED


@pytest.mark.parametrize("told", [Pose2D(0.05, 0.0, 0.0), Pose2D(0.05, 0.0, -0.05)])
def test_wheels_that_spin_in_a_corridor_do_not_stretch_it(told: Pose2D) -> None:
    start = Pose2D(13.0, 1.1, 0.0)
    corridor = GridMap("corridor", 0.05, Pose2D.identity(), CORRIDOR)
    drive = Drive(corridor, Mapper(MapperConfig(), start), start)
    drive.look()
    for _ in range(20):
        drive.scan(0.3)
    drive.told_in_scan = told
    for _ in range(100):
        drive.odom = drive.odom @ told
        drive.look()
    assert drive.error_m() < 0.05
    assert drive.last is not None
    assert drive.last.message == SLIPS


def test_a_place_that_looks_alike_behind_the_robot_is_not_where_the_wheels_led_ahead() -> None:
    depths = np.random.default_rng(1).integers(0, 20, (2, 60))
    cells = np.full((84, 600), OCCUPIED, np.int8)
    for number, (low, high) in enumerate(depths.T.tolist()):
        cells[22 - low : 62 + high, 10 * number : 10 * number + 10] = FREE
    cells[:, [0, -1]] = OCCUPIED
    start = Pose2D(13.0, 2.1, 0.0)
    niches = GridMap("niches", 0.05, Pose2D.identity(), cells)
    drive = Drive(niches, Mapper(MapperConfig(), start), start)
    for _ in range(60):
        drive.scan(0.3)
    drive.grid = GridMap("alike", 0.05, Pose2D.identity(), np.roll(cells, 38, axis=1))
    drive.scan(1.0, seconds=1.0)
    assert drive.error_m() < 0.3


@pytest.mark.parametrize("scale", [0.97, 1.0, 1.03])
def test_a_corridor_is_driven_as_long_as_it_is(scale: float) -> None:
    start = Pose2D(12.0, 1.1, 0.0)
    corridor = GridMap("corridor", 0.05, Pose2D.identity(), CORRIDOR)
    drive = Drive(corridor, Mapper(MapperConfig(), start), start)
    drive.odometry_scale = scale
    drive.look()
    errors: list[float] = []
    for _ in range(150):
        drive.scan(0.3)
        errors.append(drive.error_m())
    assert max(errors) < 0.04


@pytest.mark.parametrize("scale", [0.95, 1.0, 1.05])
def test_a_scan_a_metre_does_not_shorten_a_corridor(scale: float) -> None:
    start = Pose2D(2.0, 1.1, 0.0)
    corridor = GridMap("corridor", 0.05, Pose2D.identity(), CORRIDOR)
    drive = Drive(corridor, Mapper(MapperConfig(), start), start)
    drive.odometry_scale = scale
    drive.look()
    errors: list[float] = []
    for _ in range(25):
        drive.scan(0.5, seconds=2.0)
        errors.append(drive.error_m())
    # Up to the first pillar nothing but the wheels tells how far it is.
    assert max(errors) < 0.6
    assert errors[-1] < 0.3


def test_a_lidar_cut_for_five_seconds_is_bridged_by_odometry(make_drive: MakeDrive) -> None:
    drive = make_drive()
    for _ in range(20):
        drive.scan(0.3)
    drive.scan(0.3, 0.1, 5.0)
    for _ in range(10):
        drive.scan(0.1)
    assert drive.last is not None
    assert drive.last.state == "mapping"
    assert drive.error_m() < 0.05


@pytest.mark.parametrize("turn_rad", [0.7, -0.8])
def test_a_turn_that_the_wheels_miss_between_two_scans_does_not_bend_the_map(
    make_drive: MakeDrive, turn_rad: float
) -> None:
    drive = make_drive()
    drive.tour()
    for _ in range(3):
        drive.pose = drive.pose @ Pose2D(0.0, 0.0, turn_rad)
        assert drive.look(1.0).state == "mapping"
        assert drive.error_m() < 0.05


def test_after_a_long_way_with_a_covered_lidar_the_map_goes_on_apart_until_it_is_proven(
    make_drive: MakeDrive,
) -> None:
    drive = make_drive()
    drive.tour()
    grid, keyframes = drive.mapper.grid(), drive.mapper.num_keyframes
    drive.is_covered, drive.odometry_scale = True, 1.15
    for count in (18, 100, 18, 60, 18, 90):
        for _ in range(count):
            # Home and back, and the wheels report too much of all that.
            turns = count == 18
            drive.scan(0.0 if turns else -0.3 if count == 60 else 0.3, 0.8 if turns else 0.0)
    assert drive.last is not None
    assert drive.last.state == "unsure"
    drive.is_covered, drive.odometry_scale = False, 1.0
    assert drive.look().state == "lost"
    assert "not joined to the map yet" in drive.look().message
    assert drive.mapper.grid() is grid
    assert drive.mapper.num_keyframes == keyframes
    for _ in range(40):
        drive.scan(0.0, 0.8)
    assert drive.last.state == "mapping"
    assert drive.mapper.num_keyframes > keyframes
    assert drive.error_m() < 0.05


def drive_into_a_loose_part(drive: Drive) -> None:
    """See nothing for so long that nobody knows where the robot is, then a part of the map."""
    drive.tour()
    drive.is_covered, drive.odometry_scale = True, 1.15
    for count in (18, 100, 18, 60, 18, 90):
        for _ in range(count):
            turns = count == 18
            drive.scan(0.0 if turns else -0.3 if count == 60 else 0.3, 0.8 if turns else 0.0)
    drive.is_covered, drive.odometry_scale = False, 1.0
    assert drive.look().state == "lost"
    assert drive.mapper.is_loose
    assert drive.mapper.num_loose > 0


@pytest.mark.parametrize("error", [Pose2D(0.4, -0.3, 0.2), Pose2D(-0.6, 0.5, -0.3)])
def test_a_loose_part_is_joined_where_a_person_says_about_it_is(
    make_drive: MakeDrive, error: Pose2D
) -> None:
    drive = make_drive()
    drive_into_a_loose_part(drive)
    drive.mapper.join(drive.pose @ error)
    drive.look()
    assert drive.look().state == "mapping"
    assert not drive.mapper.is_loose
    assert drive.mapper.num_loose == 0
    assert drive.error_m() < 0.05


def test_a_loose_part_that_a_person_joins_in_a_wrong_place_is_cut_off_again(
    make_drive: MakeDrive,
) -> None:
    drive = make_drive()
    drive_into_a_loose_part(drive)
    drive.mapper.join(Pose2D(1.5, 5.0, 1.0))
    said = set[str]()
    for vx, wz, count in ((0.0, -0.8, 10), (0.3, 0.0, 100), (0.0, 0.8, 40), (0.3, 0.0, 20)):
        said |= {drive.scan(vx, wz).message for _ in range(count)}
    assert CUT in said
    assert drive.error_m() < 0.05


def test_a_loose_part_that_is_dropped_is_not_joined_and_another_one_begins(
    make_drive: MakeDrive,
) -> None:
    drive = make_drive()
    drive_into_a_loose_part(drive)
    grid = drive.mapper.grid()
    drive.mapper.drop_loose()
    assert drive.mapper.num_loose == 0
    assert not drive.mapper.is_loose
    assert drive.look().state == "lost"
    assert drive.mapper.num_loose == 1
    assert drive.mapper.grid() is grid
    for _ in range(40):
        drive.scan(0.0, 0.8)
    assert drive.last is not None
    assert drive.last.state == "mapping"
    assert drive.error_m() < 0.05


def test_a_lifted_robot_is_lost_and_found_and_the_map_is_not_bent(make_drive: MakeDrive) -> None:
    drive = make_drive()
    drive.tour()
    cells, keyframes = drive.mapper.grid().cells.copy(), drive.mapper.num_keyframes
    drive.pose = Pose2D(6.5, 2.0, 0.3)
    states = [drive.look().state for _ in range(25)]
    assert "lost" in states
    assert drive.mapper.num_keyframes == keyframes
    assert np.array_equal(cells, drive.mapper.grid().cells)
    for _ in range(40):
        drive.scan(0.2, 0.0)
    assert drive.last is not None
    assert drive.last.state == "mapping"
    assert drive.error_m() < 0.05


def make_twins() -> GridMap:
    """Two rooms alike, each with a door to one corridor."""
    cells = np.full((124, 244), OCCUPIED, np.int8)
    cells[2:30, 2:-2] = FREE
    for left in (2, 124):
        cells[32:120, left : left + 118] = FREE
        cells[30:32, left + 50 : left + 70] = FREE
        cells[80:96, left + 90 : left + 110] = OCCUPIED
    return GridMap("twins", 0.05, Pose2D.identity(), cells)


def follow(drive: Drive, *legs: tuple[float, float, float]) -> list[MapEstimate]:
    """Drive legs of seconds, m/s and rad/s; returns what the mapper made of each scan."""
    return [drive.scan(vx, wz) for s, vx, wz in legs for _ in range(round(10 * s))]


def test_a_robot_lifted_to_where_two_rooms_look_alike_waits_until_it_can_tell() -> None:
    start = Pose2D(3.0, 4.5, -0.5 * math.pi)
    drive = Drive(make_twins(), Mapper(MapperConfig(), start), start)
    drive.look()
    quarter = 0.5 * math.pi
    # Down through the door, along the corridor, up into the other room.
    follow(drive, (9.25, 0.4, 0.0), (2.0, 0.0, 0.5 * quarter), (15.25, 0.4, 0.0))
    follow(drive, (2.0, 0.0, 0.5 * quarter), (9.25, 0.4, 0.0))
    assert drive.error_m() < 0.05
    drive.pose = Pose2D(2.0, 5.0, -1.0)
    states = [drive.scan(0.0, 0.3).state for _ in range(40)]
    assert states[-1] == "lost"
    # Back into the corridor, whose ends tell.
    drive.pose = Pose2D(3.0, 2.5, -quarter)
    for _ in range(60):
        drive.scan(0.2 if drive.pose.y > 0.8 else 0.0, 0.0)
    for _ in range(20):
        drive.scan(0.0, 0.5 * quarter)
    for _ in range(30):
        drive.scan(0.2)
    assert drive.last is not None
    assert drive.last.state == "mapping"
    assert drive.error_m() < 0.05


def test_a_part_that_was_joined_in_a_wrong_place_is_cut_off_and_joined_in_the_right_one() -> None:
    world = make_twins()
    world.cells[2:12, 60:64] = world.cells[20:30, 190:200] = OCCUPIED  # to tell the corridor's ends
    start = Pose2D(3.0, 4.5, -0.5 * math.pi)
    drive = Drive(world, Mapper(MapperConfig(), start), start)
    quarter = 0.5 * math.pi
    drive.look()
    # To the door, a look into the corridor, and back.
    follow(drive, (9.25, 0.4, 0.0), (2.0, 0.0, 0.5 * quarter), (5.0, 0.4, 0.0))
    follow(drive, (4.0, 0.0, 0.5 * quarter), (5.0, 0.4, 0.0), (2.0, 0.0, -0.5 * quarter))
    follow(drive, (9.0, 0.4, 0.0))
    keyframes = drive.mapper.num_keyframes
    # Carried to the other room, of which nobody can know yet.
    drive.pose = Pose2D(9.1, 4.5, -quarter)
    follow(drive, (8.0, 0.0, 0.5 * quarter), (2.5, 0.4, 0.0), (8.0, 0.0, 0.5 * quarter))
    assert drive.last is not None
    assert drive.last.state == "mapping"
    assert drive.error_m() > 5.0
    # Out of its door, and along a corridor that does not fit.
    follow(drive, (6.75, 0.4, 0.0), (2.0, 0.0, -0.5 * quarter))
    said = {one.message for one in follow(drive, (14.0, 0.4, 0.0), (4.0, 0.0, -0.5 * quarter))}
    said |= {one.message for one in follow(drive, (5.0, 0.4, 0.0))}
    assert CUT in said
    assert drive.last.state == "mapping"
    assert drive.error_m() < 0.05
    assert drive.mapper.num_keyframes > 2 * keyframes  # both rooms are on the map
    assert wall_error_m(drive.mapper.grid(), world) <= 0.0708


def test_undo_forgets_nothing_of_before_robot_time_began_earlier(make_drive: MakeDrive) -> None:
    drive = make_drive()
    drive.stamp_ns = 20_000_000_000
    for _ in range(30):
        drive.scan(vx=0.25)
    before = drive.mapper.num_keyframes
    drive.stamp_ns = 18_000_000_000
    drive.mapper.begin_epoch()
    for _ in range(30):
        drive.scan(vx=-0.25, wz=0.5)
    assert drive.mapper.num_keyframes > before
    drive.mapper.undo(60.0)
    assert drive.mapper.num_keyframes == before


def test_undo_forgets_and_tracking_goes_on(make_drive: MakeDrive) -> None:
    drive = make_drive()
    for _ in range(60):
        drive.scan(0.4)
    place = drive.mapper.anchor(drive.pose)
    keyframes, version = drive.mapper.num_keyframes, drive.mapper.version
    left = drive.mapper.undo(3.0)
    assert left is not None
    assert drive.mapper.num_keyframes < keyframes
    assert drive.mapper.version != version
    assert drive.mapper.moved(place).distance_to(drive.pose) < 0.05
    for _ in range(10):
        drive.scan(-0.4)
    assert drive.error_m() < 0.05
    assert drive.mapper.undo(1e6) is not None
    assert drive.mapper.num_keyframes == 1


def test_a_search_that_is_no_longer_wanted_is_left_and_changes_nothing(
    make_drive: MakeDrive,
) -> None:
    drive = make_drive()
    for _ in range(20):
        drive.scan(0.3)
    job, step = None, Pose2D(0.03, 0.0, 0.0)
    while job is None:  # until a keyframe is looked for
        drive.pose, drive.odom = drive.pose @ step, drive.odom @ step
        drive.stamp_ns += 100_000_000
        drive.mapper.step(drive.make_scan())
        job = drive.mapper.take_job()
    slices = job.slices()
    assert is_left(slices)
    assert drive.mapper.wants(job)
    drive.mapper.undo(5.0)
    assert not drive.mapper.wants(job)
    before = pack(drive.mapper.snapshot())
    assert drive.mapper.take_job() is not job
    whole(slices)
    drive.mapper.finish(job)
    assert pack(drive.mapper.snapshot()) == before


def test_a_paused_map_does_not_grow(make_drive: MakeDrive) -> None:
    drive = make_drive()
    drive.scan()
    drive.mapper.pause()
    for _ in range(20):
        drive.scan(0.4)
    assert drive.mapper.num_keyframes == 1
    assert drive.error_m() < 0.05
    drive.mapper.resume()
    drive.scan(0.4)
    assert drive.mapper.num_keyframes == 2


def test_time_alone_costs_no_memory(make_drive: MakeDrive) -> None:
    drive = make_drive()
    counts = []
    for _ in range(16):
        for _ in range(16):
            drive.scan(0.0, 0.8)
        counts.append(drive.mapper.num_keyframes)
    assert counts[-1] <= counts[-6] + 2
    assert drive.error_m() < 0.05


def test_a_mapper_goes_on_from_its_bytes(make_drive: MakeDrive, flat: GridMap) -> None:
    drive = make_drive()
    drive.tour()
    place = drive.mapper.anchor(drive.pose)
    data = pack(drive.mapper.snapshot())
    again = Mapper.from_bytes(MapperConfig(), data)
    assert again.num_keyframes == drive.mapper.num_keyframes
    assert again.moved(place).distance_to(drive.pose) < 0.05
    same = again.grid().cells == drive.mapper.grid().cells
    assert same.mean() > 0.99
    drive.mapper = again
    drive.odom = Pose2D.identity()
    for _ in range(20):
        drive.scan(-0.4)
    assert drive.last is not None
    assert drive.last.state == "mapping"
    assert drive.error_m() < 0.05


def test_what_is_packed_aside_is_the_map_as_it_was(make_drive: MakeDrive) -> None:
    drive = make_drive()
    for _ in range(30):
        drive.scan(0.3)
    drive.mapper.anchor(drive.pose)
    snapshot = drive.mapper.snapshot()
    before = pack(snapshot)
    for _ in range(30):
        drive.scan(0.0, 0.8)
    drive.mapper.anchor(drive.pose)
    drive.mapper.undo(1.0)
    assert pack(snapshot) == before
    assert pack(drive.mapper.snapshot()) != before


@pytest.mark.parametrize("data", [b"", b"junk", b"x\x9c\x03\x00\x00\x00\x00\x01"])
def test_bytes_that_are_no_state_are_refused(data: bytes) -> None:
    with pytest.raises(ValueError, match="state"):
        Mapper.from_bytes(MapperConfig(), data)


@pytest.mark.parametrize("is_told", [True, False])
def test_a_map_is_extended_in_its_own_frame(
    make_drive: MakeDrive, flat: GridMap, is_told: bool
) -> None:
    cells = flat.cells.copy()
    cells[:, :70] = -1
    prior = GridMap("home", 0.05, Pose2D.identity(), cells)
    told = START @ Pose2D(0.1, -0.05, 0.1) if is_told else None
    drive = make_drive(Mapper(MapperConfig(), told, prior))
    drive.tour()
    assert drive.last is not None
    assert drive.last.state == "mapping"
    assert drive.error_m() < 0.06
    assert wall_error_m(drive.mapper.grid(), flat) <= 0.0708


def test_scans_that_cannot_be_used_are_refused(make_drive: MakeDrive) -> None:
    drive = make_drive()
    drive.scan()
    assert drive.mapper.step(drive.make_scan()) is Reject.OLD_STAMP
    drive.stamp_ns += 1
    drive.odom = Pose2D(math.nan, 0.0, 0.0)
    assert drive.mapper.step(drive.make_scan()) is Reject.BAD_ODOMETRY
