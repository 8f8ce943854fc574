"""What is done to a stored map: the operations of `map/edit`, its parameters and its reply.

All points are x, y [m] in the frame of the map as the operations before left it.
"""

from typing import Annotated, Literal

from msgspec import Meta, Struct

from trolley.geometry.pose import Finite, Pose2D
from trolley.messages.mapping import MapName
from trolley.messages.types import Point, Positive

MAX_POINTS = 10_000
MAX_OPS = 1000
Points = Annotated[list[Point], Meta(min_length=1, max_length=MAX_POINTS)]
Width = Annotated[float, Meta(gt=0.0, le=100.0)]


class EraseArea(Struct, frozen=True, kw_only=True, tag_field="op", tag="erase_area"):
    """Make all of a polygon `free` floor, or `unknown`."""

    points: Points
    to: Literal["free", "unknown"] = "free"


class EraseStroke(Struct, frozen=True, kw_only=True, tag_field="op", tag="erase"):
    """Make what a brush of `width` [m] touches along a line `free` floor, or `unknown`."""

    points: Points
    width: Width = 0.2
    to: Literal["free", "unknown"] = "free"


class DrawWall(Struct, frozen=True, kw_only=True, tag_field="op", tag="wall"):
    """Draw a wall of `width` [m] along a line."""

    points: Points
    width: Width = 0.05


class Turn(Struct, frozen=True, kw_only=True, tag_field="op", tag="turn"):
    """Turn the map counter-clockwise by `angle` [rad] about a point: all coordinates change."""

    angle: Finite
    about: Point = (0.0, 0.0)


class Crop(Struct, frozen=True, kw_only=True, tag_field="op", tag="crop"):
    """Keep the rectangle between two opposite corners."""

    corners: tuple[Point, Point]


class Merge(Struct, frozen=True, kw_only=True, tag_field="op", tag="merge"):
    """Fill in unknown cells from the map `name`, whose pose is this_T_other `pose`.

    Without a pose, the other map's walls are matched with this map's; the edit is refused unless
    they match in exactly one way.
    """

    name: MapName
    pose: Pose2D | None = None


class TakeBack(Struct, frozen=True, kw_only=True, tag_field="op", tag="undo"):
    """Go back to the previous version; it must be the only operation."""


MapOp = EraseArea | EraseStroke | DrawWall | Turn | Crop | Merge | TakeBack


EditId = Annotated[str, Meta(pattern=r"\A[a-z0-9-]{1,36}\Z")]


class EditMap(Struct, frozen=True, kw_only=True):
    """Apply `ops` to the stored map `name`, one after another, and store the result.

    The result becomes a new version of that map, or with `as_name` a map of its own. With `preview`
    nothing is stored.

    If a large map takes longer than an answer may, the answer is `working`; the same request with
    the same `id` then gives the result.
    """

    name: MapName
    ops: Annotated[list[MapOp], Meta(min_length=1, max_length=MAX_OPS)]
    as_name: MapName | None = None
    preview: bool = False
    id: EditId | None = None


class MapEdited(Struct, frozen=True, kw_only=True):
    """The result of `map/edit`: the map `name` now has this `version` (null for a preview).

    `working`: not finished yet. `placed` is the pose of the map merged last, this_T_other, and
    `walls` are points of its walls there [m] (at most 2000), for display.
    """

    state: Literal["saved", "preview", "working"]
    name: str
    message: str
    version: int | None = None
    placed: Pose2D | None = None
    walls: list[Point] = []
    width: Positive | None = None
    height: Positive | None = None
