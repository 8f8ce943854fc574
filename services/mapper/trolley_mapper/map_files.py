"""Writing a finished map: whole or not at all, and never in place of an older one."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import tomli_w
from msgspec import to_builtins

from trolley.files import make_folder, write_atomically
from trolley.gridmap import GridMap, MapError, load_map, save_map
from trolley.gridmap.description import read_description, render_description
from trolley.messages import Zone

VERSIONS = "versions"
MAX_VERSIONS = 20


def write_map(folder: Path, name: str, grid: GridMap, zones: Sequence[Zone] = ()) -> str | None:
    """Write a map; one that was there under this name is kept in `versions/<name>`.

    A map is a YAML file and the image that it names. While the image is replaced the YAML file
    names the new version's own image, so whenever the power fails a whole map is there: the old one
    or the new one.

    Args:
        folder: `<state>/maps`.
        name: of the map.
        grid: the map.
        zones: of a map that has none yet, taken over by whoever loads it first.

    Returns:
        Why it could not be written, in a sentence; None when it is.
    """
    yaml = folder / f"{name}.yaml"
    named = replace(grid, name=name)
    try:
        make_folder(folder)
        if zones:
            _write_zones(folder / f"{name}.zones.toml", zones)
        if yaml.exists():
            _keep(yaml)
            version = _next_version(folder, name)
            save_map(named, version)
            described = replace(
                read_description(version), image=f"{VERSIONS}/{name}/{version.stem}.pgm"
            )
            write_atomically(yaml, render_description(described).encode())
        save_map(named, yaml, mode="trinary", image_format="pgm")
    except MapError as error:
        return f"The map could not be written: {error}."
    except OSError as error:
        return f"The map could not be written to disk: {error.strerror}."
    return None


def _keep(yaml: Path) -> None:
    """Copy a map to the folder of its versions, unless it is there already."""
    folder = yaml.parent / VERSIONS / yaml.stem
    if (yaml.parent / read_description(yaml).image).parent == folder:
        return  # the power failed when its image was to be replaced
    save_map(load_map(yaml), _next_version(yaml.parent, yaml.stem))
    for old in _numbered(folder)[:-MAX_VERSIONS]:
        old.unlink()
        for image in folder.glob(f"{old.stem}.p*"):
            image.unlink()


def _next_version(folder: Path, name: str) -> Path:
    versions = folder / VERSIONS / name
    make_folder(versions)
    numbers = [int(one.stem) for one in _numbered(versions)]
    return versions / f"{max(numbers, default=0) + 1:04d}.yaml"


def _numbered(folder: Path) -> list[Path]:
    """The versions of a map, the oldest first."""
    found = [one for one in folder.glob("*.yaml") if one.stem.isdigit()]
    return sorted(found, key=lambda one: int(one.stem))


def _write_zones(file: Path, zones: Sequence[Zone]) -> None:
    plain = [
        {key: value for key, value in to_builtins(zone).items() if value is not None}
        for zone in zones
    ]
    write_atomically(file, tomli_w.dumps({"zones": plain}).encode())
