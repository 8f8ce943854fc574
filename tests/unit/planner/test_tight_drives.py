"""Driving where there is little room: half a view, doors, walls, and what is odd about them."""

import math

import msgspec
import numpy as np
import pytest
from bench.planner.home import scene_of
from bench.planner.situations import STATIC
from bench.planner.visit import Setting, drive
from numpy.typing import NDArray
from support.all_poses import box
from support.flatland import Flatland, HalfBlind, Masked, empty_room, two_rooms, with_block
from support.maneuvers import DT_S, SHORT_M, led_by

from trolley import codes
from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D, angle_difference
from trolley.gridmap import GridMap
from trolley.messages import Robot, Zone
from trolley_planner.control.controller import limits_of
from trolley_planner.costmap.fine_grid import FINE, FineGrid
from trolley_planner.driving.maneuver_follower import ManeuverFollower
from trolley_planner.paths.hybrid_astar.footprint_spans import TURN_RAD
from trolley_planner.paths.hybrid_astar.motion_primitives import (
    BACKWARDS,
    FORWARDS,
    TURNING,
    Maneuver,
)
from trolley_planner.paths.hybrid_astar.search_space import IN_SIGHT, OUT_OF_SIGHT

HOBBY = box(0.35, 0.30, 0.175)
ARM = box(0.65, 0.30, 0.175)
"""Reaches 0.3 m farther ahead of its wheels than the first."""


def test_a_turn_needs_its_clearance_where_the_robot_stands() -> None:
    yaws = np.linspace(0.0, 2.0, 20)
    poses = np.column_stack([np.full(20, 3.0), np.full(20, 1.0), yaws])
    follower = ManeuverFollower(Maneuver(poses, np.full(20, TURNING, np.int8)), SHORT_M)
    beside = follower.poses_from(Pose2D(3.01, 0.99, 0.0), 0.5)
    assert np.allclose(beside, np.column_stack([np.full(20, 3.01), np.full(20, 0.99), yaws]))


def test_a_robot_beside_its_line_needs_clearance_where_it_steers_back() -> None:
    x = np.linspace(0.0, 1.0, 41)
    line = np.column_stack([x, np.zeros(41), np.zeros(41)])
    follower = ManeuverFollower(Maneuver(line, np.full(41, FORWARDS, dtype=np.int8)), SHORT_M)
    off = follower.poses_from(Pose2D(0.0, -0.02, 0.1), 0.9) - line[:37]
    assert np.allclose(off[0], (0.0, -0.02, 0.1))
    assert (np.diff(np.abs(off[:, 1:]), axis=0) < 0.0).all()
    assert np.abs(off[-1]).max() < 0.001


def poses_of(led: list[tuple[Pose2D, Twist2D]]) -> NDArray[np.float64]:
    """The poses (n, 3)."""
    return np.array([(pose.x, pose.y, pose.yaw) for pose, _ in led])


def test_what_is_foreseen_of_a_robot_beside_its_line_is_what_it_does() -> None:
    x = np.linspace(0.0, 2.0, 81)
    line = np.column_stack([x, np.zeros(81), np.zeros(81)])
    for aside_m, off in ((0.0, 0.1), (-0.02, 0.1), (0.03, 0.0)):
        follower = ManeuverFollower(Maneuver(line, np.full(81, FORWARDS, dtype=np.int8)), SHORT_M)
        start = Pose2D(0.0, aside_m, off)
        foreseen = follower.poses_from(start, 0.8)
        driven = poses_of(led_by(follower, start, limits_of(PlannerConfig(), 0.1, 1.5, 1.0)))
        for axis, most in ((1, 0.003), (2, 0.02)):
            there = np.interp(foreseen[:, 0], driven[:, 0], driven[:, axis])
            assert np.abs(there - foreseen[:, axis]).max() < most


@pytest.mark.parametrize("sense", [FORWARDS, BACKWARDS])
def test_a_long_robot_that_creeps_turns_where_its_maneuver_does(sense: int) -> None:
    """A front 0.65 m ahead is aside by that much of what its heading errs."""
    yaws = TURN_RAD * np.repeat([0.0, 1.0, 2.0], 8)  # as the search finds them
    steps = 0.0375 * sense * np.column_stack([np.cos(yaws), np.sin(yaws)])
    poses = np.column_stack([np.cumsum(steps, axis=0), yaws])
    motions = np.full(len(poses), sense, dtype=np.int8)
    follower = ManeuverFollower(Maneuver(poses, motions), reach_m=0.68)
    limits = limits_of(PlannerConfig(), 0.1, 1.5, 1.0)
    driven = poses_of(led_by(follower, Pose2D(*poses[0].tolist()), limits, delay=1))
    along = np.hypot(*(poses[:, :2] - poses[0, :2]).T)
    wanted = np.interp(np.hypot(*(driven[:, :2] - poses[0, :2]).T), along, yaws)
    assert 0.65 * np.abs(driven[:, 2] - wanted).max() < 0.025
    assert len(driven) < 300


@pytest.mark.parametrize(("reach_m", "most_rad"), [(0.23, 0.035), (0.7, 0.013)])
def test_the_farther_a_robot_reaches_the_more_exactly_it_turns(
    reach_m: float, most_rad: float
) -> None:
    yaws = np.concatenate([np.linspace(0.0, 1.0, 11), np.full(20, 1.0)])
    places = np.concatenate([np.zeros((11, 2)), np.outer(np.linspace(0.0, 0.5, 20), (0.54, 0.84))])
    motions = np.repeat([TURNING, FORWARDS], [11, 20]).astype(np.int8)
    follower = ManeuverFollower(Maneuver(np.column_stack([places, yaws]), motions), reach_m=reach_m)
    limits = limits_of(PlannerConfig(), 0.5, 1.5, 1.0)
    driven = poses_of(led_by(follower, Pose2D(0.0, 0.0, 0.0), limits))
    is_moving = np.hypot(driven[:, 0], driven[:, 1]) > 0.01
    assert abs(driven[np.argmax(is_moving), 2] - 1.0) < most_rad


def lane(width_m: float) -> GridMap:
    """A room, and a dead end to its right along y = 3."""
    below = with_block(empty_room(), 4.5, 0.1, 3.4, 2.9 - width_m / 2.0)
    return with_block(below, 4.5, 3.0 + width_m / 2.0, 3.4, 2.9 - width_m / 2.0)


@pytest.mark.drives
def test_half_blind_it_leaves_a_dead_end_as_it_came_however_long_it_stood_there(ride) -> None:
    world = HalfBlind(
        lane(0.4), Pose2D(3.0, 3.0, 0.0), footprint=HOBBY, base_T_laser=Pose2D(0.05, 0.0, 0.0)
    )
    drive = ride(world)
    drive.send(Pose2D(5.5, 3.0, 0.0))
    assert drive.until_over(30.0).state == "arrived"
    drive.step(20 * 30)
    drive.send(Pose2D(2.5, 3.4, 1.0))
    status = drive.until_over(60.0)
    assert status.state == "arrived"
    assert status.recoveries == 0
    assert world.touches == 0


@pytest.mark.drives
def test_half_blind_it_says_so_where_it_has_stood_too_long_to_back_out(ride) -> None:
    """Nothing is in the way, but somebody may have put something behind it."""
    world = HalfBlind(lane(0.4), Pose2D(5.5, 3.0, 0.0), footprint=HOBBY)
    drive = ride(world)
    drive.step(20 * 10)
    drive.send(Pose2D(2.5, 3.4, 1.0))
    status = drive.until_over(200.0)
    assert (status.state, status.reason) == ("failed", codes.BLIND)
    assert status.message == (
        "The lidar has not seen for long what is behind the robot, and it has no room to turn: "
        "drive it out by hand."
    )
    assert world.touches == 0


@pytest.mark.drives
def test_half_blind_it_turns_exactly_on_the_spot_to_what_lies_behind_it(ride) -> None:
    # `base` lets its sides come to floor that was not seen at 1 cm/s only while it drives as well.
    drive = ride(HalfBlind(empty_room(), Pose2D(4.0, 3.0, 0.2), footprint=HOBBY))
    drive.send(Pose2D(2.0, 3.0, 0.0))
    first = len(drive.commands)
    drive.step(16)
    turning = [twist for twist in drive.commands[first:] if abs(twist.wz) > 0.4]
    assert len(turning) > 8
    assert {twist.vx for twist in turning} == {0.0}


@pytest.mark.drives
@pytest.mark.parametrize("kind", [HalfBlind, Masked])
def test_half_blind_it_knows_that_it_will_not_see_what_it_backs_over(
    ride, kind: type[Flatland]
) -> None:
    # `base` lets it creep there only: 13 s backwards into a dead end that it may turn in instead.
    drive = ride(kind(empty_room(), Pose2D(3.0, 3.0, 0.0), footprint=HOBBY))
    drive.step(4)
    context = drive.navigator.costmap_manager.context
    grid = FineGrid(context.costmap, FINE.finest_m, 1.0)
    grid.update((0, 0), context.costmap.shape)
    known_floor, here = context.local_costmap.known_floor, context.costmap.to_grid(drive.world.pose)
    known = known_floor.in_fine_cells(grid, (0, 0), here)

    def seen_at(ahead_m: float) -> int:
        return int(known[round(here.y / grid.fine_m), round((here.x + ahead_m) / grid.fine_m)])

    assert seen_at(0.4) == IN_SIGHT
    assert seen_at(1.0) == OUT_OF_SIGHT


@pytest.mark.drives
def test_what_reaches_far_ahead_of_the_wheels_comes_through_a_door(ride) -> None:
    drive = ride(Flatland(two_rooms(0.45), Pose2D(2.6, 2.0, 2.0), footprint=ARM))
    drive.send(Pose2D(5.5, 3.6, 0.5))
    status = drive.until_over(40.0)
    assert (status.state, status.recoveries) == ("arrived", 0)
    assert drive.world.touches == 0


class Fast(Flatland):
    """A robot that may drive at 1 m/s."""

    def robot(self) -> Robot:
        return msgspec.structs.replace(super().robot(), max_speed=1.0)


@pytest.mark.drives
@pytest.mark.parametrize("start", [Pose2D(2.6, 2.0, 2.0), Pose2D(1.2, 3.6, 0.0)])
def test_a_fast_robot_comes_through_a_door_hardly_wider_than_itself(ride, start: Pose2D) -> None:
    drive = ride(Fast(two_rooms(0.35), start, footprint=HOBBY), PlannerConfig(max_speed_mps=1.0))
    drive.send(Pose2D(6.5, 3.4, 0.5))
    status = drive.until_over(40.0)
    assert (status.state, status.recoveries) == ("arrived", 0)
    assert drive.world.touches == 0
    assert max(twist.vx for twist in drive.commands if twist is not None) > 0.8


@pytest.mark.drives
@pytest.mark.parametrize("yaw", [0.0, math.pi])
def test_a_goal_in_a_door_is_driven_to_and_left(ride, yaw: float) -> None:
    drive = ride(Flatland(two_rooms(0.5), Pose2D(2.6, 2.2, 0.5), footprint=HOBBY))
    goal = Pose2D(4.0, 3.0, yaw)
    drive.send(goal)
    assert drive.until_over(40.0).state == "arrived"
    assert drive.world.pose.distance_to(goal) < 0.06
    drive.send(Pose2D(5.5, 3.6, 0.5))
    assert drive.until_over(40.0).state == "arrived"
    assert drive.world.touches == 0


@pytest.mark.slow
@pytest.mark.drives
def test_a_goal_that_furniture_was_moved_onto_is_not_driven_to_and_named(ride) -> None:
    start, goal = Pose2D(3.0, 3.0, 0.0), Pose2D(5.5, 3.0, 0.0)
    moved = with_block(empty_room(), 5.2, 2.7, 0.6, 0.6)
    drive = ride(Flatland(empty_room(), start, truth=moved, footprint=HOBBY))
    drive.send(goal)
    status = drive.until_over(120.0)
    assert (status.state, status.reason) == ("failed", codes.BLOCKED)
    assert "on the goal" in status.message
    # Once round it, and 20 s in which it may go away.
    assert drive.now_ns < 40e9
    assert drive.world.touches == 0


@pytest.mark.drives
def test_beside_furniture_that_was_moved_the_nearest_free_place_will_do(ride) -> None:
    start, goal = Pose2D(3.0, 3.0, 0.0), Pose2D(5.5, 3.0, 0.0)
    moved = with_block(empty_room(), 5.6, 2.7, 0.6, 0.6)
    drive = ride(Flatland(empty_room(), start, truth=moved, footprint=HOBBY))
    drive.send(goal, xy_tolerance=0.4)
    assert drive.until_over(60.0).state == "arrived"
    assert drive.world.pose.distance_to(goal) <= 0.4
    assert drive.world.touches == 0


@pytest.mark.drives
@pytest.mark.parametrize("front_m", [5.20, 5.15])
def test_before_a_thing_that_reaches_a_little_into_the_goal_the_robot_stops_short(
    ride, front_m: float
) -> None:
    start, goal = Pose2D(3.0, 3.0, 0.0), Pose2D(5.0, 3.0, 0.0)
    moved = with_block(empty_room(), front_m, 2.7, 0.3, 0.6)
    drive = ride(Flatland(empty_room(), start, truth=moved, footprint=HOBBY))
    drive.send(goal)
    assert drive.until_over(60.0).state == "arrived"
    assert drive.world.pose.distance_to(goal) <= 0.05
    assert drive.now_ns < 10e9
    assert drive.world.touches == 0


@pytest.mark.drives
@pytest.mark.parametrize(
    "seed", [1, 2, 3, 4, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (0, 5))]
)
def test_a_thing_on_or_beside_the_goal_is_stopped_at_or_named(ride, seed: int) -> None:
    rng = np.random.default_rng(seed)
    goal = Pose2D(5.0, 3.0, float(rng.uniform(-math.pi, math.pi)))
    side = float(rng.uniform(-math.pi, math.pi))
    reach_m = float(rng.uniform(0.1, 0.25))  # from the goal to the thing's middle on this side
    x, y = goal.x + reach_m * math.cos(side), goal.y + reach_m * math.sin(side)
    width, height = rng.uniform(0.2, 0.6, 2).tolist()
    corner_x = x - (0.0 if math.cos(side) > 0.5 else width if math.cos(side) < -0.5 else width / 2)
    corner_y = y - (
        0.0 if math.sin(side) > 0.5 else height if math.sin(side) < -0.5 else height / 2
    )
    moved = with_block(empty_room(), corner_x, corner_y, width, height)
    drive = ride(Flatland(empty_room(), Pose2D(2.0, 3.0, 0.0), truth=moved, footprint=HOBBY))
    drive.send(goal, xy_tolerance=float(rng.choice([0.05, 0.1, 0.3])))
    status = drive.until_over(60.0)
    assert status.state == "arrived" or "on the goal" in status.message
    assert drive.now_ns < 50e9


@pytest.mark.drives
def test_inside_what_is_hollow_and_was_moved_the_nearest_free_place_outside_will_do(ride) -> None:
    start, goal = Pose2D(3.0, 3.0, 0.0), Pose2D(5.5, 3.0, 0.0)
    moved = empty_room()
    for x, y, width, height in (
        (5.0, 2.5, 1.0, 0.1),
        (5.0, 3.4, 1.0, 0.1),
        (5.0, 2.5, 0.1, 1.0),
        (5.9, 2.5, 0.1, 1.0),
    ):
        moved = with_block(moved, x, y, width, height)
    drive = ride(Flatland(empty_room(), start, truth=moved, footprint=HOBBY))
    drive.send(goal, xy_tolerance=0.9)
    assert drive.until_over(60.0).state == "arrived"
    assert drive.world.pose.distance_to(goal) <= 0.9
    assert drive.world.touches == 0


@pytest.mark.drives
def test_a_door_that_closes_on_the_robot_hits_nothing_and_lets_it_out(ride) -> None:
    world = Flatland(two_rooms(0.6), Pose2D(2.6, 3.0, 0.0), footprint=HOBBY)
    drive = ride(world)
    drive.send(Pose2D(5.5, 3.0, 0.0))
    while world.pose.x < 3.85:
        drive.step()
    # It swings against the robot's side, and stays ajar.
    world.set_truth(with_block(two_rooms(0.6), 3.95, 3.2, 0.5, 0.1))
    status = drive.until_over(60.0)
    assert status.state == "arrived"
    assert world.touches == 0


@pytest.mark.drives
@pytest.mark.parametrize(("x", "yaw"), [(5.0, 0.0), (4.0, math.pi)])
def test_it_comes_to_stand_beside_a_wall_as_it_was_asked_to(ride, x: float, yaw: float) -> None:
    goal = Pose2D(x, 0.1 + 0.15 + 0.03, yaw)
    drive = ride(Flatland(empty_room(), Pose2D(4.4, 1.3, 2.0), footprint=HOBBY))
    drive.send(goal, xy_tolerance=0.04, yaw_tolerance=0.05)
    assert drive.until_over(40.0).state == "arrived"
    assert drive.world.pose.distance_to(goal) <= 0.045
    assert abs(angle_difference(drive.world.pose.yaw, goal.yaw)) <= 0.055
    assert drive.world.touches == 0


@pytest.mark.drives
@pytest.mark.parametrize(("kind", "is_fast"), [(Flatland, True), (HalfBlind, False)])
def test_it_backs_fast_only_where_its_lidar_looks(ride, kind, is_fast: bool) -> None:
    world = kind(empty_room(3.2, 3.2), Pose2D(1.43, 1.30, 2.07), footprint=HOBBY)
    drive = ride(world)
    drive.send(Pose2D(1.46, 0.29, math.pi), xy_tolerance=0.05, yaw_tolerance=0.05)
    fastest = 0.0
    while drive.navigator.current.board.is_active:
        drive.step()
        fastest = min(fastest, world.twist.vx)
    assert drive.navigator.current.board.state == "arrived"
    assert (fastest < -0.3) == is_fast
    assert world.touches == 0


@pytest.mark.drives
def test_where_it_can_just_turn_it_does_not_feel_its_way_around_step_by_step() -> None:
    # The controller keeps 3 cm, of which rims of walls and noise leave none while it turns.
    row = next(row for row in STATIC if row.name == "dead end 0.55, from its end")
    scene = scene_of(row, 3014, is_off_grid=True, is_turned=True)
    visit = drive(scene, 3014, Setting(localizes=True))
    assert visit.is_success
    assert visit.seconds < 2.0 * scene.ideal_s()


@pytest.mark.drives
def test_where_it_was_asked_to_stand_beside_a_wall_it_does_not_leave_to_come_back() -> None:
    # While it turns by the last degree, noise has the wall 1 cm within where it stands.
    row = next(row for row in STATIC if row.name == "2-5 cm beside a wall")
    scene = scene_of(row, 6000, is_off_grid=True, is_turned=True)
    visit = drive(scene, 6000, Setting(localizes=True))
    assert (visit.ending, visit.recoveries) == ("arrived", 0)


class HeldBehind(Flatland):
    """Its base lets it back nowhere, as if nobody had seen the floor there."""

    def drive(self, twist: Twist2D, dt: float) -> None:
        super().drive(Twist2D.zero() if twist.vx < 0.0 else twist, dt)


@pytest.mark.drives
def test_held_where_it_would_back_it_turns_instead(ride) -> None:
    world = HeldBehind(lane(0.5), Pose2D(5.5, 3.0, 0.0), footprint=HOBBY)
    drive = ride(world)
    drive.send(Pose2D(4.0, 3.0, math.pi), xy_tolerance=0.05, yaw_tolerance=0.05)
    assert drive.until_over(40.0).state == "arrived"
    assert world.touches == 0


@pytest.mark.drives
def test_from_a_wall_it_comes_to_a_goal_nearby_already_looking_as_it_was_asked_to(ride) -> None:
    goal = Pose2D(3.6, 1.5, -1.2)
    drive = ride(Flatland(empty_room(), Pose2D(5.0, 0.1 + 0.15 + 0.03, 0.0), footprint=HOBBY))
    drive.send(goal, xy_tolerance=0.05, yaw_tolerance=0.05)
    # Forwards, then a turn by 110 degrees, takes half as long again.
    assert drive.until_over(8.0).state == "arrived"
    assert drive.world.touches == 0


@pytest.mark.parametrize("delay", [0, 2])
def test_a_way_that_bends_to_and_fro_is_kept_to_although_turning_takes_time(delay: int) -> None:
    step_m = 0.02
    bends = np.repeat([0.0, 1.0 / 0.3, -1.0 / 0.3, 0.0], [20, 18, 18, 15])
    yaw = np.append(0.0, np.cumsum(bends * step_m))
    middle = 0.5 * (yaw[1:] + yaw[:-1])
    x, y = (np.append(0.0, np.cumsum(step_m * part(middle))) for part in (np.cos, np.sin))
    motions = np.full(len(yaw), FORWARDS, dtype=np.int8)
    follower = ManeuverFollower(Maneuver(np.stack([x, y, yaw], axis=1), motions), SHORT_M)
    limits = limits_of(PlannerConfig(), speed=0.5, turn=1.5, deceleration=1.0)
    led = led_by(follower, Pose2D(0.0, 0.0, 0.0), limits, Twist2D(0.5, 0.0, 0.0), delay)
    assert led[-1][0].distance_to(follower.end) < 0.03
    assert max(float(np.hypot(x - pose.x, y - pose.y).min()) for pose, _ in led) < 0.03


@pytest.mark.parametrize("delay", [0, 2])
def test_a_turn_that_a_line_follows_takes_as_long_as_the_robot_brakes(delay: int) -> None:
    turn = 1.5
    yaws, along = np.linspace(0.0, turn, 16), np.linspace(0.0, 0.8, 33)[1:]
    line = np.stack([along * math.cos(turn), along * math.sin(turn), np.full(32, turn)], axis=1)
    poses = np.concatenate([np.stack([0.0 * yaws, 0.0 * yaws, yaws], axis=1), line])
    motions = np.repeat(np.array([TURNING, FORWARDS], dtype=np.int8), [16, 32])
    follower = ManeuverFollower(Maneuver(poses, motions), SHORT_M)
    limits = limits_of(PlannerConfig(), speed=0.5, turn=1.5, deceleration=1.0)
    turned_s, worst = 0.0, 0.0
    for pose, wanted in led_by(follower, Pose2D(0.0, 0.0, 0.0), limits, delay=delay)[1:]:
        turned_s += DT_S if wanted.vx == 0.0 and pose.distance_to(follower.end) > 0.7 else 0.0
        worst = max(worst, abs(pose.y * math.cos(turn) - pose.x * math.sin(turn)))
        if pose.distance_to(follower.end) < 0.05:
            break
    rate, change = limits.max_turn, limits.turn_acceleration
    assert turned_s < turn / rate + rate / change + 0.2
    assert worst < 0.015
    assert abs(pose.yaw - turn) < 0.03


@pytest.mark.parametrize(
    ("x", "y", "warning"),
    [(4.0, 3.0, codes.IN_PASSAGE), (2.5, 3.0, ""), (3.7, 1.5, ""), (7.6, 0.4, "")],
)
def test_who_is_sent_into_a_doorway_is_warned(ride, x: float, y: float, warning: str) -> None:
    drive = ride(Flatland(two_rooms(0.8), Pose2D(2.6, 2.2, 0.5), footprint=HOBBY))
    status = drive.send(Pose2D(x, y, 0.0))
    assert (status.state, status.warning) == ("driving", warning)


def test_a_way_is_given_up_where_the_robot_does_not_get_on_whatever_it_is_told() -> None:
    x = np.linspace(0.0, 1.0, 41)
    poses = np.stack([x, np.zeros(41), np.zeros(41)], axis=1)
    follower = ManeuverFollower(Maneuver(poses, np.full(41, FORWARDS, dtype=np.int8)), SHORT_M)
    drives = [follower.is_stalled(Pose2D(0.005 * step, 0.0, 0.0), 0.05) for step in range(60)]
    stands = [follower.is_stalled(Pose2D(0.3, 0.0, 0.0), 0.05) for _ in range(60)]
    assert not any(drives)
    assert stands[-1]


def test_nobody_looked_at_the_floor_beside_where_the_robot_stands(ride) -> None:
    world = HalfBlind(empty_room(), Pose2D(3.0, 3.0, 0.0), footprint=HOBBY)
    drive = ride(world)
    drive.step(10)
    layer = drive.navigator.costmap_manager.require_context().costmap.obstacle_layer
    under, behind, nothing = (np.array(cols, dtype=np.int64) for cols in ([58], [55], []))
    for cols, known in ((under, [True]), (behind, [False]), (nothing, [])):
        rows = np.full(len(cols), 60)
        assert layer.is_known_free(rows, cols, 15.0).tolist() == known


@pytest.mark.parametrize(("yaw", "looks_there"), [(0.0, True), (math.pi, False)])
def test_a_wall_that_nobody_looks_at_stands_where_the_map_has_it(
    ride, yaw: float, looks_there: bool
) -> None:
    # By the map its face is at x = 4, and a little farther by what the lidar sees.
    grid, truth = (with_block(empty_room(), x, 2.0, 0.5, 2.0) for x in (4.0, 4.05))
    drive = ride(HalfBlind(grid, Pose2D(3.6, 3.0, yaw), truth=truth))
    drive.step(10)
    fine = FineGrid(drive.navigator.costmap_manager.require_context().costmap, FINE.finest_m, 1.0)
    fine.update((50, 70), (20, 20))
    row, col = round(0.5 / fine.fine_m), round(0.5 / fine.fine_m)
    stands = np.all(fine.mask[row - 8 : row + 8, col : col + 6], axis=0)
    assert stands[:3].any() != looks_there
    assert stands[:3].all() != looks_there
    assert stands[4:].all()


@pytest.mark.parametrize("lies", ["behind glass", "in a keep-out zone"])
def test_neither_glass_nor_a_keep_out_zone_is_opened_by_what_is_seen_in_it(ride, lies: str) -> None:
    is_glass = lies == "behind glass"
    grid = with_block(empty_room(), 4.0, 2.0, 0.05 if is_glass else 0.5, 2.0)
    truth = with_block(empty_room(), 4.1 if is_glass else 4.05, 2.0, 0.5, 2.0)
    around = [(3.9, 1.9), (4.2, 1.9), (4.2, 4.1), (3.9, 4.1)]
    zones = [Zone(name="no", kind="keepout", points=around)] if lies == "in a keep-out zone" else []
    drive = ride(Flatland(grid, Pose2D(3.6, 3.0, 0.0), truth=truth, zones=zones))
    drive.step(10)
    fine = FineGrid(drive.navigator.costmap_manager.require_context().costmap, FINE.finest_m, 1.0)
    fine.update((50, 70), (20, 20))
    row, col = round(0.5 / fine.fine_m), round(0.5 / fine.fine_m)
    assert fine.mask[row - 8 : row + 8, col + 1 : col + 3].all()


@pytest.mark.parametrize("end", [4.3, 7.9])
def test_what_the_map_has_deeper_than_its_errors_stands_though_the_lidar_sees_past_it(
    ride, end: float
) -> None:
    # Such as a shelf before a wall that was drawn on the map since it is lower than the lidar.
    grid, truth = (with_block(empty_room(), x, 2.0, end - x, 2.0) for x in (4.0, 4.2))
    drive = ride(Flatland(grid, Pose2D(3.6, 3.0, 0.0), truth=truth))
    drive.step(10)
    fine = FineGrid(drive.navigator.costmap_manager.require_context().costmap, FINE.finest_m, 1.0)
    fine.update((50, 70), (20, 20))
    row, col = round(0.5 / fine.fine_m), round(0.5 / fine.fine_m)
    assert fine.mask[row - 8 : row + 8, col + 1 : col + 15].all()


@pytest.mark.drives
@pytest.mark.parametrize(
    ("situation", "seed"),
    [
        # Its pose is 4 cm off, towards the wall that it looks at.
        ("dead end 0.55, from its end", 1100),
        # The goal lies behind it, beside a wall whose rim is nearer on the map than it is.
        ("2-5 cm beside a wall", 1111),
    ],
)
def test_half_blind_it_comes_out_of_and_to_places_that_the_map_has_too_narrow(
    situation: str, seed: int
) -> None:
    row = next(row for row in STATIC if row.name == situation)
    scene = scene_of(row, seed, is_off_grid=True, is_turned=True)
    visit = drive(scene, seed, Setting("180", False, True, "tracks"))
    assert (visit.ending, visit.touched) == ("arrived", 0)
