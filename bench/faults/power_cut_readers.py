"""Reads all that Trolley saves, by Trolley's own readers."""

import logging
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from trolley.gridmap import MapError, load_map
from trolley.runtime.log import Log
from trolley.runtime.state import StateFolder
from trolley.zones import ZoneFile
from trolley_base import persistence, upkeep_watch
from trolley_localizer.map_server import CHOSEN_MAP_FILE, ChosenMap
from trolley_localizer.start_pose import LAST_POSE_FILE, LastPose
from trolley_localizer.zone_rules import state_file
from trolley_tour.stored import checks, places, tours
from trolley_tour.trips import history_file, runner
from trolley_tour.trips.record import TripRecord
from trolley_viz.session import browser_choices

ROBOT, MAP, NEW_MAP = "trolley", "apartment", "room"
HISTORY = f"{ROBOT}/{history_file.FILE}"
TYPES: dict[str, type[Any]] = {
    persistence.TIME_FILE: persistence.SavedTime,
    persistence.LATCH_FILE: persistence.SavedLatch,
    persistence.WORLD_FILE: persistence.SavedWorld,
    upkeep_watch.UPKEEP_FILE: upkeep_watch.SavedUpkeep,
    LAST_POSE_FILE: LastPose,
    CHOSEN_MAP_FILE: ChosenMap,
    state_file(MAP): ZoneFile,
    places.POSES_FILE: checks.PosesFile,
    tours.TOURS_FILE: checks.ToursFile,
    runner.TRIP_FILE: TripRecord,
    browser_choices.FILE: browser_choices.ViewerSettings,
}


@dataclass
class Reading:
    """What the readers found, by the path in the state folder."""

    values: dict[str, object] = field(default_factory=dict)
    broken: dict[str, str] = field(default_factory=dict)
    trips: frozenset[str] = frozenset()
    history_problem: str | None = None


def read_all(root: Path) -> Reading:
    """Read everything in a state folder."""
    logging.disable(logging.CRITICAL)
    found = Reading()
    folder = StateFolder(root / ROBOT, Log("reader"))
    for name, kind in TYPES.items():
        what, existed = f"{ROBOT}/{name}", (root / ROBOT / name).exists()
        found.values[what] = folder.read(name, kind)
        if existed and found.values[what] is None:
            found.broken[what] = "is broken"
    file = root / "maps" / f"{NEW_MAP}.yaml"
    what = f"maps/{file.name}"
    try:
        grid = load_map(file) if file.exists() else None
        found.values[what] = None if grid is None else (grid.resolution, grid.cells.tobytes())
    except MapError as error:
        found.broken[what] = str(error)
    past = history_file.read_trips(root / ROBOT, None, 1000, 1 << 30)
    found.trips = frozenset(f"{trip.trip} {trip.state}" for trip in past.trips)
    if past.problem or past.kept or past.num_unreadable:
        found.history_problem = f"{past.problem}, {past.kept}, {past.num_unreadable}"
    return found


def check_all_is_read(root: Path) -> None:
    """See that nothing is saved that nobody here reads.

    Raises:
        ValueError: There is such a file.
    """
    known = {root / ROBOT / name for name in (*TYPES, history_file.FILE)}
    strange = [
        path
        for path in root.rglob("*")
        if path.is_file() and path not in known and path.parent.name != "maps"
    ]
    if strange:
        raise ValueError(f"nothing reads {strange}")
