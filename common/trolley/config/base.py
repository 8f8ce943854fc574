"""`[base]`: the hardware or the simulated world, limits, and who may drive."""

from typing import Annotated, Literal

from msgspec import Meta, Struct, field

from trolley.config.hardware import (
    ChassisConfig,
    ImuConfig,
    LidarConfig,
    OdometryConfig,
    SensorName,
)
from trolley.config.robot import PoseConfig

Speed = Annotated[float, Meta(gt=0.0, le=5.0)]
Rate = Annotated[float, Meta(gt=0.0, le=10.0)]


class BatteryConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[base.simulated.battery]`: a battery for a simulated robot; without it there is none."""

    fraction: Annotated[float, Meta(ge=0.0, le=1.0)] = 1.0
    """The battery's charge when base starts."""
    minutes: Annotated[float, Meta(gt=0.0, le=100_000.0)]
    """How long a full battery lasts [min]; it charges four times as fast."""
    charger: PoseConfig | None = None
    """Where the battery is charged, within 0.3 m; nowhere if not given."""


class SimulatedConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[base.simulated]`: the world that a simulated robot drives in."""

    world: str = "apartment.toml"
    """A world file, relative to this file, or the name of one that ships with Trolley."""
    seed: Annotated[int, Meta(ge=0, le=2**31 - 1)] = 0
    """Seed of noise, slip, odometry bias and people."""
    rate: Annotated[float, Meta(gt=0.0, le=100.0)] = 1.0
    """Simulated seconds per real second."""
    start: PoseConfig | None = None
    """Where the robot really starts; the world's own start if not given."""
    battery: BatteryConfig | None = None


class RecordingConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[base.recording]`: a recorded drive to play instead of hardware."""

    file: str
    """A file written by `trolley record`, or an npz file with stamps, odom, ranges_mm, angle_min,
    angle_increment and range_max."""
    rate: Annotated[float, Meta(gt=0.0, le=100.0)] = 1.0
    """Recorded seconds per real second."""


class LimitsConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[base.limits]`: what no source of commands may exceed."""

    max_speed_mps: Speed = 0.5
    """Highest speed, along x and y together."""
    max_wz_radps: Rate = 1.5
    """Highest turn rate."""
    acceleration_mps2: Rate = 0.8
    """Highest acceleration."""
    deceleration_mps2: Rate = 1.0
    """Deceleration that the robot can always reach on level floor; the stop field relies on it."""
    angular_acceleration_radps2: Annotated[float, Meta(gt=0.0, le=50.0)] = 4.0
    """Highest angular acceleration."""
    slope: Annotated[float, Meta(ge=0.0, le=0.3)] = 0.05
    """Steepest floor, in metres of height per metre: the stop field allows for braking that much
    worse downhill."""


SensorUse = Literal["stop", "mark"]


class ExtraSensorConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[base.scans.NAME]`: an extra sensor, published as `scan/NAME` by a program or the board."""

    pose: PoseConfig = PoseConfig(x=0.0, y=0.0, yaw=0.0)
    """The sensor's pose in `base_link`: x forward, y left, yaw counter-clockwise to angle 0."""
    z_m: Annotated[float, Meta(ge=0.0, le=3.0)] = 0.2
    """Height above the floor."""
    uses: Annotated[list[SensorUse], Meta(min_length=1)] = field(
        default_factory=lambda: ["stop", "mark"]
    )
    """What its echoes are for: `stop`, the stop field; `mark`, the planner's obstacles."""
    kept_s: Annotated[float, Meta(ge=0.5, le=600.0)] = 3.0
    """For how long an echo stays that the sensor does not see past; a bumper, which sees nothing
    from afar, wants a minute."""


class BaseConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The base: what moves the robot, within which limits, and at whose command."""

    driver: Literal["simulated", "recording", "hardware"] = "simulated"
    """Where motion and scans come from: a simulation, a recording or real devices."""
    simulated: SimulatedConfig = SimulatedConfig()
    recording: RecordingConfig | None = None
    chassis: ChassisConfig = ChassisConfig()
    lidar: LidarConfig = LidarConfig()
    imu: ImuConfig | None = None
    odometry: OdometryConfig = OdometryConfig()
    limits: LimitsConfig = LimitsConfig()
    sources: dict[str, Annotated[int, Meta(ge=0, le=1000)]] = field(
        default_factory=lambda: {"teleop": 20, "calibrate": 15, "ros2": 12, "planner": 10}
    )
    """Priority of each source that may drive; the highest with a fresh command wins."""
    scans: dict[SensorName, ExtraSensorConfig] = {}
    """Sensors beside the lidar, each a table `[base.scans.NAME]`; only those listed are used."""
    stop_margin_m: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.05
    """Distance from an obstacle at which the stop field stops the robot [m]."""
