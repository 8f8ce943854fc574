"""Recorded drives as the localizer gets them, and how well it follows them.

Reads `<name>.npz`: `stamps` (n,) [s], `odom` (n, 3), a reference (n, 3) map_T_base, `ranges_mm`
(n, beams) with 65535 for no echo, `angle_min`, `angle_increment`, `range_max`, `laser_in_base`.
The tests of recorded drives use it, too.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D, angle_difference
from trolley.gridmap import load_map
from trolley.scanning import ScanInput
from trolley_localizer.core import Localizer
from trolley_localizer.estimate import Estimate

# File, odometry and reference of each drive, and its map.
FREIBURG = ("freiburg-079", "odom_signed", "reference_refined")
FREIBURG_RAW = ("freiburg-079", "odom", "reference_refined")
CREATE3 = ("create3-rplidar-mac", "odom", "reference")
MAPS = {"freiburg-079": "freiburg-079.yaml", "create3-rplidar-mac": "mac_1st_floor_final.yaml"}
# An estimate further off than this is counted as lost [m, rad].
FAR_M = 0.5
FAR_RAD = math.radians(20.0)


@dataclass(frozen=True)
class Recording:
    """One recorded drive.

    Attributes:
        stamps: (n,) [s] from 0.
        odom: (n, 3) x, y [m], yaw [rad] of the wheels.
        reference: (n, 3) map_T_base.
        ranges: (n, beams) float32 [m], no echo = +inf.
        angle_min: direction of beam 0 in `laser` [rad].
        angle_increment: direction from one beam to the next [rad].
        range_max: [m].
        base_T_laser: where the lidar is mounted.
    """

    stamps: NDArray[np.float64]
    odom: NDArray[np.float64]
    reference: NDArray[np.float64]
    ranges: NDArray[np.float32]
    angle_min: float
    angle_increment: float
    range_max: float
    base_T_laser: Pose2D

    def odom_at(self, index: int) -> Pose2D:
        """The wheels' odom_T_base at a scan."""
        return Pose2D.from_array(self.odom[index])

    def reference_at(self, index: int) -> Pose2D:
        """The true map_T_base at a scan."""
        return Pose2D.from_array(self.reference[index])

    def scan(self, index: int) -> ScanInput:
        """One scan with its odometry; the time of single beams is not known."""
        odom = self.odom_at(index)
        return ScanInput(
            stamp_ns=round(self.stamps[index] * 1e9) + 1,
            ranges=self.ranges[index],
            angle_min=self.angle_min,
            angle_increment=self.angle_increment,
            range_min=0.05,
            range_max=self.range_max,
            base_T_laser=self.base_T_laser,
            odom_T_base=odom,
            odom_T_base_end=odom,
        )

    def way_m(self) -> NDArray[np.float64]:
        """The distance driven until each scan (n,) [m]."""
        steps = np.hypot(*np.diff(self.reference[:, :2], axis=0).T)
        return np.concatenate([[0.0], np.cumsum(steps)])

    def thinned(self, step_m: float, yaw_dev_rad: float, seed: int) -> "Recording":
        """One scan every `step_m`, with worse odometry between them.

        Args:
            step_m: distance between two scans [m].
            yaw_dev_rad: deviation of the heading per step; the distance is 10 % off [rad].
            seed: of the errors.
        """
        kept = np.flatnonzero(np.diff(np.floor(self.way_m() / step_m), prepend=-1.0))
        rng = np.random.default_rng(seed)
        pose = Pose2D.identity()
        odom: list[NDArray[np.float64]] = [pose.as_array()]
        for before, after in pairwise(kept.tolist()):
            step = self.odom_at(before).inverse() @ self.odom_at(after)
            scale = 1.0 + 0.1 * float(rng.standard_normal()) * (yaw_dev_rad > 0.0)
            turn = yaw_dev_rad * float(rng.standard_normal())
            # Half of the turn before the step, half behind it: the distance errs, too.
            half = Pose2D(0.0, 0.0, 0.5 * turn)
            pose = pose @ half @ Pose2D(scale * step.x, scale * step.y, step.yaw) @ half
            odom.append(pose.as_array())
        return replace(
            self,
            stamps=self.stamps[kept],
            odom=np.array(odom),
            reference=self.reference[kept],
            ranges=self.ranges[kept],
        )


def read_recording(folder: Path, name: str, odom: str, reference: str) -> Recording:
    """Read a drive; `odom` and `reference` name the fields to use."""
    with np.load(folder / f"{name}.npz") as data:
        fields: dict[str, Any] = dict(data)
    millimetres = fields["ranges_mm"]
    ranges = np.where(millimetres == 65535, np.inf, millimetres / 1000.0).astype(np.float32)
    mounting = fields.get("laser_in_base", np.zeros(3))
    return Recording(
        stamps=fields["stamps"] - fields["stamps"][0],
        odom=fields[odom],
        reference=fields[reference],
        ranges=ranges,
        angle_min=float(fields["angle_min"]),
        angle_increment=float(fields["angle_increment"]),
        range_max=float(fields["range_max"]),
        base_T_laser=Pose2D.from_array(mounting),
    )


@dataclass(frozen=True)
class Score:
    """How well a drive was followed; one entry per scan, NaN where no pose was given."""

    error_m: NDArray[np.float64]
    error_rad: NDArray[np.float64]
    poses: list[Pose2D | None]
    states: list[str]

    @property
    def is_far(self) -> NDArray[np.bool_]:
        """Where the estimate is further off than an estimate may be, or missing."""
        return ~((self.error_m <= FAR_M) & (self.error_rad <= FAR_RAD))

    @property
    def far_share(self) -> float:
        """Share of the scans where it is."""
        return float(np.mean(self.is_far))

    @property
    def median_m(self) -> float:
        """Median of the position errors [m]."""
        return float(np.nanmedian(self.error_m))

    @property
    def p95_m(self) -> float:
        """95th percentile of the position errors [m]."""
        return float(np.nanpercentile(self.error_m, 95))


def start_nearby(recording: Recording, seed: int) -> Pose2D:
    """A start pose 0.3 m and 10 degrees off, in a direction that the seed chooses."""
    rng = np.random.default_rng(seed)
    way = rng.uniform(-math.pi, math.pi)
    first = recording.reference_at(0)
    return Pose2D(
        first.x + 0.3 * math.cos(way),
        first.y + 0.3 * math.sin(way),
        first.yaw + math.radians(10.0) * (1 if seed % 2 else -1),
    )


def estimates(recording: Recording, localizer: Localizer) -> Iterator[Estimate]:
    """Give the estimate after each scan; searches run at once."""
    for index in range(len(recording.stamps)):
        estimate = localizer.step(recording.scan(index))
        assert isinstance(estimate, Estimate)
        job = localizer.take_job()
        if job is not None:
            localizer.finish(job.run())
        yield estimate


def follow(recording: Recording, map_file: Path, seed: int, start: Pose2D | None) -> Score:
    """Let a localizer follow a drive, from a start pose or from nothing."""
    localizer = Localizer(load_map(map_file), [], LocalizerConfig(), seed)
    if start is not None:
        localizer.set_pose(start)
    return score(recording, [(e.map_T_base, e.state) for e in estimates(recording, localizer)])


def score(recording: Recording, found: list[tuple[Pose2D | None, str]]) -> Score:
    """Compare poses, one a scan, with the reference."""
    error_m, error_rad = np.full(len(found), np.nan), np.full(len(found), np.nan)
    for index, (pose, _) in enumerate(found):
        if pose is not None:
            reference = recording.reference_at(index)
            error_m[index] = pose.distance_to(reference)
            error_rad[index] = abs(angle_difference(pose.yaw, reference.yaw))
    return Score(error_m, error_rad, [pose for pose, _ in found], [state for _, state in found])


def relation_errors(folder: Path, poses: list[Pose2D | None]) -> list[float]:
    """Errors [m] of the relative poses that were measured by hand, independent of any map."""
    with np.load(folder / "freiburg-079.npz") as data:
        # Their times count from the first scan.
        stamps, relations = data["stamps"] - data["stamps"][0], data["relations"]
    errors: list[float] = []
    for t_a, t_b, dx, dy, _ in relations:
        a, b = (poses[int(np.argmin(np.abs(stamps - t)))] for t in (t_a, t_b))
        assert a is not None
        assert b is not None
        found = a.inverse() @ b
        errors.append(math.hypot(found.x - dx, found.y - dy))
    return errors
