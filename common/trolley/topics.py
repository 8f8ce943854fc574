"""The one table of streams and stored keys: key, message, owner, rate, quality of service.

Everything that publishes, subscribes or documents a topic reads its row here; requests stand in
`trolley.requests`.
"""

import dataclasses
import enum
import re
from functools import cached_property
from typing import Any, Generic, TypeVar, cast

import msgspec

from trolley import messages as m
from trolley.names import canonical

ROOT = "trolley"
M = TypeVar("M", bound=msgspec.Struct)
_ROBOT = re.compile(r"[a-z0-9_-]{1,32}")


def names_robot(chunk: str) -> bool:
    """Whether a chunk of a key can be a robot's name; strangers may put anything there."""
    return _ROBOT.fullmatch(chunk) is not None


class Qos(enum.Enum):
    """How a stream travels."""

    SENSOR = "sensor"  # newest wins, dropped under congestion
    COMMAND = "command"  # newest wins, express, highest priority
    STATE = "state"  # reliable, low priority, blocks the sender


class Kind(enum.Enum):
    """What a row of the table is."""

    STREAM = "stream"  # published by its owner, who also answers `get` with the latest value
    STORED = "stored"  # put and delete are wishes to the owner, who answers `get`
    TOKEN = "token"  # a liveliness token


@dataclasses.dataclass(frozen=True)
class Topic(Generic[M]):
    """A row of the table; what is special about a topic is a column of it."""

    name: str
    """Holds a `{placeholder}` for each chunk that varies."""
    message: type[M]
    owner: str
    """Who publishes it, in words; where several may, the one that usually does comes first."""
    rate: str
    """How often it comes, in words that `trolley.traffic.expected` reads."""
    qos: Qos = Qos.SENSOR
    kind: Kind = Kind.STREAM
    binary_get: bool = False
    """Whether `get` answers msgpack unless asked for JSON."""
    of_epoch: bool = False
    """Whether it is dropped when stamped before the present run of base."""
    of_epoch_parts: tuple[tuple[str, ...], ...] = ()
    """The varying chunks of which this holds where it does not hold for the whole topic."""
    get_only_parts: tuple[tuple[str, ...], ...] = ()
    """The varying chunks that nobody publishes: their owner only answers `get` with them."""
    owned_parts: tuple[tuple[str, ...], ...] = ()
    """The varying chunks that services publish, where anybody may publish the others."""
    is_shared: bool = False
    """Whether several services may publish the same key."""
    is_drawing: bool = False
    """Whether it is drawn by programs: kept key by key, without a list, and cleared by wildcard."""
    real_time: bool = False
    """Whether its rate counts real seconds even where a simulation runs faster or slower."""
    when_driving: bool = False
    """Whether it comes only while the robot drives, or is on a trip."""
    when_simulated: bool = False
    """Whether only a simulated robot has it."""
    max_bytes: int = 1 << 20
    max_keys: int = 2000
    """How many keys a receiver keeps the newest message of: what a stranger can make it store."""
    max_kept_bytes: int = 256 << 20
    """How large these may be together, as they came over the wire."""

    @cached_property
    def chunks(self) -> tuple[str, ...]:
        """The name's chunks."""
        return tuple(self.name.split("/"))

    @cached_property
    def num_parts(self) -> int:
        """How many chunks vary."""
        return sum(chunk.startswith("{") for chunk in self.chunks)

    @property
    def first_owner(self) -> str:
        """The service that usually publishes it."""
        return self.owner.partition(",")[0]

    @cached_property
    def is_exclusive(self) -> bool:
        """Whether one service publishes each key, seldom: nobody else's message may stand there."""
        is_state = self.qos is Qos.STATE and self.kind is Kind.STREAM
        return is_state and not self.of_epoch and not self.is_shared

    def is_of_epoch(self, parts: tuple[str, ...]) -> bool:
        """Whether a message of this key counts in one run of base only."""
        return self.of_epoch or parts in self.of_epoch_parts

    def key(self, robot: str, *parts: str) -> str:
        """The full key for these varying chunks ("*" for any); missing ones become "*"."""
        if not self.num_parts:
            return f"{ROOT}/{robot}/{self.name}"
        rest = list(parts) + ["*"] * (self.num_parts - len(parts))
        filled = [rest.pop(0) if chunk.startswith("{") else chunk for chunk in self.chunks]
        return "/".join((ROOT, robot, *filled))

    def match(self, key: str) -> tuple[str, tuple[str, ...]] | None:
        """The robot and the varying chunks (NFC) of a key of this topic, None for another key."""
        root, _, rest = key.partition("/")
        robot, _, name = rest.partition("/")
        if name == self.name and root == ROOT and not self.num_parts:
            return robot, ()
        found = name.split("/")
        if root != ROOT or len(found) != len(self.chunks):
            return None
        parts: list[str] = []
        for chunk, have in zip(self.chunks, found, strict=True):
            if chunk.startswith("{"):
                parts.append(canonical(have))
            elif chunk != have:
                return None
        return robot, tuple(parts)


_MAP_BYTES = 32 << 20

ROBOT = Topic("robot", m.Robot, "base", "on change", Qos.STATE, max_bytes=2 << 20)
CLOCK = Topic("clock", m.Clock, "base", "10 Hz", Qos.SENSOR, real_time=True)
SCAN = Topic("scan", m.Scan, "base", "5-50 Hz", Qos.SENSOR, of_epoch=True)
EXTRA_SCAN = Topic(
    "scan/{name}",
    m.Scan,
    "anyone",
    "at most 20 Hz",
    Qos.SENSOR,
    of_epoch=True,
    max_bytes=64 << 10,
    max_keys=16,
)
ODOM = Topic("odom", m.Odometry, "base", "20-50 Hz", Qos.SENSOR, of_epoch=True)
CAMERA = Topic(
    "camera", m.CameraImage, "a program of the robot", "at most 30 Hz", Qos.SENSOR, binary_get=True
)
IMU = Topic("imu", m.Imu, "base", "if any", Qos.SENSOR, of_epoch=True)
TF = Topic(
    "tf/{child}",
    m.Transform,
    "base, localizer (mapper while it maps), anyone",
    "on change, at most 20 Hz",
    Qos.STATE,
    of_epoch_parts=(("odom",),),
    get_only_parts=(("base_link",),),
    owned_parts=(("odom",), ("laser",), ("base_link",)),
)
COMMAND = Topic(
    "cmd_vel/{source}",
    m.VelocityCommand,
    "the source",
    "10-30 Hz",
    Qos.COMMAND,
    of_epoch=True,
    when_driving=True,
)
CMD_VEL = Topic("cmd_vel", m.VelocityCommand, "base", "10 Hz", Qos.SENSOR, of_epoch=True)
BASE = Topic("base", m.BaseState, "base", "on change, 1 Hz", Qos.STATE)
PROPOSALS = Topic("proposals", m.Proposals, "base", "on change", Qos.STATE)
SETUP = Topic("setup", m.SetupState, "setup", "on change", Qos.STATE)
CONFIG = Topic("config", m.ConfigChanges, "base", "on change", Qos.STATE)
_WHERE = "localizer, or mapper while it maps"
MAP = Topic(
    "map",
    m.OccupancyGrid,
    _WHERE,
    "on change",
    Qos.STATE,
    binary_get=True,
    max_bytes=_MAP_BYTES,
)
ZONES = Topic("zones", m.Zones, _WHERE, "on change", Qos.STATE)
CHANGES = Topic("changes", m.MapChanges, "localizer", "on change", Qos.STATE)
ZONE = Topic("zones/{name}", m.Zone, "localizer", "stored", Qos.STATE, Kind.STORED)
POSE = Topic("pose", m.PoseEstimate, _WHERE, "each scan", Qos.STATE, of_epoch=True)
PARTICLES = Topic(
    "particles", m.ParticleCloud, "localizer", "at most 5 Hz", Qos.SENSOR, binary_get=True
)
BEAMS = Topic("beams", m.BeamClasses, "localizer", "at most 10 Hz", Qos.SENSOR)
SUSPECTS = Topic("suspects", m.Suspects, _WHERE, "on change", Qos.STATE)
MAPPING = Topic("mapping", m.MappingStatus, "mapper", "on change", Qos.STATE)
GOAL = Topic("goal", m.GoalStatus, "planner", "on change, 5 Hz", Qos.STATE, when_driving=True)
PATH = Topic("path", m.Path, "planner", "on change", Qos.STATE, of_epoch=True)
TRAJECTORY = Topic("trajectory", m.Path, "planner", "at most 10 Hz", Qos.SENSOR, of_epoch=True)
COSTMAP = Topic(
    "costmap",
    m.OccupancyGrid,
    "planner",
    "at most 2 Hz",
    Qos.STATE,
    binary_get=True,
    of_epoch=True,
    max_bytes=_MAP_BYTES,
)
COSTMAP_GLOBAL = Topic(
    "costmap/global",
    m.OccupancyGrid,
    "planner",
    "at most 2 Hz",
    Qos.STATE,
    binary_get=True,
    of_epoch=True,
    max_bytes=_MAP_BYTES,
)
COSTS = Topic(
    "costs/{source}",
    m.OccupancyGrid,
    "anyone",
    "at most 1 Hz",
    Qos.STATE,
    max_bytes=256 << 10,
    max_keys=64,
)
POSES = Topic("poses", m.SavedPoses, "tour", "on change", Qos.STATE)
SAVED_POSE = Topic("poses/{name}", m.SavedPose, "tour", "stored", Qos.STATE, Kind.STORED)
TOURS = Topic("tours", m.Tours, "tour", "on change", Qos.STATE)
STORED_TOUR = Topic("tours/{name}", m.Tour, "tour", "stored", Qos.STATE, Kind.STORED)
TOUR = Topic(
    "tour",
    m.TourStatus,
    "tour",
    "on change, 1 Hz on a trip",
    Qos.STATE,
    real_time=True,
    when_driving=True,
)
MARKER = Topic(
    "markers/{ns}/{id}",
    m.Marker,
    "anyone; kept by tour",
    "on change",
    Qos.STATE,
    Kind.STORED,
    is_drawing=True,
    max_keys=5000,
    max_kept_bytes=8 << 20,
)
OVERLAY = Topic(
    "overlays/{id}",
    m.Overlay,
    "anyone; kept by tour",
    "on change",
    Qos.STATE,
    Kind.STORED,
    is_drawing=True,
    max_kept_bytes=8 << 20,
)
CHOICE = Topic("choices/{id}", m.Choice, "viz", "on change", Qos.STATE, is_shared=True)
SIM_TRUTH = Topic("sim/truth", m.Truth, "base, simulated", "20 Hz", Qos.SENSOR, when_simulated=True)
HEALTH = Topic("health/{service}", m.Health, "each service", "1 Hz", Qos.STATE, real_time=True)
ALIVE = Topic(
    "alive/{service}/{run}", m.Alive, "each service", "while it runs", Qos.STATE, Kind.TOKEN
)

TOPICS: tuple[Topic[Any], ...] = tuple(
    cast("Topic[Any]", row) for row in list(globals().values()) if isinstance(row, Topic)
)
"""All rows, in the order above."""


def find(key: str) -> tuple[Topic[Any], str, tuple[str, ...]] | None:
    """The row, the robot and the varying chunks of a concrete key; None if it is not a topic."""
    for topic in TOPICS:
        matched = topic.match(key)
        if matched is not None:
            return topic, *matched
    return None
