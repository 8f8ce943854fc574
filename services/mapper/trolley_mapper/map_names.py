"""Names of maps: which are taken, and which belongs to a file that is never written."""

from pathlib import Path
from typing import Any

from trolley import codes
from trolley.codes import Refused
from trolley.config import RobotConfig


def configured_file(config: RobotConfig) -> Path | None:
    """Return the YAML file of `[map] file`, which is never written."""
    file: Any = config.map.file
    return None if file is None else Path(config.path(file))


def configured_name(config: RobotConfig) -> str | None:
    """Return what the map of `[map] file` is called."""
    file = configured_file(config)
    return None if file is None else file.stem


def why_not_overwritten(config: RobotConfig, name: str) -> str:
    """Say that a map is extended that must be saved under another name; "" if it need not be."""
    if name != configured_name(config):
        return ""
    return (
        f"The map {name} is your original file, which is never overwritten: save the extended map "
        "under another name (`trolley map save NAME`)."
    )


def check_name_is_free(folder: Path, config: RobotConfig, name: str) -> None:
    """Refuse a name that a map has.

    Args:
        folder: of the maps.
        config: of the robot.
        name: that is wanted.

    Raises:
        Refused: `exists`.
    """
    if (folder / f"{name}.yaml").exists() or name == configured_name(config):
        raise Refused(
            codes.EXISTS, f"The map {name!r} already exists; choose another name.", name=name
        )
