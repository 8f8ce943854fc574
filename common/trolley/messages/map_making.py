"""Messages about a map while it is being made."""

from typing import Literal

from msgspec import Struct

from trolley.messages.types import Count, NonNegative, StampNs

MappingState = Literal["idle", "starting", "mapping", "paused", "saving"]
ExploringState = Literal["off", "exploring", "homing", "paused", "done"]


class MappingStatus(Struct, frozen=True, kw_only=True):
    """What the mapper does. Owned by `mapper`, on change and 1 Hz while it maps.

    `name` is the map that is being made, `extends` the one that it began with. `message` says in a
    sentence what is wrong, or the result. `seconds` [robot time] were mapped, `scans` make up the
    map, and `loops` were closed. `exploring` says whether the robot explores on its own, or drives
    home; `area` [m²] is the floor that it knew when it looked last.
    """

    stamp_ns: StampNs
    state: MappingState
    name: str | None = None
    extends: str | None = None
    message: str = ""
    seconds: NonNegative = 0.0
    scans: Count = 0
    loops: Count = 0
    exploring: ExploringState = "off"
    area: NonNegative = 0.0
