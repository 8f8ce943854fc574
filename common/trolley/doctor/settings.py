"""Checks of robot.toml, of the map that it names, and of what is saved about that map."""

import dataclasses
import os
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct

from trolley.config.describe import to_toml
from trolley.config.kept_settings import KEPT_FILE, load_with_kept
from trolley.config.problems import find_problems
from trolley.doctor.finding import Finding, note, ok, problem, warning
from trolley.files import BROKEN, NEWER, read_file, read_text
from trolley.gridmap import GridMap
from trolley.gridmap.io import MapError, load_map
from trolley.messages import SavedPose, Zone
from trolley.messages.mapping import MAP_NAME, MAP_NAME_RULE
from trolley.runtime.state import saved_for_others_only
from trolley.state_file import Unreadable, parse

FINE_M, COARSE_M = 0.02, 0.1
"""Cell edges that work well."""
LARGE_CELLS = 25_000_000
"""From here on the services need much memory: about 10 bytes a cell in two of them."""
LEAST_FLOOR_M2 = 1.0
"""A map with less free floor leaves a robot nowhere to go, however large its canvas is."""
MOST_FREE_EDGE = 0.5
"""Of a map in which all is known more of its edge is free only where the outside is, too."""
MOST_NAMED = 5


class PlaceFile(Struct, frozen=True, kw_only=True):
    """`poses.toml`, as the service `tour` writes it."""

    poses: list[SavedPose]


def check_file(path: Path | None) -> list[Finding]:
    """Whether robot.toml can be used."""
    if path is None:
        return [
            note(
                "settings",
                "There is no robot.toml on this computer, which is fine if no robot runs on it.",
                "`trolley init /etc/trolley/robot.toml` writes one; --config names another.",
            )
        ]
    if path.exists() and not os.access(path, os.R_OK):
        return [note("settings", f"You may not read {path}.", "Run this again with `sudo`.")]
    found = [
        problem(
            "settings",
            text if text.endswith("?") else f"{text}.",
            "Correct that line; docs/configuration.md lists every key.",
        )
        for text in find_problems(path)
    ]
    return found or [ok("settings", f"{path} can be used.")]


def check_without_robot(path: Path | None, wanted: list[str]) -> list[Finding]:
    """Whether a robot.toml without a [robot] is right here.

    Args:
        path: of it.
        wanted: units of this host that are started with the system and run a robot.
    """
    text = f"{path} has no [robot]"
    if wanted:
        return [
            problem(
                "settings",
                f"{text}, but {_listed(wanted)} shall run a robot here.",
                "Add [robot] with name and footprint; `trolley init FILE` writes an example.",
            )
        ]
    return [
        note(
            "settings",
            f"{text}, which is right for a PC or a home router.",
            "A robot needs one: `trolley init FILE` writes an example.",
        )
    ]


def check_kept(path: Path, state: Path) -> list[Finding]:
    """What counts in place of robot.toml, since it was set while the robot ran.

    Args:
        path: of a robot.toml that can be used.
        state: the host's state folder.
    """
    loaded = load_with_kept(path, state)
    folder = state / loaded.config.robot.name
    file = folder / KEPT_FILE
    if folder.exists() and not os.access(folder, os.R_OK | os.X_OK):
        text = f"You may not read {file}, which may contain settings."
        return [note("settings", text, "Run this again with `sudo`.")]
    found: list[Finding] = []
    if loaded.config.kept:
        each = "; ".join(
            f"[{one.section}] {one.key} = {_value(one.value)}, "
            f"in robot.toml {_value(one.instead_of)}"
            for one in loaded.config.kept
        )
        text = f"What was set while the robot ran counts from {file}: {each}."
        found.append(ok("settings", text))
    if loaded.edited:
        names = _listed([str(name) for name in loaded.edited])
        text = (
            f"robot.toml was edited after {names} had been set while the robot ran, so it counts."
        )
        found.append(ok("settings", text))
    remedy = "Set it again with `trolley config set`, or delete what is wrong there."
    return [*found, *(warning("settings", text, remedy) for text in loaded.troubles)]


def check_name(name: str, state: Path) -> list[Finding]:
    """Whether what people saved is there under the robot's name, which its folder has.

    Args:
        name: of the robot of robot.toml.
        state: the host's state folder.
    """
    saved = saved_for_others_only(state, name)
    if not saved:
        return []
    return [
        note(
            "settings",
            f"Nobody has saved a place or tour for {name}; {state} has those of {_listed(saved)}.",
            "If that is this robot under an earlier name, docs/install.md says how to take them "
            "along.",
        )
    ]


def _value(value: Any) -> str:
    return "not set" if value is None else to_toml(value)


@dataclasses.dataclass(frozen=True)
class MapFacts:
    """What a map holds."""

    name: str
    resolution_m: float
    size_m: tuple[float, float]
    cells: int
    unknown: float
    """Share of cells that nobody has seen."""
    occupied: float
    """Share of the known cells with something in them."""
    floor_m2: float
    """Area of the cells that are free."""
    free_edge: float
    """Share of the cells at the map's edge that are free."""


def facts_of(grid: GridMap) -> MapFacts:
    """Measure a map."""
    is_known = grid.cells >= 0
    known, occupied = int(is_known.sum()), int(grid.occupied_mask().sum())
    is_free = is_known & ~grid.occupied_mask()
    edge = np.concatenate([is_free[0], is_free[-1], is_free[1:-1, 0], is_free[1:-1, -1]])
    return MapFacts(
        grid.name,
        grid.resolution,
        grid.size_m,
        int(grid.cells.size),
        float(np.mean(~is_known)),
        occupied / max(known, 1),
        (known - occupied) * grid.resolution**2,
        float(np.mean(edge)),
    )


def check_map(facts: MapFacts) -> list[Finding]:
    """Whether a robot can find its place and its way on a map."""
    width_m, height_m = facts.size_m
    found: list[Finding] = []
    if facts.occupied == 0.0:
        found.append(
            problem(
                "map",
                f"The map {facts.name} shows no walls at all.",
                "Look at `negate` and `occupied_thresh` in its YAML file.",
            )
        )
    elif facts.occupied > 0.9:
        found.append(
            problem(
                "map",
                f"The map {facts.name} is almost all walls.",
                "Look at `negate` and `free_thresh` in its YAML file: it may be inside out.",
            )
        )
    if facts.floor_m2 < LEAST_FLOOR_M2:
        found.append(
            problem(
                "map",
                f"The map {facts.name} has hardly any free floor: {facts.floor_m2:.1f} m².",
                "Look at `free_thresh` in its YAML file, or map again.",
            )
        )
    if not FINE_M <= facts.resolution_m <= COARSE_M:
        found.append(
            warning(
                "map",
                f"The map {facts.name} has cells of {facts.resolution_m:g} m; "
                f"{FINE_M:g} to {COARSE_M:g} m work well.",
                "Scale the image and set `resolution`, or map again with 0.05.",
            )
        )
    if facts.cells > LARGE_CELLS:
        found.append(
            warning(
                "map",
                f"The map {facts.name} is {width_m:.0f} x {height_m:.0f} m in "
                f"{facts.cells / 1e6:.0f} million cells, which takes much memory.",
                "Cut off its empty margin, or use larger cells.",
            )
        )
    if facts.unknown == 0.0 and facts.free_edge > MOST_FREE_EDGE:
        found.append(
            warning(
                "map",
                f"The map {facts.name} has no unknown cells, and what lies outside its walls is "
                "free: the robot may plan to drive there.",
                "Paint the outside in grey (205), and save the image without transparency, which "
                "makes grey free (GIMP: Image, Flatten Image).",
            )
        )
    return found or [
        ok(
            "map",
            f"{facts.name}: {width_m:.1f} x {height_m:.1f} m, cells of {facts.resolution_m:g} m, "
            f"{facts.unknown:.0%} unknown.",
        )
    ]


def read_map(file: Path) -> GridMap | Finding:
    """A map, or what is wrong with its files."""
    if MAP_NAME.fullmatch(file.stem) is None:
        return problem(
            "map",
            f"{file}: {file.stem!r} cannot name a map, so the localizer does not load it.",
            f"Rename the file, and name it anew in [map] file: {MAP_NAME_RULE}.",
        )
    try:
        return load_map(file)
    except MapError as error:
        return problem("map", f"{file}: {error.problem}.", f"{_sentence(error.remedy)}")


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."


def check_places(grid: GridMap, poses: list[SavedPose]) -> list[Finding]:
    """Whether the saved places of a map lie on its free floor."""
    here = [pose for pose in poses if pose.map == grid.name]
    if not here:
        return [ok("places", f"No places are saved on the map {grid.name}.")]
    points = np.array([[one.pose.x, one.pose.y] for one in here], dtype=np.float64)
    off = [one.name for one, is_on in zip(here, grid.contains(points), strict=True) if not is_on]
    values = grid.values_at(points)
    inside = [one.name for one, value in zip(here, values, strict=True) if value >= 65]
    found: list[Finding] = []
    for names, where in ((off, "outside the map"), (inside, "in a wall")):
        if names:
            found.append(
                warning(
                    "places",
                    f"{_listed(names)} {'lies' if len(names) == 1 else 'lie'} {where}.",
                    "Drive there and save it again under the same name, or delete it.",
                )
            )
    return found or [ok("places", f"{len(here)} places are saved on the map {grid.name}.")]


def check_zones(grid: GridMap, zones: list[Zone]) -> list[Finding]:
    """Whether the zones of a map lie on it."""
    off = [
        zone.name
        for zone in zones
        if not grid.contains(np.array(zone.points, dtype=np.float64).reshape(-1, 2)).any()
    ]
    if off:
        return [
            warning(
                "zones",
                f"{_listed(off)} {'lies' if len(off) == 1 else 'lie'} outside the map.",
                "Were they drawn on another map? Delete them in the viewer.",
            )
        ]
    return [ok("zones", f"{len(zones)} zones on the map {grid.name}.")]


def _listed(names: list[str]) -> str:
    some = ", ".join(names[:MOST_NAMED])
    return some if len(names) <= MOST_NAMED else f"{some} and {len(names) - MOST_NAMED} more"


def read_list(file: Path, kind: type[Struct], field: str) -> list[Any] | Finding:
    """What a state file lists in a field, or why it cannot be read; [] where there is none yet."""
    try:
        return getattr(parse(read_file(file), kind), field)
    except FileNotFoundError:
        return []
    except (Unreadable, OSError) as error:
        return problem(
            "saved",
            f"{file} cannot be read: {error}.",
            "Its service sets it aside at the next start; restore it from a backup.",
        )


def chosen_map(state: Path, maps: Path, configured: Path | None) -> Path | None:
    """The map file that the localizer begins with, None if there is none.

    Args:
        state: the robot's state folder.
        maps: where this host's own maps lie.
        configured: what `[map] file` names.
    """
    try:
        said = tomllib.loads(read_text(state / "map.toml"))
    except (OSError, ValueError):  # nobody chose one; the localizer reports a broken file
        said = {}
    stem = None if configured is None else configured.stem
    name = said.get("name")
    if isinstance(name, str) and said.get("configured") == stem and name != stem:
        own = maps / f"{Path(name).name}.yaml"
        if own.exists():
            return own
    return configured


def check_kept_aside(state: Path) -> list[Finding]:
    """Whether files of the state had to be set aside since they were broken."""
    found = [*state.rglob(f"*.{BROKEN}-*"), *state.rglob(f"*.{NEWER}-*")] if state.exists() else []
    broken = [path.name for path in sorted(found)]
    if not broken:
        return []
    return [
        warning(
            "saved",
            f"{_listed(broken)} could not be read and {'was' if len(broken) == 1 else 'were'} "
            f"set aside in {state}.",
            "Restore a backup, or delete them if they are not needed.",
        )
    ]
