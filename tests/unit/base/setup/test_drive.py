"""Simulated robots measure themselves, or say what is wrong."""

import math
import random
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Literal

import numpy as np
import pytest
from bench.base.setup import ASSUMED_TRACK_M, FOOTPRINT, OddRobot, RandomRobot, draw, wrongs
from bench.base.setup import Tried as Set

from trolley.geometry import Pose2D, Twist2D, angle_difference
from trolley.gridmap import FREE, OCCUPIED, GridMap
from trolley_base.setup.clearance import PARAMS as CLEARANCE
from trolley_base.setup.drive import PARAMS as DRIVE
from trolley_base.setup.drive import SetupDrive
from trolley_base.setup.findings import evaluate, picture_of
from trolley_base.setup.gyro import Gyro
from trolley_base.setup.sight import Sector
from trolley_base.setup.wheels import WheelTrial
from trolley_base.world import RobotBody, Simulation, decode_world
from trolley_base.world.faulty_wheels import BOTH, Trouble

pytestmark = pytest.mark.drives

MOUNT = Pose2D(-0.09, 0.04, 2.8)
WORLD = """
map = "hall.yaml"
start = { x = 0.0, y = 0.0, yaw = 0.0 }
[wheels]
track_m = 0.22
left_scale = 1.05
right_scale = 0.96
turn_scale = 1.1
scale_std = 0.0
turn_scale_std = 0.0
slip_per_m = 0.0
yaw_slip_per_m = 0.0
yaw_slip_per_rad = 0.0
[motors]
delay_s = 0.15
dead_band_mps = 0.012
backlash_m = 0.003
[lidar]
rate_hz = 8.0
"""
ROBOT = RandomRobot(
    lidar="",
    spec=draw(random.Random(1)).spec,
    mount=MOUNT,
    left=1.0 / 1.05,
    right=1.0 / 0.96,
    track=1.1,
    delay_s=0.15,
    is_mirrored=True,
    signs=(1, 1),
    is_swapped=False,
    gyro_up=(0, -1),
    gyro_scale=1.01,
    posts=((2.2, 0.15),),
)


@lru_cache
def hall(length_m: float, width_m: float) -> GridMap:
    """A room with an alcove, the origin in its middle."""
    rows, cols = round(width_m / 0.05) + 4, round(length_m / 0.05) + 4
    cells = np.full((rows, cols), OCCUPIED, dtype=np.int8)
    cells[2:-2, 2:-2] = FREE
    if width_m > 3.0:
        cells[2:22, 2:18] = OCCUPIED
    return GridMap("hall", 0.05, Pose2D(-0.025 * cols, -0.025 * rows, 0.0), cells)


def odd_robot(
    robot: RandomRobot = ROBOT, grid: GridMap | None = None, more: str = "", world: str = WORLD
) -> OddRobot:
    body = RobotBody(FOOTPRINT, robot.mount)
    spec = decode_world(world + more, "test")
    simulation = Simulation(spec, hall(5.0, 4.0) if grid is None else grid, body, 5)
    return OddRobot(robot, simulation, np.random.default_rng(1))


def drive_with(
    odd: OddRobot,
    own: list[Sector] | None = None,
    before: Callable[[SetupDrive], None] = lambda drive: None,
    driving_s: float = 0.0,
) -> SetupDrive:
    """Drive the short course to its end."""
    ((direction, _),) = ROBOT.posts
    # As the lidar is believed to turn.
    post = (-direction - 0.15, -direction + 0.15)
    own = [post] if own is None else own
    drive = SetupDrive(FOOTPRINT, 0.5 * ASSUMED_TRACK_M, own, driving_s=driving_s)
    while not drive.has_ended:
        before(drive)
        motions, scans, imu = odd.read()
        odd.drive(drive.step(odd.now_ns, motions, scans, imu))
    return drive


def test_a_robot_measures_how_it_is_built() -> None:
    odd = odd_robot()
    drive = drive_with(odd)
    assert drive.problem is None
    assert odd.simulation.truth().collisions == 0
    findings = evaluate(drive, 0.5 * ASSUMED_TRACK_M)
    geometry = findings.geometry
    assert list(wrongs(Set(ROBOT, findings))) == []
    assert geometry.base_T_laser.distance_to(MOUNT) < 0.005
    assert abs(angle_difference(geometry.yaw.value, MOUNT.yaw)) < math.radians(0.5)
    assert geometry.left.value == pytest.approx(ROBOT.left, rel=0.008)
    assert geometry.right.value == pytest.approx(ROBOT.right, rel=0.008)
    assert geometry.track.value == pytest.approx(ROBOT.track, rel=0.01)
    assert findings.response.delay.value == pytest.approx(ROBOT.delay_s, abs=0.015)
    assert drive.slowest_mps == pytest.approx(0.014)
    assert isinstance(findings.gyro, Gyro)
    assert findings.gyro.scale.value == pytest.approx(ROBOT.gyro_scale, abs=0.01)
    # The mask lies where the post will be once the lidar is known to turn the other way.
    ((first, last),) = findings.own
    assert first < ROBOT.posts[0][0] < last
    # The picture for people shows the walls where they are.
    sight = picture_of(drive, geometry, FOOTPRINT, 0.76)
    walls = odd.simulation.truth().pose.transform_points(np.array(sight.points))
    off = np.minimum(np.abs(np.abs(walls[:, 0]) - 2.5), np.abs(np.abs(walls[:, 1]) - 2.0))
    assert np.mean(off < 0.05) > 0.7  # the rest is the alcove, and the post


def test_a_lidar_that_looks_ahead_only_is_turned_by_less_than_it_sees() -> None:
    view = "field_of_view = 3.14159\nbeams = 180\n"
    late = WORLD.replace("delay_s = 0.15", "delay_s = 0.28")
    drive = drive_with(odd_robot(replace(ROBOT, posts=(), delay_s=0.28), more=view, world=late), [])
    assert drive.problem is None
    geometry = evaluate(drive, 0.5 * ASSUMED_TRACK_M).geometry
    assert geometry.base_T_laser.distance_to(MOUNT) < 0.005
    assert abs(angle_difference(geometry.yaw.value, MOUNT.yaw)) < math.radians(0.5)
    assert geometry.track.value == pytest.approx(ROBOT.track, rel=0.01)


def test_a_robot_that_obeys_late_stays_where_it_has_seen_room() -> None:
    more = "castor_kick_rad = 0.06\ncastor_m = 0.08\n"
    world = WORLD.replace("delay_s = 0.15\n", f"delay_s = 0.28\n{more}")
    odd = odd_robot(replace(ROBOT, delay_s=0.28), world=world)
    away: list[float] = []

    def watch(drive: SetupDrive) -> None:
        away.append(odd.simulation.truth().pose.distance_to(Pose2D.identity()))

    drive = drive_with(odd, before=watch, driving_s=60.0)
    assert drive.problem is None
    assert max(away) < DRIVE.half_stroke_m + 0.5 * CLEARANCE.margin_m


def test_a_stroke_ends_in_time_where_scans_get_lost() -> None:
    world = WORLD.replace("delay_s = 0.15", "delay_s = 0.2")
    more = "[lidar.faults]\nlost_turns = 0.4\n"
    odd = odd_robot(replace(ROBOT, delay_s=0.2), hall(1.55, 1.55), more, world)
    clear_m: list[float] = []
    drive = drive_with(odd, before=lambda _: clear_m.append(odd.simulation.truth().clearance))
    assert drive.problem is None
    assert min(clear_m) > CLEARANCE.margin_m


@pytest.mark.parametrize(
    ("trouble", "words"),
    [
        (Trouble(stuck_encoders=frozenset(("left",))), "encoder of the left wheel"),
        (Trouble(stuck_encoders=frozenset(("right",))), "encoder of the right wheel"),
        (Trouble(stuck_encoders=BOTH), "wheels counted nothing"),
        (Trouble(dead_motors=BOTH), "wheels do not turn"),
        (Trouble(swapped_encoders=True), "swapped, or both encoders count backwards"),
        (Trouble(lifted=True), "not on the floor"),
        (Trouble(factor=4.0), "faster than told"),
    ],
)
def test_what_is_wrong_with_the_wheels_is_said(trouble: Trouble, words: str) -> None:
    odd = odd_robot()
    odd.hardware.chassis.wheels.trouble = trouble
    drive = drive_with(odd)
    assert drive.problem is not None
    assert words in drive.problem
    assert drive.step(odd.now_ns, [], []) == Twist2D.zero()


def test_in_a_plain_corridor_nothing_is_measured() -> None:
    drive = drive_with(odd_robot(grid=hall(40.0, 1.8)))
    assert drive.problem is not None
    assert "corridor" in drive.problem


def test_who_walks_around_the_robot_is_asked_to_keep_away() -> None:
    person = """
[[person]]
path = [[0.6, -0.8], [0.6, 0.8], [-0.6, 0.8], [-0.6, -0.8]]
loop = true
speed_mps = 0.5
radius_m = 0.25
stops_for_robot_m = 0.0
"""
    odd = odd_robot(more=person)
    drive = drive_with(odd)
    assert drive.problem is not None
    assert "Something moves around" in drive.problem or "nearer than it may be" in drive.problem
    assert all(command.twist.vx == 0.0 for command in drive.record.commands)


def test_a_robot_that_is_carried_away_says_so() -> None:
    odd = odd_robot()

    def carry(drive: SetupDrive) -> None:
        if drive.step_name == "turn 3 of 8" and odd.simulation.truth().pose.x < 0.5:
            odd.simulation.lift_robot(Pose2D(1.2, 0.8, 1.0))

    drive = drive_with(odd, before=carry)
    assert drive.problem is not None
    assert "carried" in drive.problem or "somebody moved" in drive.problem


def test_without_room_it_does_not_move() -> None:
    box = """
[[box]]
x = 0.33
y = 0.0
length_m = 0.1
width_m = 0.3
"""
    odd = odd_robot(more=box)
    drive = drive_with(odd)
    assert drive.problem is not None
    assert "more room" in drive.problem
    assert odd.way_m < 0.001


def test_it_turns_but_does_not_drive_where_strokes_have_no_room() -> None:
    box = """
[[box]]
x = 0.0
y = 0.58
length_m = 0.3
width_m = 0.1
"""
    odd = odd_robot(more=box)
    drive = drive_with(odd)
    assert drive.problem is not None
    assert "all round" in drive.problem or "nearer than it may be" in drive.problem
    assert odd.simulation.truth().collisions == 0
    assert all(command.twist.vx == 0.0 for command in drive.record.commands)


def test_what_was_wrongly_called_a_part_of_the_robot_is_found_out() -> None:
    # The post is forgotten, and a direction named in which there is none.
    odd = odd_robot(replace(ROBOT, posts=()))
    drive = drive_with(odd, own=[(1.0, 1.3)])
    assert drive.problem is not None
    assert "did not turn with the robot" in drive.problem


def test_a_board_that_falls_silent_ends_it() -> None:
    odd = odd_robot()
    drive = SetupDrive(FOOTPRINT, 0.5 * ASSUMED_TRACK_M)
    while not drive.has_ended:
        _, scans, _ = odd.read()
        assert drive.step(odd.now_ns, [], scans) == Twist2D.zero()
    assert drive.problem == "The motor board has fallen silent."


@pytest.mark.parametrize("way", ["ahead", "left"])
def test_wheels_are_not_tried_on_a_robot_that_stands_on_the_floor(
    way: Literal["ahead", "left"],
) -> None:
    odd = odd_robot(replace(ROBOT, posts=()), hall(8.0, 4.0))
    trial = WheelTrial(way, 0.5 * ASSUMED_TRACK_M)
    while not trial.has_ended:
        motions, scans, _ = odd.read()
        odd.drive(trial.step(odd.now_ns, motions, scans))
    assert trial.problem is not None
    assert "Lift it" in trial.problem
    assert odd.simulation.truth().pose.distance_to(Pose2D.identity()) < 0.2


@pytest.mark.slow
def test_a_robot_that_gets_stuck_on_its_circle_says_so() -> None:
    odd = odd_robot()

    def lift(drive: SetupDrive) -> None:
        if drive.step_name.startswith("circles"):
            odd.hardware.chassis.wheels.trouble = Trouble(lifted=True)

    drive = drive_with(odd, before=lift, driving_s=100.0)
    assert drive.problem is not None
    assert "the wheels turn, but the lidar sees no motion" in drive.problem


def test_a_robot_whose_lidar_freezes_does_not_drive_on_blindly() -> None:
    odd = odd_robot()
    drive = SetupDrive(FOOTPRINT, 0.5 * ASSUMED_TRACK_M, [(-2.35, -2.05)], driving_s=0.0)
    picture, frozen_at_m = None, 0.0
    while not drive.has_ended:
        motions, scans, imu = odd.read()
        if picture is not None:
            scans = [replace(scan, ranges=picture) for scan in scans]
        elif "stroke 3" in drive.step_name and scans and odd.simulation.truth().twist.vx > 0.1:
            picture, frozen_at_m = scans[-1].ranges, odd.way_m
        odd.drive(drive.step(odd.now_ns, motions, scans, imu))
    assert "the lidar sees no motion" in (drive.problem or "")
    assert odd.way_m - frozen_at_m < 0.4


@pytest.mark.slow
def test_who_steps_onto_the_circle_is_not_touched() -> None:
    person = """
[[person]]
path = [[1.6, 0.2], [0.4, 0.2]]
starts_s = 84.0
speed_mps = 0.6
dwell_s = 60.0
radius_m = 0.15
stops_for_robot_m = 0.3
"""
    late = WORLD.replace("delay_s = 0.15", "delay_s = 0.3")
    odd = odd_robot(more=person, world=late)
    drive = drive_with(odd, driving_s=100.0)
    assert drive.step_name.startswith("circles")
    assert drive.problem is not None
    assert "nearer than it may be" in drive.problem
    assert odd.simulation.truth().clearance > 0.08


@pytest.mark.slow
def test_a_lidar_behind_the_axle_that_looks_back_through_two_posts_is_measured() -> None:
    posts = ((0.6, 0.16), (-0.5, 0.13))
    robot = replace(ROBOT, mount=Pose2D(-0.1, 0.02, 3.1), is_mirrored=False, posts=posts)
    odd = odd_robot(robot)
    own = [(direction - 0.15, direction + 0.15) for direction, _ in posts]
    drive = drive_with(odd, own)
    assert drive.problem is None
    findings = evaluate(drive, 0.5 * ASSUMED_TRACK_M)
    assert list(wrongs(Set(robot, findings))) == []
    assert findings.geometry.base_T_laser.distance_to(robot.mount) < 0.005
    assert abs(angle_difference(findings.geometry.yaw.value, 3.1)) < math.radians(0.5)
    for (first, last), (direction, _) in zip(findings.own, sorted(posts), strict=True):
        assert first < direction < last


@pytest.mark.slow
def test_on_a_carpet_that_pulls_to_the_left_it_stays_where_it_has_seen_room() -> None:
    carpet = """
[[rug]]
x = 0.0
y = 0.0
length_m = 5.0
width_m = 4.0
slip = 0.05
pull_per_m = 0.06
"""
    odd = odd_robot(more=carpet)
    drive = drive_with(odd, driving_s=100.0)
    assert drive.problem is None
    assert odd.simulation.truth().clearance > 0.3
    geometry = evaluate(drive, 0.5 * ASSUMED_TRACK_M).geometry
    assert geometry.base_T_laser.distance_to(MOUNT) < 0.01
    assert abs(angle_difference(geometry.yaw.value, MOUNT.yaw)) < math.radians(0.5)
    # What the carpet takes is a part of what a metre counted is worth there.
    assert geometry.linear.value == pytest.approx(0.95 * 0.5 * (ROBOT.left + ROBOT.right), rel=0.01)
