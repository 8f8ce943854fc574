"""Which maps there are, and reading one of them."""

import re
from dataclasses import dataclass
from pathlib import Path

from msgspec import Struct

from trolley.config.localizer import LocalizerConfig
from trolley.gridmap import MapError, load_map
from trolley.messages import Zone
from trolley_localizer.core import Localizer
from trolley_localizer.warmup import warm_up
from trolley_localizer.zone_store import read_seeds

_NAME = re.compile(r"(?!\.)[A-Za-z0-9_.-]{1,64}")


class ChosenMap(Struct, frozen=True, kw_only=True):
    """The file `map.toml`: which map was loaded last, and what the configuration named then."""

    name: str
    configured: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class LoadedMap:
    """A map that is ready for use."""

    name: str
    localizer: Localizer
    seeds: list[Zone] | str
    """Zones from the file beside the map, or why they cannot be read."""


class MapStore:
    """The maps of the host's folder, and the one that the configuration names.

    Args:
        folder: `<state>/maps`.
        configured: the YAML file of `[map] file`, or None.
    """

    def __init__(self, folder: Path, configured: Path | None) -> None:
        self._folder = folder
        self._configured = configured

    @property
    def configured_name(self) -> str | None:
        """What the configured map is called."""
        return None if self._configured is None else self._configured.stem

    def problem(self) -> str | None:
        """Say in one sentence why the configured map cannot be used, or None."""
        file = self._configured
        if file is None:
            return None
        if _NAME.fullmatch(file.stem) is None:
            return (
                f"[map] file: {file.name!r} cannot name a map: use 1 to 64 letters, digits, "
                f"'_', '-' and '.'"
            )
        twin = self._folder / f"{file.stem}.yaml"
        if twin.exists() and twin.resolve() != file.resolve():
            return (
                f"[map] file: there is another map called {file.stem!r} in {self._folder}; "
                f"rename one of them"
            )
        return None

    def names(self) -> list[str]:
        """Return the names of all maps, in order."""
        found = {
            file.stem
            for file in self._folder.glob("*.yaml")
            if _NAME.fullmatch(file.stem) and not file.stem.endswith(".zones")
        }
        if self._configured is not None and self.problem() is None:
            found.add(self._configured.stem)
        return sorted(found)

    def file_of(self, name: str) -> Path | None:
        """Return the YAML file of a map, or None if there is no such map."""
        if self._configured is not None and name == self._configured.stem:
            return self._configured
        if _NAME.fullmatch(name) is None:
            return None
        file = self._folder / f"{name}.yaml"
        return file if file.exists() else None


def read_map(file: Path, config: LocalizerConfig, seed: int) -> LoadedMap | MapError:
    """Read a map and prepare a localizer on it (to be run aside: it takes up to seconds)."""
    warm_up()
    try:
        grid = load_map(file)
    except MapError as error:
        return error
    return LoadedMap(grid.name, Localizer(grid, [], config, seed), read_seeds(file))
