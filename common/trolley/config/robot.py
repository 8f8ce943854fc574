"""`[robot]`, `[map]`, `[start]`, `[zenoh]`: what more than one service needs."""

import os
import re
from typing import Annotated

from msgspec import Meta, Struct, field

from trolley.geometry import Pose2D, angle_problem, pose_from_quaternion
from trolley.geometry.pose import Finite
from trolley.messages.motion import Drive, RobotName
from trolley.messages.types import Point
from trolley.ports import ROUTER_PORT, ROUTER_TLS_PORT, port_of

Length = Annotated[float, Meta(ge=0.02, le=5.0)]


WITHOUT_PORT = ("unixsock-stream",)
THINNED = ("scan", "odom", "imu", "particles", "beams", "trajectory", "cmd_vel", "sim/truth")
"""Streams of which the newest message is enough for those who only look."""
PROTOCOLS = ("tcp", "tls", "unixsock-stream")
"""What the door, the roles and the limits of a link know."""


FOOTPRINTS = "{length_m, width_m}, {radius_m} or {polygon_m = [[x, y], ...]}"
"""The ways of giving a footprint."""


class FootprintConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The robot's outline in `base_link`: length and width, or a radius, or a polygon."""

    length_m: Length | None = None
    """Along x, centred on `base_link`; with `width_m`."""
    width_m: Length | None = None
    """Along y; with `length_m`."""
    radius_m: Annotated[float, Meta(ge=0.02, le=2.5)] | None = None
    """A round robot."""
    polygon_m: Annotated[list[Point], Meta(min_length=3, max_length=64)] | None = None
    """Corners [x, y] in order; `base_link` lies inside."""

    def __post_init__(self) -> None:
        """Refuse a footprint that is given in two ways, half, or not at all."""
        ways = [
            self.length_m is not None or self.width_m is not None,
            self.radius_m is not None,
            self.polygon_m is not None,
        ]
        if sum(ways) != 1 or (ways[0] and (self.length_m is None or self.width_m is None)):
            raise ValueError(f"give the footprint as {FOOTPRINTS}")


class RobotSection(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[robot]`: name, shape and drive."""

    name: RobotName
    """The robot's name in every key: 1 to 32 characters of a-z, 0-9, _ and -."""
    title: Annotated[str, Meta(max_length=64)] = ""
    """The name shown in the viewer; `name` if empty."""
    footprint: FootprintConfig
    """The robot's outline, seen from above."""
    drive: Drive = "differential"
    """The kind of drive. A simulated robot never drives sideways, not even on mecanum wheels."""
    mesh: str | None = None
    """A glb file of the robot's body, at most 1 MiB, in metres, +y up, +z forward."""


class MapSection(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[map]`: the map to start with."""

    file: str | None = None
    """A ROS map_server YAML file, relative to this file; its stem is the map's name."""


class PoseConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A pose in a file: x, y and either yaw or orientation (a quaternion about z)."""

    x: Finite
    y: Finite
    yaw: Finite | None = None
    orientation: tuple[Finite, Finite, Finite, Finite] | None = None

    def __post_init__(self) -> None:
        """Refuse two headings or none, one in degrees, and a rotation that is not about z."""
        if (self.yaw is None) == (self.orientation is None):
            raise ValueError("give either yaw or orientation = [x, y, z, w]")
        if self.yaw is not None and (problem := angle_problem(self.yaw)):
            raise ValueError(f"yaw {problem}")
        self.as_pose()

    def as_pose(self) -> Pose2D:
        """The pose, its yaw wrapped."""
        if self.orientation is not None:
            return pose_from_quaternion(self.x, self.y, self.orientation)
        return Pose2D(self.x, self.y, self.yaw or 0.0).wrapped()


class StartSection(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[start]`: where the robot is when it is switched on and no last pose is known."""

    pose: PoseConfig | str | None = None
    """Coordinates on the map, or the name of a saved place; without it the robot searches the
    map."""
    always: bool = False
    """Start here even if a last pose is known."""


MOST_SOCKET_BYTES = 107
"""`sun_path` of unix(7) has 108, one of them for the end of the path."""


def why_no_endpoint(text: str) -> str:
    """Why this is no endpoint in Zenoh's words, "" where it is one."""
    protocol, _, address = text.partition("/")
    port = re.search(r":([0-9]{1,9})([?#].*)?\Z", address)
    if protocol in WITHOUT_PORT:
        length = len(os.fsencode(address))
        return (
            f"{text!r} is not an endpoint: a Unix socket's path has {MOST_SOCKET_BYTES} bytes at "
            f"most, this one {length}"
            if length > MOST_SOCKET_BYTES
            else ""
        )
    if protocol in PROTOCOLS and port is not None:
        is_port = 0 < int(port[1]) < 65536
        return "" if is_port else f"{text!r} is not an endpoint: its port must be from 1 to 65535"
    return (
        f"{text!r} is not an endpoint: write protocol/host:port, such as "
        f"tcp/127.0.0.1:{ROUTER_PORT}; the protocol is one of "
        f"{', '.join(PROTOCOLS[:-1])} and {PROTOCOLS[-1]}"
    )


class ZenohSection(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[zenoh]`: how services find each other."""

    connect: Annotated[list[str], Meta(min_length=1)] = field(
        default_factory=lambda: [f"tcp/127.0.0.1:{ROUTER_PORT}"]
    )
    """Endpoints of the router that services and tools connect to; a Unix socket is
    `unixsock-stream//run/trolley/router`."""
    uplink: list[str] = []
    """Endpoints of a home router that this robot's router links to, such as
    `tls/home.local:7448`."""
    keys: str = "keys"
    """The folder with this host's certificate, relative to this file; for `tls/` endpoints."""
    downsample: dict[str, Annotated[float, Meta(ge=0.01, le=100.0)]] = {}
    """Highest rates of streams that leave over TLS [Hz], such as `{scan = 2.0}`."""

    def __post_init__(self) -> None:
        """Refuse unknown streams, and what is not an endpoint: Zenoh would look for it forever."""
        for name in self.downsample:
            if name not in THINNED:
                raise ValueError(
                    f"`downsample` knows {', '.join(THINNED)}, not {name!r}: other streams "
                    "are few, or every message of them counts"
                )
        for endpoint in (*self.connect, *self.uplink):
            if why_not := why_no_endpoint(endpoint):
                raise ValueError(why_not)
        for endpoint in self.connect:
            if endpoint.startswith("tcp/") and port_of(endpoint) is None:
                raise ValueError(
                    f"no router listens at {endpoint!r}: for its own host it does at "
                    f"tcp/127.0.0.1:{ROUTER_PORT}, and for others, who need keys, at tls/ such as "
                    f"tls/home.local:{ROUTER_TLS_PORT} (docs/network.md)"
                )
        for endpoint in self.uplink:
            if not endpoint.startswith("tls/"):
                raise ValueError(
                    f"{endpoint!r} cannot be an uplink: routers of two hosts meet over TLS, such "
                    f"as tls/home.local:{ROUTER_TLS_PORT}"
                )
