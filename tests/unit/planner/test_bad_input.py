"""Maps, outlines, scans and poses that make no sense: a refusal or a stop, each with its reason."""

import math

import msgspec
import numpy as np
import pytest
from support.flatland import Flatland, empty_room, scan_message, with_block

from trolley import codes
from trolley.codes import Refused
from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D
from trolley.gridmap import UNKNOWN, GridMap
from trolley.messages import OccupancyGrid, PoseEstimate, Scan, Zone
from trolley.messages.request_params import SendGoal
from trolley.messages.types import floats_from_bytes, floats_to_bytes

START = Pose2D(1.0, 3.0, 0.0)
CROSSED = [(0.2, 0.2), (-0.2, -0.2), (-0.2, 0.2), (0.2, -0.2)]
BESIDE = [(0.3, 0.1), (0.1, 0.1), (0.1, -0.1), (0.3, -0.1)]


def refused(ride, pose: Pose2D) -> Refused:
    with pytest.raises(Refused) as refusal:
        ride.navigator.requests.send(SendGoal(pose=pose), "x", ride.now_ns)
    assert ride.navigator.current.board.state == "idle"
    ride.step(20)
    assert ride.commands[-1] is None
    return refusal.value


def map_of(cells: np.ndarray) -> OccupancyGrid:
    grid = GridMap(empty_room().name, 0.05, Pose2D.identity(), cells.astype(np.int8))
    return Flatland(grid, START).map()


@pytest.mark.parametrize("value", [0, 100, UNKNOWN])
def test_on_a_map_of_one_cell_no_goal_is_taken(ride, value: int) -> None:
    drive = ride(Flatland(empty_room(), START))
    drive.navigator.inputs.map = map_of(np.full((1, 1), value))
    drive.step(4)
    assert refused(drive, Pose2D(0.02, 0.02, 0.0)).code == codes.OUTSIDE_MAP
    assert refused(drive, START).code == codes.OUTSIDE_MAP
    assert all(grid is not None for grid in drive.navigator.costmaps(drive.now_ns))


def test_on_a_map_of_nothing_known_no_goal_is_taken(ride) -> None:
    drive = ride(Flatland(empty_room(), START))
    drive.navigator.inputs.map = map_of(np.full((120, 160), UNKNOWN))
    drive.step(4)
    refusal = refused(drive, Pose2D(3.0, 3.0, 0.0))
    assert refusal.code == codes.IN_OBSTACLE
    assert "does not show" in refusal.message


@pytest.mark.parametrize("outline", [CROSSED, BESIDE, [(0.1, 0.0), (-0.1, 0.0), (0.2, 0.0)]])
def test_an_outline_that_is_none_is_named(ride, outline) -> None:
    drive = ride(Flatland(empty_room(), START))
    inputs = drive.navigator.inputs
    inputs.robot = msgspec.structs.replace(inputs.robot, footprint=outline)
    drive.step(4)
    refusal = refused(drive, Pose2D(3.0, 3.0, 0.0))
    assert refusal.code == codes.NOT_READY
    assert "footprint" in refusal.message


def test_an_outline_that_becomes_none_ends_the_goal(ride) -> None:
    drive = ride(Flatland(empty_room(), START))
    drive.send(Pose2D(5.0, 3.0, 0.0))
    drive.step(20)
    inputs = drive.navigator.inputs
    inputs.robot = msgspec.structs.replace(inputs.robot, footprint=CROSSED)
    drive.step(4)
    status = drive.navigator.current.status(drive.now_ns)
    assert (status.state, status.reason) == ("failed", codes.NOT_READY)
    assert "footprint" in status.message
    drive.step(20)
    assert drive.world.twist.is_zero


def test_with_an_outline_that_is_none_nothing_turns_to_look_round(ride) -> None:
    drive = ride(Flatland(empty_room(), START), PlannerConfig(turn_to_find=True))
    inputs = drive.navigator.inputs
    inputs.robot = msgspec.structs.replace(inputs.robot, footprint=BESIDE)
    drive.pose_state = "lost"
    plain = drive.world.estimate
    drive.world.estimate = lambda *given: msgspec.structs.replace(plain(*given), wants_turn=True)
    drive.step(20)
    assert drive.commands[-1] is None


class LostWorld(Flatland):
    """The localizer asks for a turn to find itself."""

    def estimate(
        self, stamp_ns: int, state: str = "localized", off_map: float | None = None
    ) -> PoseEstimate:
        return msgspec.structs.replace(super().estimate(stamp_ns, state, off_map), wants_turn=True)


class HeldWorld(LostWorld):
    """And the robot does not turn."""

    def drive(self, twist: Twist2D, dt: float) -> None:
        pass


@pytest.mark.parametrize("turns", [True, False])
def test_a_look_round_ends_whether_the_robot_turns_or_not(ride, turns: bool) -> None:
    world = (LostWorld if turns else HeldWorld)(empty_room(), START)
    drive = ride(world, PlannerConfig(turn_to_find=True))
    drive.pose_state = "lost"
    drive.step(20 * 30)
    rates = [0.0 if one is None else one.wz for one in drive.commands]
    seconds = sum(rate > 0.0 for rate in rates) / 20
    assert seconds > 8.0 if turns else 0.0 < seconds < 2.0
    assert rates[-1] == 0.0


@pytest.mark.parametrize(("x", "turns"), [(-0.1, True), (-0.2, False)])
def test_what_the_lidar_sees_of_the_robot_itself_leaves_room_to_look_round(
    ride, x: float, turns: bool
) -> None:
    world = LostWorld(empty_room(), START)
    post = world.base_T_laser.inverse() @ Pose2D(x, 0.05, 0.0)
    plain = world.scan

    def scan(stamp_ns: int) -> Scan:
        seen = plain(stamp_ns)
        ranges = floats_from_bytes(seen.ranges).copy()
        angle = math.atan2(post.y, post.x) - seen.angle_min
        ranges[round(angle / seen.angle_increment) % len(ranges)] = math.hypot(post.x, post.y)
        return msgspec.structs.replace(seen, ranges=floats_to_bytes(ranges))

    world.scan = scan
    drive = ride(world, PlannerConfig(turn_to_find=True))
    drive.pose_state = "lost"
    drive.step(40)
    assert any(one is not None and one.wz > 0.0 for one in drive.commands) == turns


def test_a_lidar_that_sees_nothing_far_and_wide_lets_it_drive(ride) -> None:
    world = Flatland(empty_room(), START)
    drive = ride(world, PlannerConfig(frame="odom"))
    world.scan = lambda stamp_ns: scan_message(np.full(360, np.inf), stamp_ns)
    goal = world.odom_T_base @ Pose2D(3.0, 0.0, 0.0)
    drive.navigator.requests.send(SendGoal(pose=goal), "x", drive.now_ns)
    assert drive.until_over().state == "arrived"


@pytest.mark.parametrize(
    "ranges", [np.zeros(360), np.full(360, math.nan), np.full(360, -1.0), np.zeros(0)]
)
def test_a_lidar_that_says_nothing_stops_the_robot(ride, ranges: np.ndarray) -> None:
    world = Flatland(empty_room(), START)
    drive = ride(world, PlannerConfig(give_up_s=5.0))
    drive.send(Pose2D(6.0, 3.0, 0.0))
    drive.step(40)
    seen = world.scan

    def blind(stamp_ns: int) -> Scan:
        return msgspec.structs.replace(seen(stamp_ns), ranges=floats_to_bytes(ranges))

    world.scan = blind
    drive.step(16)
    assert world.twist.is_zero
    status = drive.navigator.current.status(drive.now_ns)
    assert (status.state, status.reason) == ("recovering", codes.SCAN_LOST)
    world.scan = seen
    drive.step(20)
    assert drive.navigator.current.board.state == "driving"
    world.scan = blind
    status = drive.until_over(20.0)
    assert (status.state, status.reason) == ("failed", codes.SCAN_LOST)


def jump(drive, by: Pose2D) -> None:
    """From now on the localizer says that the robot is elsewhere."""
    world = drive.world
    plain = type(world).correction
    world.correction = lambda stamp_ns: msgspec.structs.replace(
        plain(world, stamp_ns), pose=by @ plain(world, stamp_ns).pose
    )


@pytest.mark.parametrize(
    ("by", "reason"),
    [
        (Pose2D(-20.0, 3.0, 0.4), codes.OUTSIDE_MAP),
        (Pose2D(1e6, -1e6, 0.0), codes.OUTSIDE_MAP),
        (Pose2D(3.3, 0.0, 0.0), codes.LOST),
    ],
)
def test_a_pose_that_jumps_off_the_map_or_into_a_wall_ends_the_goal(
    ride, by: Pose2D, reason: str
) -> None:
    world = Flatland(with_block(empty_room(), 4.5, 1.0, 2.5, 4.0), START)
    world.set_truth(empty_room())
    drive = ride(world, PlannerConfig(give_up_s=10.0))
    drive.send(Pose2D(2.5, 5.3, 0.0))
    drive.step(30)
    jump(drive, by)
    drive.step(12)
    assert world.twist.is_zero
    status = drive.until_over(60.0)
    assert (status.state, status.reason) == ("failed", reason)
    assert status.message
    assert world.touches == 0


def test_a_speed_zone_of_an_absurd_speed_limits_nothing_and_ends_nothing(ride) -> None:
    around = [(-9.0, -9.0), (9.0, -9.0), (9.0, 9.0), (-9.0, 9.0)]
    zone = Zone(name="fast", kind="speed", points=around, speed=1e308)
    world = Flatland(empty_room(), START, zones=[zone])
    drive = ride(world)
    drive.send(Pose2D(4.0, 3.0, 0.0))
    drive.step(40)
    assert world.twist.vx == pytest.approx(0.5, abs=0.05)


def cropped(low_y: float, high_y: float) -> OccupancyGrid:
    """A strip of the room, whose floor is free up to where the map ends."""
    room = empty_room()
    rows = slice(round(low_y / room.resolution), round(high_y / room.resolution))
    strip = GridMap(room.name, room.resolution, Pose2D(0.0, low_y, 0.0), room.cells[rows].copy())
    return Flatland(strip, START).map()


@pytest.mark.parametrize("controller", ["mppi", "pursuit"])
def test_the_robot_does_not_drive_around_a_thing_over_the_end_of_the_map(ride, controller) -> None:
    world = Flatland(empty_room(), START, truth=with_block(empty_room(), 3.9, 1.5, 0.3, 2.5))
    drive = ride(world, PlannerConfig(controller=controller, give_up_s=10.0))
    drive.navigator.inputs.map = cropped(2.0, 4.0)
    drive.send(Pose2D(6.5, 3.0, 0.0))
    highest = START.y
    for _ in range(600):
        drive.step()
        highest = max(highest, world.pose.transform_points(np.array(world.footprint))[:, 1].max())
    assert highest < 4.03  # three quarters of a cell


def test_a_place_where_the_robot_would_reach_over_the_end_of_the_map_is_refused(ride) -> None:
    long = [(0.6, 0.2), (-0.1, 0.2), (-0.1, -0.2), (0.6, -0.2)]
    drive = ride(Flatland(empty_room(), START, footprint=long))
    drive.navigator.inputs.map = cropped(2.0, 4.0)
    drive.step(4)
    assert refused(drive, Pose2D(5.0, 3.7, math.pi / 2)).code == codes.IN_OBSTACLE
    drive.send(Pose2D(5.0, 3.2, math.pi / 2))


@pytest.mark.parametrize("unknown_is_free", [True, False])
def test_the_floor_beyond_the_end_of_the_map_is_known_where_the_unknown_is_free(
    ride, unknown_is_free: bool
) -> None:
    facing_in = Pose2D(2.0, 3.8, -math.pi / 2)
    drive = ride(Flatland(empty_room(), facing_in), PlannerConfig(unknown_is_free=unknown_is_free))
    drive.navigator.inputs.map = cropped(2.0, 4.0)
    drive.step(10)
    context = drive.navigator.costmap_manager.require_context()
    here = context.costmap.to_grid(drive.navigator.inputs.base_pose())
    assert context.local_costmap.known_floor.sees_behind(here) == unknown_is_free
