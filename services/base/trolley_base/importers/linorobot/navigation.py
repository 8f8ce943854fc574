"""Footprint, speeds, map and start pose of a linorobot's navigation files.

Source:
    costmap_2d (footprint, robot_radius), base_local_planner and dwa_local_planner (speeds),
    map_server (map), AMCL (start pose).
"""

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from trolley.files import read_file
from trolley.geometry import pose_from_quaternion
from trolley_base.importers.findings import Findings, Value, shown
from trolley_base.importers.linorobot.findings import LinorobotFindings
from trolley_base.importers.parameters import read_parameters
from trolley_base.importers.settings import take_footprint, take_map

COSTMAP_FILES = ("costmap_common_params.yaml",)
"""Where parameters lie if no launch file says so, in the versions of linorobot."""
PLANNER_FILES = ("base_local_planner_default_params.yaml", "base_local_planner_params.yaml")
HOLONOMIC_FILES = ("base_local_planner_holonomic_params.yaml",)
USUAL_MAP = "house"
"""linorobot's own name for the map, if there are several and no launch file says which."""

SPEEDS = ("max_vel_x", "max_vel_trans", "max_trans_vel")
TURNS = ("max_vel_theta", "max_rot_vel", "min_in_place_vel_theta")
"""In place, ROS's planner turns at least as fast as the last, whatever the others say."""
DEFAULT_SPEED_MPS, DEFAULT_TURN_RADPS = 0.5, 1.5
MOST_SPEED_MPS, MOST_TURN_RADPS = 5.0, 10.0
SAME_RAD = 0.01
"""Two headings up to this are the same [rad]."""

Parameters = Mapping[str, Value]


def take_navigation(findings: LinorobotFindings, base: str) -> None:
    """Take everything.

    Args:
        findings: is added to.
        base: `LINOBASE`; "" if unknown.
    """
    parameters = _read_parameters(findings, base)
    take_footprint(findings, parameters.get("footprint") or parameters.get("robot_radius"))
    _take_speeds(findings, parameters)
    _take_map(findings)
    _take_start(findings)


def _read_parameters(findings: LinorobotFindings, base: str) -> Parameters:
    files = [path for node in findings.launch.of_kind("move_base") for path in node.files]
    if not files:
        names = (*COSTMAP_FILES, *(HOLONOMIC_FILES if base == "mecanum" else PLANNER_FILES))
        files = [path for name in names for path in sorted(findings.folder.rglob(name))[:1]]
    parameters: dict[str, Value] = {}
    for path in dict.fromkeys(files):
        read = read_parameters(path, findings.folder, findings.notes)
        parameters |= {name.rpartition(".")[2]: value for name, value in read.items()}
    return parameters


def _take_speeds(findings: Findings, parameters: Parameters) -> None:
    speeds = _numbers(findings, parameters, SPEEDS, MOST_SPEED_MPS)
    turns = _numbers(findings, parameters, TURNS, MOST_TURN_RADPS)
    if speeds:
        speed = speeds[0]
        findings.take("planner.max_speed_mps", speed.value, f"speed {speed.value:g} m/s", speed)
        if speed.value > DEFAULT_SPEED_MPS:
            findings.set("base.limits.max_speed_mps", speed.value)
    else:
        findings.note(f"No speed was found: {DEFAULT_SPEED_MPS} m/s is used.")
    if turns:
        turn = max(turns, key=lambda one: one.value)
        words = f"turn rate {turn.value:g} rad/s"
        findings.take("planner.max_turn_radps", turn.value, words, turn)
        if turn.value > DEFAULT_TURN_RADPS:
            findings.set("base.limits.max_wz_radps", turn.value)
    else:
        findings.note(f"No turn rate was found: {DEFAULT_TURN_RADPS} rad/s is used.")


def _numbers(
    findings: Findings, parameters: Parameters, names: tuple[str, ...], most: float
) -> list[Value]:
    """Return those of the parameters that are numbers in (0, most]."""
    numbers: list[Value] = []
    for name in names:
        given = parameters.get(name)
        if given is None:
            continue
        number = given.number
        if number is not None and 0.0 < number <= most:
            numbers.append(given._replace(value=number))
        else:
            place = findings.place(given)
            findings.note(f"{place}: {name} is {given.value!r}, which is left out.")
    return numbers


def _take_map(findings: LinorobotFindings) -> None:
    for node in findings.launch.of_kind("map_server"):
        words = node.arguments.value.split()
        if words:
            take_map(findings, node.arguments._replace(value=Path(words[0])))
            return
    maps = [path for path in sorted(findings.folder.rglob("*.yaml")) if _looks_like_map(path)]
    usual = [path for path in maps if path.stem == USUAL_MAP]
    if len(maps) == 1 or usual:
        path = (usual or maps)[0]
        take_map(findings, Value(path, path, 1))
    elif maps:
        names = ", ".join(shown(path, findings.folder) for path in maps)
        findings.note(f"There are several maps ({names}): name one in [map] file.")
    else:
        findings.note("No map was found: name one in [map] file before the robot drives to places.")


def _looks_like_map(path: Path) -> bool:
    try:
        text = read_file(path).decode("utf-8", "replace")
    except OSError:
        return False  # what cannot be read is not a map that could be taken
    return all(re.search(rf"(?m)^{key}:", text) for key in ("image", "resolution", "origin"))


def _take_start(findings: LinorobotFindings) -> None:
    start = {
        name.removeprefix("initial_"): given._replace(value=number)
        for name, given in _amcl_parameters(findings).items()
        if (number := _start_number(findings, name, given)) is not None
    }
    if "pose_x" not in start and "pose_y" not in start:
        findings.note("No start pose was found: the robot searches the map when it starts.")
        return
    pose: dict[str, Any] = {
        axis: start[f"pose_{axis}"].value if f"pose_{axis}" in start else 0.0 for axis in "xy"
    }
    yaw = _take_heading(findings, start, pose)
    words = f"start at x {pose['x']:.3f} m, y {pose['y']:.3f} m, {math.degrees(yaw):.1f}°"
    findings.take("start.pose", pose, words, *start.values())


def _amcl_parameters(findings: LinorobotFindings) -> dict[str, Value]:
    """What AMCL is told about its start, inside of its node and outside."""
    nodes = findings.launch.of_kind("amcl")
    prefixes = [f"{node.name}/" for node in nodes]
    found = {
        name.removeprefix(prefix): value
        for name, value in findings.launch.params.items()
        for prefix in prefixes
        if name.startswith(prefix)
    }
    for node in nodes:
        found |= node.params
    return {name: value for name, value in found.items() if name.startswith("initial_")}


def _start_number(findings: Findings, name: str, given: Value) -> float | None:
    if not name.startswith(("initial_pose_", "initial_orientation_")):
        return None
    number = given.number
    if number is None:
        place = findings.place(given)
        findings.note(f"{place}: {name} is {given.value!r}, not a number; it is left out.")
    return number


def _take_heading(findings: Findings, start: Parameters, pose: dict[str, Any]) -> float:
    """Put yaw or orientation into a start pose; return the yaw [rad]."""
    quaternion = [
        start[name].value if (name := f"orientation_{axis}") in start else default
        for axis, default in zip("xyzw", (0.0, 0.0, 0.0, 1.0), strict=True)
    ]
    turned: float | None = None
    if any(name.startswith("orientation_") for name in start):
        try:
            turned = pose_from_quaternion(0.0, 0.0, quaternion).yaw
        except ValueError as error:
            findings.note(f"initial_orientation_* cannot be used: {error}.")
    if turned is not None and "pose_a" not in start:
        pose["orientation"] = quaternion
        findings.note(
            f"AMCL ignored initial_orientation_*, so your robot started with heading 0; "
            f"Trolley uses {math.degrees(turned):.1f}°."
        )
        return turned
    yaw = float(start["pose_a"].value) if "pose_a" in start else 0.0
    if turned is not None and abs(math.remainder(turned - yaw, math.tau)) > SAME_RAD:
        findings.note(
            f"initial_pose_a says {math.degrees(yaw):.1f}°, initial_orientation_* "
            f"{math.degrees(turned):.1f}°: AMCL uses only the first, and so does Trolley."
        )
    pose["yaw"] = yaw
    return yaw
