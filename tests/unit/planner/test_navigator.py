"""Goals from being sent to being over."""

import dataclasses
import math
from collections.abc import Callable
from functools import partial

import msgspec
import numpy as np
import pytest
from support.flatland import BOX, Flatland, empty_room, two_rooms, with_block

from trolley import codes
from trolley.codes import Refused
from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, wrap_angle
from trolley.messages import BaseState, Zone, Zones
from trolley.messages.request_params import SendGoal, WhichGoal
from trolley_planner.context.planning_context import PlanningContext
from trolley_planner.costmap.footprint import Footprint

MakeRide = Callable[..., "object"]
START = Pose2D(1.0, 3.0, 0.0)


pytestmark = pytest.mark.drives


def errors(ride, goal: Pose2D) -> tuple[float, float]:
    pose = ride.world.pose
    return pose.distance_to(goal), abs(wrap_angle(pose.yaw - goal.yaw))


@pytest.mark.parametrize(
    "goal",
    [
        Pose2D(6.5, 4.5, 2.0),
        Pose2D(6.5, 1.0, -1.0),
        Pose2D(1.0, 3.0, 3.0),
        Pose2D(1.4, 3.0, 0.0),
        Pose2D(0.8, 3.0, 0.0),
    ],
)
def test_a_goal_is_reached_within_its_tolerances(ride, goal: Pose2D) -> None:
    drive = ride(Flatland(two_rooms(), START))
    drive.send(goal)
    status = drive.until_over()
    assert (status.state, status.reason) == ("arrived", "")
    distance, turn = errors(drive, goal)
    assert distance <= 0.05
    assert turn <= 0.05
    assert drive.world.touches == 0
    assert drive.world.twist.is_zero


def test_a_map_may_be_turned_and_fine(ride) -> None:
    room = empty_room(4.0, 3.0, 0.03, Pose2D(-3.0, 7.0, 1.1))
    drive = ride(Flatland(with_block(room, 1.8, 0.9, 0.3, 1.2), Pose2D(0.6, 1.5, 1.0)))
    goal = Pose2D(3.3, 1.5, -2.0)
    drive.send(goal)
    assert drive.until_over().state == "arrived"
    assert errors(drive, goal)[0] <= 0.05
    assert drive.world.touches == 0


def test_it_goes_round_what_is_not_on_the_map(ride) -> None:
    world = Flatland(two_rooms(), START)
    world.set_truth(with_block(two_rooms(), 2.2, 2.4, 0.4, 1.0))
    drive = ride(world)
    goal = Pose2D(3.3, 3.0, 0.0)
    drive.send(goal)
    assert drive.until_over().state == "arrived"
    assert errors(drive, goal)[0] <= 0.05
    assert world.touches == 0


def test_it_knows_what_stands_around_it_as_soon_as_the_map_was_loaded_anew(ride) -> None:
    drive = ride(Flatland(empty_room(), START))
    drive.send(Pose2D(6.0, 3.0, 0.0))
    drive.step(30)
    navigator = drive.navigator
    here = drive.world.pose
    known_m = navigator.current.execution.context.seen_clearance(here, 1.0)
    speed = drive.world.twist.vx
    navigator.inputs.map = msgspec.structs.replace(drive.world.map())
    # Another goal is only looked at: that makes the costmap anew before the next scan comes.
    asked = SendGoal(pose=drive.world.grid.origin @ Pose2D(5.0, 1.0, 0.0))
    navigator.requests.preview(asked, drive.now_ns)
    assert navigator.current.execution.context.seen_clearance(here, 1.0) == pytest.approx(
        known_m, abs=0.05
    )
    twist = navigator.command(drive.now_ns)
    assert twist.vx >= speed > 0.2


def test_where_nothing_was_looked_at_yet_nothing_is_free() -> None:
    footprint = Footprint.from_polygon(BOX)
    context = PlanningContext(empty_room(), footprint, PlannerConfig(), 0.5)
    assert context.seen_clearance(START, 1.0) < 0.0


def test_a_large_robot_passes_a_door_of_80_cm(ride) -> None:
    corners = [(0.3, 0.25), (-0.3, 0.25), (-0.3, -0.25), (0.3, -0.25)]
    drive = ride(Flatland(two_rooms(0.8), START, footprint=corners))
    drive.send(Pose2D(6.5, 4.0, 1.5))
    assert drive.until_over().state == "arrived"
    assert drive.world.touches == 0


def test_any_heading_will_do_where_that_is_asked(ride) -> None:
    drive = ride(Flatland(empty_room(), START))
    drive.send(Pose2D(3.0, 3.0, 3.0), yaw_tolerance=math.pi)
    assert drive.until_over().state == "arrived"
    assert abs(drive.world.pose.yaw) < 0.5


def test_via_points_are_passed_without_stopping(ride) -> None:
    drive = ride(Flatland(empty_room(), START))
    vias = [Pose2D(2.0, 4.5, 0.0), Pose2D(3.5, 1.5, 0.0)]
    drive.send(Pose2D(5.0, 3.0, 0.0), via=vias)
    nearest, slowest = [math.inf, math.inf], [math.inf, math.inf]
    while drive.navigator.current.board.is_active:
        drive.step()
        for index, via in enumerate(vias):
            distance = drive.world.pose.distance_to(via)
            if distance < nearest[index]:
                nearest[index], slowest[index] = distance, drive.world.twist.vx
        assert drive.now_ns < 120e9
    assert drive.navigator.current.board.state == "arrived"
    assert max(nearest) <= 0.3
    assert min(slowest) > 0.1


def test_a_new_goal_replaces_the_old_one_and_says_so_first(ride) -> None:
    drive = ride(Flatland(empty_room(), START))
    drive.send(Pose2D(5.0, 3.0, 0.0), id="first")
    drive.step(20)
    drive.statuses.clear()
    drive.send(Pose2D(1.0, 1.5, 0.0), id="second")
    drive.step()
    told = [(status.id, status.state, status.reason) for status in drive.statuses]
    assert told[:3] == [
        ("first", "canceled", codes.REPLACED),
        ("second", "planning", ""),
        ("second", "driving", ""),
    ]
    assert drive.until_over().id == "second"
    assert drive.navigator.current.board.state == "arrived"
    assert drive.navigator.current.status_of("first", 0).reason == codes.REPLACED


def test_the_same_id_twice_is_one_goal(ride) -> None:
    drive = ride(Flatland(empty_room(), START))
    drive.send(Pose2D(5.0, 3.0, 0.0), id="one")
    drive.step(10)
    again = drive.send(Pose2D(1.0, 1.0, 0.0), id="one")
    assert again.pose == drive.world.grid.origin @ Pose2D(5.0, 3.0, 0.0)
    drive.until_over()
    assert drive.send(Pose2D(1.0, 1.0, 0.0), id="one").state == "arrived"


def test_a_late_cancel_touches_no_newer_goal(ride) -> None:
    drive = ride(Flatland(empty_room(), START))
    drive.send(Pose2D(5.0, 3.0, 0.0), id="old")
    drive.send(Pose2D(3.0, 3.0, 0.0), id="new")
    with pytest.raises(Refused, match="current"):
        drive.navigator.requests.cancel(WhichGoal(id="old"), drive.now_ns)
    assert drive.navigator.current.board.state == "driving"
    assert drive.navigator.requests.cancel(WhichGoal(id="new"), drive.now_ns).state == "canceled"
    with pytest.raises(Refused) as refusal:
        drive.navigator.requests.cancel(WhichGoal(), drive.now_ns)
    assert refusal.value.code == codes.NOT_CURRENT
    assert refusal.value.message == "The robot has no goal now."


def test_only_the_last_32_goals_are_known(ride) -> None:
    drive = ride(Flatland(empty_room(), START))
    for number in range(34):
        drive.send(Pose2D(3.0, 3.0, 0.0), id=f"g-{number}")
    assert drive.navigator.current.status_of("g-1", 0) is None
    assert drive.navigator.current.status_of("g-2", 0).state == "canceled"


def test_a_paused_goal_stands_until_it_is_resumed(ride) -> None:
    drive = ride(Flatland(empty_room(), START))
    drive.send(Pose2D(5.0, 3.0, 0.0))
    drive.step(40)
    assert drive.navigator.requests.pause(WhichGoal(), drive.now_ns).state == "paused"
    drive.step(30)
    assert drive.world.twist.is_zero
    assert drive.commands[-1] is None
    assert drive.navigator.requests.resume(WhichGoal(), drive.now_ns).state == "driving"
    assert drive.until_over().state == "arrived"


@pytest.mark.parametrize(
    ("base", "reason"),
    [
        (
            BaseState(
                stamp_ns=0,
                mode="stopped",
                reason="button",
                message="Stopped. `trolley resume` lets it drive.",
            ),
            codes.STOPPED,
        ),
        (BaseState(stamp_ns=0, mode="fault", reason="bumper"), codes.BUMPER),
        (BaseState(stamp_ns=0, mode="ok", source="teleop"), codes.TAKEN_OVER),
    ],
)
def test_nothing_sets_off_by_itself_after_a_stop_or_a_hand(ride, base, reason) -> None:
    drive = ride(Flatland(empty_room(), START))
    drive.send(Pose2D(5.0, 3.0, 0.0))
    drive.step(40)
    drive.navigator.update_base(base, drive.now_ns)
    drive.navigator.update_base(BaseState(stamp_ns=0, mode="ok"), drive.now_ns)
    drive.step(60)
    status = drive.navigator.current.status(drive.now_ns)
    assert (status.state, status.reason) == ("paused", reason)
    assert status.message
    assert "trolley resume" not in status.message, "base has been resumed already"
    if reason == codes.STOPPED:
        assert "once it may drive again, resume the goal to go on." in status.message
    assert drive.world.twist.is_zero


def test_a_goal_sent_while_a_hand_falls_silent_is_driven(ride) -> None:
    drive = ride(Flatland(empty_room(), START))
    held = BaseState(stamp_ns=0, mode="ok", source="teleop")
    drive.navigator.update_base(held, drive.now_ns)
    drive.send(Pose2D(5.0, 3.0, 0.0))
    drive.step(10)
    drive.navigator.update_base(held, drive.now_ns)
    assert drive.navigator.current.board.state == "driving"
    drive.step(40)
    drive.navigator.update_base(held, drive.now_ns)
    assert drive.navigator.current.board.reason == codes.TAKEN_OVER


def test_a_restart_of_the_base_pauses_the_goal(ride) -> None:
    drive = ride(Flatland(empty_room(), START))
    drive.send(Pose2D(5.0, 3.0, 0.0))
    drive.step(20)
    drive.navigator.begin_epoch(drive.now_ns)
    drive.step(20)
    assert drive.navigator.current.board.reason == codes.RESTARTED
    assert drive.world.twist.is_zero
    drive.navigator.requests.resume(WhichGoal(), drive.now_ns)
    assert drive.until_over().state == "arrived"


@pytest.mark.parametrize("is_paused", [False, True])
def test_a_restart_of_the_base_ends_a_goal_whose_frame_it_takes_away(ride, is_paused: bool) -> None:
    world = Flatland(empty_room(), START)
    drive = ride(world, PlannerConfig(frame="odom"))
    goal = world.odom_T_base @ Pose2D(3.0, 0.0, 0.0)
    drive.navigator.requests.send(SendGoal(pose=goal, frame="odom"), "made", drive.now_ns)
    drive.step(20)
    if is_paused:
        drive.navigator.requests.pause(WhichGoal(), drive.now_ns)
    drive.navigator.begin_epoch(drive.now_ns)
    world.odom_T_base = Pose2D.identity()
    drive.step(20)
    status = drive.navigator.current.status(drive.now_ns)
    assert (status.state, status.reason) == ("failed", codes.RESTARTED)
    assert "send the goal again" in status.message
    assert world.twist.is_zero


def test_a_wait_for_the_pose_is_no_lack_of_progress(ride) -> None:
    drive = ride(Flatland(empty_room(12.0, 6.0), START))
    drive.send(Pose2D(10.0, 3.0, 0.0))
    drive.step(120)
    drive.pose_state = "lost"
    drive.step(20 * 25)
    drive.pose_state = "localized"
    before = len(drive.statuses)
    status = drive.until_over()
    assert (status.state, status.recoveries) == ("arrived", 0)
    assert {one.state for one in drive.statuses[before + 1 :]} <= {"driving", "arrived"}


@pytest.mark.parametrize("state", ["lost", "searching"])
def test_it_stands_while_the_pose_is_lost_and_drives_on_after(ride, state: str) -> None:
    drive = ride(Flatland(empty_room(), START))
    drive.send(Pose2D(5.0, 3.0, 0.0))
    drive.step(40)
    drive.pose_state = state
    drive.step(8)
    assert drive.world.twist.is_zero
    status = drive.navigator.current.status(drive.now_ns)
    assert (status.state, status.reason) == ("recovering", codes.LOST)
    drive.pose_state = "localized"
    assert drive.until_over().state == "arrived"


def test_it_stands_while_pose_and_map_are_of_different_maps_and_drives_on_after(ride) -> None:
    world = Flatland(empty_room(), START)
    drive = ride(world)
    drive.send(Pose2D(5.0, 3.0, 0.0))
    drive.step(40)
    before = world.grid
    world.grid = dataclasses.replace(before, name="upstairs")
    drive.step(8)
    assert world.twist.is_zero
    status = drive.navigator.current.status(drive.now_ns)
    assert (status.state, status.reason) == ("recovering", codes.STALE)
    with pytest.raises(Refused, match="No current pose"):
        drive.send(Pose2D(4.0, 3.0, 0.0))
    world.grid = before
    assert drive.until_over().state == "arrived"


def test_a_pose_that_stays_lost_fails_the_goal(ride) -> None:
    drive = ride(Flatland(empty_room(), START), PlannerConfig(give_up_s=5.0))
    drive.send(Pose2D(5.0, 3.0, 0.0))
    drive.step(20)
    drive.pose_state = "lost"
    status = drive.until_over(20.0)
    assert (status.state, status.reason) == ("failed", codes.LOST)


def test_an_unsure_pose_makes_it_slow(ride) -> None:
    drive = ride(Flatland(empty_room(), START))
    drive.pose_state = "unsure"
    drive.step(2)
    drive.send(Pose2D(5.0, 3.0, 0.0))
    drive.step(60)
    speeds = [twist.vx for twist in drive.commands if twist is not None]
    assert 0.1 < max(speeds) <= 0.15 + 1e-9


def test_the_lowest_of_overlapping_speed_zones_holds(ride) -> None:
    def zone(name: str, left: float, right: float, speed: float) -> Zone:
        corners = [(left, 0.5), (right, 0.5), (right, 5.5), (left, 5.5)]
        return Zone(name=name, kind="speed", points=corners, speed=speed)

    zones = [zone("slow", 2.0, 3.2, 0.2), zone("slower", 2.6, 3.6, 0.1)]
    drive = ride(Flatland(empty_room(), START, zones=zones))
    drive.send(Pose2D(5.5, 3.0, 0.0))
    fastest = {"slow": 0.0, "slower": 0.0, "free": 0.0}
    while drive.navigator.current.board.is_active:
        drive.step()
        x, speed = drive.world.pose.x, drive.world.twist.vx
        # A little inside, since braking begins at the border at the latest.
        where = "slow" if 2.15 < x < 2.55 else "slower" if 2.7 < x < 3.55 else "free"
        fastest[where] = max(fastest[where], speed)
        assert drive.now_ns < 120e9
    assert fastest["slow"] <= 0.21
    assert fastest["slower"] <= 0.11
    assert fastest["free"] > 0.4


def test_the_speed_of_a_goal_holds(ride) -> None:
    drive = ride(Flatland(empty_room(), START))
    drive.send(Pose2D(3.0, 3.0, 0.0), speed=0.2)
    drive.until_over()
    assert 0.15 < max(twist.vx for twist in drive.commands if twist) <= 0.2 + 1e-9


def test_a_keep_out_zone_is_gone_round_and_only_left(ride) -> None:
    corners = [(2.0, 2.0), (4.0, 2.0), (4.0, 4.0), (2.0, 4.0)]
    zone = Zone(name="carpet", kind="keepout", points=corners)
    drive = ride(Flatland(empty_room(), START, zones=[zone]))
    with pytest.raises(Refused) as refusal:
        drive.send(Pose2D(3.0, 3.0, 0.0))
    assert refusal.value.code == codes.KEEPOUT
    assert "carpet" in refusal.value.message
    drive.send(Pose2D(5.5, 3.0, 0.0))
    while drive.navigator.current.board.is_active:
        drive.step()
        pose = drive.world.pose
        assert not (2.0 < pose.x < 4.0 and 2.0 < pose.y < 4.0)
        assert drive.now_ns < 120e9
    assert drive.navigator.current.board.state == "arrived"


def test_a_robot_inside_a_keep_out_zone_leaves_it(ride) -> None:
    corners = [(2.0, 2.0), (4.0, 2.0), (4.0, 4.0), (2.0, 4.0)]
    zone = Zone(name="carpet", kind="keepout", points=corners)
    drive = ride(Flatland(empty_room(), Pose2D(2.3, 3.0, 0.0), zones=[zone]))
    drive.send(Pose2D(5.5, 3.0, 0.0))
    was_out = False
    while drive.navigator.current.board.is_active:
        drive.step()
        pose = drive.world.pose
        is_in = 2.0 < pose.x < 4.0 and 2.0 < pose.y < 4.0
        assert not (was_out and is_in)
        was_out = was_out or not is_in
        assert drive.now_ns < 120e9
    assert drive.navigator.current.board.state == "arrived"


def refused(ride, params: SendGoal) -> Refused:
    with pytest.raises(Refused) as refusal:
        ride.navigator.requests.send(params, "x", ride.now_ns)
    assert ride.navigator.current.board.state == "idle"
    return refusal.value


def test_goals_that_cannot_be_are_refused(ride) -> None:
    walled = with_block(empty_room(), 5.0, 0.0, 0.1, 6.0)
    drive = ride(Flatland(walled, START))

    def code(pose: Pose2D) -> str:
        return refused(drive, SendGoal(pose=drive.world.grid.origin @ pose)).code

    assert code(Pose2D(5.05, 3.0, 0.0)) == codes.IN_OBSTACLE
    assert code(Pose2D(4.9, 3.0, 0.0)) == codes.IN_OBSTACLE
    assert code(Pose2D(20.0, 3.0, 0.0)) == codes.OUTSIDE_MAP
    assert code(Pose2D(-1e9, 3.0, 0.0)) == codes.OUTSIDE_MAP
    assert code(Pose2D(6.5, 3.0, 0.0)) == codes.NO_PATH
    assert refused(drive, SendGoal(pose=START, frame="odom")).code == codes.WRONG_FRAME
    assert refused(drive, SendGoal(name="kitchen")).code == codes.TOUR_NOT_RUNNING


def test_a_via_point_that_cannot_be_is_named(ride) -> None:
    walled = with_block(empty_room(), 5.0, 0.0, 1.0, 6.0)
    drive = ride(Flatland(walled, START))
    origin = drive.world.grid.origin

    def refusal(*vias: Pose2D) -> Refused:
        there = [origin @ via for via in (Pose2D(2.0, 4.5, 0.0), *vias)]
        return refused(drive, SendGoal(pose=origin @ Pose2D(3.0, 3.0, 0.0), via=there))

    for code, via, words in (
        (codes.OUTSIDE_MAP, Pose2D(20.0, 3.0, 0.0), "The {} lies outside the map."),
        (codes.NO_PATH, Pose2D(5.5, 3.0, 0.0), "There is no path to the {} for a robot of this"),
        (codes.NO_PATH, Pose2D(7.0, 3.0, 0.0), "There is no path to the {} for a robot of this"),
    ):
        at = origin @ via
        found = refusal(via)
        assert found.code == code
        assert found.message.startswith(words.format(f"via point at x {at.x:.2f}, y {at.y:.2f}"))


def test_a_door_that_is_too_narrow_is_named(ride) -> None:
    drive = ride(Flatland(two_rooms(0.2), START))
    refusal = refused(drive, SendGoal(pose=drive.world.grid.origin @ Pose2D(6.5, 4.5, 0.0)))
    assert refusal.code == codes.NO_PATH
    [place] = refusal.details["blocked"]
    assert math.dist(place, (4.0, 3.0)) < 0.15
    assert "too narrow at x" in refusal.message


def test_without_any_gap_no_place_is_named(ride) -> None:
    drive = ride(Flatland(with_block(empty_room(), 5.0, 0.0, 0.1, 6.0), START))
    refusal = refused(drive, SendGoal(pose=drive.world.grid.origin @ Pose2D(6.5, 4.5, 0.0)))
    assert refusal.code == codes.NO_PATH
    assert "blocked" not in refusal.details


def test_a_goal_ends_with_the_place_where_its_way_was_closed(ride) -> None:
    drive = ride(Flatland(two_rooms(), START))
    drive.send(Pose2D(6.5, 4.5, 0.0))
    drive.step(20)
    drive.navigator.inputs.map = Flatland(two_rooms(0.2), START).map()
    drive.step(4)
    status = drive.navigator.current.status(drive.now_ns)
    assert (status.state, status.reason) == ("failed", codes.NO_PATH)
    assert math.dist(status.blocked[0], (4.0, 3.0)) < 0.15
    assert "too narrow" in status.message


def test_a_goal_without_a_pose_or_with_the_latch_set_is_refused(ride) -> None:
    drive = ride(Flatland(empty_room(), START))
    params = SendGoal(pose=Pose2D(3.0, 3.0, 0.0))
    drive.navigator.inputs.base = BaseState(stamp_ns=0, mode="stopped")
    assert refused(drive, params).code == codes.STOPPED
    drive.navigator.inputs.base = None
    drive.pose_state = "lost"
    drive.step(2)
    assert refused(drive, params).code == codes.NOT_LOCALIZED


@pytest.mark.parametrize("missing", ["robot", "tf/laser", "scan", "odom", "map", "zones", "pose"])
def test_what_is_missing_is_named(ride, missing: str) -> None:
    drive = ride(Flatland(empty_room(), START))
    attribute = {"tf/laser": "base_T_laser", "odom": "odometry"}.get(missing, missing)
    setattr(drive.navigator.inputs, attribute, None)
    refusal = refused(drive, SendGoal(pose=START))
    assert refusal.code == codes.NOT_READY
    assert refusal.details == {"missing": [missing]}
    assert missing in refusal.message
    assert ("`trolley map new NAME`" in refusal.message) == (missing == "map")


def test_a_preview_tells_way_and_time_and_moves_nothing(ride) -> None:
    drive = ride(Flatland(two_rooms(), START))
    goal = drive.world.grid.origin @ Pose2D(6.5, 4.5, 1.0)
    path = drive.navigator.requests.preview(SendGoal(pose=goal), drive.now_ns)
    poses = np.frombuffer(path.poses, dtype="<f4").reshape(-1, 3)
    assert path.dt > 0.0
    eta = (len(poses) - 1) * path.dt
    assert np.hypot(*(poses[0, :2] - (START.x, START.y))) < 0.05
    assert np.hypot(*(poses[-1, :2] - (goal.x, goal.y))) < 0.05
    assert poses[-1, 2] == pytest.approx(1.0, abs=1e-3)
    drive.step(10)
    assert drive.navigator.current.board.state == "idle"
    assert drive.commands[-1] is None
    began_ns = drive.now_ns
    drive.send(Pose2D(6.5, 4.5, 1.0))
    drive.until_over()
    assert (drive.now_ns - began_ns) * 1e-9 == pytest.approx(eta, rel=0.3)


def test_the_frame_odom_needs_neither_map_nor_pose(ride) -> None:
    world = Flatland(empty_room(), START)
    world.set_truth(with_block(world.grid, 2.5, 2.5, 0.5, 1.0))
    drive = ride(world, PlannerConfig(frame="odom"))
    assert drive.navigator.inputs.missing(has_time=True) == []
    goal = drive.world.odom_T_base @ Pose2D(4.0, 0.0, 0.0)
    drive.navigator.requests.send(SendGoal(pose=goal), "x", drive.now_ns)
    assert drive.until_over().state == "arrived"
    assert world.odom_T_base.distance_to(goal) <= 0.05
    assert world.touches == 0


def test_a_goal_far_ahead_in_the_frame_odom_is_driven_to(ride) -> None:
    config = PlannerConfig(frame="odom", odom_size_m=6.0)
    drive = ride(Flatland(empty_room(), START), config)
    drive.step(5)
    first = drive.navigator.costmap_manager.require_context()
    seen = np.count_nonzero(first.costmap.obstacle_layer.grid.evidence)
    goal = drive.world.odom_T_base @ Pose2D(4.5, 1.0, 0.0)
    assert not first.costmap.contains(*first.costmap.to_grid(goal).as_array()[:2])
    drive.navigator.requests.send(SendGoal(pose=goal), "x", drive.now_ns)
    now = drive.navigator.costmap_manager.require_context()
    assert np.count_nonzero(now.costmap.obstacle_layer.grid.evidence) > 0.9 * seen > 0
    assert drive.until_over().state == "arrived"
    assert drive.world.odom_T_base.distance_to(goal) <= 0.05
    assert drive.world.touches == 0


def test_a_goal_too_far_ahead_in_the_frame_odom_is_refused(ride) -> None:
    drive = ride(Flatland(empty_room(), START), PlannerConfig(frame="odom"))
    goal = drive.world.odom_T_base @ Pose2D(500.0, 0.0, 0.0)
    assert refused(drive, SendGoal(pose=goal, frame="odom")).code == codes.OUTSIDE_MAP
    assert drive.navigator.costmap_manager.require_context().grid.size_m == (40.0, 40.0)


def test_another_map_ends_the_goal(ride) -> None:
    drive = ride(Flatland(empty_room(), START))
    drive.send(Pose2D(5.0, 3.0, 0.0))
    drive.step(20)
    import msgspec

    other = msgspec.structs.replace(drive.world.map(), name="other")
    drive.navigator.inputs.map = other
    drive.step(4)
    status = drive.navigator.current.status(drive.now_ns)
    assert (status.state, status.reason) == ("failed", codes.WRONG_MAP)
    assert drive.world.twist.is_zero or drive.commands[-1] is None or drive.commands[-1].is_zero


def test_a_jump_of_the_pose_by_metres_breaks_nothing(ride) -> None:
    drive = ride(Flatland(empty_room(), START))
    drive.send(Pose2D(6.5, 3.0, 0.0))
    drive.step(60)
    jumped = msgspec.structs.replace(
        drive.world.correction(drive.now_ns), pose=Pose2D(3.0, -1.0, 1.5)
    )
    drive.navigator.inputs.update_correction(jumped)
    drive.navigator.command(drive.now_ns + 1)
    assert drive.until_over().state == "arrived"
    assert drive.world.touches == 0


def test_after_a_change_of_map_a_change_of_its_zones_is_not_taken_for_another_map(ride) -> None:
    world = Flatland(empty_room(), START)
    drive = ride(world)
    inputs = drive.navigator.inputs
    world.grid = dataclasses.replace(world.grid, name="upstairs")
    inputs.map = world.map()
    inputs.zones = Zones(stamp_ns=0, map="upstairs", zones=[])
    drive.step(4)
    drive.send(Pose2D(6.0, 3.0, 0.0))
    drive.step(10)
    corners = world.grid.origin.transform_points(np.array([(0.2, 0.2), (0.5, 0.2), (0.5, 0.5)]))
    keepout = Zone(name="corner", kind="keepout", points=[(x, y) for x, y in corners.tolist()])
    inputs.zones = Zones(stamp_ns=0, map="upstairs", zones=[keepout])
    drive.step(10)
    status = drive.navigator.current.status(drive.now_ns)
    assert (status.state, status.message) == ("driving", "")


def test_a_paused_goal_of_another_map_is_not_resumed(ride) -> None:
    drive = ride(Flatland(empty_room(), START))
    navigator, inputs = drive.navigator, drive.navigator.inputs
    drive.send(Pose2D(6.0, 3.0, 0.0))
    drive.step(20)
    navigator.requests.pause(WhichGoal(), drive.now_ns)
    drive.step(20)
    # The scan that would end it has not come yet.
    inputs.map = msgspec.structs.replace(inputs.map, name="upstairs")
    inputs.zones = msgspec.structs.replace(inputs.zones, map="upstairs")
    inputs.pose = msgspec.structs.replace(inputs.pose, map="upstairs")
    with pytest.raises(Refused) as refusal:
        navigator.requests.resume(WhichGoal(), drive.now_ns)
    assert refusal.value.code == codes.NOT_CURRENT
    status = navigator.current.status(drive.now_ns)
    assert (status.state, status.reason) == ("failed", codes.WRONG_MAP)


@pytest.mark.parametrize("asks", ["send", "preview"])
def test_what_is_refused_for_its_distance_leaves_the_goal_in_frame_odom(ride, asks: str) -> None:
    world = Flatland(empty_room(44.0, 6.0), START)
    drive = ride(world, PlannerConfig(frame="odom"))
    requests, way = drive.navigator.requests, world.odom_T_base
    requests.send(SendGoal(pose=way @ Pose2D(38.0, 0.0, 0.0)), "first", drive.now_ns)
    drive.step(4)
    far = SendGoal(pose=way @ Pose2D(100.0, 0.0, 0.0))
    ask = (
        partial(requests.send, far, "second") if asks == "send" else partial(requests.preview, far)
    )
    with pytest.raises(Refused) as refusal:
        ask(drive.now_ns)
    assert refusal.value.code == codes.OUTSIDE_MAP
    drive.step(4)
    status = drive.navigator.current.status(drive.now_ns)
    assert (status.id, status.state) == ("first", "driving")


@pytest.mark.parametrize("tolerance", [3.0, 1e308])
def test_a_goal_that_may_be_missed_by_more_than_its_distance_is_driven_to(
    ride, tolerance: float
) -> None:
    drive = ride(Flatland(empty_room(), START))
    goal = Pose2D(2.2, 3.2, 0.5)
    drive.send(goal, xy_tolerance=tolerance)
    assert drive.until_over(30.0).state == "arrived"
    assert errors(drive, goal)[0] <= 0.3


def test_an_outline_that_changes_with_a_restart_of_base_counts_without_a_map_too(ride) -> None:
    drive = ride(Flatland(empty_room(), START), PlannerConfig(frame="odom"))
    navigator = drive.navigator
    navigator.begin_epoch(drive.now_ns)
    corners = [(0.4, 0.3), (-0.4, 0.3), (-0.4, -0.3), (0.4, -0.3)]
    navigator.inputs.robot = msgspec.structs.replace(navigator.inputs.robot, footprint=corners)
    scan = drive.world.scan(drive.now_ns)
    navigator.update_scan(scan, [], drive.now_ns, drive.now_ns)  # before the first odometry
    drive.step(4)
    assert navigator.costmap_manager.context.footprint.circumscribed_m == pytest.approx(0.5)


def test_where_robot_time_begins_anew_with_base_the_planner_is_silent_and_sees(ride) -> None:
    drive = ride(Flatland(empty_room(), START))
    drive.step(200)
    drive.send(Pose2D(1.6, 3.0, 0.0))
    assert drive.until_over().state == "arrived"
    drive.now_ns = 0
    drive.navigator.begin_epoch(0)
    drive.step(20)
    assert drive.commands[-1] is None
    assert len(drive.navigator.costmap_manager.context.costmap.obstacle_layer.beams) > 0


def test_what_was_seen_stays_when_a_setting_changes_or_the_map_grows(ride) -> None:
    world = Flatland(empty_room(), START)
    world.set_truth(with_block(empty_room(), 3.0, 2.0, 0.3, 0.3))
    drive = ride(world)
    drive.step(20)
    manager = drive.navigator.costmap_manager

    def num_seen() -> int:
        return int((manager.context.costmap.obstacle_layer.grid.evidence > 0).sum())

    before = num_seen()
    assert before > 0
    drive.navigator.set_config(PlannerConfig(patience_s=9.0))
    assert manager.rebuild()
    assert num_seen() == before
    grid = drive.navigator.inputs.map
    cells = np.frombuffer(grid.cells, np.int8).reshape(grid.height, grid.width)
    grown = msgspec.structs.replace(
        grid,
        origin=grid.origin @ Pose2D(-1.0, -0.5, 0.0),
        width=grid.width + 20,
        height=grid.height + 10,
        cells=memoryview(np.pad(cells, ((10, 0), (20, 0)), constant_values=-1).tobytes()),
    )
    drive.navigator.inputs.map = grown
    assert manager.rebuild()
    assert num_seen() == before
    drive.navigator.inputs.map = msgspec.structs.replace(grown, name="another")
    assert manager.rebuild()
    assert num_seen() == 0
