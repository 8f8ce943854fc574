"""Where the zones of a map are kept, and what the localizer makes of them."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trolley.codes import Refused
from trolley.files import read_file
from trolley.messages import Zone
from trolley.state_file import Unreadable, parse
from trolley.zones import LINE_KINDS, ZoneFile, check_zone


def state_file(map_name: str) -> str:
    """Return where the zones of a map lie in the robot's state folder."""
    return f"zones/{map_name}.toml"


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
