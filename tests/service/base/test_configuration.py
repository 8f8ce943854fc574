"""What cannot be used is refused at the start, by its key."""

from pathlib import Path
from typing import Any

import pytest

from trolley import requests, topics
from trolley.config import ConfigError
from trolley_base.service import BaseService

from .conftest import MakeConfig, MakeRig


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"simulated": {"world": "nowhere"}}, r"base\.simulated.*nowhere"),
        ({"simulated": {"start": {"x": 3.05, "y": 0.0, "yaw": 0.0}}}, r"base\.simulated.*stand in"),
        ({"simulated": {"start": {"x": 50.0, "y": 0.0, "yaw": 0.0}}}, r"base\.simulated"),
        ({"things": "[[bx]]\nx = 1.0"}, r"base\.simulated.*bx"),
        (
            {"robot": {"footprint": {"polygon_m": [[0.1, 0.0], [0.3, 0.0], [0.2, 0.1]]}}},
            r"robot\.footprint.*enclose",
        ),
        ({"robot": {"mesh": "nowhere.glb"}}, r"robot\.mesh.*nowhere\.glb"),
    ],
)
def test_a_sentence_names_the_key(
    make_config: MakeConfig, settings: dict[str, Any], words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        BaseService(make_config(**settings))


def test_a_mesh_is_published_up_to_a_mebibyte(make_rig: MakeRig, tmp_path: Path) -> None:
    (tmp_path / "body.glb").write_bytes(b"glTF")
    rig = make_rig(robot={"mesh": "body.glb"})
    (reply,) = rig.lockstep.get("trolley/trolley/robot?format=msgpack")
    assert b"glTF" in reply.payload
    (tmp_path / "body.glb").write_bytes(bytes((1 << 20) + 1))
    with pytest.raises(ConfigError, match=r"robot\.mesh"):
        BaseService(rig.config)


def test_a_name_of_a_world_needs_no_suffix(make_config: MakeConfig) -> None:
    BaseService(make_config(simulated={"world": "hall.toml"}))
    BaseService(make_config(simulated={"world": "room"}))


def test_a_broken_state_file_is_kept_aside_and_the_robot_starts(
    make_rig: MakeRig, tmp_path: Path
) -> None:
    rig = make_rig()
    folder = tmp_path / "state" / "trolley"
    for name in ("base_time.toml", "base_stop.toml", "base_world.toml"):
        (folder / name).write_bytes(b"\xff\x00 = = nonsense")
    rig.restart()
    rig.drive(1.0, 0.3)
    assert rig.state.mode == "stopped", "nobody knows whether it was"
    rig.lockstep.ask(requests.BASE_RESUME)
    rig.drive(1.0, 0.3)
    assert rig.truth.twist.vx > 0.2
    assert len(list(folder.glob("*.broken-*"))) == 3


@pytest.mark.parametrize("stamp_ns", [2**63 - 1, 9_223_372_036_000_000_000])
def test_a_saved_time_centuries_ahead_is_kept_aside_and_the_robot_starts(
    make_rig: MakeRig, tmp_path: Path, stamp_ns: int
) -> None:
    rig = make_rig()
    folder = tmp_path / "state" / "trolley"
    (folder / "base_time.toml").write_text(f"stamp_ns = {stamp_ns}\n")
    healths = rig.lockstep.record(topics.HEALTH, "base")
    rig.restart()
    rig.drive(1.0, 0.3)
    assert rig.truth.twist.vx > 0.2
    assert "base_time.toml could not be read and was set aside." in healths[-1].message
    (aside,) = folder.glob("base_time.toml.broken-*")
    assert aside.read_text() == f"stamp_ns = {stamp_ns}\n"


def test_a_latch_that_cannot_be_opened_may_have_said_stopped(
    make_rig: MakeRig, tmp_path: Path
) -> None:
    rig = make_rig()
    file = tmp_path / "state" / "trolley" / "base_stop.toml"
    file.unlink(missing_ok=True)
    file.symlink_to(file.name)  # it leads to itself; a folder without rights fails in the same way
    rig.restart()
    rig.drive(1.0, 0.3)
    assert rig.state.mode == "stopped"


def test_a_state_folder_that_cannot_be_written_does_not_end_base(
    make_rig: MakeRig, tmp_path: Path
) -> None:
    state = tmp_path / "state"
    state.write_text("a file where a folder should be")
    rig = make_rig()
    rig.drive(1.0, 0.3)
    assert rig.truth.twist.vx > 0.2
    assert rig.counters["state/not_saved"] > 0
