"""What the lidar sees where the robot stands: one scan of many, the robot itself, free room."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.laser_scan import is_echo
from trolley.messages import SetupSight
from trolley.scanning import ScanInput
from trolley_base.drivers import LidarScan
from trolley_base.setup.record import Stand

Floats = NDArray[np.float64]
Sector = tuple[float, float]
"""Angles in frame `laser` [rad], counter-clockwise from the first to the second."""


@dataclass(frozen=True, slots=True)
class SightParams:
    """How scans are read; set by hand."""

    jump_m: float = 0.05
    """Two neighbouring beams whose ranges differ by more are not on one surface [m]."""
    jump_share: float = 0.05
    """Share of their range that is added to that."""
    least_share: float = 0.4
    """Share of the scans in which a beam must have an echo."""
    change_m: float = 0.15
    """A beam whose range changes by more between two scans has met something that moves [m]."""
    change_share: float = 0.05
    """Share of its range that is added to that."""
    moving_share: float = 0.12
    """Share of the beams that may change while everything stands: edges and dull surfaces do."""
    same_m: float = 0.04
    """What sits on the robot keeps its distance to the lidar within this [m]."""
    own_share: float = 0.8
    """Share of the stands at which it must."""
    widen_rad: float = math.radians(2.0)
    """A mask reaches farther than the echoes by this [rad]."""
    merge_rad: float = math.radians(6.0)
    """Echoes on the robot that lie closer together share a mask [rad]."""
    num_bins: int = 36
    """Number of directions in which room is looked for."""
    picture_m: float = 4.0
    """A picture for people shows echoes within this [m]."""
    picture_points: int = 360
    """Number of them at most."""


PARAMS = SightParams()


@dataclass(frozen=True, slots=True, eq=False)
class Beams:
    """Directions (beams,) in frame `laser` [rad], evenly from the first to the last."""

    angles: Floats

    @classmethod
    def of(cls, scan: LidarScan) -> "Beams":
        """Return those of a scan."""
        steps = np.arange(len(scan.ranges), dtype=np.float64)
        return cls(scan.angle_min + scan.angle_increment * steps)

    @classmethod
    def round_about(cls, scan: LidarScan) -> "Beams":
        """Return as many all round as such scans have: scans of real lidars begin anywhere."""
        count = max(90, min(1440, round(2.0 * math.pi / scan.angle_increment)))
        return cls(-math.pi + 2.0 * math.pi / count * np.arange(count, dtype=np.float64))

    def resample(self, scan: LidarScan) -> NDArray[np.float64]:
        """Return the ranges (beams,) of a scan in these directions; NaN where it has no echo.

        Between two beams on one surface it is interpolated, elsewhere the nearer beam counts.
        """
        count = len(scan.ranges)
        around = round(2.0 * math.pi / scan.angle_increment)
        at = np.mod((self.angles - scan.angle_min) / scan.angle_increment, around)
        first = np.floor(at).astype(np.int64)
        share = at - first
        second = first + 1
        if count >= around:
            first, second = first % count, second % count
        ranges = np.full(max(count, around) + 2, np.nan)
        ranges[:count] = np.where(is_echo(scan.ranges), scan.ranges, np.nan)
        before, after = ranges[first], ranges[second]
        jump = PARAMS.jump_m + PARAMS.jump_share * np.fmin(before, after)
        is_surface = np.abs(after - before) < jump
        nearer = np.where(share < 0.5, before, after)
        return np.where(is_surface, (1.0 - share) * before + share * after, nearer)

    def points(self, ranges: NDArray[np.floating], keep: NDArray[np.bool_]) -> Floats:
        """Return the echoes (n, 2) in frame `laser` [m] of the beams that are kept."""
        use = keep & is_echo(ranges)
        away = ranges[use].astype(np.float64)
        return np.column_stack([away * np.cos(self.angles[use]), away * np.sin(self.angles[use])])

    def outside(self, sectors: Sequence[Sector]) -> NDArray[np.bool_]:
        """Return which beams (beams,) look into none of the sectors."""
        keep = np.ones(len(self.angles), bool)
        for first, last in sectors:
            keep &= np.mod(self.angles - first, 2.0 * math.pi) > last - first
        return keep


def usual_ranges(beams: Beams, scans: Sequence[LidarScan]) -> NDArray[np.float32]:
    """Return the median (beams,) of scans; inf where most of them have no echo."""
    ranges = np.stack([beams.resample(scan) for scan in scans])
    enough = np.isfinite(ranges).mean(axis=0) >= PARAMS.least_share
    usual = np.full(ranges.shape[1], np.inf)
    usual[enough] = np.nanmedian(ranges[:, enough], axis=0)
    return usual.astype(np.float32)


def moving_share(beams: Beams, scans: Sequence[LidarScan]) -> float:
    """Return the share of the beams in which something moved between the first and last scans."""
    half = len(scans) // 2
    before, after = usual_ranges(beams, scans[:half]), usual_ranges(beams, scans[half:])
    both = is_echo(before) & is_echo(after)
    if not both.any():
        return 1.0
    changed = np.abs(before[both] - after[both])
    allowed = PARAMS.change_m + PARAMS.change_share * np.minimum(before[both], after[both])
    return float(np.mean(changed > allowed))


def in_motion(scan: LidarScan, own: Sequence[Sector]) -> ScanInput:
    """Return a scan for matching in the frame of the lidar, without the robot itself."""
    ranges = scan.ranges.copy()
    ranges[~Beams.of(scan).outside(own)] = 0.0
    return _input(scan, ranges, (scan.angle_min, scan.angle_increment), scan.stamp_ns)


def at_rest(
    beams: Beams, ranges: NDArray[np.float32], scan: LidarScan, own: Sequence[Sector], stamp_ns: int
) -> ScanInput:
    """Return usual ranges for matching in the frame of the lidar, without the robot itself.

    Args:
        beams: of the ranges.
        ranges: (beams,) [m].
        scan: one of those that they come from.
        own: where the lidar sees the robot.
        stamp_ns: of the result.
    """
    ranges = ranges.copy()
    ranges[~beams.outside(own)] = 0.0
    angles = float(beams.angles[0]), float(beams.angles[1] - beams.angles[0])
    return _input(scan, ranges, angles, stamp_ns)


def _input(
    scan: LidarScan, ranges: NDArray[np.float32], angles: tuple[float, float], stamp_ns: int
) -> ScanInput:
    here = Pose2D.identity()
    return ScanInput(
        stamp_ns=stamp_ns,
        ranges=ranges,
        angle_min=angles[0],
        angle_increment=angles[1],
        range_min=scan.range_min,
        range_max=scan.range_max,
        base_T_laser=here,
        odom_T_base=here,
        odom_T_base_end=here,
    )


def picture(
    points: Floats, base_T_laser: Pose2D, footprint: Floats, room_m: float, *, is_measured: bool
) -> SetupSight:
    """Return echoes as a picture for people.

    Args:
        points: (n, 2) in frame `laser` [m].
        base_T_laser: how it is mounted.
        footprint: (n, 2) corners [m] in `base_link`.
        room_m: how far it has to be free all round [m].
        is_measured: whether that is how it was found to be mounted.
    """
    around = base_T_laser.transform_points(points)
    near = around[np.hypot(*around.T) < PARAMS.picture_m]
    few = near[:: -(-len(near) // PARAMS.picture_points) or 1]
    return SetupSight(
        points=_points(few),
        outline=_points(footprint),
        laser=(round(base_T_laser.x, 3), round(base_T_laser.y, 3)),
        room_m=room_m,
        is_measured=is_measured,
    )


def _points(array: Floats) -> list[tuple[float, float]]:
    return [(round(x, 3), round(y, 3)) for x, y in array.tolist()]


def near_sectors(beams: Beams, ranges: NDArray[np.float32], reach_m: float) -> list[Sector]:
    """Return where something is nearer than the robot reaches: perhaps the robot itself."""
    return _sectors(beams, is_echo(ranges) & (ranges < reach_m))


def own_sectors(beams: Beams, stands: Sequence[Stand], reach_m: float) -> list[Sector]:
    """Return where the lidar sees the robot itself: what turned with it keeps its distance."""
    ranges = np.stack([stand.ranges for stand in stands]).astype(np.float64)
    ranges[~is_echo(ranges)] = np.nan
    near = np.nan_to_num(ranges, nan=np.inf) < reach_m
    has_near = near.mean(axis=0) >= PARAMS.own_share
    usual = np.full(ranges.shape[1], np.nan)
    if has_near.any():
        usual[has_near] = np.nanmedian(ranges[:, has_near], axis=0)
    stays = np.abs(ranges - usual) < PARAMS.same_m
    return _sectors(beams, has_near & (stays.mean(axis=0) >= PARAMS.own_share))


def _sectors(beams: Beams, hit: NDArray[np.bool_]) -> list[Sector]:
    angles = np.sort(np.mod(beams.angles[hit], 2.0 * math.pi))
    if not len(angles):
        return []
    gaps = np.diff(angles, append=angles[0] + 2.0 * math.pi)
    ends = np.flatnonzero(gaps > PARAMS.merge_rad)
    if not len(ends):
        return [(-math.pi, math.pi)]
    found: list[Sector] = []
    for before, end in zip(np.roll(ends, 1), ends, strict=True):
        first = float(angles[(before + 1) % len(angles)])
        width = (float(angles[end]) - first) % (2.0 * math.pi)
        start = math.remainder(first - PARAMS.widen_rad, 2.0 * math.pi)
        found.append((start, start + width + 2.0 * PARAMS.widen_rad))
    return sorted(found)


def is_within(sector: Sector, sectors: Sequence[Sector]) -> bool:
    """Say whether the middle of a sector lies in one of others."""
    middle = 0.5 * (sector[0] + sector[1])
    return any((middle - first) % (2.0 * math.pi) <= last - first for first, last in sectors)


class Room:
    """How far it is to the nearest thing in each direction from a place, as seen from many poses.

    Args:
        centre: (2,) the place, in the frame of the points [m].
    """

    def __init__(self, centre: Floats) -> None:
        self._centre = centre
        self._nearest = np.full(PARAMS.num_bins, np.inf)
        self._is_seen = np.zeros(PARAMS.num_bins, bool)

    def add(self, points: Floats) -> None:
        """Take echoes (n, 2)."""
        away = points - self._centre
        bins = self._bins(np.arctan2(away[:, 1], away[:, 0]))
        np.minimum.at(self._nearest, bins, np.hypot(away[:, 0], away[:, 1]))
        self._is_seen[bins] = True

    @property
    def free_m(self) -> float:
        """How far it is free all round [m]; 0 where a direction was never seen."""
        return 0.0 if not self._is_seen.all() else float(self._nearest.min())

    @property
    def blind(self) -> int:
        """The number of directions without any echo."""
        return int(np.count_nonzero(~self._is_seen))

    def _bins(self, angles: Floats) -> NDArray[np.int64]:
        share = np.mod(angles, 2.0 * math.pi) / (2.0 * math.pi)
        return np.minimum((share * PARAMS.num_bins).astype(np.int64), PARAMS.num_bins - 1)
