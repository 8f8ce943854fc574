"""A robot.toml from the parameters of Nav2 (ROS 2).

What Nav2 calls by another name, or has no counterpart here, is said in words: nobody should have to
find out by driving that a setting is gone.

Source:
    Nav2's configuration guide, https://docs.nav2.org/configuration.
"""

import fnmatch
import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from trolley.config import ConfigError
from trolley.config.base import LimitsConfig
from trolley.files import expand_home
from trolley.geometry import angle_problem
from trolley_base.importers.findings import Findings, Value
from trolley_base.importers.parameters import read_parameters
from trolley_base.importers.settings import take_footprint, take_map

Parameters = Mapping[str, Value]
"""By path without `ros__parameters`: `controller_server.FollowPath.vx_max`."""

CONTROLLER, COSTMAPS = "controller_server.*.", ("local_costmap.*", "global_costmap.*")
CONTROLLERS = "controller_server.controller_plugins"
SMOOTHED = "velocity_smoother.max_velocity"
SPEEDS = ("vx_max", "max_vel_x", "max_vel_trans", "desired_linear_vel", "v_linear_max")
TURNS = ("wz_max", "max_vel_theta", "rotate_to_heading_angular_vel", "v_angular_max")


class Number(NamedTuple):
    """A setting that is one of Nav2's numbers."""

    key: str
    words: str
    unit: str
    names: tuple[str, ...]
    """Patterns of paths; the first that the file has counts."""
    least: float
    most: float
    """What robot.toml allows; what is outside becomes the nearest."""


def _of(prefix: str, *names: str) -> tuple[str, ...]:
    return tuple(f"{prefix}{name}" for name in names)


NUMBERS = (
    Number("planner.max_speed_mps", "speed", "m/s", _of(CONTROLLER, *SPEEDS), 0.01, 5.0),
    Number("planner.max_turn_radps", "turn rate", "rad/s", _of(CONTROLLER, *TURNS), 0.01, 20.0),
    Number(
        "planner.acceleration_mps2",
        "acceleration",
        "m/s²",
        _of(CONTROLLER, "ax_max", "acc_lim_x", "max_linear_accel"),
        0.05,
        20.0,
    ),
    Number(
        "planner.angular_acceleration_radps2",
        "angular acceleration",
        "rad/s²",
        _of(CONTROLLER, "az_max", "acc_lim_theta", "max_angular_accel"),
        0.05,
        20.0,
    ),
    Number(
        "planner.control_rate_hz",
        "control rate",
        "Hz",
        ("controller_server.controller_frequency",),
        5.0,
        30.0,
    ),
    Number(
        "planner.progress_distance_m",
        "progress that is expected",
        "m",
        ("controller_server.*.required_movement_radius",),
        0.01,
        100.0,
    ),
    Number(
        "planner.progress_s",
        "time for that progress",
        "s",
        ("controller_server.*.movement_time_allowance",),
        1.0,
        3600.0,
    ),
    Number(
        "planner.mark_range_m",
        "range of obstacles",
        "m",
        _of("local_costmap.*", ".obstacle_max_range", ".obstacle_range"),
        0.1,
        100.0,
    ),
    Number(
        "planner.clear_range_m",
        "range of clearing",
        "m",
        _of("local_costmap.*", ".raytrace_max_range", ".raytrace_range"),
        0.1,
        100.0,
    ),
)

DEFAULT_SPEED_MPS = LimitsConfig().max_speed_mps
DEFAULT_TURN_RADPS = LimitsConfig().max_wz_radps
DEFAULT_ACCELERATION_MPS2 = LimitsConfig().acceleration_mps2
NUM_AXES = 3
"""Of a velocity: x, y, theta."""

ZONES = (
    "What is forbidden or slow there is free to the planner until you draw no-go and slow zones "
    "in the viewer, or put them with `trolley.Robot.put_zone`."
)
LEFT: tuple[tuple[str, str], ...] = (
    (
        "*.xy_goal_tolerance",
        "A goal brings its own: `trolley go NAME --xy-tolerance M`; 0.05 m unless given.",
    ),
    (
        "*.yaw_goal_tolerance",
        "A goal brings its own: `trolley go NAME --yaw-tolerance RAD`; 0.05 rad unless given.",
    ),
    (
        "*.inflation_radius",
        "The cost beside obstacles falls off without an edge: [planner] inflation_falloff_m.",
    ),
    (
        "*decel*",
        "How hard the robot surely brakes keeps it from walls: measure it, and set [base.limits] "
        "deceleration_mps2.",
    ),
    ("*.ax_min", "See deceleration: [base.limits] deceleration_mps2 is what it surely reaches."),
    (
        "*.footprint_padding",
        "The planner keeps its own distance beside the footprint: [planner] clearance_m.",
    ),
    ("*costmap*filter*", ZONES),
    ("*filter_mask_server.*", ZONES),
    ("*costmap*voxel*", "There is no 3D costmap; another sensor can be published as costs."),
    ("*costmap*", "One costmap, made from map and lidar, sets itself up."),
    ("amcl.*", "The localizer has other parameters, which need no tuning to a robot."),
    ("bt_navigator*", "There are no behaviour trees: tours, and what the planner does when stuck."),
    ("controller_server.*", "The controller scores in its own terms."),
    ("planner_server.*", "One planner: the cost-to-go, and a search over poses in tight places."),
    ("smoother_server.*", "Paths are smoothed as they are planned."),
    ("behavior_server.*", "Backing up and turning free are built in; [planner] back_up_m."),
    ("recoveries_server.*", "Backing up and turning free are built in; [planner] back_up_m."),
    ("waypoint_follower.*", "Write a tour: `trolley tour --help`."),
    ("velocity_smoother.*", "`base` keeps each command to [base.limits]."),
    (
        "collision_monitor.*",
        "The stop field of `base` is always on and knows how far it brakes.",
    ),
    ("docking_server.*", "There is no docking yet."),
    ("map_server.*", "A map has its file's name."),
    ("map_saver.*", "`trolley map` saves maps."),
    ("slam_toolbox.*", "`trolley map new` makes maps; the mapper has other parameters."),
    ("*", "Trolley has no such part."),
)
"""Patterns of paths, and why what matches is not taken; the first that matches counts."""
NODES = {"local_costmap", "global_costmap"} | {
    pattern.removesuffix(".*") for pattern, _ in LEFT if not pattern.startswith("*")
}
"""Names of Nav2's programs; what stands before one is a namespace."""


def read_nav2(path: Path) -> Findings:
    """Find out what a parameter file of Nav2 says of the robot.

    Args:
        path: such as `nav2_params.yaml`.

    Raises:
        ConfigError: It cannot be read.
    """
    findings = Findings(path.parent)
    problems: list[str] = []
    found = read_parameters(path, path.parent, problems)
    if problems:
        raise ConfigError(problems[0])
    parameters = {_plain(name): value for name, value in found.items()}
    used: set[str] = set()
    for take in (_take_shape, _take_numbers, _take_limits, _take_costs, _take_map, _take_start):
        used.update(take(findings, parameters))
    if findings.taken:
        _tell_what_is_left(findings, [name for name in parameters if name not in used])
    return findings


def _plain(name: str) -> str:
    """A path without the words that ROS puts into each: namespaces, and a costmap's name twice."""
    node, marker, parameter = name.partition("ros__parameters.")
    if not marker:
        return name
    parts = [part for part in re.split(r"[./]", node) if part not in ("", "*", "**")]
    first = next((i for i, part in enumerate(parts) if part in NODES), 0)
    parts = list(dict.fromkeys(parts[first:]))
    return ".".join([*parts, parameter])


def _find(parameters: Parameters, *patterns: str) -> tuple[str, Value] | None:
    """The first parameter that any of the patterns names, patterns in their order."""
    for pattern in patterns:
        for name, value in parameters.items():
            if fnmatch.fnmatchcase(name, pattern):
                return name, value
    return None


def _all(parameters: Parameters, *patterns: str) -> Iterator[str]:
    for name in parameters:
        if any(fnmatch.fnmatchcase(name, pattern) for pattern in patterns):
            yield name


def _take_shape(findings: Findings, parameters: Parameters) -> Iterator[str]:
    polygons = tuple(f"{one}footprint" for one in COSTMAPS)
    radii = tuple(f"{one}robot_radius" for one in COSTMAPS)
    written = {name: value for name, value in parameters.items() if value.value not in ("", "[]")}
    found = _find(written, *polygons, *radii)
    take_footprint(findings, None if found is None else found[1])
    yield from _all(parameters, *polygons, *radii)
    model = _find(parameters, "amcl.robot_model_type", "controller_server.*.motion_model")
    steered = _find(parameters, "controller_server.*.motion_model")
    if steered is not None and "ackermann" in str(steered[1].value).lower():
        findings.note(
            f"{findings.place(steered[1])}: the robot steers like a car, which Trolley cannot "
            "drive: its robots turn on the spot."
        )
        yield steered[0]
    elif model is not None:
        is_omni = "omni" in str(model[1].value).lower()
        drive = "mecanum" if is_omni else "differential"
        findings.take("robot.drive", drive, f"{drive} drive", model[1])
        yield from _all(parameters, "amcl.robot_model_type", "controller_server.*.motion_model")


def _take_numbers(findings: Findings, parameters: Parameters) -> Iterator[str]:
    plugins: Any = parameters[CONTROLLERS].value if CONTROLLERS in parameters else None
    used = (
        f"controller_server.{plugins[0]}." if isinstance(plugins, list) and plugins else CONTROLLER
    )
    for wanted in NUMBERS:
        names = [name.replace(CONTROLLER, used) for name in wanted.names]
        found = _find(parameters, *names, *wanted.names)
        number = None if found is None else found[1].number
        if found is None:
            continue
        name, value = found
        yield name
        if number is None or number <= 0.0:
            place = findings.place(value)
            findings.note(f"{place}: {name} is {value.value!r}, which is left out.")
            continue
        taken = min(max(number, wanted.least), wanted.most)
        if taken != number:
            findings.note(
                f"{findings.place(value)}: {name} is {number:g} {wanted.unit}; the nearest that "
                f"Trolley can do is {taken:g}."
            )
        findings.take(wanted.key, taken, f"{wanted.words} {taken:g} {wanted.unit}", value)


def _take_limits(findings: Findings, parameters: Parameters) -> Iterator[str]:
    """The limits of the base: the velocity smoother's, and at least what the planner may do."""
    found = parameters.get(SMOOTHED)
    axes: list[float | None] = [None] * NUM_AXES
    if found is not None:
        value: Any = found.value
        if isinstance(value, list) and len(value) == NUM_AXES:
            axes = [found._replace(value=one).number for one in value]
        yield SMOOTHED
    rows = (
        ("base.limits.max_speed_mps", "planner.max_speed_mps", DEFAULT_SPEED_MPS, 5.0, 0, "m/s"),
        (
            "base.limits.max_wz_radps",
            "planner.max_turn_radps",
            DEFAULT_TURN_RADPS,
            20.0,
            2,
            "rad/s",
        ),
    )
    for key, planner, default, most, axis, unit in rows:
        wanted = float(findings.chosen.get(planner, default))
        limit = axes[axis]
        if found is not None and limit is not None and 0.0 < limit <= most:
            findings.take(key, limit, f"limit of the base {limit:g} {unit}", found)
            if limit < wanted:
                findings.set(planner, limit)
            continue
        if wanted > default:
            findings.set(key, wanted)
        if found is not None:
            findings.note(
                f"{findings.place(found)}: {SMOOTHED} is {found.value!r}, which gives no limit of "
                f"up to {most:g} {unit}: {max(wanted, default):g} {unit} is used."
            )
    acceleration = float(findings.chosen.get("planner.acceleration_mps2", 0.0))
    if acceleration > DEFAULT_ACCELERATION_MPS2:
        findings.note(
            f"`base` still accelerates at {DEFAULT_ACCELERATION_MPS2:g} m/s² at most: raise "
            "[base.limits] acceleration_mps2 if the robot can do more."
        )


def _take_costs(findings: Findings, parameters: Parameters) -> Iterator[str]:
    found = _find(parameters, *(f"{one}cost_scaling_factor" for one in COSTMAPS))
    factor = None if found is None else found[1].number
    if found is not None and factor is not None and factor >= 0.01:
        # Nav2's cost is exp(-factor * distance); ours falls to 1/e over the falloff.
        falloff_m = round(1.0 / factor, 4)
        words = f"cost beside obstacles falls to 1/e over {falloff_m:g} m"
        findings.take("planner.inflation_falloff_m", falloff_m, words, found[1])
        yield from _all(parameters, *(f"{one}cost_scaling_factor" for one in COSTMAPS))
    unknown = _find(parameters, "planner_server.*.allow_unknown")
    if unknown is not None and isinstance(unknown[1].value, bool):
        may = unknown[1].value
        words = f"paths {'may' if may else 'may not'} lead through the unknown"
        findings.take("planner.unknown_is_free", may, words, unknown[1])
        yield unknown[0]
    frame = _find(parameters, "bt_navigator.global_frame", "global_costmap.global_frame")
    if frame is not None and frame[1].value == "odom":
        findings.take("planner.frame", "odom", "goals in the frame odom, without a map", frame[1])
        yield from _all(parameters, "bt_navigator.global_frame", "global_costmap.global_frame")


def _take_map(findings: Findings, parameters: Parameters) -> Iterator[str]:
    found = _find(parameters, "map_server.yaml_filename")
    if found is None or not str(found[1].value).strip():
        return
    path = expand_home(str(found[1].value))
    take_map(findings, found[1]._replace(value=findings.folder / path))
    yield found[0]


def _take_start(findings: Findings, parameters: Parameters) -> Iterator[str]:
    wanted = _find(parameters, "amcl.set_initial_pose")
    names = [f"amcl.initial_pose.{axis}" for axis in ("x", "y", "yaw")]
    numbers = [parameters[name].number if name in parameters else None for name in names]
    if wanted is None or wanted[1].value is not True or None in numbers[:2]:
        findings.note("No start pose is set: the robot searches the map when it starts.")
        return
    x, y, yaw = (number or 0.0 for number in numbers)
    if problem := angle_problem(yaw):
        place = findings.place(parameters[names[2]])
        findings.note(f"{place}: no start pose is taken: the yaw {problem}.")
        return
    pose: dict[str, Any] = {"x": x, "y": y, "yaw": yaw}
    words = f"start at x {x:.3f} m, y {y:.3f} m, {math.degrees(yaw):.1f}°"
    findings.take(
        "start.pose", pose, words, *(parameters[one] for one in names if one in parameters)
    )
    yield wanted[0]
    yield from (one for one in names if one in parameters)


def _tell_what_is_left(findings: Findings, names: list[str]) -> None:
    """Say of each parameter, or of many of one part together, why it is not taken."""
    reasons: dict[str, list[str]] = {}
    for name in names:
        reason = next(why for pattern, why in LEFT if fnmatch.fnmatchcase(name, pattern))
        reasons.setdefault(reason, []).append(name)
    for reason, some in reasons.items():
        first = some[0]
        rest = f" and {len(some) - 1} more" if len(some) > 1 else ""
        findings.left.append((f"{first}{rest}", reason))
