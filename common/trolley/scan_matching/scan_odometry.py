"""Odometry from the lidar alone, or beside wheels and gyro: how the robot moves from scan to scan.

Each scan is aligned, point to line, with the surfaces that the last few key scans saw, from where
a motion model expects it and held to that expectation as much as it is worth. So a robot that
stands does not drift, an error comes only with each new key scan, and where the scans do not show
the motion (along a plain corridor) the model decides and the covariance says so.

A motion model is a step and its covariance (`Prior`). `carried_on` is the one of a robot with two
driven wheels: it goes on as before, give or take what motors can do in that time, and does not
move sideways. `of_unknown_mount` knows nothing of axles: with it the motion of the lidar itself
comes out, wherever it sits. Whoever has wheels or a gyro gives what they say instead.

Source:
    Censi, An ICP variant using a point-to-line metric (2008); Guadagnino et al., Kinematic-ICP:
    Enhancing LiDAR Odometry with Kinematic Constraints for Wheeled Mobile Robots Moving on Planar
    Surfaces (2024), for the motion model as a part of the alignment and for the local map.
"""

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, Twist2D, exp_twist, log_pose
from trolley.scan_matching import surfels as kernels
from trolley.scan_matching.align import STEP, align
from trolley.scan_matching.information import gain_of, without_noise
from trolley.scan_matching.layout import AlignmentParams, Cloud, Surfels
from trolley.scan_matching.sweep import Sweep, read_sweep
from trolley.scanning import ScanInput


@dataclass(frozen=True, slots=True)
class ScanOdometryParams:
    """How scans are followed. Found with bench/base/scan_odometry.py unless stated otherwise."""

    reach_m: float = 12.0
    """Farther echoes are not used [m]; by hand."""
    cell_m: float = 0.1
    """Edge of the cells that surfels are averaged in [m]."""
    key_m: float = 0.2
    """Distance from the newest key scan after which a scan becomes one [m]."""
    key_rad: float = 0.2
    """Turn after which a scan becomes one [rad]."""
    num_keys: int = 12
    """Number of key scans that are remembered."""
    first_reach_m: float = 0.5
    """Distance within which points have partners in the first step [m]."""
    last_reach_m: float = 0.12
    """Distance within which points have partners in the last steps [m]."""
    width_m: float = 0.05
    """Residual at which a point counts half, about [m]."""
    max_iterations: int = 12
    """Number of Gauss-Newton steps of an alignment at most."""
    least_partners: int = 15
    """A scan of which fewer points have partners is lost; by hand."""
    usual_fit: float = 0.6
    """A fit below this may be that of a wrong turn: other turns are tried, too."""
    other_turns: tuple[float, ...] = (-0.1, 0.1, -0.2, 0.2, -0.35, 0.35)
    """Turns beside the expected one that are tried [rad]; by hand."""
    better_fit: float = 0.05
    """By so much another turn must fit better; by hand."""
    least_fit: float = 0.2
    """A scan that fits no better is lost."""
    gap_s: float = 2.5
    """After a longer silence of the lidar nothing is known of the motion: many a place fits, and
    the scan counts as lost [s]; by hand."""
    patience: int = 3
    """Number of lost scans in a row after which the key scans are given up; by hand."""
    deskew_m: float = 0.005
    """The scan is corrected anew where its motion was expected so wrongly [m]; by hand."""
    deskew_rad: float = 0.002
    """The same for the turn [rad]; by hand."""
    accel_mps2: float = 1.0
    """Standard deviation of how fast speed changes [m/s^2]; by hand."""
    accel_radps2: float = 3.0
    """Standard deviation of how fast the turn rate changes [rad/s^2]; by hand."""
    model_s: float = 0.15
    """Added to the time since the scan before, over which speeds change [s]; by hand: the speed
    before is itself only known as the mean over a scan."""
    aside_m: float = 0.004
    """Standard deviation of the motion sideways in a step, whatever its length [m]; by hand."""
    aside_share: float = 0.05
    """The same as a share of the distance; by hand."""
    floor_m: float = 0.002
    """Least error of a step's position [m]."""
    floor_rad: float = 0.001
    """Least error of a step's turn [rad]."""


PARAMS = ScanOdometryParams()


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """What is expected of the motion since the scan before."""

    step: Pose2D
    """before_T_now of the frame that is followed."""
    covariance: NDArray[np.float64]
    """(3, 3) of x, y [m], yaw [rad] in the frame at the scan before, positive definite."""


def carried_on(twist: Twist2D, elapsed_s: float) -> Prior:
    """Expect that a robot with two driven wheels goes on as before.

    Args:
        twist: how it moved before.
        elapsed_s: since the scan before [s].
    """
    step = exp_twist(twist, elapsed_s)
    away_s = elapsed_s + PARAMS.model_s
    along = PARAMS.accel_mps2 * away_s * elapsed_s + PARAMS.aside_m
    aside = PARAMS.aside_m + PARAMS.aside_share * math.hypot(step.x, step.y)
    turn = PARAMS.accel_radps2 * away_s * elapsed_s + PARAMS.floor_rad
    # A step sideways is what the turn within it leaves to chance.
    aside = math.hypot(aside, 0.5 * turn * (abs(step.x) + along))
    return Prior(step, np.diag([along**2, aside**2, turn**2]))


def of_unknown_mount(twist: Twist2D, elapsed_s: float) -> Prior:
    """Expect that the lidar goes on as before, in any direction."""
    prior = carried_on(twist, elapsed_s)
    along = float(prior.covariance[0, 0])
    return Prior(prior.step, np.diag([along, along, float(prior.covariance[2, 2])]))


@dataclass(frozen=True, slots=True, eq=False)
class ScanMotion:
    """How the robot moved since the scan before."""

    step: Pose2D
    """before_T_now, at the stamps of the scans."""
    twist: Twist2D
    """Its mean over that time [m/s, rad/s]; zero at the first scan."""
    covariance: NDArray[np.float64]
    """(3, 3) of the step in the frame now. Directions in which the scans do not show the motion
    have the prior's."""
    shown: NDArray[np.float64]
    """(3, 3) information on x, y, yaw in the frame now from the scans alone: a direction without
    any was not seen."""
    is_lost: bool
    """The scan does not fit those before: the step is the prior's."""


class _Alignment(NamedTuple):
    """Where an alignment has ended; `fit` the share of the weight that the points may have."""

    step: Pose2D
    information: NDArray[np.float64]
    partners: int
    fit: float


class ScanOdometry:
    """Follows the frame in which the lidar is said to be mounted, one scan after the other.

    Args:
        has_axle: `base_link` does not move sideways; else nothing is known of it.
        trusts_prior: what is expected is wrong by no more than it says, however few of a scan's
            points fit: most of what it shows may be new.
        num_keys: number of key scans that are remembered.
    """

    def __init__(
        self,
        *,
        has_axle: bool = True,
        trusts_prior: bool = False,
        num_keys: int = PARAMS.num_keys,
    ) -> None:
        self._expect = carried_on if has_axle else of_unknown_mount
        self._trusts_prior = trusts_prior
        self._keys: deque[tuple[Sweep, Pose2D]] = deque(maxlen=num_keys)
        self._surfels: Surfels | None = None
        self._stamp_ns = 0
        self._twist = Twist2D.zero()
        self._last_step = Pose2D.identity(), 0.0
        self._num_lost = 0
        self.pose = Pose2D.identity()
        """start_T_base, at the newest scan."""

    @property
    def twist(self) -> Twist2D:
        """How it is expected to go on [m/s, rad/s]."""
        return self._twist

    @property
    def is_lost(self) -> bool:
        """It does not know any more how the robot has moved: not one of the last scans fitted."""
        return self._num_lost >= PARAMS.patience

    def expect(self, elapsed_s: float) -> Prior:
        """Return what is usual for such a robot so long after the scan before [s]."""
        return self._expect(self._twist, elapsed_s)

    def update(
        self, scan: ScanInput, duration_s: float = 0.0, prior: Prior | None = None
    ) -> ScanMotion:
        """Take a scan that is newer than the last one.

        Args:
            scan: what the lidar saw; its odometry is not looked at.
            duration_s: from the first beam to the last one [s], negative for a lidar that turns
                clockwise; 0 if the scan was taken at once, or corrected already.
            prior: what is expected; None: what is usual for such a robot. That is also tried where
                a scan fits badly, unless the prior is trusted.

        Raises:
            ValueError: it is not newer.
        """
        if self._surfels is None:
            self._stamp_ns = scan.stamp_ns
            sweep = _sweep(scan, Twist2D.zero(), duration_s)
            if not sweep.is_blind:
                self._remember(sweep)
            nothing = np.zeros((3, 3))
            return ScanMotion(Pose2D.identity(), Twist2D.zero(), nothing, nothing, False)
        elapsed_s = (scan.stamp_ns - self._stamp_ns) * 1e-9
        if elapsed_s <= 0.0:
            raise ValueError("a scan must be newer than the one before")
        is_gap = elapsed_s > PARAMS.gap_s
        if is_gap:
            self._num_lost = PARAMS.patience
        usual = self.expect(elapsed_s)
        given = prior or usual
        expected = log_pose(given.step).scaled(1.0 / elapsed_s)
        sweep = _sweep(scan, expected, duration_s)
        is_blind = sweep.is_blind or is_gap
        moved, information, prior, is_lost = self._align(sweep.cloud, given, usual, is_blind)
        twist = log_pose(moved).scaled(1.0 / elapsed_s)
        if not is_lost and _differ(twist, expected, duration_s):
            sweep = _sweep(scan, twist, duration_s)
            moved, information, prior, is_lost = self._align(
                sweep.cloud, prior, usual, sweep.is_blind, moved
            )
            twist = log_pose(moved).scaled(1.0 / elapsed_s)
        unsteady = _least_variance(twist, self._twist, duration_s)
        self._stamp_ns = scan.stamp_ns
        self._carry_on(moved, elapsed_s, is_lost)
        self.pose = self.pose @ moved
        self._keep(sweep, is_lost)
        turned = _turned(prior.covariance, -moved.yaw)
        covariance = np.linalg.inv(np.linalg.inv(turned) + information) + unsteady
        return ScanMotion(moved, twist, covariance, information, is_lost)

    def _carry_on(self, moved: Pose2D, elapsed_s: float, is_lost: bool) -> None:
        """Note the speed with which the robot is expected to go on."""
        if is_lost:
            # Where nothing is seen, it is not believed for long that the robot goes on.
            self._twist = self._twist.scaled(0.5)
        else:
            # Over two steps, since the stamps of cheap lidars jitter.
            before, before_s = self._last_step
            both = log_pose(before @ moved)
            self._twist = both.scaled(1.0 / (before_s + elapsed_s))
        self._last_step = moved, elapsed_s

    def _align(
        self,
        cloud: Cloud,
        prior: Prior,
        usual: Prior,
        is_blind: bool,
        start: Pose2D | None = None,
    ) -> tuple[Pose2D, NDArray[np.float64], Prior, bool]:
        """Return the step, the information on it in the frame now, its prior, and whether lost."""
        if is_blind or self._surfels is None:
            return prior.step, np.zeros((3, 3)), prior, True
        best, held = self._align_from(start or prior.step, cloud, prior), prior
        if best.fit < PARAMS.usual_fit and not self._trusts_prior:
            turns = [usual.step @ Pose2D(0.0, 0.0, turn) for turn in PARAMS.other_turns]
            for one in [usual.step, Pose2D.identity(), *turns]:
                other = self._align_from(one, cloud, usual)
                if other.fit > best.fit + PARAMS.better_fit:
                    best, held = other, usual
        if best.partners < PARAMS.least_partners or best.fit < PARAMS.least_fit:
            return prior.step, np.zeros((3, 3)), prior, True
        return best.step, best.information, held, False

    def _align_from(self, start: Pose2D, cloud: Cloud, prior: Prior) -> "_Alignment":
        assert self._surfels is not None
        expected = (self.pose @ prior.step).as_array()
        pose, information = (self.pose @ start).as_array(), np.zeros((3, 3))
        held = np.asarray(np.linalg.inv(_turned(prior.covariance, self.pose.yaw)), np.float64)
        gain = gain_of(len(cloud.points))
        params = AlignmentParams(
            PARAMS.first_reach_m,
            PARAMS.last_reach_m,
            PARAMS.width_m,
            gain,
            PARAMS.max_iterations,
        )
        partners = align(pose, information, self._surfels, cloud, expected, held, params)
        if not np.isfinite(pose).all():
            return _Alignment(prior.step, np.zeros((3, 3)), 0, 0.0)
        found = Pose2D.from_array(pose)
        # Each point adds its weight, spread over x and y by its normal.
        weights = float(information[0, 0] + information[1, 1]) / gain
        facing = np.count_nonzero(cloud.normals.any(axis=1))
        most = facing + STEP.without_normal * (len(cloud.points) - facing)
        shown = _turned(without_noise(information), -found.yaw)
        return _Alignment(self.pose.inverse() @ found, shown, partners, weights / max(most, 1.0))

    def _keep(self, sweep: Sweep, is_lost: bool) -> None:
        """Remember the scan if it shows enough that is new, and begin anew if it was lost."""
        self._num_lost = self._num_lost + 1 if is_lost else 0
        if sweep.is_blind:
            return
        if is_lost:
            if self._num_lost < PARAMS.patience:
                return
            self._keys.clear()
        else:
            away = self._keys[-1][1].inverse() @ self.pose
            if math.hypot(away.x, away.y) < PARAMS.key_m and abs(away.yaw) < PARAMS.key_rad:
                return
        self._remember(sweep)

    def _remember(self, sweep: Sweep) -> None:
        self._keys.append((sweep, self.pose))
        capacity = sum(len(key.cloud.points) for key, _ in self._keys)
        cells = math.ceil(2.0 * PARAMS.reach_m / PARAMS.cell_m)
        corner = np.array([self.pose.x, self.pose.y]) - PARAMS.reach_m
        surfels = Surfels(
            np.empty((capacity, 2)),
            np.empty((capacity, 2)),
            np.empty(capacity),
            np.empty(capacity, np.int32),
            np.empty(capacity, np.int32),
            np.empty((cells, cells), np.int32),
            np.empty((0, 0), np.uint8),  # free space is not asked for
            np.array([corner[0], corner[1], 1.0 / PARAMS.cell_m]),
        )
        kernels.clear_surfels(surfels)
        count = 0
        for owner, (key, pose) in enumerate(self._keys):
            cloud = key.cloud
            count = kernels.add_surfels(
                surfels, count, cloud.points, cloud.normals, pose.as_array(), owner
            )
        kernels.normalise_surfels(surfels, count)
        self._surfels = surfels


def _sweep(scan: ScanInput, twist: Twist2D, duration_s: float) -> Sweep:
    """Put a scan into the frame that is followed, corrected for a motion."""
    moved = replace(
        scan, odom_T_base=Pose2D.identity(), odom_T_base_end=exp_twist(twist, duration_s)
    )
    return read_sweep(moved, PARAMS.reach_m)


def _least_variance(twist: Twist2D, before: Twist2D, duration_s: float) -> NDArray[np.float64]:
    """Return the covariance (3, 3) of a step that scans leave even where they show everything.

    A scan is corrected for the motion until it began, not for the one during it: while the robot
    gains speed, its middle is off by half of what it gains.
    """
    gained = 0.5 * abs(duration_s)
    along = PARAMS.floor_m + gained * abs(twist.vx - before.vx)
    aside = PARAMS.floor_m + gained * abs(twist.vy - before.vy)
    turn = PARAMS.floor_rad + gained * abs(twist.wz - before.wz)
    return np.diag([along**2, aside**2, turn**2])


def _differ(one: Twist2D, other: Twist2D, duration_s: float) -> bool:
    """Say whether two motions put the beams of a scan in different places."""
    along = math.hypot(one.vx - other.vx, one.vy - other.vy) * abs(duration_s)
    turn = abs(one.wz - other.wz) * abs(duration_s)
    return along > PARAMS.deskew_m or turn > PARAMS.deskew_rad


def _turned(matrix: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    """Give a covariance or an information (3, 3) in a frame in which its own is turned so [rad]."""
    cos, sin = math.cos(angle), math.sin(angle)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return turn @ matrix @ turn.T
