"""From what chassis and lidar report to where the robot is: guard, scales, gyro, lidar, track."""

import math
from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from trolley.config import RobotConfig
from trolley.geometry import Pose2D, Twist2D, exp_twist, log_pose
from trolley.messages.motion import Drive
from trolley_base.drivers import ChassisReading, LidarScan, MotionSample, Note
from trolley_base.odometry.motion_guard import MotionGuard
from trolley_base.odometry.track import OdometryTrack
from trolley_base.odometry.wheel_scales import WheelScales
from trolley_base.odometry.yaw_fusion import GyroState, YawFusion

if TYPE_CHECKING:
    from trolley_base.odometry.lidar_odometry import LidarOdometry, SeenMotion

SLIP: dict[Drive, float] = {"differential": 0.03, "mecanum": 0.06, "skid_steer": 0.12}
"""Standard deviation of the wheels' turn, as a share of it: four that are dragged round slip most.

By hand.
"""
JUMP = Note(
    "warning",
    "odometry/jump",
    "The wheels reported a motion that no robot can make; it was ignored.",
)
SENTENCES = {
    GyroState.STUCK: "The gyro keeps repeating one value; its turn rate is not used.",
    GyroState.DISAGREES: (
        "The gyro does not turn as the wheels do: see [base.chassis] imu_axes ([base.imu] axes), "
        "or the wheels slip, or the robot is carried. Its turn rate is not used."
    ),
}
"""Worth a line in the log; the others come and go with the link."""
ORIGIN = Pose2D.identity()
QUIET_STATES = (GyroState.USED, GyroState.LEARNING)


class Measured(NamedTuple):
    """What a reading says of the robot's own motion, for who compares it with commands.

    Attributes:
        motions: true motions by the wheels alone, or by the lidar of a robot whose wheels report
            nothing; each with the mean turn rate by the gyro [rad/s], None where that says nothing.
        num_jumps: motions that no robot can do, and that were ignored.
    """

    motions: tuple[tuple[MotionSample, float | None], ...] = ()
    num_jumps: int = 0


class DeadReckoning:
    """Joins the motions of a run to the robot's track in `odom`.

    Args:
        scales: between reported and true motion.
        stamp_ns: robot time at which the run begins.
        base_T_laser: where the lidar sits, should it be asked how the robot moves.
    """

    def __init__(
        self,
        config: RobotConfig,
        scales: WheelScales,
        stamp_ns: int,
        base_T_laser: Pose2D = ORIGIN,
    ) -> None:
        self.track = OdometryTrack(stamp_ns)
        self._guard = MotionGuard(stamp_ns)
        self._scales = scales
        self._fusion = YawFusion(SLIP[config.robot.drive])
        self._uses_imu = config.base.chassis.use_imu
        self._has_wheels = config.base.odometry.source != "lidar"
        self._lidar = _lidar_odometry(config, base_T_laser, stamp_ns)
        self.measured = Measured()
        """What the newest reading said."""

    @property
    def trouble(self) -> str:
        """What is wrong with what tells the motion, as a sentence; "" while nothing is known."""
        if self._lidar is not None and self._lidar.trouble:
            return self._lidar.trouble
        found = self._fusion.trouble if self._uses_imu else None
        return "" if found is None else found.value

    @property
    def has_wheels(self) -> bool:
        """Whether the wheels say how the robot moves."""
        return self._has_wheels

    def add_scan(self, scan: LidarScan) -> None:
        """Take what the lidar saw, where it is to say how the robot moves."""
        if self._lidar is None:
            return
        before_ns = self._lidar.scan_ns
        rate = None
        if before_ns is not None and not self._has_wheels:
            rate = self._gyro_rate(before_ns, scan.stamp_ns)
        seen = self._lidar.update(scan, rate)
        if self._has_wheels:
            return
        if seen is not None and self._uses_imu:
            self._judge_gyro(seen)
        motion = self._lidar.take_motion()
        if motion is not None:
            self.measured = Measured(((motion, None),))

    def command(self, now_ns: int, twist: Twist2D) -> None:
        """Take what is driven from now on."""
        if self._lidar is not None:
            self._lidar.command(now_ns, twist)

    def carry_on(self, now_ns: int) -> bool:
        """Go on as before until now where only the lidar says how, and say whether it does."""
        if self._lidar is None or self._has_wheels:
            return False
        motion = self._lidar.carried_on(now_ns, self._gyro_rate(self.track.stamp_ns, now_ns))
        if motion is not None:
            self.track.add(self._lidar.correct(motion, self.track.odom_T_base))
        return motion is not None

    def _gyro_rate(self, start_ns: int, end_ns: int) -> float | None:
        """Return the gyro's turn rate once it is known to be right [rad/s]."""
        if not self._uses_imu or self._fusion.state is not GyroState.USED:
            return None
        return self._fusion.gyro_rate(start_ns, end_ns)

    def _judge_gyro(self, seen: "SeenMotion") -> None:
        """Judge the gyro by the lidar, and learn its bias while the lidar sees the robot stand."""
        step = seen.motion.previous_T_base
        distance, turn = (0.0, 0.0) if seen.is_still else (math.hypot(step.x, step.y), step.yaw)
        self._fusion.fuse(seen.start_ns, seen.motion.stamp_ns, distance, turn)

    def add_reading(self, reading: ChassisReading) -> ChassisReading:
        """Join what was measured; return the reading with what there is to say about it added."""
        if self._uses_imu:
            for imu in reading.imu:
                self._fusion.add_gyro(imu.stamp_ns, imu.angular_velocity[2])
        if not self._has_wheels:
            self.measured = Measured()
            return reading
        if not reading.motions:
            self.measured = Measured(num_jumps=reading.num_jumps)
            return reading
        notes: list[Note] = []
        counts = Counter(reading.counts)
        measured: list[tuple[MotionSample, float | None]] = []
        num_jumps = reading.num_jumps
        for motion in reading.motions:
            if not self._guard.accepts(motion):
                counts[JUMP.kind] += 1
                notes.append(JUMP)
                num_jumps += 1
                continue
            before = self._fusion.state
            by_wheels = self._by_wheels(motion)
            start_ns = self.track.stamp_ns
            gyro = self._fusion.gyro_rate(start_ns, motion.stamp_ns) if self._uses_imu else None
            measured.append((by_wheels, gyro))
            fused = self._fuse(by_wheels) if self._uses_imu else by_wheels
            if self._lidar is not None:
                fused = self._lidar.correct(fused, self.track.odom_T_base)
            self.track.add(fused)
            now = self._fusion.state
            if now is not before and now not in QUIET_STATES:
                kind = f"odometry/{now.value}"
                counts[kind] += 1
                text = self.trouble or SENTENCES.get(now)
                if text:
                    notes.append(Note("warning", kind, text))
        self.measured = Measured(tuple(measured), num_jumps)
        return replace(reading, notes=(*reading.notes, *notes), counts=counts)

    def _by_wheels(self, motion: MotionSample) -> MotionSample:
        if self._scales.is_identity:
            return motion
        return replace(
            motion,
            previous_T_base=self._scales.true_motion(motion.previous_T_base),
            twist=self._scales.true_twist(motion.twist),
        )

    def _fuse(self, motion: MotionSample) -> MotionSample:
        """Keep the distance of the wheels, and turn as wheels and gyro together say."""
        start_ns = self.track.stamp_ns
        step = log_pose(motion.previous_T_base)
        turn = self._fusion.fuse(start_ns, motion.stamp_ns, step.speed, step.wz)
        if turn == step.wz:
            return motion
        rate = turn / ((motion.stamp_ns - start_ns) * 1e-9)
        return replace(
            motion,
            previous_T_base=exp_twist(Twist2D(step.vx, step.vy, turn)),
            twist=Twist2D(motion.twist.vx, motion.twist.vy, rate),
        )


def _lidar_odometry(
    config: RobotConfig, base_T_laser: Pose2D, stamp_ns: int
) -> "LidarOdometry | None":
    """Return what asks the lidar for the motion, None where the wheels suffice."""
    source = config.base.odometry.source
    if source == "wheels":
        return None
    from trolley_base.odometry.lidar_odometry import LidarOdometry

    has_axle = config.robot.drive != "mecanum"
    return LidarOdometry(base_T_laser, stamp_ns, has_wheels=source == "both", has_axle=has_axle)
