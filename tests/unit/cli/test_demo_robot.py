"""The demo's own robot."""

import os
import tomllib
from pathlib import Path

import numpy as np
import pytest

from trolley import worlds
from trolley.cli.demo_recording import duration_s
from trolley.cli.demo_robot import (
    PLACES,
    START,
    TOUR,
    Choices,
    parse_pose,
    settings,
    write_settings,
)
from trolley.cli.demo_run import TruthWatch
from trolley.config import ConfigError, load_config
from trolley.geometry import Pose2D, Twist2D
from trolley.gridmap import load_map
from trolley.messages import Truth
from trolley.runtime import codec
from trolley.runtime.bus import Sample


def test_the_settings_load_and_name_files_that_are_there(tmp_path: Path) -> None:
    choices = Choices(
        name="second", port=7999, viz_port=8123, foxglove_port=8124, seed=7, speed=2.0
    )
    config = load_config(write_settings(choices, tmp_path))
    assert config.robot.name == "second"
    assert config.zenoh.connect == ["tcp/127.0.0.1:7999"]
    assert (config.viz.port, config.viz.foxglove_port) == (8123, 8124)
    assert (config.base.simulated.seed, config.base.simulated.rate) == (7, 2.0)
    assert load_map(config.path(config.map.file or "")).name == "apartment"


def test_the_robot_starts_where_the_article_s_robot_did(tmp_path: Path) -> None:
    config = load_config(write_settings(Choices(), tmp_path))
    pose = config.start.pose
    assert pose is not None
    assert not isinstance(pose, str)
    assert pose.as_pose().distance_to(START) < 1e-9


def test_the_tour_visits_the_three_places_in_order() -> None:
    assert [stop.name for stop in TOUR.stops] == ["corridor", "entrance", "kitchen"]
    assert list(PLACES) == [stop.name for stop in TOUR.stops]


def test_a_chosen_start_is_where_the_robot_stands_and_thinks_it_stands() -> None:
    plain = settings(Choices(start=Pose2D(1.0, 2.0, 0.5)))
    assert plain["start"]["pose"] == {"x": 1.0, "y": 2.0, "yaw": 0.5}
    assert plain["base"]["simulated"]["start"] == plain["start"]["pose"]


def test_another_world_brings_its_own_map_and_start(tmp_path: Path) -> None:
    (tmp_path / "hall.toml").write_text('map = "hall.yaml"\nstart = { x = 1, y = 2, yaw = 3 }\n')
    (tmp_path / "hall.yaml").write_text("")
    choices = Choices(world=str(tmp_path / "hall.toml"))
    plain = settings(choices)
    assert plain["map"]["file"] == str(tmp_path / "hall.yaml")
    assert plain["start"]["pose"] == {"x": 1.0, "y": 2.0, "yaw": 3.0}
    assert not choices.has_places
    with pytest.raises(ConfigError, match="nowhere"):
        settings(Choices(world="nowhere.toml"))


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    path = tmp_path / "drive.npz"
    np.savez(
        path,
        stamps=np.array([10.0, 10.1, 10.4]),
        odom=np.zeros((3, 3)),
        ranges_mm=np.zeros((3, 4), np.uint16),
        reference=np.array([[1.0, 2.0, 0.5]] * 3),
        angle_min=0.0,
        angle_increment=0.1,
        range_max=8.0,
    )
    return path


def test_a_recording_starts_at_its_first_reference(tmp_path: Path, drive: Path) -> None:
    choices = Choices(recording=drive, map_file=worlds.find("apartment.yaml"), speed=4.0)
    plain = settings(choices)
    assert plain["base"] == {
        "driver": "recording",
        "recording": {"file": str(drive), "rate": 4.0},
    }
    assert plain["start"] == {"pose": {"x": 1.0, "y": 2.0, "yaw": 0.5}, "always": True}
    assert tomllib.loads(write_settings(choices, tmp_path).read_text()) == plain
    length_s, scans = duration_s(drive)
    assert (length_s, scans) == (pytest.approx(0.4), 3)


def test_a_map_that_is_none_is_refused_before_anything_starts(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.yaml")
    (tmp_path / "other.yaml").write_text("songs: []")
    for name, why in (("pipe.yaml", "pipe or a device"), ("other.yaml", "'image' is missing")):
        with pytest.raises(ConfigError, match=why):
            settings(Choices(map_file=tmp_path / name))


def test_a_recording_needs_a_map(drive: Path) -> None:
    with pytest.raises(ConfigError, match="--map"):
        settings(Choices(recording=drive))


def test_a_file_that_is_no_recording_is_refused_with_what_it_lacks(tmp_path: Path) -> None:
    path, plan = tmp_path / "drive.npz", worlds.find("apartment.yaml")
    np.savez(tmp_path / "half.npz", stamps=np.arange(3.0), odom=np.zeros((3, 3)))
    half = (tmp_path / "half.npz").read_bytes()
    for data, why in (
        (b"no npz at all", "not an npz file of plain arrays"),
        (b"", "not an npz file of plain arrays"),
        (half[:-30], "not an npz file of plain arrays"),
        (half, "it lacks ranges_mm, angle_min, angle_increment, range_max"),
    ):
        path.write_bytes(data)
        with pytest.raises(ConfigError, match=why):
            settings(Choices(recording=path, map_file=plan))


def test_a_world_or_map_that_is_none_is_refused_by_its_name(tmp_path: Path) -> None:
    world, plan = tmp_path / "world.toml", tmp_path / "plan.yaml"
    for data, why in (
        (b"a = [1", "world.toml: is not valid TOML"),
        (b"\xff\xfe", "world.toml: line 1 is not UTF-8 text"),
        (b"[robot]\n", "world.toml: is not a world: it names no map"),
        (b'map = "apartment.yaml"\nstart = {y = 1.0}', r"world.toml: \[start\] missing key `x`"),
        (b'map = "apartment.yaml"\nstart = {x = "a", y = 1.0}', r"\[start.x\] a number is needed"),
    ):
        world.write_bytes(data)
        with pytest.raises(ConfigError, match=why):
            settings(Choices(world=str(world)))
    text = worlds.find("apartment.yaml").read_text(encoding="utf-8")
    plan.write_text(text.replace("apartment.pgm", "nowhere.pgm"))
    with pytest.raises(ConfigError, match="there is no such image"):
        settings(Choices(map_file=plan))


@pytest.mark.parametrize("text", ["", "1,2", "1,2,3,4", "a,b,c", "1,2,nan"])
def test_a_pose_of_the_command_line_has_three_numbers(text: str) -> None:
    with pytest.raises(ValueError, match="is not X,Y,YAW"):
        parse_pose(text)
    assert parse_pose("1,-2,0.5") == Pose2D(1.0, -2.0, 0.5)


def test_collisions_are_counted_over_a_restart_of_base() -> None:
    watch = TruthWatch()
    for collisions, clearance in [(0, 0.5), (2, 0.0), (0, 0.4), (1, 0.3)]:
        truth = Truth(
            stamp_ns=1,
            world="w",
            pose=Pose2D.identity(),
            twist=Twist2D.zero(),
            collisions=collisions,
            clearance=clearance,
        )
        watch.take(Sample("k", codec.encode(truth, "msgpack"), codec.MIME["msgpack"]))
    watch.take(Sample("k", b"broken", ""))
    assert (watch.collisions, watch.closest_m) == (3, 0.0)
