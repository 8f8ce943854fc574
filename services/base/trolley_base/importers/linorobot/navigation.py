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

import numpy as np
import yaml

from trolley.files import read_file
from trolley.geometry import footprint_from_polygon, footprint_from_radius, pose_from_quaternion
from trolley.gridmap import MapError, load_map
from trolley_base.importers.linorobot.findings import Findings
from trolley_base.importers.linorobot.launch_files import Value, read_parameters, shown

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
SAME_M, SAME_RAD = 1e-6, 0.01
"""A centred box is recognised up to this [m]; two headings up to this are the same [rad]."""

Parameters = Mapping[str, Value]


def take_navigation(findings: Findings, base: str) -> None:
    """Take everything.

    Args:
        findings: is added to.
        base: `LINOBASE`; "" if unknown.
    """
    parameters = _read_parameters(findings, base)
    _take_footprint(findings, parameters)
    _take_speeds(findings, parameters)
    _take_map(findings)
    _take_start(findings)


def _read_parameters(findings: Findings, base: str) -> Parameters:
    files = [path for node in findings.launch.of_kind("move_base") for path in node.files]
    if not files:
        names = (*COSTMAP_FILES, *(HOLONOMIC_FILES if base == "mecanum" else PLANNER_FILES))
        files = [path for name in names for path in sorted(findings.folder.rglob(name))[:1]]
    parameters: dict[str, Value] = {}
    for path in dict.fromkeys(files):
        parameters |= read_parameters(path, findings.folder, findings.notes)
    return parameters


def _take_footprint(findings: Findings, parameters: Parameters) -> None:
    given = parameters.get("footprint") or parameters.get("robot_radius")
    if given is not None:
        try:
            value, words = _footprint(given.value)
        except (TypeError, ValueError, yaml.YAMLError) as error:
            findings.note(f"{findings.place(given)}: the footprint cannot be used: {error}.")
        else:
            findings.take("robot.footprint", value, words, given)
            return
    findings.note(
        "No footprint was found: the file now says 0.30 x 0.24 m. Measure the robot and correct "
        "[robot] footprint before it drives."
    )


def _footprint(value: object) -> tuple[dict[str, Any], str]:
    """Return a footprint in the terms of `robot.toml`, and in words.

    Raises:
        TypeError: it is none.
        ValueError: it is none, or makes no robot; says why.
    """
    plain: Any = yaml.safe_load(value) if isinstance(value, str) else value
    if isinstance(plain, int | float) and not isinstance(plain, bool):
        footprint_from_radius(plain)
        return {"radius_m": float(plain)}, f"footprint with a radius of {plain:g} m"
    try:
        corners = np.asarray(plain, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{plain!r:.80} holds something other than numbers") from error
    footprint_from_polygon(corners)
    half = np.abs(corners).max(axis=0)
    if len(corners) == 4 and np.all(np.abs(np.abs(corners) - half) < SAME_M):
        length, width = (round(2.0 * float(side), 6) for side in half)
        return {"length_m": length, "width_m": width}, f"footprint {length:g} x {width:g} m"
    return {"polygon_m": corners.tolist()}, f"footprint with {len(corners)} corners"


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
        number = _number(given)
        if number is not None and 0.0 < number <= most:
            numbers.append(given._replace(value=number))
        else:
            place = findings.place(given)
            findings.note(f"{place}: {name} is {given.value!r}, which is left out.")
    return numbers


def _take_map(findings: Findings) -> None:
    for node in findings.launch.of_kind("map_server"):
        words = node.arguments.value.split()
        if words:
            _use_map(findings, node.arguments._replace(value=Path(words[0])))
            return
    maps = [path for path in sorted(findings.folder.rglob("*.yaml")) if _looks_like_map(path)]
    usual = [path for path in maps if path.stem == USUAL_MAP]
    if len(maps) == 1 or usual:
        path = (usual or maps)[0]
        _use_map(findings, Value(path, path, 1))
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


def _use_map(findings: Findings, source: Value) -> None:
    """Take the map whose file is the value of `source`, if it is one."""
    path: Path = source.value
    try:
        grid = load_map(path)
    except MapError as error:
        findings.note(f"{findings.place(source)}: no map is taken: {error}.")
        return
    findings.map_file = path
    rows, columns = grid.cells.shape
    size = f"{columns * grid.resolution:.1f} x {rows * grid.resolution:.1f} m"
    findings.take("map.file", f"maps/{path.name}", f"map {path.stem}, {size}", source)


def _take_start(findings: Findings) -> None:
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


def _amcl_parameters(findings: Findings) -> dict[str, Value]:
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
    number = _number(given)
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


def _number(given: Value) -> float | None:
    """Return a finite number, None for anything else."""
    try:
        number = float(given.value)
    except (TypeError, ValueError):
        return None
    return number if math.isfinite(number) else None
