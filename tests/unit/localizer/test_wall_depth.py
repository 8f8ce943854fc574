"""A lidar that sees no opposite wall: the robot is where it is, however thick walls are drawn."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D
from trolley.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from trolley.scanning import ScanInput
from trolley_localizer.core import Localizer
from trolley_localizer.estimate import Estimate

LONG_M, WIDE_M, CELL_M = 4.1, 3.0, 0.05
"""A room, and the cells of its maps."""
AHEAD = np.linspace(-0.5 * math.pi, 0.5 * math.pi, 181)
ROUND_ABOUT = np.linspace(-math.pi, math.pi, 360, endpoint=False)
NOISE_M = 0.01
BODY_M = 0.08
"""How near its own body is."""


def room(wall_m: float, turn: float, margin_m: float = 3.0) -> GridMap:
    """The room as drawn: a cell is wall where its centre is, and floor within the room."""
    origin = Pose2D(0.0, 0.0, turn) @ Pose2D(-margin_m, -margin_m, 0.0)
    rows, cols = np.mgrid[0:240, 0:240]
    centres = CELL_M * (np.stack([cols, rows], axis=-1).reshape(-1, 2) + 0.5)
    x, y = origin.transform_points(centres).T
    beyond = np.maximum.reduce([-x, x - LONG_M, -y, y - WIDE_M])
    cells = np.select([beyond <= 0.0, beyond <= wall_m], [FREE, OCCUPIED], UNKNOWN)
    return GridMap("room", CELL_M, origin, cells.reshape(240, 240).astype(np.int8))


def as_scanned(turn: float) -> GridMap:
    """The room as a robot maps it: the cells in whose middle faces lie, and nothing behind."""
    grid = room(0.5, turn, margin_m=3.0 + 0.5 * CELL_M)
    grid.cells[grid.cells == OCCUPIED] = UNKNOWN
    along = np.linspace(0.0, 1.0, 500)
    x, y = np.meshgrid([0.0, LONG_M], WIDE_M * along)
    u, v = np.meshgrid(LONG_M * along, [0.0, WIDE_M])
    faces = np.stack([np.append(x, u), np.append(y, v)], axis=-1)
    rows, cols = grid.world_to_cell(faces).T
    grid.cells[rows, cols] = OCCUPIED
    return grid


def ranges(at: Pose2D, angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far the faces of the room are [m]."""
    cos, sin = np.cos(at.yaw + angles), np.sin(at.yaw + angles)
    with np.errstate(divide="ignore"):
        to_x = np.where(cos > 0.0, (LONG_M - at.x) / cos, -at.x / cos)
        to_y = np.where(sin > 0.0, (WIDE_M - at.y) / sin, -at.y / sin)
    return np.minimum(to_x, to_y)


def error_m(
    grid: GridMap, angles: NDArray[np.float64], hidden: NDArray[np.bool_] | None = None
) -> float:
    """How far off it is said to be in 95 % of a circle through the room, once it has begun [m]."""
    localizer, rng = Localizer(grid, [], LocalizerConfig(), 1), np.random.default_rng(2)
    found: list[float] = []
    for k in range(160):
        turned = 0.06 * k
        at = Pose2D(2.0 + 0.7 * math.sin(turned), 1.5 - 0.7 * math.cos(turned), turned)
        noise = NOISE_M * rng.standard_normal(angles.size)
        seen = ranges(at, angles) + noise
        if hidden is not None:
            seen[hidden] = BODY_M
        if k == 0:
            localizer.set_pose(at)
        scan = ScanInput(
            stamp_ns=1 + 100_000_000 * k,
            ranges=seen.astype(np.float32),
            angle_min=float(angles[0]),
            angle_increment=float(angles[1] - angles[0]),
            range_min=0.1,
            range_max=12.0,
            base_T_laser=Pose2D.identity(),
            odom_T_base=at,
            odom_T_base_end=at,
        )
        estimate = localizer.step(scan)
        assert isinstance(estimate, Estimate)
        assert estimate.map_T_base is not None
        found.append(estimate.map_T_base.distance_to(at))
    return float(np.percentile(found[60:], 95))


def test_the_robot_itself_may_hide_what_is_behind_it() -> None:
    hidden = abs(ROUND_ABOUT) > 0.6 * math.pi
    assert error_m(room(0.1, 0.4), ROUND_ABOUT, hidden) < 0.02


def test_behind_it_too_it_may_see_a_little() -> None:
    most_round = np.linspace(-0.75 * math.pi, 0.75 * math.pi, 271)
    assert error_m(room(0.1, 0.4), most_round) < 0.015


@pytest.mark.parametrize("turn", [0.0, 0.4])
@pytest.mark.parametrize("wall_m", [0.1, 0.15, 0.2])
def test_on_a_drawn_map_it_is_not_ahead_of_itself(wall_m: float, turn: float) -> None:
    assert error_m(room(wall_m, turn), AHEAD) < 0.04


@pytest.mark.parametrize("turn", [0.0, 0.4])
def test_on_a_map_made_from_scans_nothing_is_made_up_for(turn: float) -> None:
    assert error_m(as_scanned(turn), AHEAD) < 0.015


def test_who_looks_all_round_is_between_opposite_walls_anyway() -> None:
    assert error_m(room(0.1, 0.4), ROUND_ABOUT) < 0.01
