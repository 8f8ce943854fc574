"""From chassis readings to the track: what is corrected, left out and counted."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from trolley.config import ConfigError, RobotConfig
from trolley.geometry import Pose2D, Twist2D, exp_twist
from trolley.messages import Imu, Link
from trolley_base.drivers import ChassisReading, MotionSample
from trolley_base.odometry.dead_reckoning import DeadReckoning
from trolley_base.odometry.wheel_scales import WheelScales, scales_of

START_NS = 1_764_000_000_000_000_000
STEP_NS = 50_000_000
UP = Link(name="chassis", state="up")


def config_of(drive: str = "skid_steer", use_imu: bool = True, **base: object) -> RobotConfig:
    plain = {
        "robot": {"name": "r", "footprint": {"radius_m": 0.2}, "drive": drive},
        "base": {"chassis": {"use_imu": use_imu}, **base},
        "folder": str(Path()),
    }
    return msgspec.convert(plain, RobotConfig)


def test_scales_correct_the_way_and_the_twist() -> None:
    reckoning = DeadReckoning(config_of(), WheelScales(linear=1.1), START_NS)
    motion = MotionSample(START_NS + STEP_NS, Pose2D(0.02, 0.0, 0.0), Twist2D(0.4, 0.0, 0.0))
    assert reckoning.add_reading(ChassisReading((motion,), UP)).notes == ()
    assert reckoning.track.odom_T_base.x == pytest.approx(0.022)
    assert reckoning.track.twist.vx == pytest.approx(0.44)


def test_a_jump_is_counted_and_left_out() -> None:
    reckoning = DeadReckoning(config_of(), WheelScales(), START_NS)
    jump = MotionSample(START_NS + STEP_NS, Pose2D(300.0, 0.0, 0.0), Twist2D.zero())
    after = MotionSample(START_NS + 2 * STEP_NS, Pose2D(0.01, 0.0, 0.0), Twist2D.zero())
    reading = reckoning.add_reading(ChassisReading((jump, after), UP, counts={"crc": 2}))
    assert reading.counts == {"crc": 2, "odometry/jump": 1}
    assert [note.kind for note in reading.notes] == ["odometry/jump"]
    assert reckoning.track.odom_T_base == Pose2D(0.01, 0.0, 0.0)


def test_jumps_that_the_driver_left_out_are_told_too() -> None:
    reckoning = DeadReckoning(config_of(), WheelScales(), START_NS)
    reckoning.add_reading(ChassisReading((), UP, num_jumps=2))
    assert reckoning.measured.num_jumps == 2


@pytest.mark.parametrize("use_imu", [True, False])
def test_the_position_follows_the_fused_heading(use_imu: bool) -> None:
    """Wheels that slip by a tenth on an arc, a gyro that does not."""
    reckoning = DeadReckoning(config_of(use_imu=use_imu), WheelScales(), START_NS)
    rng = np.random.default_rng(1)
    true = Pose2D.identity()
    for index in range(1000):
        end_ns = START_NS + (index + 1) * STEP_NS
        rate = 0.0 if index < 80 else 0.4
        speed = 0.0 if index < 80 else 0.3
        step_s = STEP_NS * 1e-9
        true = true @ exp_twist(Twist2D(speed, 0.0, rate), step_s)
        reported = Twist2D(speed, 0.0, 1.1 * rate)
        motion = MotionSample(end_ns, exp_twist(reported, step_s), reported)
        imu = Imu(
            stamp_ns=end_ns - 20_000_000,
            angular_velocity=(0.0, 0.0, rate + 0.05 + 0.002 * float(rng.normal())),
            linear_acceleration=(0.0, 0.0, 9.8),
        )
        assert reckoning.add_reading(ChassisReading((motion,), UP, imu=(imu,))).counts == {}
    track = reckoning.track
    is_near = track.odom_T_base.distance_to(true) < 0.2
    assert is_near == use_imu
    assert track.twist.wz == pytest.approx(0.4 if use_imu else 0.44, abs=0.01)


def test_a_ratio_without_a_track_is_a_wrong_configuration() -> None:
    with pytest.raises(ConfigError, match="track_m"):
        scales_of(config_of(odometry={"wheel_ratio": 1.02}))
    scales = scales_of(config_of(odometry={"wheel_ratio": 1.02, "track_m": 0.2}))
    assert scales.matrix[1, 0] == pytest.approx(2.0 * 0.02 / 2.02 / 0.2)


def test_the_gyro_of_a_robot_that_slides_sideways_counts_too() -> None:
    """Its rollers slip: the wheels report no turn, the gyro the true one."""
    reckoning = DeadReckoning(config_of("mecanum"), WheelScales(), START_NS)
    rng = np.random.default_rng(1)
    stamp_ns, turned = START_NS, 0.0

    def go(seconds: float, reported: Twist2D, rate: float) -> None:
        nonlocal stamp_ns, turned
        for _ in range(round(seconds / (STEP_NS * 1e-9))):
            stamp_ns += STEP_NS
            before = reckoning.track.odom_T_base
            gyro = rate + 0.01 + 0.003 * float(rng.normal())
            imu = Imu(
                stamp_ns=stamp_ns,
                angular_velocity=(0.0, 0.0, gyro),
                linear_acceleration=(0.0, 0.0, 9.8),
            )
            motion = MotionSample(stamp_ns, exp_twist(reported, STEP_NS * 1e-9), reported)
            reckoning.add_reading(ChassisReading((motion,), UP, imu=(imu,)))
            turned += (before.inverse() @ reckoning.track.odom_T_base).yaw

    go(5.0, Twist2D.zero(), 0.0)
    for rate in (0.5, -0.5):  # by which the gyro is found to be right
        go(3.0, Twist2D(0.0, 0.0, rate), rate)
    go(2.0, Twist2D.zero(), 0.0)
    turned = 0.0
    go(10.0, Twist2D(0.0, 0.3, 0.0), 0.05)
    assert turned == pytest.approx(0.5, abs=0.03)
