"""What doctor says of robot.toml, maps, places and zones."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from trolley.config import load_config
from trolley.config.problems import find_problems
from trolley.doctor import Finding, Level
from trolley.doctor.settings import (
    PlaceFile,
    check_file,
    check_kept,
    check_kept_aside,
    check_map,
    check_name,
    check_places,
    check_without_robot,
    check_zones,
    chosen_map,
    facts_of,
    read_list,
    read_map,
)
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.gridmap.io import load_map, save_map
from trolley.messages import SavedPose, Zone
from trolley.state_file import render
from trolley.zones import ZoneFile
from trolley_tour.stored.checks import PosesFile

WRONG = """\
zap = 1
[robot]
name = "Bad Name"
speed = 3
footprint = { radius_m = 0.2, length_m = 1 }
[planner]
max_speed_mps = -1
rollouts = "many"
[base.lidar]
baud = 3
[base.chassis.wheels]
diameter_m = 0.1
[zenoh]
connect = ["foo"]
"""


@pytest.fixture
def room() -> GridMap:
    """5 x 4 m of free floor with walls around it."""
    cells = np.zeros((80, 100), dtype=np.int8)
    cells[[0, -1], :] = 100
    cells[:, [0, -1]] = 100
    return GridMap("room", 0.05, Pose2D(0.0, 0.0, 0.0), cells)


def place(name: str, x: float, map_name: str = "room") -> SavedPose:
    return SavedPose(name=name, map=map_name, pose=Pose2D(x, 2.0, 0.0))


def test_every_problem_of_a_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(WRONG)
    found = find_problems(path)
    for text in (
        "unknown key `zap`",
        "[robot.name]",
        "unknown key `speed`",
        "[robot.footprint] give the footprint",
        "[planner.max_speed_mps]",
        "[planner.rollouts]",
        "[base.lidar.baud]",
        "missing key `ticks_per_revolution`",
        "[zenoh] 'foo' is not an endpoint",
    ):
        assert [one for one in found if text in one], text
    assert all(one.startswith(str(path)) for one in found)
    # Nothing is said that follows from what was said before.
    assert len(found) == 9


@pytest.mark.parametrize(
    "text",
    [
        "robot = 3",
        "robot = {}",
        "[planner]\nmax_speed_mps = nan\n",
        "[robot",
        "[zap.zap]\nzap = []\n",
    ],
)
def test_a_wrong_file_always_has_a_problem(tmp_path: Path, text: str) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(text)
    assert find_problems(path)
    assert all(one.level is Level.PROBLEM for one in check_file(path))


def test_the_file_of_a_host_without_a_robot_has_none(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text('[zenoh]\nuplink = ["tls/home.local:7448"]\n')
    assert [one.level for one in check_file(path)] == [Level.OK]
    (said,) = check_without_robot(path, [])
    assert said.level is Level.NOTE
    assert "right for a PC" in said.sentence
    (said,) = check_without_robot(path, ["trolley-base.service"])
    assert said.level is Level.PROBLEM
    assert "trolley-base.service shall run a robot" in said.sentence
    path.write_text("[zenoh]\nuplink = 3\n[planner]\nfast = 1\n")
    assert len(find_problems(path)) == 2


def test_a_good_file_has_none(root_toml: Path) -> None:
    load_config(root_toml)
    assert find_problems(root_toml) == []
    assert [one.level for one in check_file(root_toml)] == [Level.OK]


@pytest.fixture
def root_toml() -> Path:
    """The example that is installed."""
    return Path(__file__).resolve().parents[3] / "deploy" / "robot.toml"


def test_no_file_is_a_note_only() -> None:
    assert [one.level for one in check_file(None)] == [Level.NOTE]


def test_a_file_for_others_only_is_no_fault_of_the_file(
    root_toml: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.access", lambda *_: False)
    (found,) = check_file(root_toml)
    assert (found.level, "sudo" in found.remedy) == (Level.NOTE, True)


def test_a_missing_file_is_a_problem(tmp_path: Path) -> None:
    assert [one.level for one in check_file(tmp_path / "robot.toml")] == [Level.PROBLEM]


def test_maps(room: GridMap) -> None:
    good = facts_of(room)
    assert good.size_m == pytest.approx((5.0, 4.0))
    assert [one.level for one in check_map(good)] == [Level.OK]
    bad = {
        "no walls": replace(good, occupied=0.0),
        "inside out": replace(good, occupied=0.95),
        "hardly any free floor": replace(good, floor_m2=0.5),
        "cells of 0.5 m": replace(good, resolution_m=0.5),
        "much memory": replace(good, cells=50_000_000),
        "outside its walls is free": replace(good, unknown=0.0, free_edge=0.9),
    }
    for words, facts in bad.items():
        found = check_map(facts)
        assert any(words in one.sentence + one.remedy for one in found), words
        assert max(one.level for one in found) >= Level.WARNING


def test_grey_that_transparency_makes_free_is_told(tmp_path: Path) -> None:
    cells = np.full((60, 60), -1, dtype=np.int8)
    cells[10:50, 10:50] = 100
    cells[11:49, 11:49] = 0
    save_map(
        GridMap("room", 0.05, Pose2D(0.0, 0.0, 0.0), cells),
        tmp_path / "room.yaml",
        image_format="png",
    )
    assert [one.level for one in check_map(facts_of(load_map(tmp_path / "room.yaml")))] == [
        Level.OK
    ]
    Image.open(tmp_path / "room.png").convert("RGBA").save(tmp_path / "room.png")  # as GIMP does
    (said,) = check_map(facts_of(load_map(tmp_path / "room.yaml")))
    assert said.level is Level.WARNING
    assert "without transparency" in said.remedy


def test_a_good_map_on_a_large_canvas_is_good(room: GridMap) -> None:
    """What a mapper saved with a wide margin of the unknown was called one without floor."""
    canvas = np.full((2000, 2000), -1, dtype=np.int8)
    canvas[900:980, 900:1000] = room.cells
    (said,) = check_map(facts_of(GridMap("room", 0.05, Pose2D(0.0, 0.0, 0.0), canvas)))
    assert said.level is Level.OK
    assert "100% unknown" in said.sentence


def test_a_map_is_read_or_it_is_said_what_is_wrong(room: GridMap, tmp_path: Path) -> None:
    save_map(room, tmp_path / "room.yaml")
    assert isinstance(read_map(tmp_path / "room.yaml"), GridMap)
    (tmp_path / "room.pgm").write_bytes(b"P5 garbage")
    broken = read_map(tmp_path / "room.yaml")
    assert isinstance(broken, Finding)
    assert broken.level is Level.PROBLEM
    assert isinstance(read_map(tmp_path / "nowhere.yaml"), Finding)
    save_map(room, tmp_path / "room.yaml")
    (tmp_path / "room.yaml").rename(tmp_path / "K\u00fcche.yaml")
    foreign = read_map(tmp_path / "K\u00fcche.yaml")
    assert isinstance(foreign, Finding)
    assert "'K\u00fcche' cannot name a map" in foreign.sentence


def test_places_lie_on_free_floor(room: GridMap) -> None:
    good = check_places(room, [place("kitchen", 2.0), place("attic", 99.0, "upstairs")])
    assert [one.level for one in good] == [Level.OK]
    bad = check_places(room, [place("kitchen", 2.0), place("garden", 9.0), place("wall", 0.02)])
    assert [one.level for one in bad] == [Level.WARNING] * 2
    assert "garden lies outside the map" in bad[0].sentence
    assert "wall lies in a wall" in bad[1].sentence
    assert [one.level for one in check_places(room, [])] == [Level.OK]


def test_zones_lie_on_the_map(room: GridMap) -> None:
    inside = Zone(name="mirror", kind="mirror", points=[(1.0, 1.0), (2.0, 1.0)])
    outside = Zone(name="away", kind="mirror", points=[(21.0, 1.0), (22.0, 1.0)])
    assert [one.level for one in check_zones(room, [inside])] == [Level.OK]
    assert [one.level for one in check_zones(room, [inside, outside])] == [Level.WARNING]


def test_what_is_saved_is_read_or_it_is_said_why_not(tmp_path: Path) -> None:
    file = tmp_path / "poses.toml"
    assert read_list(file, PlaceFile, "poses") == []
    file.write_text(
        '[[poses]]\nname = "kitchen"\nmap = "room"\npose = { x = 1.0, y = 2.0, yaw = 0.0 }\n'
    )
    assert read_list(file, PlaceFile, "poses") == [place("kitchen", 1.0)]
    for text in ("poses = 3", "[[poses", '[[poses]]\nname = "a"\n', "\x00"):
        file.write_text(text)
        assert isinstance(read_list(file, PlaceFile, "poses"), Finding), text


def test_files_are_read_as_their_services_write_them(tmp_path: Path) -> None:
    zone = Zone(name="mirror", kind="mirror", points=[(1.0, 1.0), (2.0, 1.0)])
    file = tmp_path / "home.toml"
    file.write_bytes(render(ZoneFile(zones=[zone])))
    assert read_list(file, ZoneFile, "zones") == [zone]
    file.write_bytes(render(PosesFile(poses=[place("kitchen", 1.0)])))
    assert read_list(file, PlaceFile, "poses") == [place("kitchen", 1.0)]


def test_files_that_were_kept_aside_are_named(tmp_path: Path) -> None:
    assert check_kept_aside(tmp_path / "nowhere") == []
    assert check_kept_aside(tmp_path) == []
    (tmp_path / "tours.toml.broken-1700000000").touch()
    (found,) = check_kept_aside(tmp_path)
    assert "tours.toml.broken-1700000000" in found.sentence


def test_a_robot_of_a_new_name_has_nothing_of_the_old_one(tmp_path: Path) -> None:
    assert check_name("plum", tmp_path / "nowhere") == []
    for file in ("kiwi/poses.toml", "maps/home.toml", "plum/last_pose.toml", "Not one/poses.toml"):
        (tmp_path / file).parent.mkdir()
        (tmp_path / file).touch()
    (found,) = check_name("plum", tmp_path)
    assert "place or tour for plum" in found.sentence
    assert found.sentence.endswith("those of kiwi.")
    (tmp_path / "plum" / "tours.toml").touch()
    assert check_name("plum", tmp_path) == []


def test_the_map_of_the_last_run_is_looked_at(tmp_path: Path) -> None:
    configured, maps = tmp_path / "home.yaml", tmp_path / "maps"
    assert chosen_map(tmp_path, maps, None) is None
    assert chosen_map(tmp_path, maps, configured) == configured
    (tmp_path / "map.toml").write_text('name = "attic"\nconfigured = "home"\n')
    assert chosen_map(tmp_path, maps, configured) == configured  # it is there no more
    maps.mkdir()
    (maps / "attic.yaml").touch()
    assert chosen_map(tmp_path, maps, configured) == maps / "attic.yaml"
    (tmp_path / "map.toml").write_text('name = "../../attic"\nconfigured = "home"\n')
    assert chosen_map(tmp_path, maps, configured) == maps / "attic.yaml"
    (tmp_path / "map.toml").write_text("\x00")
    assert chosen_map(tmp_path, maps, configured) == configured


def test_what_was_set_while_the_robot_ran_is_told_with_what_robot_toml_says(tmp_path: Path) -> None:
    file, state = tmp_path / "robot.toml", tmp_path / "state"
    file.write_text(
        '[robot]\nname = "one"\nfootprint = { radius_m = 0.2 }\n'
        "[planner]\nmax_speed_mps = 0.4\nclearance_m = 0.1\n"
    )
    assert check_kept(file, state) == []
    (state / "one").mkdir(parents=True)
    kept = state / "one" / "settings.toml"
    kept.write_text(
        "[set.planner]\nmax_speed_mps = 0.3\nclearance_m = 0.2\npatience_s = -1.0\n"
        "[set.tour]\nlow_battery = 0.4\n"
        "[instead_of.planner]\nmax_speed_mps = 0.4\nclearance_m = 0.2\n"
    )
    counts, edited, wrong = check_kept(file, state)
    assert (counts.level, edited.level, wrong.level) == (Level.OK, Level.OK, Level.WARNING)
    assert counts.sentence == (
        f"What was set while the robot ran counts from {kept}: [planner] max_speed_mps = 0.3, in "
        "robot.toml 0.4; [tour] low_battery = 0.4, in robot.toml not set."
    )
    assert edited.sentence.startswith("robot.toml was edited after [planner] clearance_m had been")
    assert "[planner.patience_s]" in wrong.sentence
