"""Writing a finished map: whole or not at all, and never in place of an older one."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from trolley.gridmap import GridMap, MapError
from trolley.messages import Zone
from trolley_mapper.edit.map_versions import Change, MapVersions


def write_map(folder: Path, name: str, grid: GridMap, zones: Sequence[Zone] = ()) -> str | None:
    """Write a map; one that was there under this name is kept, see `map_versions`.

    Args:
        folder: `<state>/maps`.
        name: of the map.
        grid: the map.
        zones: of a map that has none yet, taken over by whoever loads it first.

    Returns:
        Why it could not be written, in a sentence; None when it is.
    """
    versions = MapVersions(folder)
    try:
        what = "mapped" if versions.newest(name) is None else "extended"
        versions.save(replace(grid, name=name), Change(what=what), seeds=list(zones) or None)
    except MapError as error:
        return f"The map could not be written: {error}."
    return None
