"""`trolley map new --from`: a map of a recorded drive or a ROS bag."""

import contextlib
import sys
import tempfile
from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from trolley.cli import plugins
from trolley.cli.demo_recording import RECORDED
from trolley.cli.printing import say
from trolley.cli.show import Progress, print_json, seconds_text
from trolley.config import ConfigError
from trolley.gridmap import MapError, save_map
from trolley.messages.mapping import MAP_NAME

if TYPE_CHECKING:
    from trolley.recording.drive import Drive

OFFLINE = "trolley.offline"
"""Entry-point group of what services do without a robot: `map` makes one of a drive."""
BAG_COMMAND = "import-bag"


def map_of_drive(name: str, source: Path, *, as_json: bool) -> None:
    """Make the map and write it into the current folder.

    Raises:
        ConfigError: The drive cannot be used, the map is there already or cannot be written.
    """
    if not MAP_NAME.fullmatch(name):
        raise click.BadParameter(
            f"{name!r} is not a valid map name: use A-Z, a-z, 0-9, _, - and dots"
        )
    path = Path(f"{name}.yaml")
    if path.exists():
        raise ConfigError(f"{path} already exists; choose another name")
    make_map = _maker()
    drive = _read(source, as_json=as_json)
    progress = Progress()

    def tell(share: float) -> None:
        progress.show(f"{100.0 * share:.0f} %")

    try:
        made = make_map(drive, tell)
    except ValueError as error:
        raise ConfigError(f"{source}: no map can be made of it: {error}") from error
    finally:
        progress.clear()
    try:
        save_map(made.grid, path)
    except MapError as error:
        raise ConfigError(str(error)) from error
    rows, cols = made.grid.cells.shape
    size_m = cols * made.grid.resolution, rows * made.grid.resolution
    if as_json:
        print_json(
            {
                "file": str(path),
                "width": cols,
                "height": rows,
                "resolution": made.grid.resolution,
                "seconds": drive.seconds,
                "scans": made.num_scans,
                "unused": made.num_unused,
                "lost": made.num_lost,
                "loops": made.num_loops,
                "doubt": made.doubt,
            }
        )
        return
    say(
        f"{path}: {size_m[0]:.1f} x {size_m[1]:.1f} m, from {seconds_text(drive.seconds)} "
        f"and {made.num_scans} scans; places seen again: {made.num_loops}."
    )
    if made.num_unused:
        say(f"{made.num_unused} scans could not be used.", err=True, fg="yellow")
    if made.num_lost:
        share = 100.0 * made.num_lost / made.num_scans
        say(f"At {share:.0f} % of the scans it was lost: look at the map.", err=True, fg="yellow")
    if made.doubt:
        say(made.doubt, err=True, fg="yellow")


def _maker() -> Callable[..., Any]:
    """What makes a map of a drive.

    Raises:
        ConfigError: The mapper is not installed.
    """
    found = [one for one in entry_points(group=OFFLINE) if one.name == "map"]
    if not found:
        raise ConfigError("making maps needs the extra trolley-robot[mapper]")
    try:
        return found[0].load()
    except ImportError as error:
        raise ConfigError(f"making maps needs the extra trolley-robot[mapper]: {error}") from error


def _read(source: Path, *, as_json: bool) -> "Drive":
    """The drive of a recording, or of a bag that is made a recording first.

    Raises:
        ConfigError: It cannot be used.
    """
    try:
        from trolley.recording.drive import read_drive
        from trolley.recording.reader import BadRecording, ForeignRecording
    except ImportError as error:
        raise ConfigError(f"{source} needs the extra trolley-robot[foxglove]: {error}") from error
    bag_command = plugins().get(BAG_COMMAND)
    try:
        if source.suffix == RECORDED and source.is_file():
            with contextlib.suppress(ForeignRecording):
                drive = read_drive(source)
                for note in drive.notes:
                    say(note, err=True, fg="yellow")
                return drive
        if bag_command is None:
            raise ConfigError(f"{source}: a ROS bag needs the extra trolley-robot[ros2]")
        with tempfile.TemporaryDirectory() as folder:
            recording = Path(folder) / "bag.mcap"
            # What it says of the bag is for people: JSON is for the map.
            said = contextlib.redirect_stdout(sys.stderr) if as_json else contextlib.nullcontext()
            with said:
                click.get_current_context().invoke(bag_command.load(), bag=source, file=recording)
            return read_drive(recording)
    except BadRecording as problem:
        raise ConfigError(str(problem)) from problem
