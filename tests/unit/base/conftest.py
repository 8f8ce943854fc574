"""A plain room to try the simulated robot in."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from trolley.geometry import Pose2D
from trolley.gridmap import FREE, OCCUPIED, GridMap
from trolley_base.world import RobotBody, Simulation, decode_world

WORLDS = Path(__file__).resolve().parents[3] / "worlds"
FOOTPRINT = np.array([[0.15, -0.12], [0.15, 0.12], [-0.15, 0.12], [-0.15, -0.12]])

# A robot without errors, so that what it does can be calculated.
EXACT = """
[wheels]
scale_std = 0.0
turn_scale_std = 0.0
slip_per_m = 0.0
yaw_slip_per_m = 0.0
yaw_slip_per_rad = 0.0

[lidar]
noise_m = 0.0
noise_share = 0.0
drop_out = 0.0
invalid = 0.0
"""

MakeSimulation = Callable[..., Simulation]


@pytest.fixture
def room() -> GridMap:
    """A room of 6 x 4 m around the origin, with walls of 10 cm."""
    cells = np.full((84, 124), OCCUPIED, dtype=np.int8)
    cells[2:-2, 2:-2] = FREE
    return GridMap("room", 0.05, Pose2D(-3.1, -2.1, 0.0), cells)


@pytest.fixture
def simulate(room: GridMap) -> MakeSimulation:
    """A simulation of a 0.30 x 0.24 m robot in that room, at the origin, looking along +x."""

    def make(
        things: str = "",
        errors: str = EXACT,
        seed: int = 1,
        start: Pose2D | None = None,
        base_T_laser: Pose2D = Pose2D(0.0, 0.0, 0.0),  # noqa: B008
    ) -> Simulation:
        text = f'map = "room.yaml"\nstart = {{x = 0.0, y = 0.0, yaw = 0.0}}\n{things}\n{errors}'
        spec = decode_world(text, "test.toml")
        return Simulation(spec, room, RobotBody(FOOTPRINT, base_T_laser), seed, start)

    return make


@pytest.fixture
def worlds() -> Path:
    """The folder of the worlds that ship with Trolley."""
    return WORLDS
