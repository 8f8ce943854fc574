"""What is taken from a linorobot's files."""

import math
import tomllib
from pathlib import Path
from typing import Any

import pytest

from trolley_base.importers.linorobot.findings import LinorobotFindings
from trolley_base.importers.linorobot.reading import read_linorobot

from .conftest import Package

COSTMAP = "param/navigation/costmap_common_params.yaml"
PLANNER = "param/navigation/base_local_planner_default_params.yaml"
AMCL = "launch/include/amcl.launch"
LASER = "launch/include/laser.launch"


def value(findings: LinorobotFindings, key: str) -> Any:
    return tomllib.loads(f"value = {findings.chosen[key]}")["value"]


def notes(findings: LinorobotFindings) -> str:
    return "\n".join(findings.notes)


def test_takes_what_the_author_wrote(package: Package) -> None:
    findings = read_linorobot(package.folder, "2wd", "xv11")
    assert value(findings, "robot.footprint") == {"length_m": 0.32, "width_m": 0.22}
    assert value(findings, "robot.drive") == "differential"
    assert value(findings, "planner.max_speed_mps") == 0.35
    assert value(findings, "base.driver") == "hardware"
    assert value(findings, "base.chassis.board") == "linorobot"
    assert value(findings, "base.chassis.port") == "/dev/linobase"
    assert value(findings, "base.lidar.model") == "xv11"
    assert value(findings, "base.lidar.port") == "/dev/linolidar"
    assert value(findings, "base.lidar.pose") == {"x": 0.07, "y": -0.01, "yaw": 0.5}
    assert value(findings, "base.lidar.z_m") == pytest.approx(0.15)
    assert findings.map_file == package.path("maps/house.yaml")
    assert "base.chassis.baud" not in findings.chosen


def test_says_from_which_line(package: Package) -> None:
    taken = dict(read_linorobot(package.folder, "2wd", "xv11").taken)
    assert taken["footprint 0.32 x 0.22 m"] == f"{COSTMAP}:2"
    assert taken["start at x 0.549 m, y 0.218 m, 14.8°"] == f"{AMCL}:4-8"
    assert taken["speed 0.35 m/s"] == f"{PLANNER}:2"


def test_uses_the_heading_that_amcl_ignored(package: Package) -> None:
    findings = read_linorobot(package.folder, "2wd", "xv11")
    assert value(findings, "start.pose") == {
        "x": 0.548767569629,
        "y": 0.218281839179,
        "orientation": [0.0, 0.0, 0.128591756735, 0.991697615254],
    }
    assert (
        "AMCL ignored initial_orientation_*, so your robot started with heading 0; "
        "Trolley uses 14.8°." in findings.notes
    )


def test_takes_the_heading_that_amcl_knew(package: Package) -> None:
    old = '<param name="initial_pose_z" value="0.0"/>'
    package.change(AMCL, old, '<param name="initial_pose_a" value="1.5"/>')
    findings = read_linorobot(package.folder, "2wd", "xv11")
    assert value(findings, "start.pose")["yaw"] == 1.5
    assert "AMCL uses only the first" in notes(findings)


def test_takes_parameters_that_stand_outside_of_the_node(package: Package) -> None:
    package.write(
        AMCL,
        '<launch><param name="/amcl/initial_pose_x" value="2.5"/>\n'
        '<node pkg="amcl" type="amcl" name="amcl"/></launch>\n',
    )
    findings = read_linorobot(package.folder, "2wd", "xv11")
    assert value(findings, "start.pose") == {"x": 2.5, "y": 0.0, "yaw": 0.0}


def test_leaves_out_what_is_no_number(package: Package) -> None:
    package.change(AMCL, "0.548767569629", "here")
    package.change(PLANNER, "max_vel_x: 0.35", "max_vel_x: fast")
    findings = read_linorobot(package.folder, "2wd", "xv11")
    assert value(findings, "start.pose")["x"] == 0.0
    assert f"{AMCL}:4: initial_pose_x is 'here'" in notes(findings)
    assert f"{PLANNER}:2: max_vel_x is 'fast'" in notes(findings)
    assert "planner.max_speed_mps" not in findings.chosen


@pytest.mark.parametrize(
    ("footprint", "expected"),
    [
        ("[[0.2, 0.1], [0.2, -0.1], [-0.1, -0.1], [-0.1, 0.1]]", "polygon_m"),
        ('"[[0.2, 0.1], [0.2, -0.1], [-0.2, -0.1], [-0.2, 0.1]]"', "length_m"),
    ],
)
def test_knows_other_footprints(package: Package, footprint: str, expected: str) -> None:
    package.write(COSTMAP, f"footprint: {footprint}\n")
    findings = read_linorobot(package.folder, "2wd", "xv11")
    assert expected in value(findings, "robot.footprint")


def test_knows_a_round_robot(package: Package) -> None:
    package.write(COSTMAP, "robot_radius: 0.17\n")
    findings = read_linorobot(package.folder, "2wd", "xv11")
    assert value(findings, "robot.footprint") == {"radius_m": 0.17}


@pytest.mark.parametrize(
    "footprint",
    [
        "[[-x, -y], [-x, y], [x, y], [x, -y]]",
        "[[0.1, 0.1]]",
        "[[0.1, 0.1], [0.2, 0.1], [0.3, 0.1]]",
        "[[30, 20], [-30, 20], [-30, -20], [30, -20]]",
        "[[0.1, 0.1], [0.2]]",
        "true",
        "{a: 1}",
        '"[[0.1"',
        "[]",
    ],
)
def test_refuses_a_footprint_that_is_none(package: Package, footprint: str) -> None:
    package.write(COSTMAP, f"obstacle_range: 2.5\nfootprint: {footprint}\n")
    findings = read_linorobot(package.folder, "2wd", "xv11")
    assert "robot.footprint" not in findings.chosen
    assert "Measure the robot" in notes(findings)


def test_names_file_and_line_of_broken_yaml(package: Package) -> None:
    package.write(COSTMAP, "obstacle_range: 2.5\nfootprint: [[-0.1, 0.1]\nnext: 1\n")
    findings = read_linorobot(package.folder, "2wd", "xv11")
    assert f"{COSTMAP}:3 is not valid YAML" in notes(findings)
    assert value(findings, "planner.max_speed_mps") == 0.35


def test_names_file_and_line_of_broken_xml(package: Package) -> None:
    # As in the article that this command is made for.
    broken = '<launch>\n  <node pkg="amcl" type="amcl" name="amcl" </node>\n</launch>\n'
    package.write(AMCL, broken)
    findings = read_linorobot(package.folder, "2wd", "xv11")
    assert f"{AMCL}:2 is not valid XML" in notes(findings)
    assert "start.pose" not in findings.chosen
    assert findings.map_file is not None


def test_says_that_the_maps_image_is_missing(package: Package) -> None:
    package.path("maps/house.pgm").unlink()
    findings = read_linorobot(package.folder, "2wd", "xv11")
    assert findings.map_file is None
    assert "map.file" not in findings.chosen
    assert "house.pgm" in notes(findings)


def test_does_without_environment(package: Package) -> None:
    findings = read_linorobot(package.folder, "", "")
    assert "robot.drive" not in findings.chosen
    assert "base.lidar.model" not in findings.chosen
    assert value(findings, "base.chassis.board") == "linorobot"
    assert value(findings, "robot.footprint") == {"length_m": 0.32, "width_m": 0.22}
    text = notes(findings)
    assert f"{LASER}:2: $(env LINOLIDAR) is not set" in text
    assert "--base 4wd" in text


def test_sets_no_board_for_a_base_that_it_cannot_drive(package: Package) -> None:
    findings = read_linorobot(package.folder, "ackermann", "xv11")
    assert "base.chassis.board" not in findings.chosen
    assert "cannot drive a base of the kind ackermann" in notes(findings)


def test_knows_that_an_x4_is_faster(package: Package) -> None:
    findings = read_linorobot(package.folder, "2wd", "ydlidar")
    assert value(findings, "base.lidar.model") == "ydlidar_x4"
    assert "base.lidar.baud" not in findings.chosen
    assert "an X4 talks at 128000" in notes(findings)


@pytest.mark.parametrize(
    ("reversion", "yaw", "says"),
    [("true", 0.5 - math.pi, "turns the YDLIDAR's angles"), ("false", 0.5, ""), (None, 0.5, "add")],
)
def test_turns_an_x4_as_its_driver_does(
    package: Package, reversion: str | None, yaw: float, says: str
) -> None:
    if reversion is not None:
        package.change(
            "launch/include/lidar/ydlidar.launch",
            "</node>",
            f'<param name="reversion" type="bool" value="{reversion}"/></node>',
        )
    findings = read_linorobot(package.folder, "2wd", "ydlidar")
    assert value(findings, "base.lidar.pose")["yaw"] == pytest.approx(yaw, abs=1e-6)
    assert says in notes(findings)
    assert says or "reversion" not in notes(findings)


def test_knows_that_a_fast_rplidar_is_no_a1(package: Package) -> None:
    package.change("launch/include/lidar/rplidar.launch", "115200", "256000")
    findings = read_linorobot(package.folder, "2wd", "rplidar")
    assert "base.lidar.model" not in findings.chosen
    assert "is not an A1" in notes(findings)


def test_turns_an_rplidar_as_its_driver_counts(package: Package) -> None:
    findings = read_linorobot(package.folder, "2wd", "rplidar")
    assert value(findings, "base.lidar.pose")["yaw"] == pytest.approx(0.5 - math.pi, abs=1e-6)


@pytest.mark.parametrize(
    ("inverted", "roll", "is_upside_down"),
    [("false", "0", False), ("true", "0", True), ("true", "3.14159265", False)],
)
def test_an_rplidar_whose_driver_mirrors_its_scan_is_turned_over(
    package: Package, inverted: str, roll: str, is_upside_down: bool
) -> None:
    param = f'<param name="inverted" type="bool" value="{inverted}"/></node>'
    package.change("launch/include/lidar/rplidar.launch", "</node>", param)
    package.change(LASER, "0.1 0.5 0 0  /base", f"0.1 0.5 0 {roll}  /base")
    findings = read_linorobot(package.folder, "2wd", "rplidar")
    assert ("base.lidar.upside_down" in findings.chosen) == is_upside_down
    # It looks where it looked: rplidar_ros mirrors about the axis of its zero.
    assert value(findings, "base.lidar.pose")["yaw"] == pytest.approx(0.5 - math.pi, abs=1e-6)


def test_an_ld19_whose_driver_leaves_its_scan_clockwise_is_turned_over(package: Package) -> None:
    package.write(
        "launch/include/lidar/ld19.launch",
        '<launch><node name="LD19" pkg="ldlidar_stl_ros" type="ldlidar_stl_ros_node">'
        '<param name="laser_scan_dir" type="bool" value="false"/></node></launch>\n',
    )
    findings = read_linorobot(package.folder, "2wd", "ld19")
    assert value(findings, "base.lidar.model") == "ld19"
    assert value(findings, "base.lidar.upside_down") is True
    assert value(findings, "base.lidar.pose")["yaw"] == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("arguments", "yaw", "is_upside_down"),
    [
        ("0.1 0 0.1 0.5 0 0 base_link laser", 0.5, False),
        ("0.1 0 0.1 0.5 0 3.14159265 base_link laser", 0.5, True),
        ("0.1 0 0.1 0.5 3.14159265 0 base_link laser", 0.5 - math.pi, True),
        ("0.1 0 0.1 0 0 0.247404 0.968912 base_link laser", 0.5, False),
        ("0.1 0 0.1 1 0 0 0 base_link laser", 0.0, True),
    ],
)
def test_reads_how_the_lidar_is_turned(
    package: Package, arguments: str, yaw: float, is_upside_down: bool
) -> None:
    old = "0.07 -0.01 0.1 0.5 0 0  /base_link /laser"
    package.change(LASER, old, arguments)
    findings = read_linorobot(package.folder, "2wd", "xv11")
    pose = value(findings, "base.lidar.pose")
    assert pose["yaw"] == pytest.approx(yaw, abs=1e-4)
    assert pose["x"] == pytest.approx(0.1)
    assert ("base.lidar.upside_down" in findings.chosen) == is_upside_down


def test_reads_the_older_publisher_with_its_period(package: Package) -> None:
    package.write(
        LASER,
        '<launch><node pkg="tf" type="static_transform_publisher" name="x"\n'
        ' args="0.1 0 0.1 0 0 0 base_mount laser_link 100"/>\n'
        '<node pkg="tf" type="static_transform_publisher" name="y"\n'
        ' args="0.2 0.1 0 1.570796 0 0 base_link base_mount 100"/></launch>\n',
    )
    findings = read_linorobot(package.folder, "2wd", "xv11")
    pose = value(findings, "base.lidar.pose")
    assert pose == pytest.approx({"x": 0.2, "y": 0.2, "yaw": math.pi / 2}, abs=1e-5)


@pytest.mark.parametrize(
    "arguments", ["", "1 2 3 base_link laser", "a b c d e f g h", "0 0 0 0 0 0 0 base_link laser"]
)
def test_says_that_a_transform_is_none(package: Package, arguments: str) -> None:
    package.change(LASER, "0.07 -0.01 0.1 0.5 0 0  /base_link /laser", arguments)
    findings = read_linorobot(package.folder, "2wd", "xv11")
    assert "base.lidar.pose" not in findings.chosen
    assert "is not a static transform" in notes(findings)


def test_a_lidar_that_hangs_on_nothing_is_said(package: Package) -> None:
    package.change(LASER, "/base_link /laser", "/arm /laser")
    findings = read_linorobot(package.folder, "2wd", "xv11")
    assert "leads to arm, not to base_link" in notes(findings)


def test_files_that_include_each_other_end(package: Package) -> None:
    package.write(
        AMCL, '<launch><include file="$(find linorobot)/launch/navigate.launch"/></launch>'
    )
    assert read_linorobot(package.folder, "2wd", "xv11").map_file is not None


def test_follows_arguments_and_conditions(package: Package) -> None:
    package.write(
        "launch/navigate.launch",
        '<launch><arg name="sim" default="false"/><arg name="name" default="house"/>\n'
        '<group if="$(arg sim)">\n'
        '<node pkg="map_server" type="map_server" name="a" args="no"/></group>\n'
        '<node pkg="map_server" type="map_server" name="b" unless="$(arg sim)"\n'
        ' args="$(find linorobot)/maps/$(arg name).yaml"/></launch>\n',
    )
    assert read_linorobot(package.folder, "2wd", "xv11").map_file is not None


def test_finds_the_older_places(package: Package) -> None:
    """Before 2018 the files lay one folder higher."""
    for name, older in (
        (AMCL, "launch/amcl.launch"),
        (COSTMAP, "param/costmap_common_params.yaml"),
    ):
        package.path(name).rename(package.path(older))
    package.path("launch/navigate.launch").unlink()
    findings = read_linorobot(package.folder, "2wd", "xv11")
    assert "start.pose" in findings.chosen
    assert value(findings, "robot.footprint") == {"length_m": 0.32, "width_m": 0.22}
    assert "There is no navigate.launch." in notes(findings)


def test_an_empty_package_gives_defaults_and_says_them(package: Package) -> None:
    for path in package.folder.rglob("*.*"):
        path.unlink()
    findings = read_linorobot(package.folder, "", "")
    assert findings.chosen == {"base.driver": '"hardware"', "base.chassis.board": '"linorobot"'}
    assert findings.taken == []
    assert len(findings.notes) >= 8


def test_a_few_files_in_one_folder_are_enough(package: Package, tmp_path: Path) -> None:
    few = tmp_path / "few"
    few.mkdir()
    for path in (package.path(AMCL), package.path(COSTMAP), *package.path("maps").iterdir()):
        (few / path.name).write_bytes(path.read_bytes())
    findings = read_linorobot(few, "", "")
    assert {"start.pose", "robot.footprint", "map.file"} <= findings.chosen.keys()
    assert findings.map_file is not None
    assert findings.map_file.parent == few


def test_of_several_maps_none_is_guessed(package: Package) -> None:
    package.path("launch/navigate.launch").unlink()
    first = next(package.path("maps").glob("*.yaml"))
    for name in ("cellar", "attic"):
        first.with_name(f"{name}.yaml").write_bytes(first.read_bytes())
    first.unlink()
    findings = read_linorobot(package.folder, "", "")
    assert "map.file" not in findings.chosen
    assert "There are several maps (maps/attic.yaml, maps/cellar.yaml)" in notes(findings)
