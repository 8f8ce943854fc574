"""What a cheap lidar does to a revolution that has been measured: edges, tilt, sun, lost ones."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import wrap_angles
from trolley_base.drivers.interface import LidarScan
from trolley_base.world.spec import LidarFaults, Sun

EDGE_M = 0.1
"""Two beams whose ranges differ by more than this have an edge between them [m]."""


class FaultyLidar:
    """Spoils revolutions.

    Args:
        faults: in what ways.
        rng: draws which beams and revolutions.
    """

    def __init__(self, faults: LidarFaults, rng: np.random.Generator) -> None:
        self._faults = faults
        self._rng = rng

    def spoil(self, scan: LidarScan, yaw: float, sun: Sun | None) -> LidarScan | None:
        """Return what the sensor sends for a revolution, None if that is lost.

        Args:
            scan: as it was measured.
            yaw: of the laser in `map` at its end [rad].
            sun: that shines on the robot, if one does.
        """
        faults, rng = self._faults, self._rng
        ranges = scan.ranges
        beams = np.arange(len(ranges), dtype=np.float64)
        bearings = scan.angle_min + beams * scan.angle_increment
        if faults.tilt_rad > 0.0:
            ranges = self._meeting_the_floor(ranges, bearings, scan.range_max)
        if faults.mixed > 0.0:
            ranges = self._mixed(ranges)
        if sun is not None:
            off = wrap_angles(bearings + yaw - sun.towards)
            blinded = (np.abs(off) < 0.5 * sun.width_rad) & (rng.random(len(off)) < sun.lost)
            ranges = np.where(blinded, np.float32(0.0), ranges)
        stamp_ns = scan.stamp_ns
        if faults.stamp_jitter_s > 0.0:
            stamp_ns += round(faults.stamp_jitter_s * 1e9 * float(rng.standard_normal()))
        if faults.lost_turns > 0.0 and rng.random() < faults.lost_turns:
            return None
        return (
            scan
            if ranges is scan.ranges and stamp_ns == scan.stamp_ns
            else replace(scan, stamp_ns=stamp_ns, ranges=ranges)
        )

    def _meeting_the_floor(
        self, ranges: NDArray[np.float32], bearings: NDArray[np.floating[Any]], reach: float
    ) -> NDArray[np.float32]:
        """Return ranges (n,), none longer than to where its beam meets the floor."""
        faults = self._faults
        down = math.tan(faults.tilt_rad) * np.cos(bearings - faults.tilt_towards)
        with np.errstate(divide="ignore"):
            floor = np.where(down > 0.0, faults.height_m / down, np.inf)
        # Carpet scatters: the echo lies a little before or behind.
        floor *= 1.0 + 0.02 * self._rng.standard_normal(len(floor))
        floor[floor > reach] = np.inf
        return np.minimum(ranges, floor.astype(np.float32))

    def _mixed(self, ranges: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return ranges (n,) with some at edges between what is before and what is behind."""
        behind = np.roll(ranges, -1)
        both = np.isfinite(ranges) & np.isfinite(behind) & (ranges > 0.0) & (behind > 0.0)
        with np.errstate(invalid="ignore"):
            edge = both & (np.abs(ranges - behind) > EDGE_M)
        edge &= self._rng.random(len(ranges)) < self._faults.mixed
        part = self._rng.random(len(ranges)).astype(np.float32)
        spoiled = ranges.copy()
        spoiled[edge] += part[edge] * (behind[edge] - ranges[edge])
        return spoiled
