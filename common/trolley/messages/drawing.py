"""What programs draw into the viewer: markers, overlays over the scene, and clicks on menus."""

from typing import Literal

from msgspec import Struct

from trolley.geometry.pose import Finite, Pose2D
from trolley.messages.types import Colour, Count, NonNegative, Point3, StampNs

WHITE: Colour = (1.0, 1.0, 1.0, 1.0)
DARK: Colour = (0.0, 0.0, 0.0, 0.5)


class Marker(Struct, frozen=True, kw_only=True):
    """An object in the scene, stored under `markers/<ns>/<id>`.

    `pose` and `z` [m] are in `frame` (a leading slash is dropped by the owner; `place:<name>` is a
    saved place); `size` [m] along x, y, z; `lifetime` [s], 0 = forever. Lines use `points` [m],
    texts and icons their string.
    """

    frame: str = "map"
    kind: Literal["sphere", "cube", "cylinder", "arrow", "line", "text", "icon"]
    pose: Pose2D = Pose2D(x=0.0, y=0.0, yaw=0.0)
    z: Finite = 0.0
    size: Point3 = (0.2, 0.2, 0.2)
    color: Colour = WHITE
    points: list[Point3] = []
    text: str = ""
    icon: str = ""
    motion: Literal["none", "jump", "jump_once", "rotate_x", "rotate_y", "rotate_z"] = "none"
    lifetime: NonNegative = 0.0


class OverlayRule(Struct, frozen=True, kw_only=True):
    """Text and colour of an overlay while distance [m] and bearing [rad] lie within the bounds."""

    distance_min: Finite | None = None
    distance_max: Finite | None = None
    bearing_min: Finite | None = None
    bearing_max: Finite | None = None
    text: str = ""
    color: Colour | None = None


class Overlay(Struct, frozen=True, kw_only=True):
    """A panel over the scene, stored under `overlays/<id>`.

    `source` is `<topic>:<field>[.<field>|[i]]` or `tf:<parent>/<child>:distance|bearing`; the first
    of `rules` that matches gives text and colour. In a text, `{value}`, `{distance}` and
    `{bearing}` stand for the source's values.
    """

    kind: Literal["text", "menu", "gauge", "plot"]
    title: str = ""
    text: str = ""
    items: list[str] = []
    index: Count | None = None
    source: str = ""
    min: Finite | None = None
    max: Finite | None = None
    unit: str = ""
    place: str = ""
    size: NonNegative | None = None
    color: Colour = WHITE
    background: Colour = DARK
    rules: list[OverlayRule] = []


class Choice(Struct, frozen=True, kw_only=True):
    """What a person clicked in the overlay menu `choices/<id>`. Published by `viz`."""

    stamp_ns: StampNs
    index: Count
    item: str
