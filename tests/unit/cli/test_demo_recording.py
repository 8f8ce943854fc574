"""What the demo takes from a file of `trolley record`."""

import tomllib
from pathlib import Path

import msgspec
import pytest
from support.samples import make_clock, make_odometry, make_scan, make_transform

from trolley import topics
from trolley.cli.demo_recording import duration_s, with_recorded
from trolley.cli.demo_robot import Choices, write_settings
from trolley.config import ConfigError, load_config
from trolley.geometry import Pose2D
from trolley.gridmap import load_map
from trolley.messages import OccupancyGrid, PoseEstimate, Robot, Zone, Zones
from trolley.recording.recorder import Recorder
from trolley.recording.writer import RecordingWriter
from trolley.runtime import codec
from trolley.runtime.bus import Sample
from trolley.topics import Topic

MIRROR = Zone(name="old mirror", kind="mirror", points=[(0.0, 1.0), (2.0, 1.0)])
SECOND_NS = 1_000_000_000
OUTLINE = [(0.2, 0.1), (-0.2, 0.1), (-0.2, -0.1), (0.2, -0.1)]
ROBOT = Robot(
    stamp_ns=0,
    name="one",
    title="",
    footprint=OUTLINE,
    drive="differential",
    max_speed=0.5,
    max_wz=1.0,
    deceleration=1.0,
)
MAP = OccupancyGrid(
    stamp_ns=0,
    name="attic",
    frame="map",
    resolution=0.1,
    width=3,
    height=2,
    origin=Pose2D(-1.0, -2.0, 0.0),
    cells=memoryview(bytes([0, 100, 255, 0, 0, 100])),
)


def record(
    path: Path,
    *,
    grid: OccupancyGrid | None = MAP,
    estimate: bool = True,
    restarted_s: float = 99.0,
) -> Path:
    """Ten seconds straight on at 0.1 m/s, known at 5 s to be at x = 3.5 m; written each second."""
    with RecordingWriter(path, "one", {}) as writer:
        recorder = Recorder(writer, "one")

        def take(topic: Topic, message: msgspec.Struct, *parts: str) -> None:
            payload = codec.encode(message, "msgpack")
            sample = Sample(topic.key("one", *parts), payload, codec.MIME["msgpack"])
            recorder.take(sample, stamp_ns, 0)

        stamp_ns = 0
        take(topics.ROBOT, ROBOT)
        take(topics.TF, make_transform(1, "laser", "base_link"), "laser")
        if grid is not None:
            take(topics.MAP, grid)
            take(topics.ZONES, Zones(stamp_ns=0, map=grid.name, zones=[MIRROR]))
        for step in range(101):
            stamp_ns = step * SECOND_NS // 10
            epoch_ns = round(restarted_s * SECOND_NS)
            take(topics.CLOCK, make_clock(stamp_ns, epoch=epoch_ns if stamp_ns > epoch_ns else 0))
            if step % 10 == 0:
                writer.flush()
            take(topics.ODOM, make_odometry(stamp_ns, 0.01 * step))
            take(topics.SCAN, make_scan(stamp_ns))
            if estimate and step == 50:
                known = PoseEstimate(
                    stamp_ns=stamp_ns,
                    map="attic",
                    pose=Pose2D(3.5, 1.0, 0.0),
                    covariance=None,
                    state="localized",
                    match=1.0,
                    spread=0.0,
                )
                take(topics.POSE, known)
        writer.finish()
    return path


def test_map_start_and_footprint_are_the_recorded_ones(tmp_path: Path) -> None:
    file = record(tmp_path / "drive.mcap")
    choices = with_recorded(Choices(recording=file), tmp_path)
    config = load_config(write_settings(choices, tmp_path))
    assert config.base.recording is not None
    assert Path(config.base.recording.file) == file
    assert config.robot.footprint.polygon_m == OUTLINE
    start = config.start.pose
    assert start is not None
    assert not isinstance(start, str)
    assert (start.x, start.y, start.yaw) == pytest.approx((3.0, 1.0, 0.0))
    assert config.map.file is not None
    grid = load_map(config.map.file)
    assert (grid.name, grid.resolution, grid.origin) == ("attic", 0.1, MAP.origin)
    assert grid.cells.tobytes() == bytes(MAP.cells)
    zones = tomllib.loads((tmp_path / "attic.zones.toml").read_text(encoding="utf-8"))
    assert zones == {
        "zones": [{"name": "old mirror", "kind": "mirror", "points": [[0.0, 1.0], [2.0, 1.0]]}]
    }
    assert duration_s(file) == (pytest.approx(10.0), 101)


def test_what_is_named_counts_more(tmp_path: Path) -> None:
    file = record(tmp_path / "drive.mcap")
    other = tmp_path / "floor.yaml"
    choices = Choices(recording=file, map_file=other, start=Pose2D(1.0, 2.0, 3.0))
    taken = with_recorded(choices, tmp_path)
    assert (taken.map_file, taken.start) == (other, choices.start)
    # On another map it stood somewhere else than the file says.
    assert with_recorded(Choices(recording=file, map_file=other), tmp_path).start is None


def test_a_map_with_an_evil_name_stays_in_the_folder(tmp_path: Path) -> None:
    evil = msgspec.structs.replace(MAP, name="../../evil")
    folder = tmp_path / "a" / "b"
    folder.mkdir(parents=True)
    taken = with_recorded(Choices(recording=record(tmp_path / "x.mcap", grid=evil)), folder)
    assert taken.map_file == folder / "recorded.yaml"


def test_what_of_the_file_is_not_played_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = record(tmp_path / "drive.mcap")
    with_recorded(Choices(recording=whole), tmp_path)
    assert capsys.readouterr().err == ""
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    with_recorded(Choices(recording=cut), tmp_path)
    assert "The file was cut or is damaged" in capsys.readouterr().err
    restarted = record(tmp_path / "restarted.mcap", restarted_s=6.0)
    with_recorded(Choices(recording=restarted), tmp_path)
    assert "`base` was restarted after 6 s, where the drive ends." in capsys.readouterr().err


def test_what_is_missing_is_said(tmp_path: Path) -> None:
    file = record(tmp_path / "drive.mcap", grid=None, estimate=False)
    with pytest.raises(ConfigError, match=r"contains no map.*--map"):
        with_recorded(Choices(recording=file), tmp_path)
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(b"nothing")
    with pytest.raises(ConfigError, match="not an MCAP file"):
        with_recorded(Choices(recording=broken), tmp_path)
    with pytest.raises(ConfigError, match="not an MCAP file"):
        duration_s(broken)


def test_other_recordings_are_left_as_they_are(tmp_path: Path) -> None:
    choices = Choices(recording=tmp_path / "drive.npz", map_file=tmp_path / "floor.yaml")
    assert with_recorded(choices, tmp_path) is choices
