"""A simulated drive, recorded, played by base again, and followed by the localizer as before."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from trolley import topics, worlds
from trolley.config import ConfigError, RobotConfig
from trolley.geometry import Pose2D, Twist2D
from trolley.messages import PoseEstimate, Scan, VelocityCommand, floats_from_bytes
from trolley.recording.drive import Drive, read_drive
from trolley.recording.reader import BadRecording
from trolley.recording.recorder import Recorder
from trolley.recording.writer import RecordingWriter
from trolley.runtime.bus import Sample
from trolley.runtime.lockstep import Lockstep
from trolley_base.service import BaseService
from trolley_localizer.service import LocalizerService

DRIVE_S = 15.0
START = Pose2D(0.549, 0.218, 0.258)


def config_of(base: dict[str, Any], start: Pose2D) -> RobotConfig:
    plain = {
        "robot": {"name": "trolley", "footprint": {"length_m": 0.3, "width_m": 0.24}},
        "map": {"file": str(worlds.find("apartment.yaml"))},
        "start": {"pose": {"x": start.x, "y": start.y, "yaw": start.yaw}},
        "base": base,
    }
    return msgspec.convert(plain, RobotConfig)


class Recorded:
    """A drive by hand through the apartment: what was published, and the file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        world = {"world": str(worlds.find("apartment.toml")), "seed": 3}
        config = config_of({"driver": "simulated", "simulated": world}, START)
        with Lockstep() as bus, RecordingWriter(path, "trolley", {}) as writer:
            recorder = Recorder(writer, "trolley")

            def take(sample: Sample) -> None:
                recorder.take(sample, bus.now_ns, 0)

            self.poses: list[PoseEstimate] = bus.record(topics.POSE)
            self.scans: list[Scan] = bus.record(topics.SCAN)
            bus.add(LocalizerService(config))
            bus.add(BaseService(config))
            bus.run(3.0)  # the recording begins when all is under way
            bus.bus.subscribe("trolley/trolley/**", take)
            for reply in bus.get("trolley/trolley/**?format=msgpack"):
                sample = Sample(reply.key, reply.payload, reply.encoding)
                recorder.take(sample, bus.now_ns, 0, is_latest=True)
            while bus.now_s < DRIVE_S:
                turn = 0.6 if bus.now_s % 6.0 > 4.0 else 0.0
                command = VelocityCommand(
                    stamp_ns=bus.now_ns, twist=Twist2D(0.3, 0.0, turn), valid_for=0.3
                )
                bus.publish(topics.COMMAND, command, "teleop")
                bus.run(0.1)
            writer.finish()


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    return Recorded(tmp_path_factory.mktemp("drive") / "drive.mcap")


@pytest.fixture(scope="module")
def drive(recorded: Recorded) -> Drive:
    return read_drive(recorded.path)


def test_the_file_holds_all_that_it_takes(recorded: Recorded, drive: Drive) -> None:
    assert drive.map is not None
    assert drive.map.name == "apartment"
    assert drive.robot is not None
    assert len(drive.robot.footprint) == 4
    assert drive.base_T_laser is not None
    assert drive.seconds > DRIVE_S - 4.0
    first = drive.scans[0].stamp_ns
    (then,) = [pose for pose in recorded.poses if pose.stamp_ns == first]
    assert then.pose is not None
    assert drive.map_T_start is not None
    assert drive.map_T_start.distance_to(then.pose) < 0.05


def test_base_plays_it_and_the_localizer_follows_it(recorded: Recorded, drive: Drive) -> None:
    assert drive.map_T_start is not None
    playing = {"driver": "recording", "recording": {"file": str(recorded.path)}}
    config = config_of(playing, drive.map_T_start)
    with Lockstep() as bus:
        scans = bus.record(topics.SCAN)
        poses = bus.record(topics.POSE)
        bus.add(LocalizerService(config))
        bus.add(BaseService(config))
        bus.run(drive.seconds)
    shift_ns = drive.scans[0].stamp_ns
    before = {one.stamp_ns - shift_ns: one for one in recorded.scans}
    assert len(scans) > 80
    for scan in scans[1:]:  # the first stands at the epoch
        was = before[scan.stamp_ns]
        assert bytes(scan.ranges) == bytes(was.ranges)
        assert (scan.time_increment, scan.range_min) == (was.time_increment, was.range_min)
    assert {pose.state for pose in poses} <= {"localized", "unsure"}
    known = {one.stamp_ns - shift_ns: one.pose for one in recorded.poses}
    apart = [
        pose.pose.distance_to(was)
        for pose in poses
        if (was := known.get(pose.stamp_ns)) is not None and pose.pose is not None
    ]
    assert len(apart) > 80
    assert np.median(apart) < 0.03
    assert max(apart) < 0.10
    assert floats_from_bytes(scans[-1].ranges).size > 100


def test_a_file_without_scans_is_refused_in_words(tmp_path: Path, recorded: Recorded) -> None:
    path = tmp_path / "poses.mcap"
    with RecordingWriter(path, "trolley", {}) as writer:
        recorder = Recorder(writer, "trolley", ["pose"])
        for pose in recorded.poses[:5]:
            payload = msgspec.msgpack.encode(pose)
            recorder.take(Sample("trolley/trolley/pose", payload, "application/msgpack"), 1, 1)
        writer.finish()
    with pytest.raises(BadRecording, match=r"no scan and no odom and no tf/laser"):
        read_drive(path)
    with pytest.raises(ConfigError, match=r"base\.recording.*record at least"):
        BaseService(config_of({"driver": "recording", "recording": {"file": str(path)}}, START))
