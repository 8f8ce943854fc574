"""Messages about the map and the pose on it."""

import re
from typing import Annotated, Literal

from msgspec import Meta, Struct

from trolley.geometry.pose import Pose2D
from trolley.messages.types import (
    Count,
    Covariance,
    NonNegative,
    Point,
    Positive,
    Share,
    StampNs,
    check_floats,
)

MAP_NAME = re.compile(r"(?!\.)[A-Za-z0-9_.-]{1,64}")
MapName = Annotated[str, Meta(pattern=rf"\A{MAP_NAME.pattern}\Z")]
"""A map's name: the stem of its file."""
MAP_NAME_RULE = "a map's name has 1 to 64 of A-Z, a-z, 0-9, _, - and ., and no dot first"

Size = Annotated[int, Meta(ge=1, le=2**31 - 1)]
"""Columns or rows of a grid, at least one."""

Edge = Annotated[float, Meta(ge=1e-4, le=1e3)]
"""Edge of a cell [m]: between these nothing overflows."""
MAX_COORDINATE_M = 1e6
"""Largest x or y of a map's origin, a saved place or a zone [m]: farther off, digits are lost."""

ZoneKind = Literal["mirror", "glass", "keepout", "speed", "room"]
PoseState = Literal["searching", "localized", "unsure", "lost", "mapping"]


class OccupancyGrid(Struct, frozen=True, kw_only=True):
    """A grid of int8 cells, row-major: index = row * width + col, `resolution` [m] an edge.

    The outer corner of cell (0, 0) is at `origin` (frame_T_grid), columns along its +x, rows along
    +y. On `map`: 0 free to 100 occupied, -1 unknown. On `costmap`: 100 where the footprint's centre
    may not be, 99 inscribed, -1 unknown. On `costs/<source>`: 0 no cost to 100; a metre through
    cells of cost c counts as 1 + c / 10 metres of free floor, for 10 s from when it was published.
    """

    stamp_ns: StampNs
    name: str
    frame: str
    resolution: Edge
    width: Size
    height: Size
    origin: Pose2D
    cells: memoryview

    def __post_init__(self) -> None:
        """Refuse cells that do not fill width x height, and a grid too far away."""
        if len(self.cells) != self.width * self.height:
            raise ValueError(
                f"OccupancyGrid.cells: {len(self.cells)} bytes "
                f"for {self.width} x {self.height} cells"
            )
        if max(abs(self.origin.x), abs(self.origin.y)) > MAX_COORDINATE_M:
            raise ValueError(f"OccupancyGrid.origin: more than {MAX_COORDINATE_M:g} m away")


class Zone(Struct, frozen=True, kw_only=True):
    """A named part of the map: `mirror` and `glass` are polylines, the other kinds polygons.

    Points are in `map` [m]; polygons are closed automatically. `speed` [m/s] is only for `speed`
    zones. A `room` only names a part of the map; the robot drives there as anywhere else. If a zone
    is put under its own key, `name` may be left out.
    """

    name: str = ""
    kind: ZoneKind
    points: Annotated[list[Point], Meta(min_length=2, max_length=10_000)]
    speed: Positive | None = None


class Zones(Struct, frozen=True, kw_only=True):
    """All zones of one map. Owned by `localizer`, on change."""

    stamp_ns: StampNs
    map: str
    zones: list[Zone]


class Candidate(Struct, frozen=True, kw_only=True):
    """One pose that the robot might have."""

    pose: Pose2D
    match: Share


class PoseEstimate(Struct, frozen=True, kw_only=True):
    """Where the robot is: `pose` is map_T_base at `stamp_ns`. Owned by `localizer`, each scan.

    `pose` and `covariance` are null until first known. `match` is the share of beams that the map
    explains, `spread` [m] how far apart the hypotheses are, `candidates` the places between which a
    search cannot decide; `wants_turn` asks for a turn in place to tell them apart. `off_map` is how
    far the robot has driven since it left the map [m], null on the map. `map` is null if there is
    none any more: what was published on `map` and `zones` is gone.
    """

    stamp_ns: StampNs
    map: str | None
    pose: Pose2D | None
    covariance: Covariance | None
    state: PoseState
    match: Share
    spread: NonNegative
    candidates: list[Candidate] = []
    wants_turn: bool = False
    message: str = ""
    off_map: NonNegative | None = None


class ParticleCloud(Struct, frozen=True, kw_only=True):
    """The localizer's hypotheses: poses float32 (N, 3) x, y, yaw in `map`; weights float32 (N,)."""

    stamp_ns: StampNs
    poses: memoryview
    weights: memoryview

    def __post_init__(self) -> None:
        """Refuse arrays that do not fit each other."""
        poses = check_floats("ParticleCloud", "poses", self.poses, 3)
        weights = check_floats("ParticleCloud", "weights", self.weights)
        if poses != weights:
            raise ValueError(f"ParticleCloud.weights: {weights} values for {poses} poses")


class MapInfo(Struct, frozen=True, kw_only=True):
    """A loaded map without its cells."""

    name: str
    frame: str
    resolution: Positive
    width: Count
    height: Count
    origin: Pose2D
