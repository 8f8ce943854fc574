"""Recordings as rosbag2, read by the library `mcap` (Foxglove's), which did not write them."""

import json
import math
from collections import defaultdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from ruamel.yaml import YAML
from support.samples import make_clock, make_estimate, make_goal, make_places

from trolley import topics
from trolley.cli import cli
from trolley.geometry import Pose2D, Twist2D
from trolley.messages import (
    OccupancyGrid,
    Odometry,
    PoseEstimate,
    Scan,
    Transform,
    floats_to_bytes,
)
from trolley.messages import Path as PathMessage
from trolley.recording.drive import read_drive
from trolley.recording.recorder import Recorder
from trolley.recording.writer import RecordingWriter
from trolley.runtime import codec
from trolley.runtime.bus import Sample

SECOND_NS = 1_000_000_000
BEGIN_NS = 1_700_000_000 * SECOND_NS
TICKS = 40
"""Of 50 ms."""
LASER = Pose2D(0.1, -0.05, 0.5)
CORRECTIONS = {0: Pose2D(1.0, 2.0, 0.3), 20: Pose2D(1.1, 2.0, 0.35)}
"""map_T_odom by the tick from which on it holds."""
RANGES = np.array([1.0, math.inf, 0.0, 2.5], np.float32)
CELLS = np.array([[0, 100, -1], [50, 0, 0]], np.int8)


def odom_T_base(tick: int) -> Pose2D:
    return Pose2D(0.02 * tick, 0.01 * tick, 0.015 * tick)


def stamp(tick: int) -> int:
    return BEGIN_NS + tick * SECOND_NS // 20


def grid(tick: int, frame: str = "map") -> OccupancyGrid:
    return OccupancyGrid(
        stamp_ns=stamp(tick),
        name="home",
        frame=frame,
        resolution=0.05,
        width=3,
        height=2,
        origin=Pose2D(-1.0, -2.0, 0.0),
        cells=memoryview(CELLS.tobytes()),
    )


def estimate(tick: int, state: str = "localized") -> PoseEstimate:
    return make_estimate(stamp(tick), state)


def messages(tick: int) -> list[tuple[str, Any]]:
    """What the robot published at a tick, by the name below its key."""
    found: list[tuple[str, Any]] = [("clock", make_clock(stamp(tick), epoch=BEGIN_NS))]
    if tick == 0:
        mount = Transform(stamp_ns=stamp(0), parent="base_link", child="laser", pose=LASER, z=0.2)
        found += [("tf/laser", mount), ("map", grid(0)), ("goal", make_goal(stamp(0)))]
        found += [("poses", make_places(stamp(0), "kitchen")), ("pose", estimate(0, "lost"))]
        line = floats_to_bytes(np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 1.5]]))
        found.append(("path", PathMessage(stamp_ns=stamp(0), frame="map", poses=line)))
        found.append(("costmap", grid(0, "odom")))
    if tick in CORRECTIONS:
        link = Transform(stamp_ns=stamp(tick), parent="map", child="odom", pose=CORRECTIONS[tick])
        found.append(("tf/odom", link))
    twist = Twist2D(0.4, 0.0, 0.3)
    found.append(("odom", Odometry(stamp_ns=stamp(tick), pose=odom_T_base(tick), twist=twist)))
    if tick % 2 == 0:
        scan = Scan(
            stamp_ns=stamp(tick),
            frame="laser",
            angle_min=-1.0,
            angle_increment=0.5,
            time_increment=0.01,
            range_min=0.1,
            range_max=8.0,
            ranges=memoryview(RANGES.tobytes()),
        )
        found += [("scan", scan), ("pose", estimate(tick))]
    return found


def record(path: Path, *, finish: bool = True) -> Path:
    with RecordingWriter(path, "kiwi", {}) as writer:
        recorder = Recorder(writer, "kiwi")
        for tick in range(TICKS):
            for name, message in messages(tick):
                payload = codec.encode(message, "msgpack")
                sample = Sample(f"trolley/kiwi/{name}", payload, codec.MIME["msgpack"])
                recorder.take(sample, stamp(tick), stamp(tick))
            if tick % 10 == 0:
                writer.flush()
        broken = Sample("trolley/kiwi/odom", b"\xc1", codec.MIME["msgpack"])
        recorder.take(broken, stamp(TICKS), stamp(TICKS))
        writer.flush()
        if finish:
            writer.finish()
    return path


def run(*words: str) -> Any:
    return CliRunner().invoke(cli, ["export", "bag", *words])


def exported(recording: Path, *options: str) -> tuple[Path, dict[str, Any]]:
    out = recording.parent / "bag"
    done = run(str(recording), str(out), "--json", *options)
    assert done.exit_code == 0, done.output
    return out, json.loads(done.stdout)


def read_by_foxglove(folder: Path) -> dict[str, list[tuple[int, SimpleNamespace]]]:
    """All messages by topic, with the time at which they came."""
    found: dict[str, list[tuple[int, SimpleNamespace]]] = defaultdict(list)
    with (folder / f"{folder.name}.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, message, content in reader.iter_decoded_messages():
            found[channel.topic].append((message.log_time, content))
    return found


def stamp_of(header: Any) -> int:
    return header.stamp.sec * SECOND_NS + header.stamp.nanosec


def pose_of(at: Any, turned: Any) -> Pose2D:
    assert (turned.x, turned.y) == (0.0, 0.0)
    return Pose2D(at.x, at.y, 2.0 * math.atan2(turned.z, turned.w))


def test_others_read_every_message_with_its_time_and_stamp(tmp_path: Path) -> None:
    folder, told = exported(record(tmp_path / "drive.mcap"))
    seen = read_by_foxglove(folder)
    assert {name: len(rows) for name, rows in seen.items()} == told["written"]
    assert told["written"] == {
        "/scan": TICKS // 2,
        "/odom": TICKS,
        "/tf": TICKS,
        "/tf_static": 1,
        "/map": 1,
        "/amcl_pose": TICKS // 2,
        "/plan": 1,
        "/local_costmap/costmap": 1,
    }
    for number, (at_ns, scan) in enumerate(seen["/scan"]):
        assert at_ns == stamp_of(scan.header) == stamp(2 * number)
        assert scan.header.frame_id == "laser"
        np.testing.assert_array_equal(scan.ranges, [1.0, math.inf, math.nan, 2.5])
        assert (scan.angle_min, scan.angle_max) == (-1.0, 0.5)
    for tick, (_, odometry) in enumerate(seen["/odom"]):
        assert stamp_of(odometry.header) == stamp(tick)
        where = pose_of(odometry.pose.pose.position, odometry.pose.pose.orientation)
        np.testing.assert_allclose(where.as_array(), odom_T_base(tick).as_array(), atol=1e-12)
        assert (odometry.twist.twist.linear.x, odometry.twist.twist.angular.z) == (0.4, 0.3)
    (_, cells), (_, line) = seen["/map"][0], seen["/plan"][0]
    assert np.array(list(cells.data), np.int8).tolist() == CELLS.ravel().tolist()
    assert [(one.pose.position.x, one.pose.position.y) for one in line.poses] == [(0, 0), (1, 2)]
    assert seen["/local_costmap/costmap"][0][1].header.frame_id == "odom"


def test_the_tree_of_frames_leads_from_the_map_to_the_lidar(tmp_path: Path) -> None:
    seen = read_by_foxglove(exported(record(tmp_path / "drive.mcap"))[0])
    (fixed,) = seen["/tf_static"][0][1].transforms
    assert (fixed.header.frame_id, fixed.child_frame_id) == ("base_link", "laser")
    assert fixed.transform.translation.z == 0.2
    base_T_laser = pose_of(fixed.transform.translation, fixed.transform.rotation)
    for tick, (_, message) in enumerate(seen["/tf"]):
        links = {
            (one.header.frame_id, one.child_frame_id): pose_of(
                one.transform.translation, one.transform.rotation
            )
            for one in message.transforms
        }
        assert {stamp_of(one.header) for one in message.transforms} == {stamp(tick)}
        assert links.keys() == {("map", "odom"), ("odom", "base_link")}
        found = links["map", "odom"] @ links["odom", "base_link"] @ base_T_laser
        map_T_odom = CORRECTIONS[max(since for since in CORRECTIONS if since <= tick)]
        expected = map_T_odom @ odom_T_base(tick) @ LASER
        np.testing.assert_allclose(found.as_array(), expected.as_array(), atol=1e-12)


def test_what_was_left_out_is_named(tmp_path: Path) -> None:
    recording = record(tmp_path / "drive.mcap")
    _, told = exported(recording)
    assert told["left"].keys() == {"goal", "poses"}
    assert told["notes"] == ["Left out: 1 of odom that cannot be understood."]
    said = run(str(recording), str(tmp_path / "other")).output
    assert "goal, poses: `trolley ros2` does not publish them" in said


def test_its_metadata_say_what_ros2_bag_needs_to_play_it(tmp_path: Path) -> None:
    folder, told = exported(record(tmp_path / "drive.mcap"), "--namespace", "/kiwi")
    text = (folder / "metadata.yaml").read_text()
    about = YAML(typ="safe").load(text)["rosbag2_bagfile_information"]
    assert (about["version"], about["storage_identifier"]) == (8, "mcap")
    assert about["relative_file_paths"] == ["bag.mcap"]
    assert about["message_count"] == sum(told["written"].values())
    assert about["starting_time"]["nanoseconds_since_epoch"] == BEGIN_NS
    rows = {row["topic_metadata"]["name"]: row for row in about["topics_with_message_count"]}
    assert rows.keys() == told["written"].keys()
    assert rows["/kiwi/scan"]["topic_metadata"]["type"] == "sensor_msgs/msg/LaserScan"
    for name, durability in (("/kiwi/map", 1), ("/kiwi/tf_static", 1), ("/kiwi/tf", 2)):
        text = rows[name]["topic_metadata"]["offered_qos_profiles"]
        assert YAML(typ="safe").load(text)[0]["durability"] == durability
    with AnyReader([folder]) as reader:  # pyrefly: ignore[bad-argument-type]
        assert reader.message_count == about["message_count"]


def test_there_and_back_is_the_same_drive(tmp_path: Path) -> None:
    recording = record(tmp_path / "drive.mcap")
    folder, _ = exported(recording)
    back = tmp_path / "back.mcap"
    done = CliRunner().invoke(cli, ["import", "bag", str(folder), str(back)])
    assert done.exit_code == 0, done.output
    one, other = read_drive(recording), read_drive(back)
    assert [bytes(scan.ranges) for scan in one.scans] == [bytes(s.ranges) for s in other.scans]
    assert [scan.stamp_ns for scan in one.scans] == [scan.stamp_ns for scan in other.scans]
    np.testing.assert_allclose(
        [row.pose.as_array() for row in one.odometry],
        [row.pose.as_array() for row in other.odometry],
        atol=1e-12,
    )
    assert other.base_T_laser is not None
    np.testing.assert_allclose(other.base_T_laser.as_array(), LASER.as_array(), atol=1e-12)


def test_of_a_recording_that_was_cut_what_came_before_is_kept(tmp_path: Path) -> None:
    recording = record(tmp_path / "drive.mcap", finish=False)
    recording.write_bytes(recording.read_bytes()[:-3000])
    folder, told = exported(recording)
    assert 0 < told["written"]["/scan"] < TICKS // 2
    assert "was cut or is damaged" in told["notes"][0]
    assert len(read_by_foxglove(folder)["/scan"]) == told["written"]["/scan"]


def test_a_restart_of_base_ends_the_correction(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    later_ns = BEGIN_NS + 60 * SECOND_NS
    with RecordingWriter(path, "kiwi", {}) as writer:
        recorder = Recorder(writer, "kiwi")
        rows = [(stamp(tick), row) for tick in range(3) for row in messages(tick)]
        for at_ns in (later_ns, later_ns + SECOND_NS):
            odometry = Odometry(stamp_ns=at_ns, pose=odom_T_base(0), twist=Twist2D.zero())
            rows += [(at_ns, ("clock", make_clock(at_ns, epoch=later_ns)))]
            rows += [(at_ns, ("odom", odometry))]
        for at_ns, (name, message) in rows:
            payload = codec.encode(message, "msgpack")
            sample = Sample(f"trolley/kiwi/{name}", payload, codec.MIME["msgpack"])
            recorder.take(sample, at_ns, at_ns)
        writer.finish()
    folder, told = exported(path)
    (note,) = told["notes"]
    assert note.startswith(
        "`base` was restarted after 0 s: `/odom` starts over there, and time lea"
    )
    seen = read_by_foxglove(folder)["/tf"]
    assert [len(message.transforms) for _, message in seen] == [2, 2, 2, 1, 1]


def test_what_cannot_be_exported_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    recording = record(tmp_path / "drive.mcap")
    there = tmp_path / "there"
    there.mkdir()
    text = tmp_path / "notes.txt"
    text.write_text("no recording")
    empty = tmp_path / "empty.mcap"
    with RecordingWriter(empty, "kiwi", {}) as writer:
        payload = codec.encode(make_places(0, "kitchen"), "msgpack")
        sample = Sample(topics.POSES.key("kiwi"), payload, codec.MIME["msgpack"])
        Recorder(writer, "kiwi").take(sample, BEGIN_NS, BEGIN_NS)
        writer.finish()
    new = str(tmp_path / "new")
    for words, why in (
        ([str(recording), str(there)], "already exists; name another folder"),
        ([str(recording), f"{new}.mcap"], "a rosbag2 is a folder"),
        ([str(recording), new, "--namespace", "kiwi"], "write /kiwi or /home/kiwi, or / for none"),
        ([str(text), new], "is not an MCAP file"),
        ([str(empty), new], "holds nothing that a bag can hold, only poses"),
        ([str(tmp_path / "none.mcap"), new], "does not exist"),
    ):
        done = run(*words)
        assert done.exit_code == 2, done.output
        assert why in " ".join(done.output.split())
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("namespace", ["/", "/kiwi"])
def test_a_namespace_stands_before_every_topic(tmp_path: Path, namespace: str) -> None:
    _, told = exported(record(tmp_path / "drive.mcap"), "--namespace", namespace)
    assert f"{namespace.rstrip('/')}/scan" in told["written"]
