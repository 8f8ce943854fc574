"""Messages of `base`: the robot, its clock, odometry, inertia, transforms and commands."""

from typing import Annotated, Literal

from msgspec import Meta, Struct

from trolley import codes
from trolley.geometry.pose import Finite, Pose2D, Twist2D
from trolley.messages.types import NonNegative, Point, Point3, Positive, Share, StampNs

PROTOCOL = 1
CHASSIS = "chassis"
"""What `base` calls the connection to the motor board in `BaseState.links`."""
MAX_MESH_BYTES = 1 << 20
MAX_RATE = 1e4
"""No clock runs faster: its time would soon overflow."""

RobotName = Annotated[str, Meta(pattern=r"\A[a-z0-9_-]{1,32}\Z")]
"""A robot's name, as it stands in every key."""

Drive = Literal["differential", "skid_steer", "mecanum"]


class Robot(Struct, frozen=True, kw_only=True):
    """What this robot is; other programs discover robots by it. Owned by `base`, on change.

    `footprint` is a polygon in `base_link` [m]; `max_speed` [m/s], `max_wz` [rad/s] and
    `deceleration` [m/s^2] are the limits that `base` enforces; `mesh` is a glb body or null.
    `delay` is the usual time from a command until odometry shows that the wheels follow it [s],
    null if nobody has measured it. `replayed` is a recording that is played: no robot is there.
    """

    stamp_ns: StampNs
    protocol: int = PROTOCOL
    name: RobotName
    title: str
    footprint: Annotated[list[Point], Meta(min_length=3)]
    drive: Drive
    max_speed: Positive
    max_wz: Positive
    deceleration: Positive
    mesh: bytes | None = None
    simulated: bool = False
    delay: NonNegative | None = None
    replayed: bool = False

    def __post_init__(self) -> None:
        """Refuse a mesh over 1 MiB."""
        if self.mesh is not None and len(self.mesh) > MAX_MESH_BYTES:
            raise ValueError(
                f"Robot.mesh: {len(self.mesh)} bytes, at most {MAX_MESH_BYTES} are allowed"
            )


class Clock(Struct, frozen=True, kw_only=True):
    """Robot time, owned by `base`, 10 Hz: `rate` robot seconds pass in one real second.

    `epoch` is the robot time [ns] at which this run of `base` began; sensor and pose messages
    stamped before it belong to an earlier run.
    """

    stamp_ns: StampNs
    rate: Annotated[float, Meta(gt=0.0, le=MAX_RATE)]
    epoch: StampNs


class Odometry(Struct, frozen=True, kw_only=True):
    """Where the robot is according to its wheels. Owned by `base`, 20-50 Hz.

    `pose` is odom_T_base, `twist` is in `base_link`.
    """

    stamp_ns: StampNs
    pose: Pose2D
    twist: Twist2D


class Imu(Struct, frozen=True, kw_only=True):
    """Inertial readings turned into `base_link`.

    `angular_velocity` [rad/s], `linear_acceleration` [m/s^2], each about or along x, y, z.
    """

    stamp_ns: StampNs
    angular_velocity: Point3
    linear_acceleration: Point3


class Transform(Struct, frozen=True, kw_only=True):
    """`pose` is parent_T_child; `z` [m] is the child's height above the parent's ground plane."""

    stamp_ns: StampNs
    parent: str
    child: str
    pose: Pose2D
    z: Finite = 0.0


class VelocityCommand(Struct, frozen=True, kw_only=True):
    """A velocity command in `base_link`, valid for `valid_for` seconds (at most 0.5) from arrival.

    `scan_ns` is the stamp of the scan it was computed with, 0 if none. On `cmd_vel/<source>` it is
    what the source asks for, on `cmd_vel` what `base` drives. Any finite `valid_for` is accepted
    here; `base` judges it and counts unusable ones. However short it is, the command holds for one
    control period.
    """

    stamp_ns: StampNs
    twist: Twist2D
    valid_for: Finite
    scan_ns: StampNs = 0


class Battery(Struct, frozen=True, kw_only=True):
    """Charge as a share, voltage [V], and whether it is charging; null where unknown."""

    fraction: Share | None = None
    voltage: NonNegative | None = None
    charging: bool | None = None


class Link(Struct, frozen=True, kw_only=True):
    """A connection of `base` to a piece of hardware."""

    name: str
    state: Literal["up", "down", "searching"]
    message: str = ""


class BaseState(Struct, frozen=True, kw_only=True):
    """What `base` is doing, on change and at 1 Hz.

    `mode`: `ok`; `stopped` (latched until resumed); `held` (continues by itself); `fault`. `source`
    is the source of commands in control, null if none; `reason` a code, "" if none.
    `not_stopped`: the robot moves although it was told to stand, or it is not known whether it
    still moves. Then `mode` is `fault` and `reason` is `does_not_obey`; programs show `message`
    instead of "stopped".
    """

    stamp_ns: StampNs
    mode: Literal["ok", "stopped", "held", "fault"]
    source: str | None = None
    reason: str = ""
    message: str = ""
    links: list[Link] = []
    battery: Battery | None = None
    not_stopped: bool = False

    @property
    def is_halted(self) -> bool:
        """Whether only somebody's resume lets it drive again: stopped, or not obeying."""
        return self.mode == "stopped" or self.reason == codes.DOES_NOT_OBEY

    @property
    def is_stop_unconfirmed(self) -> bool:
        """Whether a stop holds that the silent motor board cannot confirm; `message` says why."""
        return self.mode == "stopped" and any(
            link.name == CHASSIS and link.state != "up" for link in self.links
        )

    @property
    def may_still_move(self) -> bool:
        """Whether "stopped" would be wrong, or a guess: programs show `message` instead."""
        return self.not_stopped or self.is_stop_unconfirmed

    def is_from_before(self, asked_ns: int) -> bool:
        """Whether it was published before something that was asked for at this robot time.

        It may arrive after that: requests go first. A stamp of 0 (no robot time) says nothing.
        """
        return 0 < self.stamp_ns < asked_ns


class Truth(Struct, frozen=True, kw_only=True):
    """Where the simulated robot really is: world_T_base, 20 Hz.

    `collisions` counts the times the robot drove into something (faster than 0.02 m/s); `clearance`
    [m] is the distance from the footprint to the nearest solid thing.
    """

    stamp_ns: StampNs
    world: str
    pose: Pose2D
    twist: Twist2D
    collisions: int
    clearance: Finite
