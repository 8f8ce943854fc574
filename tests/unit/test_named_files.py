"""Every file that a person names is refused where it is none: a pipe would hold up all."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from trolley.backup import BackupError, Unpacked
from trolley.cli.demo_recording import duration_s
from trolley.cli.demo_robot import first_reference
from trolley.config import ConfigError, load_config
from trolley.config.load import read_toml
from trolley.gridmap import MapError, load_map
from trolley.recording.reader import BadRecording, RecordingFile
from trolley.runtime.log import Log
from trolley.runtime.state import StateFolder
from trolley.security.certificates import read_certificates
from trolley.security.host_keys import KeysError
from trolley_base.drivers import DriverError
from trolley_base.importers.linorobot.launch_files import Launch, LaunchReader
from trolley_base.importers.parameters import read_parameters
from trolley_base.recording.npz_file import load_npz
from trolley_base.world.world_file import WorldError, load_world
from trolley_localizer.zone_rules import read_seeds

REFUSALS = (
    ConfigError, WorldError, MapError, BadRecording, DriverError, KeysError, BackupError, OSError,
)  # fmt: skip


def load_map_with_image(path: Path) -> None:
    description = path.parent / "map.yaml"
    description.write_text(
        f"image: {path.name}\nresolution: 0.05\norigin: [0, 0, 0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n"
    )
    load_map(description)


def launch(path: Path) -> None:
    said = Launch()
    LaunchReader(path.parent, {}).read(path, said)
    (problem,) = said.problems
    raise OSError(problem)


def parameters(path: Path) -> None:
    problems: list[str] = []
    read_parameters(path, path.parent, problems)
    (problem,) = problems
    raise OSError(problem)


def seeds(path: Path) -> None:
    problem = read_seeds(path.with_name("home.yaml"))
    assert isinstance(problem, str)
    raise OSError(problem)


def restore(path: Path) -> None:
    Unpacked(path, path.parent / "state")


READERS: dict[str, Callable[[Path], object]] = {
    "robot.toml": load_config,
    "any.toml": read_toml,
    "world.toml": load_world,
    "map.yaml": load_map,
    "map.pgm": load_map_with_image,
    "home.zones.toml": seeds,
    "drive.mcap": RecordingFile,
    "drive.npz": load_npz,
    "reference.npz": first_reference,
    "length.npz": duration_s,
    "bringup.launch": launch,
    "param.yaml": parameters,
    "key.pem": lambda path: read_certificates(path.parent),
    "robot.tar.gz": restore,
}


@pytest.mark.parametrize("name", READERS)
def test_a_pipe_is_refused_with_a_sentence(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    os.mkfifo(path)
    with pytest.raises(REFUSALS, match=r"pipe|not a regular") as refused:
        READERS[name](path)
    assert name in str(refused.value)


@pytest.mark.parametrize("name", ["robot.toml", "world.toml", "drive.npz", "bringup.launch"])
def test_a_device_is_refused_with_a_sentence(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.symlink_to("/dev/zero")
    with pytest.raises(REFUSALS, match="device"):
        READERS[name](path)


def test_a_pipe_in_place_of_a_state_file_is_kept_aside(tmp_path: Path) -> None:
    from trolley_base.persistence import SavedTime

    os.mkfifo(tmp_path / "base_time.toml")
    assert StateFolder(tmp_path, Log("test")).read("base_time.toml", SavedTime) is None
    assert [path.is_fifo() for path in tmp_path.glob("base_time.toml.broken-*")] == [True]


BOMBS = {
    "nested": "<launch>" + "<group>" * 50_000 + "</group>" * 50_000 + "</launch>",
    "laughing": '<!DOCTYPE l [<!ENTITY a "ha"><!ENTITY b "&a;&a;">]><launch a="&b;"/>',
}


@pytest.mark.parametrize("name", BOMBS)
def test_xml_that_no_launch_file_holds_is_refused_with_its_line(tmp_path: Path, name: str) -> None:
    path = tmp_path / "bringup.launch"
    path.write_text(BOMBS[name])
    said = Launch()
    LaunchReader(tmp_path, {}).read(path, said)
    (problem,) = said.problems
    assert problem.startswith("bringup.launch:1 ")
