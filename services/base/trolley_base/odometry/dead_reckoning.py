"""From what the chassis reports to where the robot is: guard, scales, gyro, track."""

from collections import Counter
from dataclasses import replace
from typing import NamedTuple

from trolley.config import RobotConfig
from trolley.geometry import Twist2D, exp_twist, log_pose
from trolley.messages.motion import Drive
from trolley_base.drivers import ChassisReading, MotionSample, Note
from trolley_base.odometry.motion_guard import MotionGuard
from trolley_base.odometry.track import OdometryTrack
from trolley_base.odometry.wheel_scales import WheelScales
from trolley_base.odometry.yaw_fusion import GyroState, YawFusion

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
        "The gyro does not turn as the wheels do: see [base.chassis] imu_axes, or the wheels "
        "slip, or the robot is carried. Its turn rate is not used."
    ),
}
"""Worth a line in the log; the others come and go with the link."""
QUIET_STATES = (GyroState.USED, GyroState.LEARNING)


class Measured(NamedTuple):
    """What a reading says of the robot's own motion, for who compares it with commands.

    Attributes:
        motions: true motions by the wheels alone, each with the mean turn rate by the gyro [rad/s],
            None where that says nothing.
        num_jumps: motions that no robot can do, and that were ignored.
    """

    motions: tuple[tuple[MotionSample, float | None], ...] = ()
    num_jumps: int = 0


class DeadReckoning:
    """Joins the motions of a run to the robot's track in `odom`.

    Args:
        scales: between reported and true motion.
        stamp_ns: robot time at which the run begins.
    """

    def __init__(self, config: RobotConfig, scales: WheelScales, stamp_ns: int) -> None:
        self.track = OdometryTrack(stamp_ns)
        self._guard = MotionGuard(stamp_ns)
        self._scales = scales
        self._fusion = YawFusion(SLIP[config.robot.drive])
        self._uses_imu = config.base.chassis.use_imu
        self.measured = Measured()
        """What the newest reading said."""

    @property
    def trouble(self) -> str:
        """What is wrong with the gyro, as a sentence; "" while nothing is known to be."""
        found = self._fusion.trouble if self._uses_imu else None
        return "" if found is None else found.value

    def add_reading(self, reading: ChassisReading) -> ChassisReading:
        """Join what was measured; return the reading with what there is to say about it added."""
        if self._uses_imu:
            for imu in reading.imu:
                self._fusion.add_gyro(imu.stamp_ns, imu.angular_velocity[2])
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
            self.track.add(self._fuse(by_wheels) if self._uses_imu else by_wheels)
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
        turn = self._fusion.fuse(start_ns, motion.stamp_ns, step.vx, step.wz)
        if turn == step.wz:
            return motion
        rate = turn / ((motion.stamp_ns - start_ns) * 1e-9)
        return replace(
            motion,
            previous_T_base=exp_twist(Twist2D(step.vx, step.vy, turn)),
            twist=Twist2D(motion.twist.vx, motion.twist.vy, rate),
        )
