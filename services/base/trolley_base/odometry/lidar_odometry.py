"""Odometry that the lidar corrects: what wheels or habit say, put right by each scan.

`model` is where the robot would be by wheels and gyro alone; without wheels, where it would be if
it went on as before but for what it was told since. Each scan says where the robot was at its first
beam (`trolley.scan_matching`), and so how `model` lies in `odom`. Like this the lidar decides where
it sees, the wheels where it does not, and both are weighed where each says a part.

It brings numba along; imported only where the settings ask for it.
"""

import enum
import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, Twist2D, angle_difference, exp_twist, log_pose
from trolley.scan_matching.scan_odometry import Prior, ScanMotion, ScanOdometry
from trolley.scanning import ScanInput
from trolley_base.drivers import LidarScan, MotionSample
from trolley_base.odometry.motion_ratio import MotionRatio
from trolley_base.odometry.track import OdometryTrack


@dataclass(frozen=True, slots=True)
class LidarOdometryParams:
    """How wheels and gyro are weighed against the lidar.

    By hand; the wheels' deviations were found with bench/base/scan_odometry.py.
    """

    wheels_share: float = 0.1
    """Standard deviation of a distance by the wheels, as a share of it."""
    wheels_m: float = 0.01
    """The same of any step: wheels and scans are not simultaneous [m]."""
    aside_share: float = 0.02
    """Standard deviation of a step sideways, as a share of the distance."""
    wheels_turn_share: float = 0.08
    """Standard deviation of a turn by wheels, or wheels and gyro, as a share of it."""
    wheels_rad: float = 0.01
    """The same of any step [rad]."""
    gyro_share: float = 0.02
    """Standard deviation of a turn by the gyro alone, as a share of it."""
    gyro_rad: float = 0.004
    """The same of any step [rad]."""
    still_mps: float = 0.015
    """A robot that the scans show to be slower stands [m/s]."""
    still_radps: float = 0.03
    """The same of its turn rate [rad/s]."""
    late_s: float = 0.13
    """Time until motors do as they are told: boards with a control loop of 20 Hz, geared motors
    [s]."""
    kept_s: float = 2.0
    """Commands are kept for this long [s]."""
    longest_s: float = 0.6
    """Without wheels nothing is known of the motion for longer than this after a scan [s]."""
    told_s: float = 0.2
    """Motions seen by the lidar are joined until they last this long: over a shorter time the noise
    of the scans would look like speed [s]."""
    slow_mps: float = 0.05
    """Slower wheels say nothing of whether they grip [m/s]."""
    slow_radps: float = 0.2
    """The same of a turn [rad/s]."""
    judged_m: float = 0.3
    """Way by the wheels after which they are judged [m]."""
    judged_rad: float = 1.5
    """Turn by the wheels after which they are judged [rad]."""
    forgetting: float = 1.5
    """Older ways and turns are forgotten over so many times that."""
    slips_below: float = 0.4
    """Way seen by the lidar per way of the wheels below which they slip."""
    reversed_below: float = -0.4
    """Way or turn seen per that of the wheels below which the sign is wrong."""
    most: float = 5.0
    """Greatest ratio that one step may report, either way."""
    shown_m: float = 0.01
    """Standard deviation of the way by the scan alone, above which it does not judge wheels [m]."""


PARAMS = LidarOdometryParams()


class WheelTrouble(enum.Enum):
    """How wheels and lidar differ; the value is a sentence."""

    SLIP = (
        "The wheels turn, but by the lidar the robot hardly moves: it is stuck, or they slip. The "
        "odometry follows the lidar."
    )
    BACKWARDS = (
        "The wheels report the opposite of the way that the lidar sees the robot go: does an "
        "encoder count backwards, or not tell back from ahead? The odometry follows the lidar."
    )
    TURNS_BACKWARDS = (
        "The wheels report turns the opposite way to what the lidar sees: left and right are "
        "swapped, or the lidar is upside down. The odometry follows the lidar."
    )


class WheelCheck:
    """Learns how far the robot goes, by the lidar, for what its wheels report."""

    def __init__(self) -> None:
        away, turn = PARAMS.judged_m, PARAMS.judged_rad
        self._ahead = MotionRatio(PARAMS.slow_mps, PARAMS.forgetting * away, PARAMS.most)
        self._turn = MotionRatio(PARAMS.slow_radps, PARAMS.forgetting * turn, PARAMS.most)

    @property
    def trouble(self) -> WheelTrouble | None:
        """What is wrong, None while that is not known or nothing is."""
        ahead, turn = self._ahead, self._turn
        if turn.covered >= PARAMS.judged_rad and turn.value < PARAMS.reversed_below:
            return WheelTrouble.TURNS_BACKWARDS
        if ahead.covered < PARAMS.judged_m or ahead.value > PARAMS.slips_below:
            return None
        is_reversed = ahead.value < PARAMS.reversed_below
        return WheelTrouble.BACKWARDS if is_reversed else WheelTrouble.SLIP

    def add(self, wheels: Pose2D, seen: Pose2D, shown: NDArray[np.float64], seconds: float) -> None:
        """Take a step by the wheels and by the lidar, and the information that the scan gives."""
        if shown[2, 2] * PARAMS.wheels_rad**2 > 1.0:
            self._turn.add(wheels.yaw, seen.yaw, seconds)
        if shown[0, 0] * PARAMS.shown_m**2 > 1.0:
            self._ahead.add(wheels.x, seen.x, seconds)


@dataclass(frozen=True, slots=True, eq=False)
class SeenMotion:
    """What a scan says of the motion since the scan before."""

    start_ns: int
    """Robot time of the scan before [ns]."""
    motion: MotionSample
    """Until the scan's first beam."""
    is_still: bool
    """The robot stands, as far as scans show that."""


LOST = (
    "The lidar does not show how the robot moves, so there is no odometry: is it covered, or is "
    "there nothing in its reach?"
)


class LidarOdometry:
    """Corrects a model of the motion by scans.

    Args:
        base_T_laser: where the lidar sits.
        stamp_ns: robot time at which the run begins.
        has_wheels: what the wheels report is a part of the model.
        has_axle: the robot does not move sideways.
    """

    def __init__(
        self, base_T_laser: Pose2D, stamp_ns: int, *, has_wheels: bool, has_axle: bool
    ) -> None:
        self._base_T_laser = base_T_laser
        self._has_wheels = has_wheels
        self._has_axle = has_axle
        self._scans = ScanOdometry(has_axle=has_axle)
        self._model, self._wheels = OdometryTrack(stamp_ns), OdometryTrack(stamp_ns)
        self._odom_T_model = self._start = Pose2D.identity()
        self._scan_ns: int | None = None
        self._model_then = self._wheels_then = Pose2D.identity()
        """Where the tracks were at that scan, should they not reach back to it."""
        self._check = WheelCheck()
        self._commands: deque[tuple[int, Twist2D]] = deque([(stamp_ns, Twist2D.zero())])
        self._told_then = Twist2D.zero()
        self._seen, self._seen_from_ns = Pose2D.identity(), stamp_ns

    @property
    def trouble(self) -> str:
        """What is wrong with wheels or lidar, as a sentence; "" while nothing is known to be."""
        if self._has_wheels:
            found = self._check.trouble
            return "" if found is None else found.value
        if self._scans.is_lost:
            return LOST
        return ""

    @property
    def scan_ns(self) -> int | None:
        """Robot time of the newest scan, None before the first [ns]."""
        return self._scan_ns

    def correct(self, motion: MotionSample, odom_T_base: Pose2D) -> MotionSample:
        """Return a motion as one from a pose in `odom` on, with what scans say."""
        if self._has_wheels:
            self._wheels.add(motion)
            if self._distrusts_wheels:
                motion = self.carried_on(motion.stamp_ns, None) or motion
        self._model.add(motion)
        now = self._odom_T_model @ self._model.odom_T_base
        return MotionSample(motion.stamp_ns, odom_T_base.inverse() @ now, motion.twist)

    @property
    def _distrusts_wheels(self) -> bool:
        """Whether the lidar alone is followed."""
        return self._check.trouble is not None and not self._scans.is_lost

    def command(self, now_ns: int, twist: Twist2D) -> None:
        """Take what is driven from now on."""
        if twist != self._commands[-1][1]:
            self._commands.append((now_ns, twist))
            while now_ns - self._commands[1][0] > PARAMS.kept_s * 1e9:
                self._commands.popleft()

    def _told(self, start_ns: int, end_ns: int) -> Twist2D:
        """Return the mean of what the motors did as they were told over a time, once they heard."""
        late_ns = round(PARAMS.late_s * 1e9)
        start_ns, end_ns = start_ns - late_ns, end_ns - late_ns
        total, until_ns = Twist2D.zero(), end_ns
        for at_ns, twist in reversed(self._commands):
            since_ns = max(at_ns, start_ns)
            if since_ns < until_ns:
                part = twist.scaled((until_ns - since_ns) / (end_ns - start_ns))
                total = Twist2D(total.vx + part.vx, total.vy + part.vy, total.wz + part.wz)
                until_ns = since_ns
        return total

    def carried_on(self, now_ns: int, turn_rate: float | None) -> MotionSample | None:
        """Return how a robot has gone on without its wheels' word, None if no time has passed.

        Args:
            now_ns: robot time.
            turn_rate: by the gyro since the last call [rad/s], None where it says nothing.
        """
        elapsed_s = (now_ns - self._model.stamp_ns) * 1e-9
        if elapsed_s <= 0.0:
            return None
        twist = self._habit(now_ns)
        if turn_rate is not None:
            twist = Twist2D(twist.vx, twist.vy, turn_rate)
        return MotionSample(now_ns, exp_twist(twist, elapsed_s), twist)

    def _habit(self, now_ns: int) -> Twist2D:
        """Return how the robot goes now; standing where that is not known."""
        told, then = self._told(self._model.stamp_ns, now_ns), self._told_then
        twist = self._scans.twist
        if self._scan_ns is None or now_ns - self._scan_ns > PARAMS.longest_s * 1e9:
            return Twist2D.zero()
        if _is_still(twist):
            twist = Twist2D.zero()
        sideways = 0.0 if self._has_axle else twist.vy + told.vy - then.vy
        return Twist2D(twist.vx + told.vx - then.vx, sideways, twist.wz + told.wz - then.wz)

    def update(self, scan: LidarScan, turn_rate: float | None) -> SeenMotion | None:
        """Take a scan; None where it says nothing, or is not newer than the last.

        Args:
            scan: what the lidar saw.
            turn_rate: by the gyro since the scan before [rad/s], None where it says nothing.
        """
        before_ns = self._scan_ns
        if before_ns is not None and scan.stamp_ns <= before_ns:
            return None
        self._scan_ns = scan.stamp_ns
        then_ns = scan.stamp_ns if before_ns is None else before_ns
        then, now = _ends(self._model, then_ns, scan.stamp_ns, self._model_then)
        wheels = _ends(self._wheels, then_ns, scan.stamp_ns, self._wheels_then)
        self._model_then, self._wheels_then = now, wheels[1]
        seconds = (scan.stamp_ns - then_ns) * 1e-9
        duration_s = max(len(scan.ranges) - 1, 0) * scan.time_increment
        step = then.inverse() @ now
        prior = None if before_ns is None else self._prior(step, seconds, turn_rate)
        found = self._scans.update(self._input(scan), duration_s, prior)
        if before_ns is None:
            # Whatever the wheels did before is kept.
            self._start = self._odom_T_model @ now
            self._seen_from_ns = scan.stamp_ns
            return None
        self._odom_T_model = self._start @ self._scans.pose @ now.inverse()
        if self._has_wheels and not found.is_lost:
            by_wheels = wheels[0].inverse() @ wheels[1]
            self._check.add(by_wheels, found.step, found.shown, seconds)
        self._told_then = self._told(before_ns, scan.stamp_ns)
        self._join(scan.stamp_ns, found)
        if found.is_lost:
            return None
        motion = MotionSample(scan.stamp_ns, found.step, found.twist)
        return SeenMotion(before_ns, motion, _is_still(found.twist))

    def _join(self, scan_ns: int, found: ScanMotion) -> None:
        if found.is_lost:
            self._seen_from_ns, self._seen = scan_ns, Pose2D.identity()
        else:
            self._seen = self._seen @ found.step

    def take_motion(self) -> MotionSample | None:
        """Return what the last scans together say of the motion, once they last long enough."""
        if self._scan_ns is None:
            return None
        seconds = (self._scan_ns - self._seen_from_ns) * 1e-9
        if seconds < PARAMS.told_s:
            return None
        step, self._seen = self._seen, Pose2D.identity()
        self._seen_from_ns = self._scan_ns
        return MotionSample(self._scan_ns, step, log_pose(step).scaled(1.0 / seconds))

    def _prior(self, step: Pose2D, seconds: float, turn_rate: float | None) -> Prior:
        """Return what is expected of the motion between two scans."""
        if not self._has_wheels or self._distrusts_wheels:
            covariance = self._scans.expect(seconds).covariance.copy()
            if turn_rate is not None:
                turn = turn_rate * seconds
                step = Pose2D(step.x, step.y, turn)
                covariance[2, 2] = (PARAMS.gyro_share * turn) ** 2 + PARAMS.gyro_rad**2
            return Prior(step, covariance)
        away = math.hypot(step.x, step.y)
        turn = abs(angle_difference(step.yaw, 0.0))
        turn_std = math.hypot(PARAMS.wheels_turn_share * turn, PARAMS.wheels_rad)
        along = math.hypot(PARAMS.wheels_share * away, PARAMS.wheels_m)
        share = PARAMS.aside_share if self._has_axle else PARAMS.wheels_share
        aside = math.hypot(share * away, PARAMS.wheels_m) + 0.5 * turn_std * away
        return Prior(step, np.diag([along**2, aside**2, turn_std**2]))

    def _input(self, scan: LidarScan) -> ScanInput:
        return ScanInput(
            stamp_ns=scan.stamp_ns,
            ranges=scan.ranges,
            angle_min=scan.angle_min,
            angle_increment=scan.angle_increment,
            range_min=scan.range_min,
            range_max=scan.range_max,
            base_T_laser=self._base_T_laser,
            odom_T_base=Pose2D.identity(),
            odom_T_base_end=Pose2D.identity(),
        )


def _is_still(twist: Twist2D) -> bool:
    return twist.speed < PARAMS.still_mps and abs(twist.wz) < PARAMS.still_radps


def _ends(
    track: OdometryTrack, then_ns: int, now_ns: int, known_then: Pose2D
) -> tuple[Pose2D, Pose2D]:
    """Return where a track was at two robot times, of which it may not reach back to the first."""
    then, now = track.poses_at(np.array([then_ns, now_ns], dtype=np.int64))
    first = Pose2D.from_array(then) if then_ns >= track.oldest_ns else known_then
    return first, Pose2D.from_array(now)
