"""What the kinds of zones are, the file they are kept in, and which room a point lies in."""

from collections.abc import Iterable
from typing import Any, ClassVar, Final

import numpy as np
from msgspec import Struct

from trolley.geometry.polygon import polygon_contains, signed_area
from trolley.messages.mapping import PoseEstimate, Zone, ZoneKind, Zones

LINE_KINDS: Final[tuple[ZoneKind, ...]] = ("mirror", "glass")
"""These are lines, all others are areas."""


class ZoneFile(Struct, frozen=True, kw_only=True):
    """The zones of one map on disk."""

    SCHEMA: ClassVar[int] = 2

    zones: list[Zone]

    @classmethod
    def bring_forward(cls, plain: dict[str, Any], schema: int) -> dict[str, Any]:
        """Return the content of a file of schema 1: it knew no rooms."""
        del schema
        return plain


def room_at(zones: Iterable[Zone], x: float, y: float) -> str | None:
    """Return the name of the smallest room that a point of the map [m] lies in, None if in none."""
    found: list[tuple[float, str]] = []
    for zone in zones:
        if zone.kind == "room":
            corners = np.array(zone.points, np.float64)
            if polygon_contains(corners, np.array([[x, y]]))[0]:
                found.append((abs(signed_area(corners)), zone.name))
    return min(found)[1] if found else None


def room_of(estimate: PoseEstimate | None, zones: Zones | None) -> str | None:
    """Return the room that a robot is in, None where it is in none or its place is not known."""
    if estimate is None or estimate.pose is None or zones is None or zones.map != estimate.map:
        return None
    return room_at(zones.zones, estimate.pose.x, estimate.pose.y)
