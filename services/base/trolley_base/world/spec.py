"""What a world file says: things that are not on the map, mirrors, glass, people, and the robot.

Lengths in metres, angles in radians, poses and points in frame `map`. The file is TOML; it is
decoded strictly, so a key that is misspelt is refused and not ignored.
"""

import math
import re
from typing import Annotated, Literal

import msgspec
from msgspec import Meta, Struct

from trolley.config.robot import PoseConfig
from trolley.geometry import Finite
from trolley.messages.types import NonNegative, Positive, Share

Point = tuple[Finite, Finite]
Polyline = Annotated[list[Point], Meta(min_length=2)]
Scale = Annotated[float, Meta(gt=0.5, lt=2.0)]
# The errors of any usable robot are far below these; larger values are typing errors.
Spread = Annotated[float, Meta(ge=0.0, le=0.5)]


class WorldError(ValueError):
    """A world that cannot be used: one sentence that names the file and the key."""


class Box(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A solid rectangle, such as a bag on the floor: centre, heading and size.

    `seen`: whether the lidar's plane meets it, or passes above or below.
    """

    x: Finite
    y: Finite
    yaw: Finite = 0.0
    length_m: Positive
    width_m: Positive
    seen: bool = True
    name: str = ""


class Circle(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A solid round object, such as a bucket; `seen` as for a box."""

    x: Finite
    y: Finite
    radius_m: Positive
    seen: bool = True
    name: str = ""


class Mirror(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A mirror along a polyline: beams bounce off, the robot does not pass.

    `side`: `both`, or `left`, the side to the left of who walks from the first point to the last;
    the back then gives plain echoes. `echo_share` of the beams come straight back from dust.
    """

    points: Polyline
    side: Literal["both", "left"] = "both"
    echo_share: Share = 0.0
    name: str = ""


class Glass(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A pane along a polyline: most beams go through, the robot does not.

    `transmission` is the share of beams that pass; those that meet the pane within `echo_within`
    of the perpendicular always come back, as from a real window.
    """

    points: Polyline
    transmission: Share = 0.9
    echo_within: Annotated[float, Meta(ge=0.0, le=math.pi / 2)] = 0.05
    name: str = ""


class Dull(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A black or shiny surface along a polyline: most beams do not come back from it.

    `echo_share` of the beams do, and all that meet it within `echo_within` of the perpendicular.
    The robot does not pass.
    """

    points: Polyline
    echo_share: Share = 0.1
    echo_within: Annotated[float, Meta(ge=0.0, le=math.pi / 2)] = 0.3
    name: str = ""


class Rug(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A rectangle of floor where the wheels slip: a rug, or a threshold if it is narrow.

    `slip` of what the wheels drive is lost there, and each crossing draws how much its pile turns
    the robot: `pull_per_m` is the standard deviation.
    """

    x: Finite
    y: Finite
    yaw: Finite = 0.0
    length_m: Positive
    width_m: Positive
    slip: Spread = 0.05
    pull_per_m: Spread = 0.1
    name: str = ""


class Sun(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A rectangle of floor from where the lidar looks into the sun.

    `towards` is the direction of the sun; of the beams within half of `width_rad` of it a share
    `lost` measures nothing.
    """

    x: Finite
    y: Finite
    yaw: Finite = 0.0
    length_m: Positive
    width_m: Positive
    towards: Finite
    width_rad: Annotated[float, Meta(gt=0.0, le=2.0 * math.pi)] = 0.5
    lost: Share = 0.8
    name: str = ""


class Person(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Somebody who walks along a path, over and over.

    `path` is walked there and back, or round and round with `loop`, with `dwell_s` at each point.
    The seed chooses where on the path the person is at first; with `starts_s` the person stands at
    the first point until that time instead. With `legs` the lidar (and the robot) meets two
    swinging legs in place of a round body. `stops_for_robot_m`: the person stands still rather
    than come nearer to the robot than this, 0 walks until they touch. A person who has been blocked
    for `patience_s` turns round.
    """

    path: Annotated[list[Point], Meta(min_length=1)]
    radius_m: Annotated[float, Meta(gt=0.0, le=1.0)] = 0.2
    speed_mps: Annotated[float, Meta(gt=0.0, le=3.0)] = 0.8
    loop: bool = False
    dwell_s: NonNegative = 0.0
    starts_s: NonNegative | None = None
    legs: bool = False
    stops_for_robot_m: NonNegative = 0.35
    patience_s: NonNegative = 3.0
    name: str = ""


class Wheels(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How well the wheels grip the floor, and how wrongly the board measures their motion.

    Each seed draws the scales of both wheels and of the track around the given ones, with the
    `…_std` as standard deviation. A scale of 1.02 reports two per cent more than was driven; the
    board holds the commanded velocity by what it reports. Slip is a random walk: its standard
    deviation grows with the square root of what was driven.
    """

    track_m: Annotated[float, Meta(gt=0.02, le=2.0)] = 0.2
    left_scale: Scale = 1.0
    right_scale: Scale = 1.0
    turn_scale: Scale = 1.0
    scale_std: Annotated[float, Meta(ge=0.0, le=0.1)] = 0.004
    turn_scale_std: Annotated[float, Meta(ge=0.0, le=0.1)] = 0.015
    slip_per_m: Spread = 0.01
    yaw_slip_per_m: Spread = 0.015
    yaw_slip_per_rad: Spread = 0.015


class Motors(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What lies between a command and the wheels' motion; without this section nothing does.

    A command acts `delay_s` after it was given, or up to `jitter_s` later. A wheel that is told to
    turn more slowly than `dead_band_mps` stands. Each wheel turns `backlash_m` before it moves the
    robot, when its direction changes. `uneven`: the right wheel gains and loses speed slower by
    this share. A robot with a castor that turns back swings by up to `castor_kick_rad` within
    `castor_m`. While the battery empties, for `sag_minutes`, speed and acceleration fall by `sag`.
    """

    delay_s: Annotated[float, Meta(ge=0.0, le=2.0)] = 0.0
    jitter_s: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0
    dead_band_mps: Annotated[float, Meta(ge=0.0, le=0.5)] = 0.0
    backlash_m: Annotated[float, Meta(ge=0.0, le=0.1)] = 0.0
    uneven: Annotated[float, Meta(ge=0.0, le=0.9)] = 0.0
    castor_kick_rad: Annotated[float, Meta(ge=0.0, le=0.5)] = 0.0
    castor_m: Annotated[float, Meta(gt=0.0, le=1.0)] = 0.08
    sag: Annotated[float, Meta(ge=0.0, le=0.9)] = 0.0
    sag_minutes: Positive = 60.0


class LidarFaults(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a cheap lidar does beside measuring; without this section nothing.

    `mixed` of the beams at an edge end between what is before it and what is behind. The mount
    leans by `tilt_rad` towards `tilt_towards`, so that at `height_m` above the floor its beams meet
    the floor there. A share `lost_turns` of the revolutions does not arrive. Stamps err by
    `stamp_jitter_s` (standard deviation).
    """

    mixed: Share = 0.0
    tilt_rad: Annotated[float, Meta(ge=0.0, le=0.3)] = 0.0
    tilt_towards: Finite = 0.0
    height_m: Positive = 0.15
    lost_turns: Share = 0.0
    stamp_jitter_s: Annotated[float, Meta(ge=0.0, le=0.1)] = 0.0


class LidarSpec(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The scanner: its grid, its reach and its errors.

    The `beams` of a scan lie evenly over `field_of_view`, centred on straight ahead; the sensor
    turns on where it is blind. The standard deviation of a range is `noise_m` + `noise_share` *
    range. A share `drop_out` of the beams finds no echo, a share `invalid` is reported as unusable.
    """

    beams: Annotated[int, Meta(ge=8, le=8192)] = 360
    field_of_view: Annotated[float, Meta(ge=0.5, le=2.0 * math.pi)] = 2.0 * math.pi
    rate_hz: Annotated[float, Meta(ge=1.0, le=50.0)] = 10.0
    clockwise: bool = False
    range_min_m: NonNegative = 0.1
    range_max_m: Annotated[float, Meta(gt=0.0, le=200.0)] = 8.0
    noise_m: Spread = 0.008
    noise_share: Spread = 0.003
    drop_out: Share = 0.01
    invalid: Share = 0.002
    faults: LidarFaults = LidarFaults()

    def __post_init__(self) -> None:
        """Refuse a reach that is empty and shares that exceed the whole."""
        if self.range_min_m >= self.range_max_m:
            raise ValueError(
                f"range_min_m = {self.range_min_m} must be below range_max_m = {self.range_max_m}"
            )
        if self.drop_out + self.invalid > 1.0:
            raise ValueError("drop_out and invalid together must not exceed 1")


class DriveLimits(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the motors can do."""

    max_speed_mps: Positive = 0.5
    max_wz_radps: Positive = 2.0
    acceleration_mps2: Positive = 1.0
    deceleration_mps2: Positive = 1.5
    angular_acceleration_radps2: Positive = 4.0
    angular_deceleration_radps2: Positive = 6.0


class WorldSpec(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One world file."""

    map: Annotated[str, Meta(min_length=1)]
    start: PoseConfig
    box: list[Box] = []
    circle: list[Circle] = []
    mirror: list[Mirror] = []
    glass: list[Glass] = []
    dull: list[Dull] = []
    rug: list[Rug] = []
    sun: list[Sun] = []
    person: list[Person] = []
    wheels: Wheels = Wheels()
    motors: Motors = Motors()
    lidar: LidarSpec = LidarSpec()
    limits: DriveLimits = DriveLimits()


def decode_world(text: bytes | str, source: str) -> WorldSpec:
    """Decode the text of a world file.

    Args:
        text: TOML, as in `worlds/README.md`.
        source: the file's name for the error message.

    Raises:
        WorldError: naming `source`, the key, and what is expected there.
    """
    try:
        return msgspec.toml.decode(text, type=WorldSpec)
    except msgspec.ValidationError as error:
        raise WorldError(f"{source}: {_with_key_first(str(error))}") from error
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise WorldError(f"{source}: not a TOML file: {error}") from error


def _with_key_first(message: str) -> str:
    """Turn msgspec's "Expected … - at `$.box[0].x`" into "box[0].x: Expected …"."""
    match = re.fullmatch(r"(.*) - at `\$\.?(.*)`", message, flags=re.DOTALL)
    if match is None or not match[2]:
        return message.replace(" - at `$`", "")
    return f"{match[2]}: {match[1]}"
