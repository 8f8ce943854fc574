"""Which settings are proposed, and how they come into a robot.toml."""

import dataclasses
import re
import tomllib
from pathlib import Path
from typing import Any

import msgspec
import pytest

from trolley.cli.init import render
from trolley.config import ConfigError, load_config, robot_toml
from trolley_base.detection import settings
from trolley_base.detection.ports import Port
from trolley_base.detection.results import FoundDevice, PortResult
from trolley_base.drivers.boards import counted_track_m

LINOROBOT = PortResult(
    Port("/dev/ttyACM0", "/dev/serial/by-id/teensy"),
    FoundDevice("board", "linorobot", "linorobot", 57600),
)
BRIDGE = PortResult(
    Port("/dev/ttyACM0", "/dev/serial/by-id/arduino"),
    FoundDevice("board", "arduino_bridge", "ROSArduinoBridge", 57600),
)
UGV = PortResult(
    Port("/dev/ttyACM0", "/dev/serial/by-id/esp32"),
    FoundDevice("board", "waveshare_ugv", "Waveshare UGV", 115200),
)
CREATE = PortResult(
    Port("/dev/ttyUSB1", "/dev/serial/by-id/ftdi"),
    FoundDevice("board", "create2", "Create 2 or Roomba", 115200),
)
LINOROBOT2 = PortResult(
    Port("/dev/ttyACM0", "/dev/serial/by-id/pico"),
    FoundDevice("board", "linorobot2", "linorobot2", 115200),
)
LD19 = PortResult(
    Port("/dev/ttyUSB0", "/dev/serial/by-path/pci-1"), FoundDevice("lidar", "ld19", "LD19", 230400)
)
NOTHING = PortResult(Port("/dev/ttyUSB1", "/dev/ttyUSB1"))

SETTING = re.compile(r" =|base\.scans")
ROBOT = """\
# My robot.
[robot]
name = "haro"   # the cat's name
footprint = { length_m = 0.3, width_m = 0.2 }
"""

EXPLAINED = render({"robot.name": '"haro"', "robot.footprint": "{ radius_m = 0.2 }"})


def changed(text: str, *seen: PortResult) -> str:
    proposal = settings.propose(seen, tomllib.loads(text))
    return robot_toml.with_values(text, proposal.values, proposal.waiting, proposal.tables)


def base_of(text: str) -> dict[str, Any]:
    return tomllib.loads(text)["base"]


def test_sets_what_was_found_and_keeps_the_rest(tmp_path: Path) -> None:
    text = changed(ROBOT, LINOROBOT, LD19, NOTHING)
    assert text.startswith(ROBOT)
    path = tmp_path / "robot.toml"
    path.write_text(text)
    config = load_config(path)
    assert config.base.driver == "hardware"
    assert config.base.chassis.board == "linorobot"
    assert config.base.chassis.port == "/dev/serial/by-id/teensy"
    assert config.base.lidar.model == "ld19"
    assert config.base.lidar.port == "/dev/serial/by-path/pci-1"


def test_writes_the_speed_that_is_not_the_models_own(tmp_path: Path) -> None:
    port = Port("/dev/ttyUSB0", "/dev/serial/by-path/pci-1")
    for baud, written in ((115200, 115200), (256000, None)):
        found = FoundDevice("lidar", "rplidar_a2", "RPLIDAR A2", baud)
        text = changed(ROBOT, PortResult(port, found))
        assert base_of(text)["lidar"].get("baud") == written


def test_overwrites_neither_pose_nor_scales() -> None:
    text = changed(
        ROBOT
        + """
[base.lidar]
# Measured twice.
pose = { x = 0.1, y = 0.0, yaw = 3.1 }  # backwards
port = "/dev/ttyUSB9"
[base.odometry]
linear_scale = 1.02
""",
        LD19,
    )
    base = base_of(text)
    assert base["lidar"]["pose"] == {"x": 0.1, "y": 0.0, "yaw": 3.1}
    assert base["lidar"]["port"] == "/dev/serial/by-path/pci-1"
    assert base["odometry"] == {"linear_scale": 1.02}
    assert "chassis" not in base
    assert "# Measured twice." in text
    assert "# backwards" in text


def test_changes_nothing_the_second_time() -> None:
    for text in (ROBOT, EXPLAINED):
        for seen in ((LINOROBOT, LD19), (BRIDGE, LD19), (CREATE, LD19), (LINOROBOT2, LD19)):
            once = changed(text, *seen)
            assert changed(once, *seen) == once


@pytest.mark.parametrize("is_explained", [False, True], ids=["short", "as init writes it"])
def test_leaves_a_board_commented_out_until_its_wheels_are_known(
    tmp_path: Path, is_explained: bool
) -> None:
    path = tmp_path / "robot.toml"
    text = changed(EXPLAINED if is_explained else ROBOT, BRIDGE)
    path.write_text(text)
    assert load_config(path).base.chassis.board is None
    lines = text.replace('# board = "arduino_bridge"', 'board = "arduino_bridge"').splitlines()
    start = next(i for i, line in enumerate(lines) if "Fill this in" in line)
    lines[start + 1 :] = [line.removeprefix("# ") for line in lines[start + 1 :]]
    filled = "\n".join(lines).replace("revolution = 0.0", "revolution = 1550")
    path.write_text(filled.replace("_m = 0.0", "_m = 0.1"))
    config = load_config(path)
    assert config.base.chassis.board == "arduino_bridge"
    assert config.base.chassis.port == "/dev/serial/by-id/arduino"
    assert config.base.chassis.wheels is not None


def test_takes_the_place_of_the_lines_that_explain() -> None:
    before, after = EXPLAINED.splitlines(), changed(EXPLAINED, LINOROBOT, LD19).splitlines()
    assert len(before) == len(after)
    differing = [(old, new) for old, new in zip(before, after, strict=True) if old != new]
    assert differing == [
        ('# driver = "simulated"', 'driver = "hardware"'),
        ("# board =", 'board = "linorobot"'),
        ('# port = ""', 'port = "/dev/serial/by-id/teensy"'),
        ("# model =", 'model = "ld19"'),
        ('# port = ""', 'port = "/dev/serial/by-path/pci-1"'),
    ]


def test_asks_which_robot_a_waveshare_board_is_in(tmp_path: Path) -> None:
    text = changed(ROBOT, UGV)
    assert "board" not in base_of(text)["chassis"]
    path = tmp_path / "robot.toml"
    lines = [
        line.removeprefix("# ") if line.startswith(("# board =", "# [", "# type")) else line
        for line in text.splitlines()
    ]
    assert "ugv_beast" in text  # what it may be
    path.write_text("\n".join(lines).replace('type = ""', 'type = "ugv_rover"'))
    chassis = load_config(path).base.chassis
    assert chassis.board == "waveshare_ugv"
    assert counted_track_m(chassis) == 0.172


@pytest.mark.parametrize("is_explained", [False, True], ids=["short", "as init writes it"])
def test_lists_what_a_create_feels(tmp_path: Path, is_explained: bool) -> None:
    before = EXPLAINED if is_explained else ROBOT
    text = changed(before, CREATE, LD19)
    path = tmp_path / "robot.toml"
    path.write_text(text)
    scans = load_config(path).base.scans
    assert {name: one.kept_s for name, one in scans.items()} == {"bumper": 60.0, "cliff": 60.0}
    assert text.count("[base.scans.bumper]") == text.count("[base.scans.light_bumper]") == 1
    assert all(line in text for line in before.splitlines() if not SETTING.search(line))
    # Its owner may want the light sensors, too, and has only to take the # away.
    at = text.index("# [base.scans.light_bumper]")
    path.write_text(text[:at] + text[at:].replace("# ", ""))
    assert load_config(path).base.scans["light_bumper"].uses == ["mark"]


def test_says_what_a_create_feels_and_how_large_it_is() -> None:
    proposal = settings.propose((CREATE, LD19), tomllib.loads(ROBOT))
    notes = " ".join(proposal.sensor_notes)
    assert "[base.scans.bumper], [base.scans.cliff]" in notes
    assert "Commented out" in notes
    assert "footprint = { radius_m = 0.17 }" in notes
    assert settings.by_name(proposal)["base.scans.bumper.kept_s"] == 60.0
    base = base_of(settings.render(proposal))
    assert base["scans"].keys() == {"bumper", "cliff"}
    round_one = {"robot": {"footprint": {"radius_m": 0.17}}}
    assert "footprint" not in " ".join(settings.propose((CREATE,), round_one).sensor_notes)
    assert settings.propose((LINOROBOT, LD19), tomllib.loads(ROBOT)).sensor_notes == []


def test_lists_none_of_what_a_board_feels_where_its_owner_has_chosen() -> None:
    own = ROBOT + "\n[base.scans.cliff]\nkept_s = 5.0  # a rug\n"
    text = changed(own, CREATE)
    assert base_of(text)["scans"] == {"cliff": {"kept_s": 5.0}}
    assert "light_bumper" not in text


@pytest.mark.parametrize(
    "scans",
    ["[base.scans]\nfront = { z_m = 0.3 }\n", "[base]\nscans = { front = { z_m = 0.3 } }\n"],
)
def test_lists_it_beside_sensors_that_are_written_on_one_line(scans: str) -> None:
    found = base_of(changed(f"{ROBOT}\n{scans}", CREATE))["scans"]
    assert found["front"] == {"z_m": 0.3}
    assert found["bumper"] == {"z_m": 0.05, "kept_s": 60.0}


def test_lists_what_is_wired_to_the_pins_of_an_arduino() -> None:
    inputs = "\n[base.chassis.inputs]\nbumper_pins = [4]\nsonar_pins = { ahead = 5 }\n"
    text = changed(ROBOT + inputs, BRIDGE)
    assert base_of(text)["scans"] == {"bumper": {"kept_s": 60.0}}
    assert "\n# [base.scans.ahead]\n# pose = " in text
    assert "scans" not in base_of(changed(ROBOT, BRIDGE))


def test_leaves_a_sonar_to_its_owner_who_knows_where_it_sits() -> None:
    text = changed(ROBOT, LINOROBOT2)
    assert "scans" not in base_of(text)
    assert "\n# [base.scans.ultrasound]\n# pose = " in text


class Serial(msgspec.Struct):
    number: int
    """Number on its sheet."""


def test_asks_for_what_a_lidars_driver_requires(monkeypatch: pytest.MonkeyPatch) -> None:
    needy = dataclasses.replace(settings.MODELS["ld19"], settings=Serial)
    monkeypatch.setattr(settings, "MODELS", {"ld19": needy})
    text = changed(ROBOT, LD19)
    assert "model" not in base_of(text)["lidar"]
    assert '# model = "ld19"' in text
    assert "# [base.lidar.settings]\n# # Number on its sheet. (whole number)\n# number = " in text
    text = changed(ROBOT + "\n[base.lidar.settings]\nnumber = 3\n", LD19)
    assert base_of(text)["lidar"]["model"] == "ld19"


def test_keeps_known_wheels() -> None:
    wheels = "\n[base.chassis.wheels]\nticks_per_revolution = 1\ndiameter_m = 0.1\ntrack_m = 0.2\n"
    text = changed(ROBOT + wheels, BRIDGE)
    chassis = base_of(text)["chassis"]
    assert chassis["board"] == "arduino_bridge"
    assert chassis["wheels"]["track_m"] == 0.2


@pytest.mark.parametrize(
    "base",
    [
        "\n[base]\nchassis.port = 'x'\n",
        "\n[base]\nchassis = { port = 'x' }\n",
        "\n[base.chassis]\nport = 'x'\n\n[base.chassis.inputs]\nbumper_pins = [1]\n",
        "\n[base.chassis.inputs]\nbumper_pins = [1]\n\n[base]\ndriver = 'simulated'\n",
    ],
)
def test_copes_with_all_ways_to_write_a_table(base: str) -> None:
    chassis = base_of(changed(ROBOT + base, LINOROBOT))["chassis"]
    assert chassis["board"] == "linorobot"
    assert chassis["port"] == "/dev/serial/by-id/teensy"


def test_corrects_a_speed_that_was_of_another_device() -> None:
    text = changed(ROBOT + "\n[base.lidar]\nbaud = 115200\n", LD19)
    assert base_of(text)["lidar"]["baud"] == 230400


def test_leaves_the_choice_among_several_to_the_person() -> None:
    proposal = settings.propose((LD19, LD19, LINOROBOT), {})
    assert not any(key[1] == "lidar" for key in proposal.values)
    assert "more than one lidar" in proposal.notes[0]


def test_proposes_nothing_for_nothing() -> None:
    assert settings.propose((NOTHING,), {}).values == {}


def test_prints_toml_that_can_be_read() -> None:
    proposal = settings.propose((BRIDGE, LD19), {})
    base = base_of(settings.render(proposal))
    assert base["driver"] == "hardware"
    assert base["lidar"] == {"model": "ld19", "port": "/dev/serial/by-path/pci-1"}
    assert "# ticks_per_revolution" in settings.render(proposal)


def test_a_file_that_would_not_load_is_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(ROBOT)
    with pytest.raises(ConfigError, match=r"robot.toml: \[base.driver\]"):
        robot_toml.replace_text(path, ROBOT + '[base]\ndriver = "magic"\n')
    assert path.read_text() == ROBOT
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    path, link = tmp_path / "robot.toml", tmp_path / "link.toml"
    path.write_text(ROBOT)
    link.symlink_to(path)
    robot_toml.replace_text(link, ROBOT + "\n# more\n")
    assert link.is_symlink()
    assert path.read_text().endswith("# more\n")


def test_a_word_that_toml_cannot_hold_is_refused() -> None:
    with pytest.raises(ConfigError, match="cannot be put into the file"):
        robot_toml.with_values(EXPLAINED, {("start", "pose"): "a\x7fb"})


def test_a_pose_is_written_on_one_line_and_taken_out_again() -> None:
    pose = {"x": 1.0, "y": 2.0, "yaw": 0.5}
    changed = robot_toml.with_values(EXPLAINED, {("start", "pose"): pose})
    assert "\npose = { x = 1.0, y = 2.0, yaw = 0.5 }\n" in changed
    again = robot_toml.with_values(changed, {("start", "pose"): {**pose, "x": 3.0}})
    assert tomllib.loads(again)["start"]["pose"]["x"] == 3.0
    without = robot_toml.with_values(again, {("start", "pose"): None})
    assert "pose" not in tomllib.loads(without).get("start", {})
    assert without.splitlines()[0] == EXPLAINED.splitlines()[0]
