"""A room with two posts: where each beam from its middle ends can be calculated."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from support.round_bodies import ranges_to
from trolley.geometry import Pose2D
from trolley.gridmap import FREE, OCCUPIED, GridMap, save_map

HALF_ROOM_M = 3.0, 2.0
POSTS = ((1.0, 0.8, 0.2), (-1.9, -0.5, 0.25))
"""x, y, radius [m], where a mirrored or turned picture would not have them."""
THINGS = "".join(f"[[circle]]\nx = {x}\ny = {y}\nradius_m = {r}\n" for x, y, r in POSTS)
"""The posts, as a world file has them."""
PERFECT = """
[lidar]
noise_m = 0.0
noise_share = 0.0
drop_out = 0.0
invalid = 0.0
"""


def make_world(folder: Path) -> Path:
    """Write a world file: the robot stands in the room's middle and looks along +x."""
    cells = np.full((84, 124), OCCUPIED, dtype=np.int8)
    cells[2:-2, 2:-2] = FREE
    save_map(GridMap("posts", 0.05, Pose2D(-3.1, -2.1, 0.0), cells), folder / "posts.yaml")
    world = folder / "posts.toml"
    start = "start = {x = 0.0, y = 0.0, yaw = 0.0}"
    world.write_text(f'map = "posts.yaml"\n{start}\n{THINGS}{PERFECT}')
    return world


def distances_to_walls(angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where beams (n,) [rad] end that start in the room's middle [m]."""
    x, y = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore"):
        ranges = np.minimum(HALF_ROOM_M[0] / np.abs(x), HALF_ROOM_M[1] / np.abs(y))
    return np.minimum(ranges, ranges_to(np.array(POSTS), angles).min(axis=1))
