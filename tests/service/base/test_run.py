"""A run of base: robot time, what is published, and what a restart takes up again."""

import json
import math
from pathlib import Path

import pytest

from trolley import topics
from trolley.geometry import Pose2D, Twist2D
from trolley.messages import Clock, Robot, Transform, Truth, floats_from_bytes
from trolley.runtime import codec
from trolley.topics import Qos

from .conftest import REAL, MakeConfig, MakeRig, Rig

S = 1_000_000_000


def test_robot_time_starts_at_zero_in_lockstep_and_runs_with_it(rig: Rig) -> None:
    clocks = rig.lockstep.record(topics.CLOCK)
    rig.run(1.0)
    assert clocks[-1] == Clock(stamp_ns=rig.lockstep.now_ns, rate=1.0, epoch=0)
    assert len(clocks) == 10


def test_a_faster_world_lets_robot_time_pass_faster(make_rig: MakeRig) -> None:
    rig = make_rig(simulated={"rate": 2.0})
    clocks = rig.lockstep.record(topics.CLOCK)
    rig.run(2.0)
    assert clocks[-1].rate == 2.0
    assert clocks[-1].stamp_ns == pytest.approx(2 * rig.lockstep.now_ns, abs=20_000_000)
    assert len(clocks) == 20, "others judge the silence of the clock by their own"


def test_the_streams_come_at_their_rates_and_in_order(rig: Rig) -> None:
    scans = rig.lockstep.record(topics.SCAN)
    for messages in (rig.odometry, rig.truths, rig.driven):
        messages.clear()
    rig.run(10.0)
    assert len(scans) == 100
    assert 200 <= len(rig.odometry) <= 500
    assert len(rig.truths) == 200
    assert len(rig.driven) == 100
    for messages in (scans, rig.odometry, rig.truths, rig.driven):
        stamps = [message.stamp_ns for message in messages]
        assert stamps == sorted(set(stamps))


def test_odometry_that_covers_a_scan_is_there_before_it(rig: Rig) -> None:
    scans = rig.lockstep.record(topics.SCAN)
    for _ in range(100):
        before = len(scans)
        rig.run(0.02)
        for scan in scans[before:]:
            beams = len(floats_from_bytes(scan.ranges))
            last_beam_ns = scan.stamp_ns + (beams - 1) * scan.time_increment * 1e9
            assert rig.odometry[-1].stamp_ns >= last_beam_ns


def test_the_mount_of_the_lidar_is_on_the_wire(make_rig: MakeRig) -> None:
    rig = make_rig(base={"lidar": {"pose": {"x": 0.1, "y": 0.0, "yaw": 1.5}, "z_m": 0.3}})
    (reply,) = rig.lockstep.get("trolley/trolley/tf/laser")
    transform = json.loads(reply.payload)
    assert (transform["parent"], transform["child"], transform["z"]) == ("base_link", "laser", 0.3)
    assert transform["pose"] == {"x": 0.1, "y": 0.0, "yaw": 1.5}
    scans = rig.lockstep.record(topics.SCAN)
    rig.run(0.2)
    ranges = floats_from_bytes(scans[-1].ranges)
    # Ahead of the robot is where the laser looks at -1.5 rad: a wall 3 m from the centre.
    beam = round((-1.5 - scans[-1].angle_min) / scans[-1].angle_increment)
    assert ranges[beam] == pytest.approx(2.9, abs=0.02)


def test_the_frame_of_the_robot_is_answered_from_odometry(rig: Rig) -> None:
    rig.drive(1.0, 0.3, 0.5)
    replies = rig.lockstep.get("trolley/trolley/tf/*")
    keys = {reply.key for reply in replies}
    assert keys == {"trolley/trolley/tf/laser", "trolley/trolley/tf/base_link"}
    (reply,) = rig.lockstep.get("trolley/trolley/tf/base_link")
    frame = json.loads(reply.payload)
    assert (frame["parent"], frame["child"]) == ("odom", "base_link")
    assert frame["pose"]["x"] == pytest.approx(rig.odometry[-1].pose.x, abs=0.02)


def test_a_restart_is_a_new_epoch_with_odometry_from_zero(rig: Rig) -> None:
    rig.drive(2.0, 0.3)
    before_ns = rig.now_ns
    clocks = rig.lockstep.record(topics.CLOCK)
    rig.restart()
    rig.odometry.clear()
    rig.run(1.0)
    assert clocks[-1].epoch >= before_ns
    assert clocks[-1].stamp_ns == clocks[-1].epoch + S
    assert rig.odometry[0].pose == Pose2D(0.0, 0.0, 0.0)
    assert rig.odometry[-1].stamp_ns > clocks[-1].epoch


def test_robot_time_never_goes_back_even_where_the_hosts_clock_does(rig: Rig) -> None:
    rig.run(115.0)
    before_ns = rig.now_ns
    rig.lockstep.kill("base")
    rig.lockstep.now_ns = 0  # a computer without a battery for its clock
    rig.base = rig.lockstep.add(type(rig.base)(rig.config))
    assert rig.base.epoch_ns > before_ns


def test_commands_of_an_earlier_run_are_dropped(rig: Rig) -> None:
    rig.run(1.0)
    old_ns = rig.now_ns
    rig.restart()
    rig.run(0.3)
    rig.send(Twist2D(0.3, 0.0, 0.0), stamp_ns=old_ns)
    rig.run(0.3)
    assert rig.truth.twist.is_zero
    assert rig.counters["cmd_vel/earlier_run"] == 1


def test_a_restarted_robot_stands_where_it_stood(rig: Rig) -> None:
    rig.drive(2.0, 0.3, 0.3)
    rig.run(2.0)
    before = rig.truth.pose
    assert before.x > 0.3
    rig.restart()
    rig.run(0.2)
    assert rig.truth.pose.distance_to(before) < 1e-9
    assert rig.truth.pose.yaw == pytest.approx(before.yaw)
    assert rig.truth.collisions == 0


def test_another_start_in_the_configuration_counts(rig: Rig, make_config: MakeConfig) -> None:
    rig.drive(2.0, 0.3)
    rig.run(1.0)
    rig.restart(make_config(simulated={"start": {"x": -1.0, "y": 0.5, "yaw": 0.0}}))
    rig.run(0.2)
    assert rig.truth.pose == Pose2D(-1.0, 0.5, 0.0)


def test_the_same_seed_gives_the_same_bytes(make_config: MakeConfig, tmp_path: Path) -> None:
    def run(name: str, seed: int) -> list[bytes]:
        rig = Rig(make_config(errors=REAL, seed=seed), tmp_path / name)
        payloads: list[bytes] = []
        rig.lockstep.bus.subscribe("trolley/**", lambda sample: payloads.append(sample.payload))
        rig.drive(3.0, 0.3, 0.4)
        rig.lockstep.close()
        return payloads

    first = run("a", 1)
    assert len(first) > 250
    assert run("b", 1) == first
    assert run("c", 2) != first


def test_another_robot_of_the_same_world_is_an_obstacle(rig: Rig) -> None:
    other = Robot(
        stamp_ns=0,
        name="other",
        title="Other",
        footprint=[(0.15, -0.12), (0.15, 0.12), (-0.15, 0.12), (-0.15, -0.12)],
        drive="differential",
        max_speed=0.5,
        max_wz=1.5,
        deceleration=1.0,
    )
    where = Truth(
        stamp_ns=0,
        world="hall",
        pose=Pose2D(1.0, 0.0, math.pi / 2),
        twist=rig.truth.twist,
        collisions=0,
        clearance=1.0,
    )

    def put(topic, message) -> None:
        rig.lockstep.bus.put(topic.key("other"), codec.encode(message, "msgpack"), "", Qos.STATE)

    put(topics.ROBOT, other)
    for _ in range(60):
        put(topics.SIM_TRUTH, where)
        rig.drive(0.1, 0.4)
    assert rig.truth.collisions == 0
    assert rig.truth.pose.x == pytest.approx(1.0 - 0.12 - 0.05 - 0.15, abs=0.02)
    # Taken away, it is no longer in the way.
    rig.run(3.0)
    rig.drive(2.0, 0.4)
    assert rig.truth.pose.x > 1.0


def test_transforms_are_of_the_contract(rig: Rig) -> None:
    (reply,) = rig.lockstep.get("trolley/trolley/tf/laser?format=msgpack")
    assert codec.decode(Transform, reply.payload, reply.encoding).child == "laser"


def test_a_base_whose_computer_slept_begins_anew(rig: Rig) -> None:
    rig.run(1.0)
    rig.lockstep.slept_ns += 10 * S
    rig.run(1.0)
    assert not rig.base.is_spent, "that may be a pause of a busy machine"
    rig.lockstep.slept_ns += 60 * S
    rig.run(0.2)
    assert rig.base.is_spent
