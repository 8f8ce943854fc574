"""Messages about a map while it is being made."""

from typing import Literal

from msgspec import Struct

from trolley.messages.types import Count, NonNegative, StampNs

MappingState = Literal["idle", "starting", "mapping", "paused", "saving"]
ExploringState = Literal["off", "exploring", "homing", "paused", "done"]


class MappingStatus(Struct, frozen=True, kw_only=True):
    """What the mapper is doing. Owned by `mapper`, on change, and at 1 Hz while it maps.

    `name` is the map that is being made, `extends` the one that it started from. `message` says in
    a sentence what is wrong, or what the result is. `seconds` [robot time] have been mapped,
    `scans` make up the map, and `loops` have been closed. `exploring` says whether the robot is
    exploring by itself or driving home; `area` [m²] is the floor that was known at the last check.
    `loose` scans belong to parts of which it is not known how they lie to the map; they are not
    part of it, unless `map/join` or what the robot sees joins them to it. `may_discard` says if
    `map/cancel` is obeyed: not while the map is saved, unless its zones wait for a localizer that
    is not running.
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
    loose: Count = 0
    may_discard: bool = False
