"""Reads a world: its TOML file and the map that it names."""

from dataclasses import dataclass
from pathlib import Path

from trolley.files import read_file
from trolley.gridmap import GridMap, MapError, load_map
from trolley_base.world import WorldError, WorldSpec, decode_world


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """A world as stored on disk.

    Attributes:
        name: the file's stem, the same for all robots in it.
        spec: what the file says.
        grid: the map that it names.
        map_file: path of that map.
    """

    name: str
    spec: WorldSpec
    grid: GridMap
    map_file: Path


def load_world(path: Path) -> World:
    """Read a world file and its map, which lies relative to it.

    Raises:
        WorldError: naming the file, the key, and what is expected there.
    """
    try:
        text = read_file(path)
    except OSError as error:
        raise WorldError(f"{path}: cannot be read: {error.strerror}") from error
    spec = decode_world(text, str(path))
    map_file = path.parent / spec.map
    try:
        grid = load_map(map_file)
    except MapError as error:
        raise WorldError(f"{path}: map: {error}") from error
    return World(path.stem, spec, grid, map_file)
