"""What the robot does when it makes no progress."""

import math
from dataclasses import replace

import msgspec
import pytest
from support.all_poses import box
from support.flatland import Flatland, empty_room, two_rooms, with_block

from trolley import codes
from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D
from trolley.gridmap import GridMap
from trolley.messages import Zone
from trolley_planner.driving import route
from trolley_planner.driving.recovery import RECOVERY_SEQUENCE, Recovery, RecoveryAction
from trolley_planner.driving.route import ROUTE

START = Pose2D(1.0, 3.0, 0.0)
SECOND_NS = 1_000_000_000


pytestmark = pytest.mark.drives


def two_doors() -> GridMap:
    """Two rooms with a door in the middle and one at the top, which is a detour."""
    rooms = two_rooms()
    cells = rooms.cells.copy()
    cells[96:114, 79:81] = 0
    return GridMap(rooms.name, rooms.resolution, rooms.origin, cells)


def test_a_door_that_is_blocked_for_a_while_is_waited_for(ride) -> None:
    world = Flatland(two_rooms(), START)
    world.set_truth(with_block(two_rooms(), 3.9, 2.5, 0.2, 1.0))
    drive = ride(world)
    drive.send(Pose2D(6.0, 3.0, 0.0))
    drive.until(lambda: drive.navigator.current.board.state == "recovering")
    status = drive.navigator.current.status(drive.now_ns)
    assert status.reason == codes.BLOCKED
    assert status.blocked
    assert "wait" in status.message
    world.set_truth(two_rooms())
    assert drive.until_over().state == "arrived"
    assert world.touches == 0


def test_at_a_door_that_is_narrower_than_the_map_says_it_looks_from_close_by(ride) -> None:
    world = Flatland(two_rooms(0.4), START)
    lower = with_block(two_rooms(0.4), 3.95, 2.8, 0.1, 0.1)
    world.set_truth(with_block(lower, 3.95, 3.15, 0.1, 0.05))  # 0.25 m are left
    drive = ride(world)
    drive.send(Pose2D(6.0, 3.0, 0.0))
    drive.until(lambda: drive.navigator.current.board.state == "recovering")
    assert world.pose.distance_to(Pose2D(4.0, 3.0, 0.0)) < 0.8


def test_a_slow_computer_is_not_busy_with_looking_for_a_way_past_what_blocks_the_door(ride) -> None:
    world = Flatland(two_rooms(), Pose2D(2.0, 2.6, 0.0), footprint=box(0.35, 0.30, 0.175))
    drive = ride(world)
    drive.send(Pose2D(6.0, 3.0, 0.0))
    drive.step(40)
    world.set_truth(with_block(two_rooms(), 3.9, 2.5, 0.2, 0.6))  # 0.30 m are left, as it is wide
    drive.until(lambda: drive.navigator.current.board.state == "recovering")
    search = drive.navigator.costmap_manager.require_context().pose_search
    before = search.num_states
    drive.step(100)
    assert 0 < (search.num_states - before) * ROUTE.rest_per_state_s < 5.0


def test_another_door_that_opens_is_soon_noticed_however_long_the_search_was(
    ride, monkeypatch: pytest.MonkeyPatch
) -> None:
    # As many poses as there are to search among chairs.
    monkeypatch.setattr(route, "ROUTE", replace(ROUTE, rest_per_state_s=1e-3))
    narrow = with_block(two_doors(), 3.9, 2.5, 0.2, 0.6)  # 0.30 m are left, as it is wide
    start, closed = Pose2D(2.0, 2.6, 0.0), with_block(narrow, 3.9, 4.7, 0.2, 0.7)
    world = Flatland(two_doors(), start, closed, footprint=box(0.35, 0.30, 0.175))
    drive = ride(world)
    drive.send(Pose2D(6.0, 3.0, 0.0))
    drive.step(60)
    world.set_truth(narrow)
    drive.until(lambda: world.pose.x > 4.3, 11.0)
    assert world.pose.x > 4.3


def test_a_blocked_way_fails_after_bounded_tries(ride) -> None:
    world = Flatland(two_rooms(), START)
    world.set_truth(with_block(two_rooms(), 3.9, 2.5, 0.2, 1.0))
    drive = ride(world, PlannerConfig(give_up_s=30.0))
    drive.send(Pose2D(6.0, 3.0, 0.0))
    status = drive.until_over(150.0)
    assert (status.state, status.reason) == ("failed", codes.BLOCKED)
    assert status.recoveries >= 4
    assert status.message
    assert world.touches == 0
    drive.step(20)
    assert world.twist.is_zero


@pytest.mark.parametrize("changes", [pytest.param("zones", marks=pytest.mark.slow), "map"])
def test_a_blocked_way_fails_though_map_or_zones_change_again_and_again(ride, changes) -> None:
    drive = ride(Flatland(two_rooms(), START), PlannerConfig(give_up_s=10.0))
    drive.send(Pose2D(6.5, 4.5, 1.5))
    drive.step(20)
    drive.world.set_truth(with_block(two_rooms(), 3.9, 2.4, 0.2, 1.2))
    inputs, counts = drive.navigator.inputs, []
    for edit in range(8):
        corners = [(7.0, 1.0), (7.5, 1.0), (7.5, 1.5 + 0.01 * edit)]
        room = Zone(name="pantry", kind="room", points=corners)
        if changes == "zones":
            inputs.zones = msgspec.structs.replace(inputs.zones, zones=[room])
        else:
            inputs.map = drive.world.map()
        status = drive.until_over(15.0)
        counts.append(status.recoveries)
    assert (status.state, status.reason) == ("failed", codes.BLOCKED)
    assert counts == sorted(counts)


def test_the_other_door_is_taken_when_one_stays_blocked(ride) -> None:
    world = Flatland(two_doors(), START)
    world.set_truth(with_block(two_doors(), 3.9, 2.5, 0.2, 1.0))
    drive = ride(world)
    drive.send(Pose2D(6.0, 3.0, 0.0))
    assert drive.until_over().state == "arrived"
    assert world.touches == 0


def test_a_goal_beside_something_is_met_within_its_tolerance(ride) -> None:
    world = Flatland(empty_room(), START)
    goal = Pose2D(5.0, 3.0, 0.0)
    world.set_truth(with_block(empty_room(), 5.15, 2.8, 0.3, 0.4))
    drive = ride(world)
    drive.send(goal, xy_tolerance=0.2)
    assert drive.until_over().state == "arrived"
    assert world.pose.distance_to(goal) <= 0.2
    assert world.touches == 0


@pytest.mark.slow
def test_a_goal_that_something_stands_on_fails_with_a_reason(ride) -> None:
    world = Flatland(empty_room(), Pose2D(3.0, 3.0, 0.0))
    world.set_truth(with_block(empty_room(), 4.8, 2.8, 0.4, 0.4))
    drive = ride(world, PlannerConfig(give_up_s=12.0))
    drive.send(Pose2D(5.0, 3.0, 0.0))
    status = drive.until_over(200.0)
    assert (status.state, status.reason) == ("failed", codes.BLOCKED)
    assert world.touches == 0


def always(_: RecoveryAction) -> bool:
    return True


def test_tries_rise_begin_anew_after_progress_and_end() -> None:
    recovery = Recovery(PlannerConfig(give_up_s=60.0))
    recovery.update_remaining(5.0)
    begun = [recovery.begin_next(second * SECOND_NS, always) for second in range(7)]
    assert begun == [*RECOVERY_SEQUENCE, RECOVERY_SEQUENCE[-1]]
    recovery.update_remaining(4.0)
    assert recovery.begin_next(100 * SECOND_NS, always) is RECOVERY_SEQUENCE[0]
    assert recovery.begin_next(161 * SECOND_NS, always) is None


def test_tries_without_room_are_left_out() -> None:
    recovery = Recovery(PlannerConfig())
    begun = [recovery.begin_next(0, lambda one: one is RecoveryAction.TURN) for _ in range(4)]
    assert begun == [
        RecoveryAction.WAIT,
        RecoveryAction.CLEAR,
        RecoveryAction.TURN,
        RecoveryAction.WAIT_LONGER,
    ]
    assert recovery.count == 4


def test_a_hold_up_long_ago_does_not_count_behind_a_person_who_walks_on() -> None:
    recovery = Recovery(PlannerConfig(give_up_s=20.0))
    recovery.update_remaining(1.0)
    for hold_up in range(20):
        began_s = 100 * hold_up
        assert recovery.begin_next(began_s * SECOND_NS, always) is RecoveryAction.WAIT
        recovery.end()
        for _ in range(10):  # the person walks on by 1.5 m, and the robot behind them
            recovery.move_goal()
            recovery.update_path_length(1.15)
            recovery.update_remaining(1.0)


def test_a_goal_that_moves_is_no_progress() -> None:
    recovery = Recovery(PlannerConfig(give_up_s=20.0))
    recovery.update_remaining(3.0)
    begun: list[RecoveryAction | None] = []
    for second in range(5):  # the person comes nearer, and goes away again
        begun.append(recovery.begin_next(second * SECOND_NS, always))
        recovery.move_goal()
        recovery.update_path_length(3.0 if second % 2 else 2.0)
        recovery.update_remaining(3.0 if second % 2 else 2.0)
    assert begun == [*RECOVERY_SEQUENCE[:5]]


def test_waits_that_ended_by_themselves_are_not_held_against_the_goal() -> None:
    recovery = Recovery(PlannerConfig(give_up_s=20.0))
    for second in range(0, 80, 4):
        assert recovery.begin_next(second * SECOND_NS, always) is RecoveryAction.WAIT
        recovery.forgive((second + 4) * SECOND_NS)
        assert recovery.current is None
    assert recovery.count == 20
    begun = [recovery.begin_next((80 + 5 * step) * SECOND_NS, always) for step in range(6)]
    assert begun == [*RECOVERY_SEQUENCE[:5], None]


def test_nobody_is_waited_for_without_end() -> None:
    recovery = Recovery(PlannerConfig(give_up_s=20.0))
    for second in range(100):
        assert recovery.begin_next(second * SECOND_NS, always) is not None
        recovery.forgive((second + 1) * SECOND_NS)
    recovery.excuse(1000 * SECOND_NS)
    assert recovery.begin_next(101 * SECOND_NS, always) is None


def test_another_way_is_taken_where_something_unseen_is_in_the_way(ride) -> None:
    class Sill(Flatland):
        """The wheels do not get over a sill in the middle door, which no lidar sees."""

        def drive(self, twist: Twist2D, dt: float) -> None:
            before, odometry = self.pose, self.odom_T_base
            super().drive(twist, dt)
            if 3.75 < self.pose.x < 4.2 and abs(self.pose.y - 3.0) < 0.5:
                self.pose, self.odom_T_base = before, odometry
                self.twist = Twist2D.zero()

    world = Sill(two_doors(), Pose2D(2.5, 3.0, 0.0))
    drive = ride(world, PlannerConfig(progress_s=4.0))
    drive.send(Pose2D(5.0, 4.0, 0.0))
    assert drive.until_over(200.0).state == "arrived"
    told = [status.message for status in drive.statuses if status.state == "recovering"]
    assert any("another route" in message for message in told)
    assert world.touches == 0


def test_a_robot_without_room_neither_backs_up_nor_turns(ride) -> None:
    # A dead end just wider than the robot, which somebody closes behind it.
    lane = with_block(with_block(empty_room(), 2.0, 0.1, 5.9, 2.72), 2.0, 3.18, 5.9, 2.72)
    world = Flatland(lane, START)
    drive = ride(world, PlannerConfig(give_up_s=20.0, patience_s=2.0))
    drive.send(Pose2D(6.0, 3.0, 0.0))
    drive.until(lambda: world.pose.x > 2.6)
    shut = with_block(lane, world.pose.x + 0.6, 2.8, 0.2, 0.4)
    world.set_truth(with_block(shut, world.pose.x - 0.4, 2.8, 0.1, 0.4))
    status = drive.until_over(150.0)
    assert (status.state, status.reason) == ("failed", codes.BLOCKED)
    told = {status.message for status in drive.statuses}
    assert any("keeps waiting" in message for message in told)  # what comes after these two
    assert not any("turns" in message or "another route" in message for message in told)
    assert world.touches == 0


def test_a_goal_without_room_to_turn_is_come_into_straight(ride) -> None:
    corners = [(0.3, 0.2), (-0.3, 0.2), (-0.3, -0.2), (0.3, -0.2)]
    # A niche as wide as the robot and a little more: 0.6 m, where its circle needs 0.72 m.
    niche = with_block(with_block(empty_room(), 6.5, 1.5, 1.5, 1.2), 6.5, 3.3, 1.5, 1.2)
    for heading in (0.0, math.pi):
        drive = ride(Flatland(niche, Pose2D(4.5, 3.0, 1.0), footprint=corners))
        goal = Pose2D(7.2, 3.0, heading)
        drive.send(goal)
        assert drive.until_over().state == "arrived"
        assert drive.world.pose.distance_to(goal) <= 0.05
        assert abs(math.remainder(drive.world.pose.yaw - heading, 2.0 * math.pi)) <= 0.05
        assert drive.world.touches == 0
