"""`trolley ros2` between a robot and nodes that speak as rmw_zenoh does, over real routers."""

import math
import os
import signal
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh.ext
from support.processes import Process, own_router
from support.ros_node import RosNode, wait_for
from support.waiting import PATIENCE_S, wait_until

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.connection import Connection
from trolley.geometry import Pose2D, Twist2D
from trolley.messages import (
    Clock,
    GoalStatus,
    OccupancyGrid,
    Odometry,
    PoseEstimate,
    Scan,
    Transform,
    VelocityCommand,
    floats_to_bytes,
)
from trolley.messages import (
    Path as RobotPath,
)
from trolley.messages.request_params import SendGoal, SetPose
from trolley.runtime.guest import guest
from trolley.runtime.service import Service, answers, every, on
from trolley.security.access import security_of
from trolley.security.keyring import Keyring
from trolley_ros2 import cdr
from trolley_ros2.published import MOST_FRAMES

pytestmark = [
    pytest.mark.programs,
    pytest.mark.again("a node that is silent for half a second has died"),
]

GEOMETRY = "geometry_msgs/msg"


class Robot(Service):
    """Base, localizer and planner in one, as far as the bridge hears and asks them."""

    name = "base"

    def __init__(self) -> None:
        self.commands: list[VelocityCommand] = []
        self.goals: list[SendGoal] = []
        self.poses: list[SetPose] = []
        self.cells = 0

    def start(self) -> None:
        mount = Transform(stamp_ns=0, parent="base_link", child="laser", pose=Pose2D(0.1, 0, 0))
        self.publish(topics.TF, mount, "laser")
        self.publish(
            topics.PATH,
            RobotPath(stamp_ns=0, frame="map", poses=floats_to_bytes(np.ones((4, 3)))),
        )
        self.publish(topics.COSTMAP, self.grid("odom"))
        self.publish(topics.MAP, self.grid("map"))

    def grid(self, frame: str) -> OccupancyGrid:
        return OccupancyGrid(
            stamp_ns=0,
            name="home",
            frame=frame,
            resolution=0.05,
            width=40,
            height=30,
            origin=Pose2D(-1.0, -1.0, 0.0),
            cells=memoryview(np.full(1200, self.cells, np.int8).tobytes()),
        )

    def change_map(self) -> None:
        """Any other map."""
        self.cells = 100
        self.publish(topics.MAP, self.grid("map"))

    @every(0.1, clock="local")
    def tick(self) -> None:
        stamp_ns = time.monotonic_ns()
        self.publish(topics.CLOCK, Clock(stamp_ns=stamp_ns, rate=1.0, epoch=0))
        at = Pose2D(1.0, 0.0, 0.5)
        self.publish(topics.ODOM, Odometry(stamp_ns=stamp_ns, pose=at, twist=Twist2D.zero()))
        correction = Transform(stamp_ns=stamp_ns, parent="map", child="odom", pose=Pose2D(0, 2, 0))
        self.publish(topics.TF, correction, "odom")
        self.publish(
            topics.SCAN,
            Scan(
                stamp_ns=stamp_ns,
                frame="laser",
                angle_min=-math.pi,
                angle_increment=math.tau / 360,
                time_increment=0.0,
                range_min=0.1,
                range_max=8.0,
                ranges=floats_to_bytes(np.full(360, 2.0)),
            ),
        )
        self.publish(
            topics.POSE,
            PoseEstimate(
                stamp_ns=stamp_ns,
                map="home",
                pose=Pose2D(1.0, 2.0, 0.5),
                covariance=[0.01, 0, 0, 0, 0.01, 0, 0, 0, 0.01],
                state="localized",
                match=0.9,
                spread=0.0,
            ),
        )

    @on(topics.COMMAND, "ros2")
    def drive(self, command: VelocityCommand, _source: str) -> None:
        self.commands.append(command)

    @answers(requests.GOAL_SEND)
    def send(self, params: SendGoal) -> GoalStatus:
        if params.frame != "map":
            raise Refused(codes.WRONG_FRAME, "A goal is in the frame map.")
        self.goals.append(params)
        return GoalStatus(stamp_ns=1, id=params.id, state="planning", pose=params.pose)

    @answers(requests.POSE_SET)
    def set_pose(self, params: SetPose) -> PoseEstimate:
        self.poses.append(params)
        raise Refused(codes.OUTSIDE_MAP, "That is outside the map.")


@pytest.fixture
def robot(endpoint: str) -> Iterator[Robot]:
    service = Robot()
    with guest(service, "one", [endpoint]):
        yield service


Bridge = Callable[..., Process]


@pytest.fixture
def run_bridge(robot: Robot, endpoint: str, tmp_path: Path) -> Iterator[Bridge]:
    """Start `trolley ros2`, and wait until it is there."""
    started: list[Process] = []

    def run(*options: str) -> Process:
        program = "from trolley.start import command; command()"
        arguments = ["-c", program, "ros2", "--connect", endpoint, "--robot", "one", *options]
        process = Process(arguments, tmp_path / f"bridge{len(started)}.log")
        started.append(process)
        wait_until(
            lambda: "ROS 2 nodes see the robot" in process.log or not process.is_running,
            lambda: process.log,
        )
        assert process.is_running, process.log
        return process

    yield run
    for process in started:
        process.kill()


@contextmanager
def ros_node(*arguments: Any, **more: Any) -> Iterator[RosNode]:
    node = RosNode(*arguments, **more)
    try:
        yield node
    finally:
        node.close()


def counters(endpoint: str) -> dict[str, int]:
    """What the bridge counted."""
    with Connection([endpoint]) as connection:
        found = connection.get("one", topics.HEALTH)
    return {
        name: number
        for (service,), health in found.items()
        if service.startswith("ros2-")
        for name, number in health.counters.items()
    }


def twist(vx: float, wz: float = 0.0) -> Any:
    vector = [cdr.make(f"{GEOMETRY}/Vector3", *xyz) for xyz in ((vx, 0.0, 0.0), (0.0, 0.0, wz))]
    return cdr.make(cdr.TWIST, *vector)


def header(frame: str) -> Any:
    now = cdr.make("builtin_interfaces/msg/Time", int(time.time()), 0)
    return cdr.make("std_msgs/msg/Header", now, frame)


def pose(x: float, y: float) -> Any:
    return cdr.make(
        f"{GEOMETRY}/Pose",
        cdr.make(f"{GEOMETRY}/Point", x, y, 0.0),
        cdr.make(f"{GEOMETRY}/Quaternion", 0.0, 0.0, 0.0, 1.0),
    )


def goal(x: float, frame: str = "map") -> Any:
    return cdr.make(cdr.POSE, header(frame), pose(x, 1.0))


@pytest.mark.parametrize(
    ("distro", "mode"), [("jazzy", "peer"), ("humble", "peer"), ("jazzy", "client")]
)
def test_a_node_sees_the_robot_as_it_would_see_nav2(
    run_bridge: Bridge, endpoint: str, distro: str, mode: str
) -> None:
    run_bridge("--distro", distro)
    with ros_node(endpoint, mode=mode, hashes=distro == "jazzy") as node:
        shown = [
            "/one/amcl_pose",
            "/one/cmd_vel",
            "/one/goal_pose",
            "/one/initialpose",
            "/one/local_costmap/costmap",
            "/one/map",
            "/one/odom",
            "/one/plan",
            "/one/scan",
            "/one/tf",
            "/one/tf_static",
        ]
        wait_until(lambda: node.topics() == shown, lambda: f"{node.topics()}")
        assert "NN/%/%one/trolley" in node.graph()
        kept = {"transient_local": True}
        scan = node.subscribe("/one/scan", cdr.LASER_SCAN)
        odom = node.subscribe("/one/odom", cdr.ODOMETRY)
        tree = node.subscribe("/one/tf", cdr.TF_MESSAGE)
        static = node.subscribe("/one/tf_static", cdr.TF_MESSAGE, **kept)
        grid = node.subscribe("/one/map", cdr.OCCUPANCY_GRID, **kept)
        estimate = node.subscribe("/one/amcl_pose", cdr.POSE_WITH_COVARIANCE, **kept)
        plan = node.subscribe("/one/plan", cdr.PATH)
        costmap = node.subscribe("/one/local_costmap/costmap", cdr.OCCUPANCY_GRID, **kept)

        heard = wait_for(scan, "a scan", 3)
        assert len(list(heard.ranges)) == 360
        # Robot time is not the host's: the stamps are.
        assert abs(heard.header.stamp.sec - time.time()) < 60.0
        assert wait_for(odom, "odometry").pose.pose.position.x == 1.0
        wait_until(lambda: tree and len(tree[-1].transforms) == 2, "the tree from map to base_link")
        frames = [(one.header.frame_id, one.child_frame_id) for one in tree[-1].transforms]
        assert frames == [("map", "odom"), ("odom", "base_link")]
        mounts = wait_for(static, "the lidar's place").transforms
        assert [one.child_frame_id for one in mounts] == ["laser"]
        assert (wait_for(grid, "the map").info.width, len(list(grid[-1].data))) == (40, 1200)
        assert wait_for(estimate, "the pose").pose.pose.position.y == 2.0
        assert len(wait_for(plan, "the plan").poses) == 4
        assert wait_for(costmap, "the costmap").header.frame_id == "odom"


def test_who_comes_late_gets_the_map_and_never_one_of_before(
    run_bridge: Bridge, robot: Robot, endpoint: str
) -> None:
    run_bridge()
    with ros_node(endpoint, "first") as first:
        seen = first.subscribe("/one/map", cdr.OCCUPANCY_GRID, transient_local=True)
        wait_for(seen, "the map")
        with ros_node(endpoint, "second") as second:
            wait_for(
                second.subscribe("/one/map", cdr.OCCUPANCY_GRID, transient_local=True),
                "the map, from what is kept: nobody publishes it again",
            )
        assert len(seen) == 1
        key = first.key("/one/map", cdr.OCCUPANCY_GRID)
    wait_until(lambda: not heard(endpoint, key), "nobody listens any more")
    robot.change_map()
    with ros_node(endpoint, "third") as third:
        maps = third.subscribe("/one/map", cdr.OCCUPANCY_GRID, transient_local=True)
        wait_for(maps, "the new map")
        assert {next(iter(one.data)) for one in maps} == {100}


def test_a_program_with_ever_new_frames_does_not_fill_the_tree(
    run_bridge: Bridge, robot: Robot, endpoint: str
) -> None:
    run_bridge()
    for number in range(MOST_FRAMES + 10):
        frame = Transform(
            stamp_ns=0, parent="base_link", child=f"f{number}", pose=Pose2D(0.1, 0, 0)
        )
        robot.call_soon(lambda one=frame: robot.publish(topics.TF, one, one.child))
    with ros_node(endpoint) as node:
        tree = node.subscribe("/one/tf_static", cdr.TF_MESSAGE, transient_local=True)
        wait_until(lambda: "tf_static/too_many" in counters(endpoint), "the rest is counted")
        wait_until(lambda: tree and len(tree[-1].transforms) == MOST_FRAMES, "the others are there")


def heard(endpoint: str, key: str) -> bool:
    """Whether anybody listens to a key."""
    with Connection([endpoint]) as connection:
        publisher = connection.bus.session.declare_publisher(key)
        time.sleep(0.1)  # until the router has told
        status: Any = publisher.matching_status
        return bool(status.matching)


def test_what_no_node_subscribes_to_is_not_even_heard_from_the_robot(
    run_bridge: Bridge, endpoint: str
) -> None:
    run_bridge()
    with ros_node(endpoint) as node:
        assert node.topics()
        assert not heard(endpoint, topics.SCAN.key("one"))
        scans = node.subscribe("/one/scan", cdr.LASER_SCAN)
        wait_for(scans, "a scan")
        wait_until(lambda: heard(endpoint, topics.SCAN.key("one")), "it listens")
        node.unsubscribe()
        wait_until(lambda: not heard(endpoint, topics.SCAN.key("one")), "it listens no more")


def test_a_node_drives_sends_a_goal_and_says_where_the_robot_is(
    run_bridge: Bridge, robot: Robot, endpoint: str
) -> None:
    bridge = run_bridge()
    with ros_node(endpoint, "nav") as node:
        twists = node.advertise("/one/cmd_vel", cdr.TWIST)
        repeat(lambda: twists.publish(twist(0.2, 0.1)), lambda: robot.commands, "a velocity")
        assert robot.commands[0].twist == Twist2D(0.2, 0.0, 0.1)
        assert robot.commands[0].valid_for == 0.5
        stamped = node.advertise("/one/cmd_vel", cdr.TWIST_STAMPED)
        message = cdr.make(cdr.TWIST_STAMPED, header("base_link"), twist(0.3))
        repeat(
            lambda: stamped.publish(message),
            lambda: robot.commands[-1].twist.vx == 0.3,
            "a stamped velocity",
        )
        goals = node.advertise("/one/goal_pose", cdr.POSE)
        repeat(lambda: goals.publish(goal(3.0)), lambda: robot.goals, "a goal")
        assert robot.goals[0].pose == Pose2D(3.0, 1.0, 0.0)
        repeat(
            lambda: goals.publish(goal(3.0, "moon")),
            lambda: "A goal is in the frame map" in bridge.log,
            "the planner's refusal is said",
        )
        poses = node.advertise("/one/initialpose", cdr.POSE_WITH_COVARIANCE)
        covariance = np.zeros(36)
        covariance[[0, 7, 35]] = 0.25, 0.25, 0.07
        inner = cdr.make(f"{GEOMETRY}/PoseWithCovariance", pose(1.0, 2.0), covariance)
        where = cdr.make(cdr.POSE_WITH_COVARIANCE, header("map"), inner)
        repeat(lambda: poses.publish(where), lambda: robot.poses, "a pose")
        assert robot.poses[0] == SetPose(
            pose=Pose2D(1.0, 2.0, 0.0), covariance=[0.25, 0, 0, 0, 0.25, 0, 0, 0, 0.07]
        )
        wait_until(lambda: "That is outside the map" in bridge.log, lambda: bridge.log)


def repeat(publish: Callable[[], None], happened: Callable[[], object], what: str) -> None:
    """Publish as nodes do, until it is heard: nothing is kept for who subscribes late."""

    def has_happened() -> object:
        publish()
        return happened()

    wait_until(has_happened, what)


def test_bad_messages_are_dropped_counted_and_said_and_good_ones_still_obeyed(
    run_bridge: Bridge, robot: Robot, endpoint: str
) -> None:
    bridge = run_bridge()
    with ros_node(endpoint, "odd") as node:
        good = node.advertise("/one/cmd_vel", cdr.TWIST)
        newer = node.advertise("/one/cmd_vel", cdr.TWIST, "RIHS01_" + "ab" * 32)
        other = node.advertise("/one/cmd_vel", "std_msgs/msg/String")
        payload = cdr.write(twist(9.0))
        bad: dict[str, Callable[[], None]] = {
            "not_finite": lambda: good.publish(twist(math.nan)),
            "malformed": lambda: good.put(b"\x00\x01\x00\x00rubbish"),
            "no_attachment": lambda: good.put(payload, attached=False),
            "definition": lambda: newer.publish(twist(9.0)),
            "type": lambda: other.put(b"\x00\x01\x00\x00\x01\x00\x00\x00\x00"),
        }
        for reason, publish in bad.items():
            repeat(publish, lambda reason=reason: f"cmd_vel/{reason}" in counters(endpoint), reason)
        repeat(lambda: good.publish(twist(0.1)), lambda: robot.commands, "a good one is obeyed")
        # Once: where all are late for a second, the sender's clock was set back, and they count.
        good.put(payload, delayed_s=5.0)
        wait_until(lambda: "cmd_vel/late" in counters(endpoint), "what was long on its way")
        assert {one.twist.vx for one in robot.commands} == {0.1}
        assert bridge.log.count("Message of ROS 2 dropped") >= len(bad)
        assert "Traceback" not in bridge.log


def test_of_a_thousand_velocities_a_second_base_gets_fifty_and_the_last_one(
    run_bridge: Bridge, robot: Robot, endpoint: str
) -> None:
    run_bridge()
    with ros_node(endpoint, "flood") as node:
        twists = node.advertise("/one/cmd_vel", cdr.TWIST)
        repeat(lambda: twists.publish(twist(0.2)), lambda: robot.commands, "it is heard")
        moving, began_s = cdr.write(twist(0.2)), time.monotonic()
        for _ in range(3000):
            twists.put(moving)
        # Zenoh may lose any one of a flood.
        still = twist(0.0)
        repeat(
            lambda: twists.publish(still),
            lambda: robot.commands[-1].twist.is_zero,
            "the last one comes",
        )
        lasted_s = time.monotonic() - began_s
        assert len(robot.commands) <= 2 + lasted_s * 50 + 50
        wait_until(lambda: counters(endpoint).get("cmd_vel/flood", 0) > 100, "it is counted")


def test_goals_in_a_flood_do_not_flood_the_planner(
    run_bridge: Bridge, robot: Robot, endpoint: str
) -> None:
    run_bridge()
    with ros_node(endpoint, "flood") as node:
        goals = node.advertise("/one/goal_pose", cdr.POSE)
        began_s = time.monotonic()
        repeat(lambda: goals.publish(goal(3.0)), lambda: robot.goals, "it is heard")
        for _ in range(1000):
            goals.publish(goal(4.0))
        # Behind a flood one may be so late that it is dropped.
        last = Pose2D(5.0, 1.0, 0.0)
        repeat(lambda: goals.publish(goal(5.0)), lambda: robot.goals[-1].pose == last, "it comes")
        assert len(robot.goals) <= 3 + 2 * (time.monotonic() - began_s)


def test_a_node_that_dies_while_it_drives_stops_the_robot(
    run_bridge: Bridge, robot: Robot, endpoint: str
) -> None:
    bridge = run_bridge()

    def has_been_noticed() -> bool:
        node = RosNode(endpoint, "teleop")
        twists = node.advertise("/one/cmd_vel", cdr.TWIST)
        repeat(
            lambda: twists.publish(twist(0.2)),
            lambda: robot.commands and not robot.commands[-1].twist.is_zero,
            "it drives",
        )
        num_before = len(robot.commands)
        is_over = threading.Event()

        def drive() -> None:
            while not is_over.wait(0.05):
                twists.publish(twist(0.2))

        driving = threading.Thread(target=drive)
        driving.start()
        wait_until(lambda: len(robot.commands) > num_before + 2, "it drives")
        is_over.set()
        driving.join()
        node.close()
        gone_s = time.monotonic()
        wait_until(lambda: is_said() or time.monotonic() > gone_s + 2.0, "it is said")
        return is_said()

    def is_said() -> bool:
        return "/teleop, which was driving, is gone" in bridge.log

    # A bridge that hears of it only when the last velocity has lapsed has nothing to stop.
    wait_until(has_been_noticed, lambda: bridge.log)
    wait_until(lambda: robot.commands[-1].twist.is_zero, "the robot is told to stand")


def test_a_viewer_only_looks(run_bridge: Bridge, robot: Robot, endpoint: str) -> None:
    run_bridge("--role", "viewer")
    with ros_node(endpoint) as node:
        assert not {"/one/cmd_vel", "/one/goal_pose", "/one/initialpose"} & set(node.topics())
        twists = node.advertise("/one/cmd_vel", cdr.TWIST)
        scans = node.subscribe("/one/scan", cdr.LASER_SCAN)
        for _ in range(10):
            twists.publish(twist(0.2))
        wait_for(scans, "it hears everything that came before", 5)
        assert robot.commands == []


def test_nodes_may_have_a_router_of_their_own_and_no_namespace(
    run_bridge: Bridge, robot: Robot, endpoint: str
) -> None:
    with own_router() as elsewhere:
        bridge = run_bridge("--router", elsewhere, "--namespace", "/")
        with ros_node(elsewhere) as node, ros_node(endpoint) as misled:
            assert "/scan" in node.topics()
            assert misled.topics() == []
            wait_for(node.subscribe("/scan", cdr.LASER_SCAN), "a scan")
            goals = node.advertise("/goal_pose", cdr.POSE)
            repeat(lambda: goals.publish(goal(3.0)), lambda: robot.goals, "a goal")
            assert bridge.terminate() == 0
            wait_until(
                lambda: node.topics() == ["/goal_pose", "/scan"] or not node.topics(), "gone"
            )


def test_nodes_that_meet_at_trolleys_router_hear_each_other() -> None:
    with own_router() as where, ros_node(where, "talker") as talker, ros_node(where) as listener:
        heard = listener.subscribe("/chatter", cdr.TWIST)
        twists = talker.advertise("/chatter", cdr.TWIST)
        repeat(lambda: twists.publish(twist(0.2)), lambda: heard, "a message")
        wait_until(lambda: talker.topics() == ["/chatter"], "it sees the other's subscription")


def test_a_router_that_lets_other_hosts_in_serves_the_nodes_of_its_own(tmp_path: Path) -> None:
    now = datetime.now(UTC)
    keyring = Keyring(tmp_path / "ring")
    keyring.create(now)
    keys = keyring.issue("router", "home", now + timedelta(days=9), ["127.0.0.1"], replace=False)
    with own_router(security_of(keys)) as where, ros_node(where, mode="client") as node:
        kept = zenoh.ext.declare_advanced_publisher(
            node.session,
            node.key("/map", cdr.TWIST),
            cache=zenoh.ext.CacheConfig(max_samples=1),
            publisher_detection=True,
        )
        kept.put(cdr.write(twist(0.2)), attachment=struct.pack("<qqB16s", 1, 1, 16, bytes(16)))
        with ros_node(where, "late", mode="client") as late:
            wait_for(late.subscribe("/map", cdr.TWIST, transient_local=True), "what was kept")
            assert "NN/%/%/rviz" in late.graph()


def test_a_bridge_that_is_killed_leaves_no_topics_behind(run_bridge: Bridge, endpoint: str) -> None:
    bridge = run_bridge()
    with ros_node(endpoint) as node:
        wait_until(node.topics, "it is there")
        os.kill(bridge.pid, signal.SIGKILL)
        wait_until(lambda: node.topics() == [], "it is gone")


def test_systemd_hears_that_it_is_ready_and_that_it_lives(
    robot: Robot, endpoint: str, tmp_path: Path
) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.settimeout(PATIENCE_S)
        program = "from trolley.start import command; command()"
        bridge = Process(
            ["-c", program, "ros2", "--connect", endpoint, "--robot", "one"],
            tmp_path / "bridge.log",
            {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "20000000"},
        )
        try:
            while (said := systemd.recv(100)).startswith(b"STATUS="):
                pass  # it asks for time to compile
            assert said == b"READY=1\nSTATUS="
            assert systemd.recv(100) == b"WATCHDOG=1"
        finally:
            bridge.kill()


def test_a_robot_and_a_router_of_theirs_that_are_not_there_are_said(
    robot: Robot, endpoint: str, trolley: Callable
) -> None:
    done = trolley("ros2", "--connect", endpoint, "--robot", "ones", "--router", "tcp/127.0.0.1:1")
    assert done.returncode == 3, done.stderr
    assert "no robot called ones" in done.stderr
    assert "no router for ROS 2 nodes answers" in done.stderr
    assert "Traceback" not in done.stderr
