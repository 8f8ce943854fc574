"""Where the maps and simulated worlds lie that ship with Trolley."""

import os
import sys
from pathlib import Path

from trolley.files import expand_home

VARIABLE = "TROLLEY_WORLDS"


def folder() -> Path:
    """The folder of worlds: `TROLLEY_WORLDS`, else the clone's, else where an installer put it.

    Raises:
        FileNotFoundError: None of them is there.
    """
    given = os.environ.get(VARIABLE)
    if given:
        return Path(given)
    places = [
        Path(__file__).resolve().parents[2] / "worlds",
        Path(sys.prefix) / "share" / "trolley" / "worlds",
    ]
    for place in places:
        if place.is_dir():
            return place
    tried = ", ".join(map(str, places))
    raise FileNotFoundError(f"no folder of worlds: name it in {VARIABLE} (looked for {tried})")


def find(name: str | Path, beside: Path | None = None) -> Path:
    """A world or map file: absolute, else in the folder `beside`, else one that ships with Trolley.

    A world that ships may be named without its `.toml`.

    Raises:
        FileNotFoundError: It is in none of these places.
    """
    path = expand_home(name)
    places = [path] if path.is_absolute() else [(beside or Path.cwd()) / path, folder() / path]
    if not path.suffix and not path.is_absolute():
        places.append(folder() / f"{path}.toml")
    for place in places:
        if place.is_file():
            return place
    tried = ", ".join(map(str, places))
    raise FileNotFoundError(f"there is no file {name} (looked for {tried})")
