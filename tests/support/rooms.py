"""Furnished rooms of straight walls, and what a lidar sees in them while it moves."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, Twist2D, integrate_twist
from trolley.scanning import ScanInput

NOISE_M = 0.01
"""Standard deviation of a range [m]."""
Walls = NDArray[np.float64]
"""(n, 2, 2) both ends x, y [m] of each."""


def box(pose: Pose2D, length_m: float, width_m: float) -> Walls:
    """The four sides of a box around a pose."""
    half = 0.5 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * (length_m, width_m)
    corners = pose.transform_points(half)
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def furnished_room(rng: np.random.Generator, free_m: float = 1.0) -> Walls:
    """A room of 4 to 7 m with five pieces of furniture, and free floor around the origin."""
    size = rng.uniform(4.0, 7.0, 2)
    x, y = (rng.uniform(-0.15, 0.15, 2) * size).tolist()
    middle = Pose2D(x, y, float(rng.uniform(-math.pi, math.pi)))
    parts = [box(middle, *size.tolist())]
    while len(parts) < 6:
        away, way = rng.uniform(free_m + 0.8, 3.0), rng.uniform(-math.pi, math.pi)
        pose = Pose2D(away * math.cos(way), away * math.sin(way), float(rng.uniform(0.0, 3.0)))
        parts.append(box(pose, *rng.uniform(0.2, 0.9, 2).tolist()))
    return np.concatenate(parts)


def corridor(width_m: float = 1.6) -> Walls:
    """Two plain walls without an end in sight, along x."""
    half = 0.5 * width_m
    return np.array([[[-50.0, half], [50.0, half]], [[-50.0, -half], [50.0, -half]]])


def look(
    walls: Walls,
    map_T_base: Pose2D,
    twist: Twist2D,
    base_T_laser: Pose2D,
    rng: np.random.Generator,
    *,
    stamp_s: float = 0.0,
    duration_s: float = 0.1,
    mirrored: bool = False,
) -> ScanInput:
    """One revolution of a lidar on a robot that moves meanwhile; its odometry says nothing.

    Args:
        walls: what there is to see.
        map_T_base: where the robot is at the first beam.
        twist: how it moves.
        base_T_laser: where the lidar sits.
        rng: of the noise.
        stamp_s: time of the first beam [s].
        duration_s: until the last one [s].
        mirrored: it hangs upside down, so that its beams come in the other order.
    """
    beams = 360
    increment = 2.0 * math.pi / beams
    angles = -math.pi + increment * np.arange(beams)
    lasers = np.array(
        [
            (integrate_twist(map_T_base, twist, float(part)) @ base_T_laser).as_array()
            for part in duration_s * np.arange(beams) / (beams - 1)
        ]
    )
    headings = lasers[:, 2] + (-angles if mirrored else angles)
    ways = np.stack([np.cos(headings), np.sin(headings)], axis=1)
    edges = walls[:, 1] - walls[:, 0]
    towards = walls[None, :, 0] - lasers[:, None, :2]
    cross = ways[:, None, 0] * edges[:, 1] - ways[:, None, 1] * edges[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = (towards[..., 0] * edges[:, 1] - towards[..., 1] * edges[:, 0]) / cross
        along = (towards[..., 0] * ways[:, None, 1] - towards[..., 1] * ways[:, None, 0]) / cross
    is_met = (reach > 0.0) & (along >= 0.0) & (along <= 1.0)
    ranges = np.where(is_met, reach, np.inf).min(axis=1)
    ranges = np.where(ranges < 12.0, ranges + NOISE_M * rng.standard_normal(beams), np.inf)
    return ScanInput(
        stamp_ns=round(1e9 * stamp_s) + 1,
        ranges=ranges.astype(np.float32),
        angle_min=-math.pi,
        angle_increment=increment,
        range_min=0.05,
        range_max=12.0,
        base_T_laser=base_T_laser,
        odom_T_base=Pose2D.identity(),
        odom_T_base_end=Pose2D.identity(),
    )
