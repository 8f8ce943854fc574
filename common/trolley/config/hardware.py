"""`[base.chassis]`, `[base.lidar]`, `[base.odometry]`: the devices of a real robot."""

from typing import Annotated, Any, Literal

from msgspec import Meta, Struct

from trolley.config.robot import PoseConfig
from trolley.drivers import BOARDS, LIDARS

Board = Annotated[str, Meta(max_length=32, extra={"drivers": BOARDS})]
LidarModel = Annotated[str, Meta(max_length=32, extra={"drivers": LIDARS})]
Baud = Annotated[int, Meta(ge=1200, le=4_000_000)]
Degrees = Annotated[float, Meta(ge=-360.0, le=360.0)]
Pin = Annotated[int, Meta(ge=0, le=99)]
SensorName = Annotated[str, Meta(pattern="^[a-z0-9_-]{1,32}$")]
Scale = Annotated[float, Meta(ge=0.5, le=2.0)]
Axis = Literal["x", "-x", "y", "-y", "z", "-z"]


class LidarConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[base.lidar]`: the lidar and where it is mounted (a recording brings its own)."""

    model: LidarModel | None = None
    """The lidar's model, if the driver is `hardware`; `ld19` also covers LD06 and STL-06P to 26,
    `ydlidar_x2` the X3."""
    port: str = ""
    """The serial port; a name below /dev/serial/by-id or by-path stays the same. A device on the
    network is `tcp://host:port` or `udp://host:port`; one that sends to this computer `udp://:port`."""
    baud: Baud | None = None
    """Baud rate of the line; the model's own if not given."""
    mode: Literal["auto", "standard", "express"] = "auto"
    """How an RPLIDAR measures; `auto` is what the sensor calls typical, with an A1 the express
    scan if it has it; only an A1 has `express`."""
    pose: PoseConfig = PoseConfig(x=0.0, y=0.0, yaw=0.0)
    """The lidar's pose in `base_link`: x forward, y left, yaw counter-clockwise to angle 0."""
    z_m: Annotated[float, Meta(ge=0.0, le=3.0)] = 0.2
    """Height above the floor."""
    upside_down: bool = False
    """Whether it is mounted upside down, which reverses its rotation; angle 0 stays the same."""
    reversed: bool = False
    """Whether the sensor rotates the opposite way to its model."""
    masks_deg: list[tuple[Degrees, Degrees]] = []
    """Angles in frame `laser`, counter-clockwise [from, to], where it sees the robot itself."""
    range_min_m: Annotated[float, Meta(gt=0.0, le=5.0)] | None = None
    """Nearer echoes are ignored; the model's own limit if not given."""
    range_max_m: Annotated[float, Meta(gt=0.0, le=100.0)] | None = None
    """Farther echoes are ignored; the model's own limit if not given."""
    no_echo: Literal["hold", "creep"] | None = None
    """What a program does where no beam comes back, so that nobody knows whether the floor is free
    there: `hold` before it, or `creep` on. The model's own if not given: `creep` for `lds01`, whose
    reach often ends before the next wall, else `hold`."""
    settings: dict[str, Any] = {}
    """Settings that only this model has; its page lists them."""

    def __post_init__(self) -> None:
        """Refuse limits that leave nothing between them."""
        near, far = self.range_min_m, self.range_max_m
        if near is not None and far is not None and near >= far:
            raise ValueError("range_min_m must be less than range_max_m")


class WheelsConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[base.chassis.wheels]`: the wheels of a board that counts ticks (`arduino_bridge`)."""

    ticks_per_revolution: Annotated[float, Meta(gt=0.0, le=1e6)]
    """Ticks per turn of the wheel: the encoder's resolution times the gear ratio."""
    diameter_m: Annotated[float, Meta(gt=0.0, le=1.0)]
    """Diameter of a driven wheel."""
    track_m: Annotated[float, Meta(gt=0.0, le=3.0)]
    """Distance between the centres of the left and right wheels."""
    reverse_left: bool = False
    """Whether encoder and motor of the left wheel count and turn the wrong way round."""
    reverse_right: bool = False
    """Whether encoder and motor of the right wheel count and turn the wrong way round."""


class InputsConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[base.chassis.inputs]`: what is wired to the pins of the board (`arduino_bridge`)."""

    bumper_pins: Annotated[list[Pin], Meta(max_length=4)] = []
    """Digital pins of bumpers."""
    cliff_pins: Annotated[list[Pin], Meta(max_length=4)] = []
    """Digital pins of the cliff sensors, which look for the floor."""
    bumper_active: Annotated[int, Meta(ge=0, le=1)] = 0
    """What a bumper pin reads when it is hit; a switch to ground with a pull-up reads 0."""
    cliff_active: Annotated[int, Meta(ge=0, le=1)] = 1
    """What a cliff pin reads when there is no floor."""
    sonar_pins: Annotated[dict[SensorName, Pin], Meta(max_length=4)] = {}
    """Digital pins of sonars with one pin for both ways (PING))), SEN136B5B), each by the name of
    its table `[base.scans.NAME]`."""
    battery_pin: Pin | None = None
    """The analog pin that measures the battery."""
    battery_volts_per_count: Annotated[float, Meta(gt=0.0, le=1.0)] = 0.0049
    """Battery voltage per count of that pin, including the voltage divider."""
    battery_empty_v: Annotated[float, Meta(gt=0.0, le=100.0)] = 10.5
    """Voltage below which, after 2 s, the robot does not drive (`waveshare_ugv`, `hoverboard` and
    `linorobot2` too)."""
    battery_full_v: Annotated[float, Meta(gt=0.0, le=100.0)] = 12.6
    """Voltage of a fully charged battery (`waveshare_ugv`, `hoverboard` and `linorobot2` too)."""

    def __post_init__(self) -> None:
        """Refuse a battery that is empty when it is full."""
        if self.battery_empty_v >= self.battery_full_v:
            raise ValueError("battery_empty_v must be less than battery_full_v")


class PidConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[base.chassis.pid]`: gains of the board's speed control, sent on each connection."""

    p: Annotated[float, Meta(ge=0.0, le=1e4)]
    """Proportional gain."""
    i: Annotated[float, Meta(ge=0.0, le=1e4)]
    """Integral gain."""
    d: Annotated[float, Meta(ge=0.0, le=1e4)]
    """Derivative gain."""
    o: Annotated[float, Meta(gt=0.0, le=1e4)] = 50.0
    """The divisor Ko of ROSArduinoBridge; `linorobot` has none."""


class ChassisConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[base.chassis]`: the motor board, where the driver is `hardware`."""

    board: Board | None = None
    """The firmware it runs; without one only the lidar works and the robot cannot drive."""
    port: str = ""
    """The serial port; a name below /dev/serial/by-id or by-path stays the same. A device on the
    network is `tcp://host:port` or `udp://host:port`; one that sends to this computer `udp://:port`."""
    baud: Baud | None = None
    """Baud rate of the line; the board's own if not given."""
    watchdog_s: Annotated[float, Meta(gt=0.0, le=10.0)] | None = None
    """Silence after which the firmware stops the motors, if you have changed and tested it; above
    0.5 s the robot drives at most 0.2 m/s."""
    delay_s: Annotated[float, Meta(ge=0.0, le=1.0)] | None = None
    """Longest time from a command until odometry shows that the wheels follow it, if you have
    measured it; 0.35 s if not given. The stop field brakes that much earlier; the shorter it is,
    the sooner an ignored stop is found."""
    usual_delay_s: Annotated[float, Meta(ge=0.0, le=1.0)] | None = None
    """Usual time from a command until odometry shows that the wheels follow it, if you have
    measured it; `delay_s` if not given. The planner steers from where the robot will be by
    then."""
    use_imu: bool = True
    """Fuse the turn rate of the board's gyro, if it has one."""
    imu_axes: tuple[Axis, Axis, Axis] = ("x", "y", "z")
    """The axes of the chip that point forward, left and up; `-y` is opposite to y."""
    pid: PidConfig | None = None
    wheels: WheelsConfig | None = None
    inputs: InputsConfig = InputsConfig()
    settings: dict[str, Any] = {}
    """Settings that only this board has; its page lists them."""

    def __post_init__(self) -> None:
        """Refuse axes that do not make a right-handed frame, and delays that cannot be."""
        if (self.usual_delay_s or 0.0) > (1.0 if self.delay_s is None else self.delay_s):
            raise ValueError("usual_delay_s is longer than delay_s, the longest one")
        if not _is_right_handed(self.imu_axes):
            raise ValueError(
                "imu_axes must name x, y and z once each and be right-handed, such as "
                '["y", "-x", "z"]'
            )


class ImuConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[base.imu]`: an inertial unit on an I2C bus of this computer, in place of the board's."""

    chip: Literal["mpu6050", "icm20948", "bno055", "bno085"]
    """Which chip; `mpu6050` covers the MPU-6500, 9250 and 9255 too, `bno085` the BNO080 and 086."""
    bus: Annotated[int, Meta(ge=0, le=255)] = 1
    """The number of the bus: 1 is /dev/i2c-1, on the pins 3 and 5 of a Raspberry Pi."""
    address: Annotated[int, Meta(ge=0x08, le=0x77)] | None = None
    """The chip's address on the bus; its usual one if not given."""
    axes: tuple[Axis, Axis, Axis] = ("x", "y", "z")
    """The axes of the chip that point forward, left and up; `-y` is opposite to y."""

    def __post_init__(self) -> None:
        """Refuse axes that do not make a right-handed frame."""
        if not _is_right_handed(self.axes):
            raise ValueError(
                'axes must name x, y and z once each and be right-handed, such as ["y", "-x", "z"]'
            )


def _is_right_handed(axes: tuple[Axis, Axis, Axis]) -> bool:
    letters = [axis[-1] for axis in axes]
    if sorted(letters) != ["x", "y", "z"]:
        return False
    swaps = sum(letters[i] > letters[j] for i in range(3) for j in range(i + 1, 3))
    return (swaps + sum(axis.startswith("-") for axis in axes)) % 2 == 0


class OdometryConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[base.odometry]`: what tells motion; corrections of wheels, from `trolley calibrate`."""

    source: Literal["wheels", "lidar", "both"] = "wheels"
    """`lidar` compares each scan with those before it, for a base without encoders; `both` corrects
    the wheels with that. A gyro is used with any of them."""
    linear_scale: Scale = 1.0
    """True metres per reported metre, forwards and backwards."""
    sideways_scale: Scale = 1.0
    """True metres per reported metre sideways (mecanum)."""
    angular_scale: Scale = 1.0
    """True radians per reported radian; a larger value means a narrower track."""
    wheel_ratio: Annotated[float, Meta(ge=0.8, le=1.25)] = 1.0
    """The right wheel's true diameter over the left one's."""
    track_m: Annotated[float, Meta(gt=0.0, le=3.0)] | None = None
    """The track that the board calculates with; needed for `wheel_ratio` where the board has no
    [base.chassis.wheels]."""
