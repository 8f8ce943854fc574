"""Two scans compared with each other, without the map.

They tell a robot that has driven on, be it off the map, from one that was carried elsewhere; and
they lead the robot on where the map ends, better than the wheels alone.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.gridmap import distance_transform
from trolley.scanning import Points
from trolley_localizer.filter.motion_model import move_covariance
from trolley_localizer.kernels.matching import refine_pose
from trolley_localizer.kernels.overlap import compare_with_view, draw_view
from trolley_localizer.matching.map_matcher import BeamSet


@dataclass(frozen=True, slots=True)
class ScanToScanParams:
    """How scans are compared. Set by hand unless stated otherwise."""

    num_bins: int = 360
    """Number of directions of a view."""
    reach_bins: int = 2
    """Least number of bins by which matching directions may differ: headings err, walls are met
    askew. Where beams lie further apart, what lies between two of them counts as seen by both."""
    slack_m: float = 0.15
    """Distance by which two ranges may differ [m]."""
    slack_share: float = 0.02
    """Share of the range by which two ranges may differ, besides `slack_m`."""
    least_compared: int = 30
    """Number of beams below which a comparison says nothing, unless `least_conflicts` disagree."""
    least_conflicts: int = 10
    """Number of beams that disagree from which on fewer do as well: of `least_compared` so many are
    a break, however many of the others agree."""
    least_overlap: float = 0.7
    """Overlap below which two scans are not of one drive. Where the robot drives, on the map or off
    it, they agree in 0.97 of the beams, and in 0.05 to 0.6 where it was carried."""
    usual_overlap: float = 0.95
    """Overlap by the wheels' step below which the wheels slip and the step between the scans counts
    instead."""
    renew_m: float = 0.3
    """Distance after which the earlier scan is replaced [m]."""
    renew_rad: float = 0.3
    """Turn after which the earlier scan is replaced [rad]."""
    renew_s: float = 5.0
    """Time after which the earlier scan is replaced [s]."""
    field_m: float = 10.0
    """Distance from the robot within which scans are aligned with each other [m]."""
    most_field_cells: int = 2000
    """The same in cells at most, which is less on a map finer than 5 mm: at 1 mm the field would
    take some 5 GB."""
    wall_m: float = 0.5
    """Distance from an echo beyond which nothing is aligned with it [m]."""
    widths_m: tuple[float, ...] = (0.25, 0.1)
    """Widths of Welsch's function, in the order of their use [m]."""
    max_steps: int = 8
    """Gauss-Newton steps at each width."""
    odom_dev_m: float = 0.05
    """Standard deviation of the odometry's position between two scans [m]."""
    odom_dev_rad: float = 0.03
    """Standard deviation of the odometry's heading between two scans [rad]."""
    beam_dev_m: float = 0.05
    """Standard deviation of a beam's end [m]."""
    independent_beams: float = 60.0
    """Number of independent beams that a scan counts as."""
    floor_m: float = 0.01
    """Least error of the position of aligned scans [m]."""
    floor_rad: float = 0.004
    """Least error of the heading of aligned scans [rad]."""


PARAMS = ScanToScanParams()


@dataclass(frozen=True, slots=True, eq=False)
class LedPose:
    """Where two scans say that the robot has gone."""

    pose: NDArray[np.float64]
    """(3,) x, y [cells], yaw [rad] in `grid`."""
    covariance: NDArray[np.float64]
    """(3, 3) of the pose."""


def half_of_field(resolution: float) -> int:
    """Return half the edge of the field within which scans are aligned with each other [cells]."""
    return min(math.ceil(PARAMS.field_m / resolution), PARAMS.most_field_cells)


class View:
    """What a scan sees, wherever it was taken.

    Args:
        beams: of the scan.
        resolution: cell edge [m].
    """

    def __init__(self, beams: BeamSet, resolution: float) -> None:
        self.beams = beams
        self.ends = beams.points(beams.used)
        self._resolution = resolution
        self._laser = np.array([np.add.reduce(part) / part.size for part in beams.start])
        self._near = np.empty(PARAMS.num_bins)
        self._far = np.empty(PARAMS.num_bins)
        beam_bins = round(beams.step_rad * PARAMS.num_bins / (2.0 * math.pi))
        reach = max(PARAMS.reach_bins, beam_bins)
        draw_view(self._near, self._far, self.ends, self._laser, reach)

    def compare(self, ends: Points, relation: Pose2D) -> tuple[int, int]:
        """Count the echoes of another scan that agree with this view, and those that do not.

        Args:
            ends: in `base_link` of the other [cells].
            relation: pose of the other seen from this one [cells, rad].
        """
        slack = np.array([PARAMS.slack_m / self._resolution, PARAMS.slack_share])
        return compare_with_view(
            self._near,
            self._far,
            self._laser,
            ends,
            relation.as_array(),
            slack,
        )

    @cached_property
    def field(self) -> NDArray[np.float32]:
        """Distance to the nearest echo [cells], with a ring, the robot in the middle."""
        half = half_of_field(self._resolution)
        rows, cols = (np.floor(part).astype(np.int64) + half for part in (self.ends.y, self.ends.x))
        inside = (rows >= 0) & (rows < 2 * half) & (cols >= 0) & (cols < 2 * half)
        echoes = np.zeros((2 * half, 2 * half), np.uint8)
        echoes[rows[inside], cols[inside]] = 1
        far = PARAMS.wall_m / self._resolution
        field = np.full((2 * half + 2, 2 * half + 2), far, np.float32)
        field[1:-1, 1:-1] = distance_transform(echoes, 1.0, far)
        return field


class EarlierScan:
    """A scan that later ones are compared with.

    Args:
        view: what it saw.
        pose: where it was taken (3,) x, y [cells], yaw [rad] in `grid`.
        covariance: (3, 3) of the pose.
    """

    def __init__(
        self, view: View, pose: NDArray[np.float64], covariance: NDArray[np.float64]
    ) -> None:
        self.view = view
        self.pose = Pose2D.from_array(pose)
        self.covariance = covariance.copy()


class ScanToScan:
    """Compares each scan with an earlier one of the same drive."""

    def __init__(self, resolution: float) -> None:
        self._resolution = resolution
        self._earlier: EarlierScan | None = None
        self._view: View | None = None
        """Of the newest scan, which is compared at the pose expected and again at the one found."""
        self._since_s = 0.0

    def forget(self) -> None:
        """Begin anew with the next scan."""
        self._earlier = None

    def agreement(self, beams: BeamSet, pose: NDArray[np.float64]) -> float | None:
        """Return the share of beams in which a scan and the earlier one agree, if it can be said.

        Args:
            beams: of the scan.
            pose: where it is believed to have been taken (3,) [cells, rad].
        """
        earlier = self._earlier
        if earlier is None:
            return None
        here, there = self._view_of(beams), earlier.view
        relation = earlier.pose.inverse() @ Pose2D.from_array(pose)
        agree, conflict = there.compare(here.ends, relation)
        agree_back, conflict_back = here.compare(there.ends, relation.inverse())
        conflicts = conflict + conflict_back
        compared = agree + agree_back + conflicts
        if compared < PARAMS.least_compared and conflicts < PARAMS.least_conflicts:
            return None
        return (agree + agree_back) / compared

    def follow(
        self,
        beams: BeamSet,
        pose: NDArray[np.float64],
        covariance: NDArray[np.float64],
        elapsed_s: float,
    ) -> bool:
        """Take a scan into account; returns whether it does not go on where the earlier one was.

        Args:
            beams: of the scan.
            pose: where it was taken by the estimate (3,) [cells, rad].
            covariance: (3, 3) of the pose.
            elapsed_s: since the scan before [s].
        """
        self._since_s += elapsed_s
        agreement = self.agreement(beams, pose)
        is_break = agreement is not None and agreement < PARAMS.least_overlap
        if self._earlier is None or is_break or self._is_far(self._earlier, pose):
            self._earlier = EarlierScan(self._view_of(beams), pose, covariance)
            self._since_s = 0.0
        return is_break

    def _view_of(self, beams: BeamSet) -> View:
        if self._view is None or self._view.beams is not beams:
            self._view = View(beams, self._resolution)
        return self._view

    def _is_far(self, earlier: EarlierScan, pose: NDArray[np.float64]) -> bool:
        """Say whether a newer scan should take the place of the earlier one."""
        relation = earlier.pose.inverse() @ Pose2D.from_array(pose)
        return (
            math.hypot(relation.x, relation.y) * self._resolution > PARAMS.renew_m
            or abs(math.remainder(relation.yaw, 2.0 * math.pi)) > PARAMS.renew_rad
            or self._since_s > PARAMS.renew_s
        )

    def align(self, pose: NDArray[np.float64], beams: BeamSet) -> LedPose | None:
        """Align a pose with the earlier scan.

        Args:
            pose: where the odometry says that the scan was taken (3,) [cells, rad].
            beams: of the scan.
        """
        earlier, cells = self._earlier, 1.0 / self._resolution
        if earlier is None:
            return None
        points = self._view_of(beams).ends
        middle = float(half_of_field(self._resolution))
        start = (earlier.pose.inverse() @ Pose2D.from_array(pose)).as_array()
        start[:2] += middle
        moved, information = start.copy(), np.zeros((3, 3))
        devs = np.array([PARAMS.odom_dev_m * cells, PARAMS.odom_dev_m * cells, PARAMS.odom_dev_rad])
        prior = np.diag(devs**-2)
        share = min(PARAMS.independent_beams, points.x.size) / max(points.x.size, 1)
        gain = share / (PARAMS.beam_dev_m * cells) ** 2
        field = earlier.view.field
        for width_m in PARAMS.widths_m:
            tuning = np.array([width_m * cells, gain])
            refine_pose(moved, information, field, points, start, prior, tuning, PARAMS.max_steps)
        if not np.isfinite(moved).all():
            moved = start
        relation = Pose2D(float(moved[0]) - middle, float(moved[1]) - middle, float(moved[2]))
        floor = np.array([PARAMS.floor_m * cells, PARAMS.floor_m * cells, PARAMS.floor_rad])
        own = np.linalg.inv(prior + information) + np.diag(floor**2)
        cos, sin = math.cos(earlier.pose.yaw), math.sin(earlier.pose.yaw)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        carried = move_covariance(earlier.covariance, earlier.pose, relation)
        return LedPose((earlier.pose @ relation).as_array(), carried + turn @ own @ turn.T)
