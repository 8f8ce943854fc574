"""How the robot moves: as the wheels count it, and as the lidar sees it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, Twist2D, angle_difference
from trolley.scan_matching.scan_odometry import Prior, ScanOdometry
from trolley_base.drivers import LidarScan, MotionSample
from trolley_base.setup.record import SetupRefused
from trolley_base.setup.sight import Beams, Sector, at_rest, in_motion, usual_ranges

Floats = NDArray[np.float64]
STANDS_APART_NS = 1_000_000_000
"""Stands are matched as if they came so soon after each other: they lie farther apart in time than
scans of one drive may."""


@dataclass(frozen=True, slots=True)
class MotionParams:
    """When wheels stand, and what is believed of stands; set by hand."""

    still_mps: float = 0.004
    """Wheels that are slower stand [m/s]."""
    still_radps: float = 0.02
    """Wheels that turn the robot more slowly stand [rad/s]."""
    prior_m: float = 0.05
    """Standard deviation of where a stand is expected [m]."""
    prior_rad: float = 0.03
    """The same of its direction [rad]."""
    plain: float = 0.02
    """Share of what a scan shows that it must show in each direction: less is a plain corridor."""
    all_round_rad: float = 1.7 * math.pi
    """Field of view from which on each stand shows what all others have shown [rad]."""
    num_stands: int = 60
    """Number of stands that are remembered of a lidar that sees less: all of a drive."""


PARAMS = MotionParams()


class WheelCount:
    """What the wheels have counted, in all and from stand to stand."""

    def __init__(self) -> None:
        self.way = self.turn = 0.0
        """Ahead [m], and counter-clockwise [rad]."""
        self.still_since_ns: int | None = None
        """Since when the wheels stand as told; None while they do not."""
        self._at_stands: list[tuple[float, float]] = []

    def take(self, motion: MotionSample, *, is_to_stand: bool) -> None:
        """Add what the board reports."""
        step, twist = motion.previous_T_base, motion.twist
        self.way += step.x
        self.turn += step.yaw
        if twist.speed > PARAMS.still_mps or abs(twist.wz) > PARAMS.still_radps:
            self.still_since_ns = None
        elif self.still_since_ns is None and is_to_stand:
            self.still_since_ns = motion.stamp_ns

    def note_stand(self) -> None:
        """Note what is counted at a stand."""
        self._at_stands.append((self.way, self.turn))

    def between_stands(self, index: int = -2) -> tuple[float, float]:
        """Return the way [m] and the turn [rad] counted from a stand to the next, the last two."""
        before, after = self._at_stands[index], self._at_stands[index + 1]
        return after[0] - before[0], after[1] - before[1]


class LidarTrack:
    """Where the lidar is: followed scan by scan on the way, and corrected at each stand."""

    def __init__(self) -> None:
        self.beams: Beams | None = None
        """The directions in which stands see, once there is a scan."""
        self.scans: list[LidarScan] = []
        """Since they were last forgotten."""
        self.latest_ns = 0
        self._moving = ScanOdometry(has_axle=False)
        self._standing = ScanOdometry(has_axle=False, trusts_prior=True)
        self._moving_at_stand = self._start_T_moving = Pose2D.identity()

    @property
    def pose(self) -> Pose2D:
        """Where it is by the scans on the way alone."""
        return self._moving.pose

    @property
    def here(self) -> Pose2D:
        """start_T_laser now."""
        return self._start_T_moving @ self._moving.pose

    @property
    def since_stand(self) -> Pose2D:
        """How it has moved since the last stand."""
        return self._moving_at_stand.inverse() @ self._moving.pose

    def view_rad(self, own: Sequence[Sector]) -> float:
        """Return how far round the lidar sees, but for the robot itself [rad].

        Where no beam of the last scans measures, as where it is masked, it sees nothing.

        Args:
            own: where it sees the robot.
        """
        scan = self.scans[-1]
        alike = [one.ranges for one in self.scans if len(one.ranges) == len(scan.ranges)]
        sees = np.max(alike, axis=0) > 0.0
        sees &= Beams.of(scan).outside(own)
        return abs(scan.angle_increment) * int(np.count_nonzero(sees))

    def take(self, scan: LidarScan) -> bool:
        """Keep a scan; False where it is not newer."""
        if scan.stamp_ns <= self.latest_ns:
            return False
        if self.beams is None:
            self.beams = Beams.round_about(scan)
        self.latest_ns = scan.stamp_ns
        self.scans.append(scan)
        return True

    def follow(self, scan: LidarScan, own: Sequence[Sector]) -> Twist2D:
        """Follow a scan, and return how fast the lidar moves.

        Raises:
            SetupRefused: it cannot be followed.
        """
        duration_s = max(len(scan.ranges) - 1, 0) * scan.time_increment
        found = self._moving.update(in_motion(scan, own), duration_s)
        if self._moving.is_lost:
            raise SetupRefused(
                "The lidar cannot follow how the robot moves: it sees too little here, or the "
                "robot was carried away."
            )
        return found.twist

    def note_stand(
        self, scans: Sequence[LidarScan], own: Sequence[Sector], number: int
    ) -> tuple[Pose2D, NDArray[np.float32], bool]:
        """Find where it stands, and correct where the scans on the way have led.

        Args:
            scans: taken there.
            own: where it sees the robot itself.
            number: of the stand, from 0.

        Returns:
            start_T_laser, the usual ranges (beams,) [m], and whether the walls in sight tell too
            little of how it moved.

        Raises:
            SetupRefused: what it sees does not fit what it saw before.
        """
        assert self.beams is not None  # there are scans
        ranges = usual_ranges(self.beams, scans)
        prior = None
        if not number and self.view_rad(own) < PARAMS.all_round_rad:
            # After some strokes the last stands all looked one way.
            self._standing = ScanOdometry(
                has_axle=False, trusts_prior=True, num_keys=PARAMS.num_stands
            )
        if number:
            spread = (PARAMS.prior_m, PARAMS.prior_m, PARAMS.prior_rad)
            prior = Prior(self.since_stand, np.diag(np.square(spread)))
        seen = self._standing.update(
            at_rest(self.beams, ranges, scans[-1], own, (number + 1) * STANDS_APART_NS), 0.0, prior
        )
        if seen.is_lost:
            raise SetupRefused(
                "What the lidar sees here does not fit what it saw before: the robot was carried "
                "away, or too much has changed around it."
            )
        is_plain = bool(number) and _is_plain(seen.shown)
        self._moving_at_stand = self._moving.pose
        self._start_T_moving = self._standing.pose @ self._moving.pose.inverse()
        return self._standing.pose, ranges, is_plain


class Turn:
    """How far a direction has turned since it was first seen: beyond half a turn, too.

    Args:
        direction: that was seen first [rad].
    """

    def __init__(self, direction: float) -> None:
        self._last = direction
        self.angle = 0.0
        """Counter-clockwise [rad]."""

    def update(self, direction: float) -> float:
        """Take the direction as it is seen now [rad], and return the angle."""
        self.angle += angle_difference(direction, self._last)
        self._last = direction
        return self.angle


def axle_of(poses: Sequence[Pose2D]) -> Floats:
    """Return the point (2,) in the frame of the lidar that stays where it is on all turns [m]."""
    rows = np.zeros((2 * len(poses), 4))
    places = np.zeros(2 * len(poses))
    for index, pose in enumerate(poses):
        cos, sin = math.cos(pose.yaw), math.sin(pose.yaw)
        rows[2 * index] = cos, -sin, -1.0, 0.0
        rows[2 * index + 1] = sin, cos, 0.0, -1.0
        places[2 * index : 2 * index + 2] = -pose.x, -pose.y
    found, *_ = np.linalg.lstsq(rows, places, rcond=None)
    return np.asarray(found[:2], np.float64)


def _is_plain(shown: Floats) -> bool:
    values = np.linalg.eigvalsh(shown[:2, :2])
    return bool(values[0] < PARAMS.plain * values.sum())
