"""Bags that rosbags' own writers wrote, as recordings."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from trolley.cli import cli
from trolley.gridmap import OCCUPIED_FROM, load_map
from trolley.messages import floats_from_bytes
from trolley.recording.drive import Drive, read_drive

KINDS = ("bag", "mcap", "db3")
BEGIN_S = 1_700_000_000
SCANS = 40
RANGES = [1.0, math.inf, math.nan, 0.01, 9.0, 3.0]
"""An echo, no echo, invalid, too near, farther than can be measured, an echo."""
LASER = (0.1, -0.05, 0.5)


class _Bag:
    """Writes messages of ROS 1 or ROS 2."""

    def __init__(self, folder: Path, kind: str) -> None:
        self.is_ros1 = kind == "bag"
        self.store: Any = get_typestore(Stores.ROS1_NOETIC if self.is_ros1 else Stores.ROS2_JAZZY)
        if self.is_ros1:  # rosbags has only the types of std_msgs and the like for it
            definition = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(get_types_from_msg(definition, "tf2_msgs/msg/TFMessage"))
        self.path = folder / ("drive.bag" if self.is_ros1 else "drive")
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        self.writer: Any = (
            Writer1(self.path)
            if self.is_ros1
            else Writer2(self.path, version=9, storage_plugin=plugin)
        )
        self.topics: dict[str, Any] = {}

    def make(self, name: str, *fields: Any) -> Any:
        return self.store.types[name](*fields)

    def header(self, at_s: float, frame: str) -> Any:
        second, rest_ns = divmod(round(at_s * 1e9), 1_000_000_000)
        stamp = self.make("builtin_interfaces/msg/Time", BEGIN_S + second, rest_ns)
        first = (0,) if self.is_ros1 else ()
        return self.make("std_msgs/msg/Header", *first, stamp, frame)

    def put(self, topic: str, at_s: float, message: Any) -> None:
        name = message.__msgtype__
        if topic not in self.topics:
            self.topics[topic] = self.writer.add_connection(topic, name, typestore=self.store)
        pack = self.store.serialize_ros1 if self.is_ros1 else self.store.serialize_cdr
        at_ns = BEGIN_S * 1_000_000_000 + round(at_s * 1e9)
        self.writer.write(self.topics[topic], at_ns, bytes(pack(message, name)))

    def quaternion(self, yaw: float, *, upside_down: bool = False) -> Any:
        half = 0.5 * yaw
        fields = (
            (math.cos(half), math.sin(half), 0.0, 0.0)
            if upside_down
            else (0.0, 0.0, math.sin(half), math.cos(half))
        )
        return self.make("geometry_msgs/msg/Quaternion", *fields)

    def transform(
        self, at_s: float, parent: str, child: str, x: float, y: float, turned: Any
    ) -> Any:
        shift = self.make("geometry_msgs/msg/Vector3", x, y, 0.2)
        link = self.make("geometry_msgs/msg/Transform", shift, turned)
        header = self.header(at_s, parent)
        one = self.make("geometry_msgs/msg/TransformStamped", header, child, link)
        return self.make("tf2_msgs/msg/TFMessage", [one])

    def scan(self, at_s: float, *, step: float = 0.1, ranges: Any = RANGES) -> Any:
        return self.make(
            "sensor_msgs/msg/LaserScan",
            self.header(at_s, "laser_link"),
            0.2,
            0.2 + (len(ranges) - 1) * step,
            step,
            0.01 if ranges is RANGES else 0.0,
            0.1,
            0.1,
            8.0,
            np.array(ranges, np.float32),
            np.arange(len(ranges), dtype=np.float32),
        )

    def odometry(self, at_s: float) -> Any:
        point = self.make("geometry_msgs/msg/Point", 0.5 * at_s, 0.0, 0.0)
        pose = self.make("geometry_msgs/msg/Pose", point, self.quaternion(0.0))
        forward = self.make("geometry_msgs/msg/Vector3", 0.5, 0.0, 0.0)
        still = self.make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
        twist = self.make("geometry_msgs/msg/Twist", forward, still)
        zeros = np.zeros(36)
        return self.make(
            "nav_msgs/msg/Odometry",
            self.header(at_s, "odom"),
            "base_link",
            self.make("geometry_msgs/msg/PoseWithCovariance", pose, zeros),
            self.make("geometry_msgs/msg/TwistWithCovariance", twist, zeros),
        )


def _drive(
    folder: Path, kind: str, *, by_tf: bool = False, upside_down: bool = False, step: float = 0.1
) -> Path:
    bag = _Bag(folder, kind)
    with bag.writer:
        x, y, yaw = LASER
        turned = bag.quaternion(yaw, upside_down=upside_down)
        link = bag.transform(0.0, "base_link", "laser_link", x, y, turned)
        bag.put("/tf_static", 0.0, link)
        name = bag.make("std_msgs/msg/String", "x" * 50)
        for number in range(SCANS):
            at_s = 0.1 * number
            if by_tf:
                moved = bag.transform(
                    at_s, "odom", "base_link", 0.5 * at_s, 0.0, bag.quaternion(0.0)
                )
                bag.put("/tf", at_s, moved)
            else:
                bag.put("/odom", at_s, bag.odometry(at_s))
            bag.put("/scan", at_s + 0.05, bag.scan(at_s + 0.02, step=step))
            bag.put("/chatter", at_s + 0.06, name)
    return bag.path


ROOM = (-1.5, 5.0, -1.2, 1.6)
"""The walls of a room: the least and greatest x and y [m], from where the drive begins."""


def _room(folder: Path, kind: str) -> Path:
    """A drive of 3 m through the room."""
    bag = _Bag(folder, kind)
    step = math.radians(2.0)
    with bag.writer:
        x, y, yaw = LASER
        bag.put(
            "/tf_static",
            0.0,
            bag.transform(0.0, "base_link", "laser_link", x, y, bag.quaternion(yaw)),
        )
        angles = yaw + 0.2 + step * np.arange(180)
        along, across = np.cos(angles), np.sin(angles)
        for number in range(60):
            at_s = 0.1 * number
            left, right, low, high = ROOM
            wall_x = np.where(along > 0.0, right, left) - (0.5 * at_s + x)
            wall_y = np.where(across > 0.0, high, low) - y
            ranges = np.minimum(wall_x / along, wall_y / across)
            bag.put("/odom", at_s, bag.odometry(at_s))
            bag.put("/scan", at_s, bag.scan(at_s, step=step, ranges=ranges))
        bag.put("/odom", 6.0, bag.odometry(6.0))
    return bag.path


def _imported(bag: Path, *options: str) -> tuple[Drive, str]:
    out = bag.parent / "out.mcap"
    done = CliRunner().invoke(cli, ["import", "bag", str(bag), str(out), *options])
    assert done.exit_code == 0, done.output
    return read_drive(out), done.output


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_becomes_a_drive(tmp_path: Path, kind: str) -> None:
    drive, said = _imported(_drive(tmp_path, kind))
    assert (len(drive.scans), len(drive.odometry)) == (SCANS, SCANS)
    assert drive.scans[1].stamp_ns == BEGIN_S * 10**9 + 120_000_000
    ranges = floats_from_bytes(drive.scans[0].ranges)
    np.testing.assert_array_equal(ranges, np.array([1, math.inf, 0, 0, math.inf, 3], np.float32))
    assert drive.odometry[10].pose.x == pytest.approx(0.5)
    assert drive.odometry[10].twist.vx == 0.5
    assert drive.base_T_laser is not None
    np.testing.assert_allclose(drive.base_T_laser.as_array(), LASER, atol=1e-9)
    assert "not taken  /chatter  Trolley records no such thing" in said


def test_what_was_taken_is_told_to_programs_too(tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    words = ["import", "bag", str(_drive(tmp_path, "mcap")), str(out), "--json"]
    told = json.loads(CliRunner().invoke(cli, words).stdout)
    assert told["file"] == str(out)
    assert told["taken"]["/odom"] == f"odom: {SCANS} of {SCANS}"
    assert told["left"].keys() == {"/chatter", "/tf_static"}


def test_without_odometry_the_transforms_count(tmp_path: Path) -> None:
    drive, said = _imported(_drive(tmp_path, "mcap", by_tf=True))
    assert len(drive.odometry) == SCANS
    assert drive.odometry[10].twist.vx == pytest.approx(0.5)
    assert "from odom -> base_link" in said


@pytest.mark.parametrize(
    ("upside_down", "step", "reversed_"),
    [(False, -0.1, True), (True, 0.1, True), (True, -0.1, False)],
)
def test_each_beam_keeps_its_place_and_time(
    tmp_path: Path, upside_down: bool, step: float, reversed_: bool
) -> None:
    drive, _ = _imported(_drive(tmp_path, "mcap", upside_down=upside_down, step=step))
    scan = drive.scans[0]
    assert scan.angle_increment == pytest.approx(0.1)
    # The beam of 1 m was measured first, at 0.2 rad about the lidar's own axis.
    index = floats_from_bytes(scan.ranges).tolist().index(1.0)
    assert index == (5 if reversed_ else 0)
    angle = scan.angle_min + index * scan.angle_increment
    assert angle == pytest.approx(-0.2 if upside_down else 0.2)
    at_s = (scan.stamp_ns - BEGIN_S * 10**9) * 1e-9 + index * scan.time_increment
    assert at_s == pytest.approx(0.02, abs=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_of_a_bag_that_was_cut_what_came_before_is_kept(tmp_path: Path, kind: str) -> None:
    bag = _long(tmp_path, kind)
    path = bag if bag.is_file() else next(bag.glob("*.[md][cb]*"))
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * 0.6)])
    if bag.is_dir():
        (bag / "metadata.yaml").unlink()  # is written at the end
    drive, said = _imported(bag, "--laser", "0", "0", "0")
    assert 2 <= len(drive.scans) < LONG
    assert "cut or is damaged" in said


LONG = 150


def _long(folder: Path, kind: str) -> Path:
    """Several chunks of every format."""
    bag = _Bag(folder, kind)
    filler = bag.make("std_msgs/msg/String", "x" * 20_000)
    with bag.writer:
        for number in range(LONG):
            bag.put("/odom", 0.1 * number, bag.odometry(0.1 * number))
            bag.put("/scan", 0.1 * number + 0.05, bag.scan(0.1 * number + 0.02))
            bag.put("/chatter", 0.1 * number + 0.06, filler)
    return bag.path


def test_what_cannot_be_used_is_said(tmp_path: Path) -> None:
    text = tmp_path / "drive.bag"
    text.write_text("no bag at all")
    bag = _drive(tmp_path, "mcap")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes((bag / f"{bag.name}.mcap").read_bytes()[:2000])
    own = tmp_path / "own.mcap"
    assert CliRunner().invoke(cli, ["import", "bag", str(bag), str(own)]).exit_code == 0
    for arguments, problem in (
        ([str(own)], "is a recording of Trolley already: `trolley replay`"),
        ([str(cut)], "was cut or is damaged: its last"),
        ([str(text)], "is neither a ROS 1 bag nor a rosbag2"),
        ([str(bag), str(tmp_path / "x.mcap"), "--scan", "/front"], "the bag has /scan"),
        ([str(bag), str(text)], "already exists"),
        ([str(tmp_path / "none")], "does not exist"),
    ):
        done = CliRunner().invoke(cli, ["import", "bag", *arguments])
        assert done.exit_code != 0
        assert problem in " ".join(done.output.split())
    assert not (tmp_path / "x.mcap").exists()
    assert text.read_text() == "no bag at all"


def test_a_definition_without_what_is_needed_is_named(tmp_path: Path) -> None:
    bag = _Bag(tmp_path, "mcap")
    definition = "std_msgs/Header header\nfloat32 angle\n"
    with bag.writer:
        bag.put("/odom", 0.0, bag.odometry(0.0))
        other = bag.writer.add_connection(
            "/scan", "sensor_msgs/msg/LaserScan", msgdef=definition, rihs01="RIHS01_" + "0" * 64
        )
        bag.writer.write(other, BEGIN_S * 10**9, b"\0\1\0\0" + b"\7" * 9)
    done = CliRunner().invoke(cli, ["import", "bag", str(bag.path), str(tmp_path / "x.mcap")])
    assert done.exit_code != 0
    assert "it is no sensor_msgs/msg/LaserScan as the bag defines it" in " ".join(
        done.output.split()
    )


@pytest.mark.parametrize("source", ["bag", "mcap", "recording"])
def test_a_map_is_made_without_a_robot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, source: str
) -> None:
    drive = _room(tmp_path, "mcap" if source == "recording" else source)
    if source == "recording":
        _imported(drive)
        drive = tmp_path / "out.mcap"
    elif source == "mcap":
        (drive,) = drive.glob("*.mcap")
    monkeypatch.chdir(tmp_path)
    words = ["map", "new", "room", "--from", str(drive)]
    done = CliRunner().invoke(cli, [*words, "--json"])
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    assert (told["file"], told["scans"], told["lost"]) == ("room.yaml", 60, 0)
    grid = load_map("room.yaml")
    rows, cols = np.nonzero(grid.cells >= OCCUPIED_FROM)
    walls = (rows.min(), rows.max(), cols.min(), cols.max())
    found = np.array(walls) * grid.resolution + np.repeat([grid.origin.y, grid.origin.x], 2)
    np.testing.assert_allclose(found, (*ROOM[2:], *ROOM[:2]), atol=0.11)
    again = CliRunner().invoke(cli, words)
    assert "room.yaml already exists; choose another name" in again.stderr


def test_of_what_is_no_drive_no_map_is_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cut.mcap").write_bytes(b"\x89MCAP0\r\n")
    (tmp_path / "photo.jpg").write_bytes(b"\xff\xd8\xff\xe0")
    for words, why in (
        (["room", "--from", "cut.mcap"], "ends before its first message"),
        (["room", "--from", "photo.jpg"], "photo.jpg"),
        (["a/b", "--from", "cut.mcap"], "is not a valid map name"),
        (["room", "--from", "cut.mcap", "--explore"], "give one of them"),
    ):
        done = CliRunner().invoke(cli, ["map", "new", *words])
        assert done.exit_code not in (0, 1), done.output
        assert why in done.stderr
        assert not list(tmp_path.glob("*.yaml"))
