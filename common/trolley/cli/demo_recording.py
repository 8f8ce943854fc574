"""What a demo takes from the recorded drive that it plays: map, zones, start, footprint."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np
import tomli_w

from trolley.cli.demo_robot import Choices
from trolley.cli.printing import say
from trolley.config import ConfigError
from trolley.files import open_file
from trolley.gridmap import GridMap, MapError, save_map
from trolley.messages import OccupancyGrid, Zones
from trolley.messages.mapping import MapName

if TYPE_CHECKING:
    from trolley.recording.drive import Drive

RECORDED = ".mcap"
"""How files of `trolley record` end; other drives are npz files."""


def with_recorded(choices: Choices, folder: Path) -> Choices:
    """The choices with what a file of `trolley record` says; its map is written into a folder.

    Raises:
        ConfigError: The file cannot be used, or holds no map and none was named.
    """
    if choices.recording is None or choices.recording.suffix != RECORDED:
        return choices
    drive = _read(choices.recording)
    for note in drive.notes:
        say(note, err=True, fg="yellow")
    map_file, start = choices.map_file, choices.start
    if map_file is None:
        if drive.map is None:
            raise ConfigError(
                f"{choices.recording} contains no map; name the one it was driven on with --map"
            )
        map_file = _write_map(drive.map, drive.zones, folder)
        # On another map it stood elsewhere.
        start = start or drive.map_T_start
    outline = None if drive.robot is None else [list(point) for point in drive.robot.footprint]
    return dataclasses.replace(choices, map_file=map_file, start=start, outline=outline)


def duration_s(recording: Path) -> tuple[float, int]:
    """How long a recorded drive is [s] and how many scans it has."""
    if recording.suffix == RECORDED:
        drive = _read(recording)
        return drive.seconds, len(drive.scans)
    with open_file(recording) as file, np.load(file, allow_pickle=False) as archive:
        stamps = archive["stamps"]
    return float(stamps[-1] - stamps[0]), len(stamps)


def _read(recording: Path) -> "Drive":
    try:
        from trolley.recording.drive import read_drive
        from trolley.recording.reader import BadRecording
    except ImportError as error:
        raise ConfigError(
            f"{recording} needs the extra trolley-robot[foxglove]: {error}"
        ) from error
    try:
        return read_drive(recording)
    except BadRecording as error:
        raise ConfigError(str(error)) from error


def _write_map(grid: OccupancyGrid, zones: Zones | None, folder: Path) -> Path:
    """Write a map and, beside it, its zones, as the localizer takes them over."""
    try:
        name = msgspec.convert(grid.name, MapName)
    except msgspec.ValidationError:
        name = "recorded"
    cells = np.frombuffer(grid.cells, dtype=np.int8).reshape(grid.height, grid.width)
    path = folder / f"{name}.yaml"
    try:
        save_map(GridMap(name, grid.resolution, grid.origin, cells), path)
    except (MapError, ValueError) as error:
        raise ConfigError(f"the recorded map cannot be used: {error}") from error
    if zones is not None and zones.map == grid.name:
        listed = [
            {name: value for name, value in msgspec.to_builtins(zone).items() if value is not None}
            for zone in zones.zones
        ]
        text = tomli_w.dumps({"zones": listed})
        path.with_name(f"{name}.zones.toml").write_text(text, encoding="utf-8")
    return path
