"""Writing settings into `robot.toml`, in which people write, too."""

from pathlib import Path
from typing import NamedTuple

from trolley import codes
from trolley.codes import Refused
from trolley.config import ConfigError, RobotConfig, load_config
from trolley.config.changeable_settings import Name, Values, value_of
from trolley.config.robot_toml import NotWritable, read_text, replace_text, with_values

WRITABLE = 0o200
"""The bit by which a file's owner may write it: without it, it is nobody's to change."""


class Saved(NamedTuple):
    """What became of settings that were to be saved."""

    is_saved: bool
    why: str = ""
    """Why not."""


NO_FILE = Saved(False, "this robot runs without a robot.toml")
NOT_ASKED = Saved(False, "you asked not to save it")


def save(path: Path, known: RobotConfig, section: str, values: Values) -> Saved | Refused:
    """Change settings in a file; what else stands there stays, comments too.

    Args:
        path: of the file.
        known: what it says, as far as base knows.
        section: of the settings.
        values: by key; None: the line goes.

    Returns:
        Whether it is saved, or why nothing may be changed at all: somebody has edited the file
        meanwhile, and it says something else about these settings or cannot be used.
    """
    try:
        old = read_text(path)
        now = load_config(path)
    except ConfigError as error:
        if not path.exists():
            return Saved(False, f"{path} is gone")
        return Refused(
            codes.FILE_CHANGED,
            f"Somebody has edited robot.toml, and it cannot be used as it is: {error}. Nothing was "
            "changed.",
        )
    edited = _edited_meanwhile(now, known, section, values)
    if edited is not None:
        return Refused(codes.FILE_CHANGED, edited)
    chunks = tuple(section.split("."))
    try:
        new = with_values(old, {(*chunks, key): value for key, value in values.items()}, {}, "")
        if new == old:
            return Saved(True)
        if not path.stat().st_mode & WRITABLE:
            return Saved(False, f"{path} is write-protected")
        if read_text(path) != old:
            return Refused(codes.FILE_CHANGED, "Somebody is editing robot.toml; try again.")
        replace_text(path, new)
    except (NotWritable, OSError) as error:
        why = str(error) if isinstance(error, ConfigError) else f"{path}: {error.strerror}"
        return Saved(False, why)
    except ConfigError as error:
        return Refused(codes.BAD_REQUEST, str(error))
    return Saved(True)


def _edited_meanwhile(
    now: RobotConfig, known: RobotConfig, section: str, values: Values
) -> str | None:
    """Say which of some settings somebody has changed in the file to something else."""
    for key, wanted in values.items():
        name = Name(section, key)
        says, knew = value_of(now, name), value_of(known, name)
        if says not in (knew, wanted):
            return (
                f"Somebody has edited robot.toml, which now says {key} = {says}, not {knew}: that "
                "counts after a restart; change it there, or restart first."
            )
    return None
