"""Where a lidar sits, by the static transforms of launch files.

Source:
    `static_transform_publisher` of tf and tf2_ros: x y z, then yaw pitch roll or a quaternion,
    then parent and child, then (tf only) a period.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley_base.importers.linorobot.launch_files import Launch, Value

Matrix = NDArray[np.float64]

BASE, FOOTPRINT = "base_link", "base_footprint"
LASERS = ("laser", "lidar", "base_scan", "scan")
LEVEL_RAD = 0.1
"""A head that leans more than this no longer scans a plane [rad]."""
DEEPEST = 8


@dataclass(frozen=True, slots=True)
class Mount:
    """Where a lidar sits in `base_link`.

    Attributes:
        x_m: forward.
        y_m: left.
        z_m: above the floor.
        yaw: of its x axis [rad].
        is_upside_down: its z axis points down.
        sources: where that stands.
    """

    x_m: float
    y_m: float
    z_m: float
    yaw: float
    is_upside_down: bool
    sources: tuple[Value, ...]


@dataclass(frozen=True, slots=True)
class _Link:
    parent: str
    parent_T_child: Matrix
    source: Value


def find_mount(launch: Launch, problems: list[str]) -> Mount | None:
    """Find the lidar's transform to the base.

    Args:
        launch: what is started.
        problems: is added to where a transform cannot be used.

    Returns:
        None if there is none that leads from a laser to the base.
    """
    links = _links(launch, problems)
    child = next((name for name in links if any(word in name for word in LASERS)), None)
    if child is None:
        return None
    base_T_laser, sources = np.eye(4), list[Value]()
    while child not in (BASE, FOOTPRINT):
        link = links.get(child)
        if link is None or len(sources) > DEEPEST:
            problems.append(f"The lidar's transform leads to {child}, not to {BASE}.")
            return None
        base_T_laser = link.parent_T_child @ base_T_laser
        sources.append(link.source)
        child = link.parent
    height_m = float(base_T_laser[2, 3])
    floor = links.get(BASE)
    if child == BASE and floor is not None and floor.parent == FOOTPRINT:
        height_m += float(floor.parent_T_child[2, 3])
        sources.append(floor.source)
    if abs(base_T_laser[2, 2]) < math.cos(LEVEL_RAD):
        problems.append("The lidar is not mounted level; it is treated as if it were.")
    return Mount(
        x_m=float(base_T_laser[0, 3]),
        y_m=float(base_T_laser[1, 3]),
        z_m=height_m,
        yaw=math.atan2(base_T_laser[1, 0], base_T_laser[0, 0]),
        is_upside_down=bool(base_T_laser[2, 2] < 0.0),
        sources=tuple(sources),
    )


def _links(launch: Launch, problems: list[str]) -> dict[str, _Link]:
    links: dict[str, _Link] = {}
    for node in launch.of_kind("static_transform_publisher"):
        words = node.arguments.value.split()
        frames = [word.lstrip("/") for word in words if not _is_number(word)]
        numbers = [float(word) for word in words if _is_number(word)]
        rotation = _rotation(numbers[3:], is_tf2=node.package == "tf2_ros")
        if len(frames) != 2 or rotation is None:
            place = f"{node.arguments.file}:{node.arguments.line}"
            problems.append(f"{place}: {node.arguments.value!r} is not a static transform.")
            continue
        parent_T_child = np.eye(4)
        parent_T_child[:3, :3] = rotation
        parent_T_child[:3, 3] = numbers[:3]
        links[frames[1]] = _Link(frames[0], parent_T_child, node.arguments)
    return links


def _rotation(numbers: list[float], *, is_tf2: bool) -> Matrix | None:
    """Return the rotation behind x, y and z; None if these are not the right numbers."""
    if not is_tf2 and len(numbers) in (4, 5):  # a period stands behind the frames
        numbers = numbers[:-1]
    if len(numbers) == 3:
        return _from_angles(*numbers)
    return _from_quaternion(np.array(numbers)) if len(numbers) == 4 else None


def _from_angles(yaw: float, pitch: float, roll: float) -> Matrix:
    """Turn about z, then y, then x (REP-103)."""
    (cy, cp, cr), (sy, sp, sr) = np.cos([yaw, pitch, roll]), np.sin([yaw, pitch, roll])
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def _from_quaternion(quaternion: Matrix) -> Matrix | None:
    """Turn by a quaternion x, y, z, w; None for zero."""
    norm = float(np.linalg.norm(quaternion))
    if norm < 1e-6:
        return None
    x, y, z, w = quaternion / norm
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def _is_number(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False
