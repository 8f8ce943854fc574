"""Which zones are allowed, the file they are kept in, and which room a point lies in."""

from collections.abc import Iterable, Sequence
from typing import Any, ClassVar, Final

import numpy as np
from msgspec import Struct, structs

from trolley import codes
from trolley.codes import Refused
from trolley.geometry.polygon import (
    check_polygon,
    distance_to_segments,
    polygon_contains,
    signed_area,
)
from trolley.messages.mapping import MAX_COORDINATE_M, PoseEstimate, Zone, ZoneKind, Zones
from trolley.messages.types import Point, fit_into_a_message
from trolley.names import canonical, name_problem

LINE_KINDS: Final[tuple[ZoneKind, ...]] = ("mirror", "glass")
"""These are lines, all others are areas."""
MAX_ZONES = 500
"""Number of zones on one map above which more are refused."""
_SAME_MIRROR_M = 0.3
"""Distance of a suspected mirror from a known one within which both are the same [m]."""
_SAME_POINT_M = 1e-3
"""Length that a line must exceed [m]."""


class ZoneFile(Struct, frozen=True, kw_only=True):
    """The zones of one map on disk."""

    SCHEMA: ClassVar[int] = 2

    zones: list[Zone]

    @classmethod
    def bring_forward(cls, plain: dict[str, Any], schema: int) -> dict[str, Any]:
        """Return the content of a file of schema 1: it knew no rooms."""
        del schema
        return plain


def check_zone(zone: Zone, name: str) -> Zone:
    """Return a zone as it may be stored under a name.

    Args:
        zone: as it came.
        name: from the key; it rules.

    Raises:
        Refused: `bad_request` with the reason.
    """
    name = canonical(name)
    problem = name_problem(name)
    if problem is not None:
        raise Refused(codes.BAD_REQUEST, f"{problem[:1].upper()}{problem[1:]}.")
    if zone.name and canonical(zone.name) != name:
        raise Refused(
            codes.BAD_REQUEST, f"The zone calls itself {zone.name!r} but its key says {name!r}."
        )
    points = np.array(zone.points, dtype=np.float64)
    if np.abs(points).max() > MAX_COORDINATE_M:
        raise Refused(
            codes.BAD_REQUEST,
            f"Zone {name!r}: coordinates may be {MAX_COORDINATE_M:.0f} m at most.",
        )
    if zone.kind in LINE_KINDS:
        if np.hypot(*np.diff(points, axis=0).T).sum() < _SAME_POINT_M:
            raise Refused(codes.BAD_REQUEST, f"The {zone.kind} line {name!r} has no length.")
    else:
        try:
            check_polygon(points)
        except ValueError as error:
            raise Refused(codes.BAD_REQUEST, f"Zone {name!r}: {error}.") from error
    if (zone.kind == "speed") != (zone.speed is not None):
        raise Refused(
            codes.BAD_REQUEST,
            "A speed zone needs its speed in m/s, and no other kind of zone has one.",
        )
    return structs.replace(zone, name=name)


def with_zone(zones: list[Zone], zone: Zone) -> list[Zone]:
    """Return the list with a zone added, or replaced under its name.

    Raises:
        Refused: there are too many.
    """
    kept = [one for one in zones if one.name != zone.name]
    if len(kept) >= MAX_ZONES:
        raise Refused(codes.TOO_LARGE, f"A map can have {MAX_ZONES} zones.")
    changed = sorted([*kept, zone], key=lambda one: one.name)
    if not fit_into_a_message(changed):
        raise Refused(codes.TOO_LARGE, f"There is no room for {zone.name!r}; delete others first.")
    return changed


def without_zone(zones: list[Zone], name: str) -> tuple[list[Zone], Zone]:
    """Return the list without a zone, and that zone.

    Raises:
        Refused: `unknown_name`.
    """
    name = canonical(name)
    for zone in zones:
        if zone.name == name:
            return [one for one in zones if one is not zone], zone
    raise Refused(codes.UNKNOWN_NAME, f"There is no zone {name!r} on this map.")


def is_known(line: Sequence[Point], mirrors: Iterable[Sequence[Point]]) -> bool:
    """Say whether a suspected mirror is one of those that are known: its middle lies on one."""
    middle = 0.5 * (np.array(line[:1]) + np.array(line[-1:]))
    lines = (np.array(mirror, np.float64) for mirror in mirrors)
    return any(
        float(distance_to_segments(middle, one[:-1], one[1:])[0]) <= _SAME_MIRROR_M for one in lines
    )


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
