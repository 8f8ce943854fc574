"""`trolley import nav2`: what is taken, what is not and why."""

import fnmatch
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from trolley.config import load_config
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap, save_map
from trolley_base.commands.import_nav2 import import_nav2
from trolley_base.importers import nav2

PARAMS = """\
amcl:
  ros__parameters:
    use_sim_time: True
    alpha1: 0.2
    laser_max_range: 100.0
    robot_model_type: "nav2_amcl::DifferentialMotionModel"
    set_initial_pose: true
    initial_pose: {x: 1.5, y: -0.5, z: 0.0, yaw: 1.57}
bt_navigator:
  ros__parameters:
    global_frame: map
    default_server_timeout: 20
controller_server:
  ros__parameters:
    controller_frequency: 50.0
    progress_checker:
      required_movement_radius: 0.5
      movement_time_allowance: 10.0
    general_goal_checker:
      xy_goal_tolerance: 0.25
      yaw_goal_tolerance: 0.25
    FollowPath:
      plugin: "nav2_mppi_controller::MPPIController"
      vx_max: 0.7
      wz_max: 1.9
      ax_max: 3.0
      ax_min: -3.0
      az_max: 3.5
      batch_size: 2000
local_costmap:
  local_costmap:
    ros__parameters:
      global_frame: odom
      footprint: "[[0.3, 0.2], [0.3, -0.2], [-0.3, -0.2], [-0.3, 0.2]]"
      inflation_layer:
        cost_scaling_factor: 4.0
        inflation_radius: 0.55
      voxel_layer:
        scan: {raytrace_max_range: 3.0, obstacle_max_range: 2.5}
global_costmap:
  global_costmap:
    ros__parameters:
      robot_radius: 0.22
      track_unknown_space: true
map_server:
  ros__parameters:
    yaml_filename: ""
planner_server:
  ros__parameters:
    GridBased: {plugin: "nav2_navfn_planner/NavfnPlanner", allow_unknown: true}
velocity_smoother:
  ros__parameters:
    max_velocity: [0.5, 0.0, 2.5]
    max_accel: [2.5, 0.0, 3.2]
docking_server:
  ros__parameters:
    dock_plugins: ['simple']
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "nav2_params.yaml"
    path.write_text(PARAMS)
    return path


def run(*arguments: object) -> Result:
    return CliRunner().invoke(import_nav2, [*map(str, arguments)])


def test_it_takes_what_robot_toml_has_too(file: Path, tmp_path: Path) -> None:
    output = tmp_path / "home" / "robot.toml"
    done = run(file, "-o", output)
    assert done.exit_code == 0, done.output
    config = load_config(output)
    assert config.robot.footprint.length_m == 0.6
    assert config.robot.drive == "differential"
    planner, limits = config.planner, config.base.limits
    # The velocity smoother allowed less than the controller.
    assert (planner.max_speed_mps, limits.max_speed_mps) == (0.5, 0.5)
    assert (planner.max_turn_radps, limits.max_wz_radps) == (1.9, 2.5)
    assert (planner.acceleration_mps2, planner.angular_acceleration_radps2) == (3.0, 3.5)
    assert planner.inflation_falloff_m == pytest.approx(1.0 / 4.0)
    assert (planner.mark_range_m, planner.clear_range_m) == (2.5, 3.0)
    assert planner.unknown_is_free
    assert config.start.pose.x == 1.5  # pyrefly: ignore[missing-attribute]
    said = " ".join(done.output.split())
    assert "controller_frequency is 50 Hz; the nearest that Trolley can do is 30" in said
    assert "raise [base.limits] acceleration_mps2" in said
    assert f"{file.name}:24" in said


def test_nothing_is_dropped_silently(file: Path) -> None:
    findings = nav2.read_nav2(file)
    why = " ".join(reason for _, reason in findings.left)
    for words in ("--xy-tolerance", "--yaw-tolerance", "inflation_falloff_m", "deceleration_mps2"):
        assert words in why
    # As many parameters as the file has, each taken or with a reason.
    parameters = nav2.read_parameters(file, file.parent, [])
    left = sum(
        1 + int(what.rpartition(" and ")[2].split()[0]) if " and " in what else 1
        for what, _ in findings.left
    )
    lines = {place.rpartition(":")[2] for _, place in findings.taken}
    assert 0 < left < len(parameters)
    assert len(lines) >= 12


def test_every_parameter_has_a_reason() -> None:
    assert fnmatch.fnmatchcase("anything.at.all", nav2.LEFT[-1][0])


def test_the_map_is_copied_beside_it(file: Path, tmp_path: Path) -> None:
    cells = np.zeros((20, 40), dtype=np.int8)
    cells[0] = 100
    save_map(GridMap("house", 0.05, Pose2D(0.0, 0.0, 0.0), cells), tmp_path / "house.yaml")
    assert "No map is taken" in run(file, "-o", tmp_path / "a" / "robot.toml").output
    output = tmp_path / "out" / "robot.toml"
    result = run(file, "-o", output, "--map", tmp_path / "house.yaml")
    assert (result.exit_code, "No map is taken" in result.output) == (0, False)
    assert (tmp_path / "out" / "maps" / "house.yaml").exists()
    named = tmp_path / "named.yaml"
    named.write_text(PARAMS.replace('yaml_filename: ""', "yaml_filename: house.yaml"))
    assert run(named, "-o", tmp_path / "b" / "robot.toml").exit_code == 0
    assert (tmp_path / "b" / "maps" / "house.pgm").exists()


def test_a_namespace_and_omni_wheels_are_understood(tmp_path: Path) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(
        "/**:\n  controller_server:\n    ros__parameters:\n      FollowPath:\n"
        "        motion_model: Omni\n        vx_max: 0.3\n"
    )
    findings = nav2.read_nav2(path)
    assert findings.chosen["robot.drive"] == '"mecanum"'
    assert findings.chosen["planner.max_speed_mps"] == "0.3"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (b"", "says nothing that Nav2 would read: give a file of its parameters"),
        (b"a: b", "says nothing that Nav2 would read"),
        (b"- 1", "says nothing that Nav2 would read"),
        (b"amcl: {ros__parameters: {alpha1: 1}}", "says nothing that Nav2 would read"),
        (b"[", "p.yaml:1 is not valid YAML"),
        (
            b"a: &a {x: 1}\n"
            + b"".join(
                b"%c: &%c {<<: [*%c, *%c]}\n" % (n, n, n - 1, n - 1) for n in range(98, 123)
            ),
            "p.yaml:7 is not valid YAML (more than 10 references",
        ),
        (b"\xff\xfe\0", "p.yaml is not valid YAML (not UTF-8 text)"),
    ],
)
def test_a_file_that_says_nothing_writes_nothing(tmp_path: Path, text: bytes, why: str) -> None:
    path = tmp_path / "p.yaml"
    path.write_bytes(text)
    done = run(path, "-o", tmp_path / "robot.toml")
    assert done.exit_code == 2
    said = " ".join(done.output.split())
    assert why in said
    assert "footprint" not in said  # nothing was written that it could be about
    assert not (tmp_path / "robot.toml").exists()


@pytest.mark.parametrize("value", ["nan", "-1", "fast", "[]", "{}", "1e999"])
def test_a_value_that_cannot_be_is_left_out_and_said(tmp_path: Path, value: str) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(PARAMS.replace("vx_max: 0.7", f"vx_max: {value}"))
    done = run(path, "-o", tmp_path / "robot.toml")
    assert done.exit_code == 0, done.output
    load_config(tmp_path / "robot.toml")


def read(folder: Path, text: str) -> nav2.Findings:
    path = folder / "p.yaml"
    path.write_text(text)
    return nav2.read_nav2(path)


@pytest.mark.parametrize(
    "text",
    [
        "/robot1:\n" + "".join(f"  {line}\n" for line in PARAMS.splitlines()),
        PARAMS.replace(
            "local_costmap:\n  local_costmap:\n    ros__parameters:",
            "<robot_namespace>/local_costmap:\n  local_costmap:\n    ros__parameters:",
        ),
        PARAMS.replace("controller_server:", "/robot1/controller_server:"),
    ],
)
def test_what_stands_in_a_namespace_is_what_stands_without_one(tmp_path: Path, text: str) -> None:
    assert read(tmp_path, text).chosen == read(tmp_path, PARAMS).chosen


def test_a_robot_that_steers_like_a_car_is_not_called_differential(tmp_path: Path) -> None:
    found = read(tmp_path, PARAMS.replace("batch_size: 2000", 'motion_model: "Ackermann"'))
    assert "robot.drive" not in found.chosen
    assert any("steers like a car" in note for note in found.notes)


def test_a_controller_that_is_not_used_says_nothing(tmp_path: Path) -> None:
    spare = "    Precise: {vx_max: 0.1, desired_linear_vel: 0.1}\n    FollowPath:\n"
    text = PARAMS.replace("    FollowPath:\n", spare).replace(
        "    controller_frequency: 50.0", "    controller_plugins: [FollowPath]"
    )
    assert read(tmp_path, text).chosen["planner.max_turn_radps"] == "1.9"
    assert read(tmp_path, text.replace("[0.5, 0.0, 2.5]", "[5.0, 0.0, 2.5]")).chosen[
        "planner.max_speed_mps"
    ] == ("0.7")


@pytest.mark.parametrize("value", ["[0.5, 0.0]", "[-0.5, 0.0, 2.5]", "[7.0, 0.0, 2.5]", "fast"])
def test_a_limit_that_is_not_taken_is_said(tmp_path: Path, value: str) -> None:
    found = read(tmp_path, PARAMS.replace("[0.5, 0.0, 2.5]", value))
    assert any("velocity_smoother.max_velocity" in note for note in found.notes)


def test_a_start_pose_in_degrees_is_left_out_and_said(tmp_path: Path) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(PARAMS.replace("yaw: 1.57", "yaw: 90.0"))
    done = run(path, "-o", tmp_path / "robot.toml")
    assert done.exit_code == 0, done.output
    assert "p.yaml:8: no start pose is taken: the yaw 90 is more than" in done.output
    assert load_config(tmp_path / "robot.toml").start.pose is None


def test_a_keepout_mask_and_the_padding_have_reasons_of_their_own(tmp_path: Path) -> None:
    text = PARAMS.replace("      robot_radius: 0.22", "      footprint_padding: 0.05")
    mask = "keepout_filter_mask_server:\n  ros__parameters:\n    yaml_filename: keepout.yaml\n"
    left = dict(read(tmp_path, text + mask).left)
    assert "clearance_m" in left["global_costmap.footprint_padding"]
    assert "no-go" in left["keepout_filter_mask_server.yaml_filename"]
