"""The localizer's core: what it says of scans of a known place."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D, Twist2D
from trolley.gridmap import FREE, OCCUPIED, GridMap
from trolley.scanning import Reject
from trolley_localizer.core import Localizer
from trolley_localizer.estimate import Estimate
from trolley_localizer.kernels.matching import BEHIND_MIRROR, EXPLAINED, NOT_ON_MAP, UNUSED

from .conftest import BASE_T_LASER, BEAMS, Drive, Turn, at, make_scan

MakeDrive = Callable[..., Drive]


def settle(drive: Drive, scans: int = 8) -> Estimate:
    for _ in range(scans - 1):
        drive.scan(0.2, 0.2)
    return drive.scan(0.2, 0.2)


def test_a_set_pose_is_believed_after_three_scans_that_agree(make_drive: MakeDrive) -> None:
    drive = make_drive()
    drive.localizer.set_pose(drive.pose @ Pose2D(0.2, -0.1, 0.1))
    states = [drive.scan().state for _ in range(4)]
    assert states == ["unsure", "unsure", "localized", "localized"]


def test_the_estimate_is_good_to_a_cell(make_drive: MakeDrive) -> None:
    drive = make_drive()
    drive.localizer.set_pose(drive.pose @ Pose2D(0.3, 0.0, -0.17))
    estimates = [drive.scan(0.4, 0.5) for _ in range(40)]
    assert drive.error_m(estimates[-1]) < 0.05
    assert estimates[-1].state == "localized"
    assert estimates[-1].match > 0.9
    assert estimates[-1].covariance is not None
    assert np.linalg.eigvalsh(estimates[-1].covariance).min() > 0.0


def test_without_a_start_it_searches_and_finds(make_drive: MakeDrive) -> None:
    drive = make_drive(2.0, 4.5, -2.0)
    first = drive.scan()
    assert first.state == "searching"
    assert first.map_T_base is None
    assert settle(drive).state == "localized"
    assert drive.error_m(drive.scan()) < 0.06


def test_a_wrong_start_pose_is_not_believed(make_drive: MakeDrive) -> None:
    drive = make_drive()
    wrong = drive.pose @ Pose2D(1.0, 1.2, 0.4)
    drive.localizer.set_pose(wrong)
    for _ in range(20):
        estimate = drive.scan()
        assert estimate.state != "localized" or drive.error_m(estimate) < 0.3
    assert estimate.state == "localized"


def test_a_robot_that_was_carried_off_is_found_within_three_seconds(make_drive: MakeDrive) -> None:
    drive = make_drive()
    drive.localizer.set_pose(drive.pose)
    settle(drive)
    drive.pose = at(drive.grid, 1.6, 4.8, 2.5)
    wrong = [drive.scan() for _ in range(30)]
    believed = [e for e in wrong if e.state == "localized" and drive.error_m(e) > 0.5]
    assert len(believed) < 10
    assert drive.error_m(wrong[-1]) < 0.06
    assert wrong[-1].state == "localized"


@pytest.mark.parametrize("place", [(1.6, 4.8, 2.5), (4.6, 1.0, -0.4), (7.3, 2.0, -1.1)])
def test_a_lidar_with_few_echoes_notices_too_that_it_was_carried_off(
    make_drive: MakeDrive, place: tuple[float, float, float]
) -> None:
    drive = make_drive()
    drive.turn = lambda: Turn(90)

    def narrow(ranges: np.ndarray) -> None:
        ahead = BASE_T_LASER.yaw - math.pi + np.arange(ranges.size) * math.radians(4.0)
        ranges[np.cos(ahead) < math.cos(math.radians(45.5))] = np.inf

    drive.alter = narrow
    drive.localizer.set_pose(drive.pose)
    assert settle(drive).state == "localized"
    drive.pose = at(drive.grid, *place)
    estimates = [drive.scan() for _ in range(40)]
    wrong = [e for e in estimates if e.state == "localized" and drive.error_m(e) > 0.5]
    assert len(wrong) < 10


def test_why_a_pose_is_unsure_is_judged_by_changed_settings(make_drive: MakeDrive) -> None:
    drive = make_drive()
    drive.localizer.set_pose(drive.pose)
    assert settle(drive).state == "localized"
    drive.localizer.set_config(LocalizerConfig(max_spread_m=0.005))
    estimate = settle(drive, 30)
    assert estimate.state == "unsure"
    assert estimate.message == "the hypotheses lie far apart"


def test_a_robot_that_stands_does_not_wander(make_drive: MakeDrive) -> None:
    drive = make_drive()
    drive.localizer.set_pose(drive.pose)
    settle(drive)
    before = drive.scan().map_T_base
    for _ in range(100):
        after = drive.scan().map_T_base
    assert before is not None
    assert after is not None
    assert before.distance_to(after) < 0.01
    assert drive.localizer.particles()[0].shape[0] >= LocalizerConfig().min_particles


def test_a_gap_of_seconds_does_not_lose_it(make_drive: MakeDrive) -> None:
    drive = make_drive(6.0, 1.0, 1.5)
    drive.odometry_scale = 0.92
    drive.localizer.set_pose(drive.pose)
    settle(drive)
    for _ in range(3):
        estimate = drive.scan(0.4, 0.25, seconds=2.3)
        assert estimate.state in ("localized", "unsure")
        assert drive.error_m(estimate) < 0.3
        settle(drive, 3)


@pytest.mark.parametrize("sweep_s", [0.1, -0.1])
def test_motion_during_the_scan_is_taken_out(flat: GridMap, sweep_s: float) -> None:
    localizer = Localizer(flat, [], LocalizerConfig(), 0)
    pose = at(flat, 5.5, 3.0, 0.4)
    localizer.set_pose(pose)
    scan = make_scan(flat, pose, Pose2D.identity(), 1, Twist2D(0.5, 0.0, 1.5), sweep_s)
    estimate = localizer.step(scan)
    assert isinstance(estimate, Estimate)
    assert estimate.map_T_base is not None
    assert estimate.map_T_base.distance_to(pose) < 0.03
    assert abs((pose.inverse() @ estimate.map_T_base).yaw) < math.radians(0.7)


def test_tf_odom_joins_pose_and_odometry(make_drive: MakeDrive) -> None:
    drive = make_drive()
    drive.localizer.set_pose(drive.pose)
    estimate = settle(drive)
    assert estimate.map_T_odom is not None
    assert estimate.map_T_base is not None
    joined = estimate.map_T_odom @ drive.odom
    assert joined.distance_to(estimate.map_T_base) < 1e-9


def test_a_covered_lidar_confirms_nothing(make_drive: MakeDrive) -> None:
    drive = make_drive()
    drive.localizer.set_pose(drive.pose)
    settle(drive)

    def cover(ranges: np.ndarray) -> None:
        ranges[:] = 0.15

    drive.alter = cover
    estimates = [drive.scan() for _ in range(20)]
    assert estimates[-1].state == "unsure"
    assert "sees too little" in estimates[-1].message


def test_no_echo_at_all_is_no_reason_to_be_lost(make_drive: MakeDrive) -> None:
    drive = make_drive()
    drive.localizer.set_pose(drive.pose)
    settle(drive)
    drive.alter = lambda ranges: ranges.fill(np.inf)
    estimates = [drive.scan(0.2) for _ in range(40)]
    assert estimates[-1].state == "unsure"
    assert set(estimates[-1].beam_classes) == {UNUSED}
    drive.alter = lambda ranges: None
    assert settle(drive).state == "localized"


def test_nonsense_in_the_ranges_is_left_out(make_drive: MakeDrive) -> None:
    drive = make_drive()
    drive.localizer.set_pose(drive.pose)

    def spoil(ranges: np.ndarray) -> None:
        ranges[::7] = np.nan
        ranges[1::7] = -1.0
        ranges[2::7] = 1e30

    drive.alter = spoil
    estimate = settle(drive)
    assert estimate.state == "localized"
    assert drive.error_m(estimate) < 0.05
    assert (estimate.beam_classes[::7] == UNUSED).all()


def test_bad_input_is_rejected_by_name(flat: GridMap) -> None:
    localizer = Localizer(flat, [], LocalizerConfig(), 0)
    pose = at(flat, 5.5, 3.0, 0.4)
    good = make_scan(flat, pose, Pose2D.identity(), 10)
    assert isinstance(localizer.step(good), Estimate)
    assert localizer.step(good) is Reject.OLD_STAMP
    lost = make_scan(flat, pose, Pose2D.identity(), 20)
    object.__setattr__(lost, "odom_T_base", Pose2D(math.nan, 0.0, 0.0))
    assert localizer.step(lost) is Reject.BAD_ODOMETRY
    askew = make_scan(flat, pose, Pose2D.identity(), 20)
    object.__setattr__(askew, "angle_min", math.inf)
    assert localizer.step(askew) is Reject.BAD_GEOMETRY


@pytest.mark.parametrize("silent_s", [0.0, 3600.0])
def test_odometry_that_jumps_does_not_move_the_robot(
    make_drive: MakeDrive, silent_s: float
) -> None:
    drive = make_drive()
    drive.localizer.set_pose(drive.pose)
    settle(drive)
    drive.stamp_ns += round(silent_s * 1e9)
    drive.odom = Pose2D(500.0, -300.0, 2.0)
    estimate = drive.scan()
    assert drive.error_m(estimate) < 0.06


def test_a_pose_off_the_map_or_in_a_wall_is_named(flat: GridMap) -> None:
    localizer = Localizer(flat, [], LocalizerConfig(), 0)
    assert localizer.pose_problem(at(flat, 5.5, 3.0, 0.0)) is None
    assert localizer.pose_problem(at(flat, -0.2, 3.0, 0.0)) == "outside_map"
    assert localizer.pose_problem(at(flat, 0.05, 3.0, 0.0)) == "in_obstacle"


def test_beams_through_a_mirror_are_left_out(flat: GridMap) -> None:
    # A mirror across the way to the wall on the right: seen through it, the room goes on.
    pose = at(flat, 5.0, 1.2, 0.0)
    line_grid = np.array([[6.9, 0.3], [6.9, 2.1]])
    mirror = flat.origin.transform_points(line_grid)
    localizer = Localizer(flat, [mirror], LocalizerConfig(), 0)
    localizer.set_pose(pose)
    scan = make_scan(flat, pose, Pose2D.identity())
    estimate = localizer.step(scan)
    assert isinstance(estimate, Estimate)
    angles = np.arange(BEAMS) * scan.angle_increment + scan.angle_min + BASE_T_LASER.yaw
    aside = np.abs(np.arctan2(np.sin(angles), np.cos(angles)))
    assert (estimate.beam_classes[aside < 0.4] == BEHIND_MIRROR).all()
    assert not (estimate.beam_classes[aside > 0.6] == BEHIND_MIRROR).any()


def test_what_stands_about_is_not_on_the_map(make_drive: MakeDrive) -> None:
    drive = make_drive()
    drive.localizer.set_pose(drive.pose)

    def put_box(ranges: np.ndarray) -> None:
        ranges[100:130] = np.minimum(ranges[100:130], 0.7)

    drive.alter = put_box
    estimate = settle(drive)
    assert (estimate.beam_classes[100:130] == NOT_ON_MAP).mean() > 0.9
    assert (estimate.beam_classes[200:] == EXPLAINED).mean() > 0.9
    assert estimate.state == "localized"


def test_a_bed_that_was_moved_beside_the_robot_does_not_pull_it_along() -> None:
    # The bed meets a third of the beams, but is an eighth of what the lidar sees.
    room = np.full((84, 104), OCCUPIED, np.int8)
    room[2:-2, 2:-2] = FREE
    room[2:8, 60:90] = OCCUPIED
    beside, moved = room.copy(), room.copy()
    beside[30:66, 2:18] = OCCUPIED
    moved[22:58, 10:26] = OCCUPIED
    known, true = (GridMap("room", 0.05, Pose2D.identity(), cells) for cells in (beside, moved))
    drive = Drive(true, Localizer(known, [], LocalizerConfig(), 0), Pose2D(1.7, 2.0, 0.3))
    drive.localizer.set_pose(drive.pose)
    for _ in range(5):
        estimate = drive.scan(wz=0.2)
        assert drive.error_m(estimate) < 0.1
    assert estimate.state == "localized"


def test_the_same_seed_gives_the_same_bytes(make_drive: MakeDrive) -> None:
    results = []
    for _ in range(2):
        drive = make_drive(seed=5)
        drive.localizer.set_pose(drive.pose @ Pose2D(0.2, 0.1, 0.1))
        settle(drive)
        poses, weights = drive.localizer.particles()
        results.append((poses.tobytes(), weights.tobytes(), drive.scan().map_T_base))
    assert results[0] == results[1]


def test_alike_rooms_are_told_apart_only_by_going_on(flat: GridMap) -> None:
    # Two rooms that are exactly alike, joined by a corridor that only one end of has a niche.
    cells = np.full((64, 204), 100, np.int8)
    cells[2:42, 2:82] = 0
    cells[2:42, 122:202] = 0
    cells[30:36, 82:122] = 0
    cells[36:62, 96:100] = 0
    twins = GridMap("twins", 0.05, Pose2D(0.0, 0.0, 0.0), cells)
    drive = Drive(twins, Localizer(twins, [], LocalizerConfig(), 0), Pose2D(1.5, 1.0, 0.0))
    for _ in range(5):
        estimate = drive.scan()
    assert estimate.state == "searching"
    assert estimate.wants_turn
    assert len(estimate.candidates) >= 2
    assert min(c.map_T_base.distance_to(drive.pose) for c in estimate.candidates) < 0.1


def test_a_robot_with_a_scan_a_second_finds_itself_while_it_drives(
    make_drive: Callable[..., Drive],
) -> None:
    """Each search is older than 0.5 m by the next scan."""
    drive = make_drive()

    def furnish(ranges: np.ndarray) -> None:
        ranges[::4] *= 0.6  # so that one view does not prove it

    drive.alter = furnish
    said = [drive.scan(vx=0.6, wz=1.0, seconds=1.0) for _ in range(12)]
    assert said[0].state != "localized"
    assert said[-1].state == "localized"
    assert drive.error_m(said[-1]) < 0.1


def restart_base(drive: Drive) -> None:
    """Let base begin a new run, where the robot stands."""
    drive.localizer.restart_odometry()
    drive.odom = Pose2D.identity()
    drive.stamp_ns += 5_000_000_000


def test_a_search_from_before_a_restart_of_base_is_made_again(make_drive: MakeDrive) -> None:
    drive = make_drive()
    drive.odom = Pose2D(3.0, 2.0, 1.0)
    drive.localizer.step(make_scan(drive.grid, drive.pose, drive.odom, drive.stamp_ns))
    job = drive.localizer.take_job()
    assert job is not None
    restart_base(drive)
    drive.localizer.step(make_scan(drive.grid, drive.pose, drive.odom, drive.stamp_ns))
    drive.localizer.finish(job.run())
    estimates = [drive.scan() for _ in range(5)]
    assert estimates[-1].state == "localized"
    assert max(drive.error_m(one) for one in estimates if one.map_T_base is not None) < 0.06


def test_a_robot_that_is_searched_for_stays_in_place_when_base_restarts(
    make_drive: MakeDrive,
) -> None:
    drive = make_drive(2.5, 5.0, 0.4)
    for _ in range(10):
        drive.scan(0.3, 0.1)
    drive.localizer.search()
    drive.alter = lambda ranges: ranges.fill(1.2)  # nothing of it fits
    drive.scan()
    restart_base(drive)
    estimates = [drive.scan() for _ in range(5)]
    assert {one.state for one in estimates} == {"searching"}
    assert max(drive.error_m(one) for one in estimates) < 0.06
