"""Where settings are saved: in `robot.toml`, in which people write, too, or beside the state."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from trolley import codes
from trolley.codes import Refused
from trolley.config import ConfigError, RobotConfig
from trolley.config.changeable_settings import LIMITS, Name, Values, acts, value_of
from trolley.config.changeable_settings import with_values as config_with
from trolley.config.kept_settings import KEPT_FILE, file_of, said_of, was_edited
from trolley.config.load import KeptSetting, checked, read_toml
from trolley.config.robot_toml import NotWritable, read_text, replace_text, with_values
from trolley.runtime.state import StateFolder

WRITABLE = 0o200
"""The bit by which a file's owner may write it: without it, it is nobody's to change."""


class Saved(NamedTuple):
    """What became of settings that were to be saved."""

    is_saved: bool
    why: str = ""
    """Why not; where some are `kept`: why not in robot.toml."""
    kept: frozenset[str] = frozenset()
    """The keys of those that are kept in the state folder instead."""
    is_written: bool = False
    """Whether robot.toml was changed."""


NO_FILE = Saved(False, "this robot runs without a robot.toml")
NOT_ASKED = Saved(False, "you asked not to save it")


class SettingsFiles:
    """Saves settings in `robot.toml`, or in `settings.toml` where that cannot be written.

    It reads and writes files, so all but `keeps` is called on the worker's thread.

    Args:
        path: of the robot.toml.
        known: what it says, as far as base knows.
        state: the robot's state folder.
        kept: what stands in settings.toml.
    """

    def __init__(
        self, path: Path, known: RobotConfig, state: StateFolder, kept: Iterable[KeptSetting]
    ) -> None:
        self._path = path
        self._known = known
        self._state = state
        self._kept = {Name(one.section, one.key): one for one in kept}

    @property
    def keeps(self) -> Path:
        """Where settings are kept that cannot be written into robot.toml."""
        return self._state.path / KEPT_FILE

    def drop_edited(self) -> OSError | None:
        """Forget what robot.toml was edited for since: it counts, whatever is written there later.

        Returns:
            Why that cannot be saved; None where nothing is wrong.
        """
        try:
            robot_toml = read_toml(self._path)
        except ConfigError:  # edited to something that nobody can use: the next start looks again
            return None
        # What is set only in robot.toml never counted: it stays for whoever put it there.
        still = {
            name: one
            for name, one in self._kept.items()
            if acts(name) == "file" or not was_edited(robot_toml, one)
        }
        return self._write(still)

    def save(self, section: str, values: Values) -> Saved | Refused:
        """Save settings; what else stands in the files stays, comments in robot.toml too.

        Args:
            section: of the settings.
            values: by key; None: back to the default.

        Returns:
            Whether they are saved, or why nothing may be changed at all: somebody has edited
            robot.toml meanwhile, and it says something else about these settings or cannot be used.
        """
        try:
            old, robot_toml = read_text(self._path), read_toml(self._path)
            now = checked(robot_toml, self._path)
        except ConfigError as error:
            if not self._path.exists():
                return Saved(False, f"{self._path} is gone")
            return Refused(
                codes.FILE_CHANGED,
                "Somebody has edited robot.toml, and it cannot be used as it is: "
                f"{error}. Nothing was changed.",
            )
        edited = _edited_meanwhile(now, self._known, section, values)
        if edited is not None:
            return Refused(codes.FILE_CHANGED, edited)
        try:
            known = config_with(self._known, section, values)
            after = config_with(now, section, values)
        except ConfigError as error:
            return Refused(codes.BAD_REQUEST, str(error))
        try:
            is_changed = self._write_into_robot_toml(old, section, values)
        except (NotWritable, OSError) as error:
            is_ours = isinstance(error, ConfigError)
            why = str(error) if is_ours else f"{self._path}: {error.strerror}"
            names = [Name(section, key) for key in values]
            if section == LIMITS and any(
                value_of(after, one) > value_of(now, one) for one in names
            ):
                return Saved(False, f"{why}, and a limit is never kept above what it says")
            return self._keep(robot_toml, section, values, why)
        except ConfigError as error:
            return Refused(codes.BAD_REQUEST, str(error))
        if is_changed is None:
            return Refused(codes.FILE_CHANGED, "Somebody is editing robot.toml; try again.")
        self._known = known
        gone = {Name(section, key) for key in values}
        error = self._write({name: one for name, one in self._kept.items() if name not in gone})
        # Where robot.toml was changed, what is kept no longer counts in any case.
        if error is not None and not is_changed:
            return Saved(False, f"{self.keeps} cannot be written: {error.strerror}")
        return Saved(True, is_written=is_changed)

    def _write_into_robot_toml(self, old: str, section: str, values: Values) -> bool | None:
        """Write settings into robot.toml.

        Returns:
            Whether it had to be changed for that; None if somebody else is changing it.

        Raises:
            NotWritable: It is not to be written.
            OSError: It cannot be read or written.
            ConfigError: They cannot be put into it.
        """
        chunks = tuple(section.split("."))
        new = with_values(old, {(*chunks, key): value for key, value in values.items()})
        if new == old:
            return False
        if not self._path.stat().st_mode & WRITABLE:
            raise NotWritable(f"{self._path} is write-protected")
        if read_text(self._path) != old:
            return None
        replace_text(self._path, new)
        return True

    def _keep(self, robot_toml: Mapping[str, Any], section: str, values: Values, why: str) -> Saved:
        """Keep settings in the state folder, with what robot.toml says of them."""
        kept = dict(self._kept)
        keys: list[str] = []
        for key, value in values.items():
            name = Name(section, key)
            said = said_of(robot_toml, name)
            kept.pop(name, None)
            if value != said:
                kept[name] = KeptSetting(section=section, key=key, value=value, instead_of=said)
                keys.append(key)
        error = self._write(kept)
        if error is not None:
            return Saved(False, f"{why}, and {self.keeps} cannot be written: {error.strerror}")
        return Saved(True, why, frozenset(keys))

    def _write(self, kept: dict[Name, KeptSetting]) -> OSError | None:
        """Write settings.toml, if that changes it."""
        if kept == self._kept:
            return None
        try:
            self._state.write(KEPT_FILE, file_of(kept.values()))
        except OSError as error:
            return error
        self._kept = kept
        return None


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
