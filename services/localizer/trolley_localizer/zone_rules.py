"""Which zones are allowed on a map, and the file that they are seeded from."""

import unicodedata
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from trolley import codes
from trolley.codes import Refused
from trolley.files import read_file
from trolley.geometry.polygon import check_polygon
from trolley.messages import Zone
from trolley.messages.types import name_problem
from trolley.state_file import Unreadable, parse
from trolley.zones import LINE_KINDS, ZoneFile

MAX_ZONES = 500
"""Number of zones on one map above which more are refused."""
_SAME_POINT_M = 1e-3
"""Length that a line must exceed [m]."""


def state_file(map_name: str) -> str:
    """Return where the zones of a map lie in the robot's state folder."""
    return f"zones/{map_name}.toml"


def check_zone(zone: Zone, name: str) -> Zone:
    """Return a zone as it may be stored under a name.

    Args:
        zone: as it came.
        name: from the key; it rules.

    Raises:
        Refused: `bad_request` with the reason.
    """
    name = unicodedata.normalize("NFC", name)
    problem = name_problem(name)
    if problem is not None:
        raise Refused(codes.BAD_REQUEST, f"{problem[:1].upper()}{problem[1:]}.")
    if zone.name and unicodedata.normalize("NFC", zone.name) != name:
        raise Refused(
            codes.BAD_REQUEST, f"The zone calls itself {zone.name!r} but its key says {name!r}."
        )
    points = np.array(zone.points, dtype=np.float64)
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
    return msgspec.structs.replace(zone, name=name)


def with_zone(zones: list[Zone], zone: Zone) -> list[Zone]:
    """Return the list with a zone added, or replaced under its name.

    Raises:
        Refused: there are too many.
    """
    kept = [one for one in zones if one.name != zone.name]
    if len(kept) >= MAX_ZONES:
        raise Refused(codes.TOO_LARGE, f"A map can have {MAX_ZONES} zones.")
    return sorted([*kept, zone], key=lambda one: one.name)


def without_zone(zones: list[Zone], name: str) -> tuple[list[Zone], Zone]:
    """Return the list without a zone, and that zone.

    Raises:
        Refused: `unknown_name`.
    """
    name = unicodedata.normalize("NFC", name)
    for zone in zones:
        if zone.name == name:
            return [one for one in zones if one is not zone], zone
    raise Refused(codes.UNKNOWN_NAME, f"There is no zone {name!r} on this map.")


def mirror_lines(zones: list[Zone]) -> list[NDArray[np.float64]]:
    """Return the polylines (n, 2) [m] that the lidar does not see as they are."""
    return [np.array(zone.points, dtype=np.float64) for zone in zones if zone.kind in LINE_KINDS]


def read_seeds(map_file: Path) -> list[Zone] | str:
    """Read `<map>.zones.toml` beside a map; a sentence says why it cannot be used."""
    file = map_file.with_name(f"{map_file.stem}.zones.toml")
    try:
        found = parse(read_file(file), ZoneFile)
        return [check_zone(zone, zone.name) for zone in found.zones]
    except FileNotFoundError:
        return []
    except OSError as error:
        return f"{file}: cannot be read: {error.strerror}"
    except Unreadable as error:
        return f"{file}: {error}"
    except Refused as refused:
        return f"{file}: {refused.message}"
