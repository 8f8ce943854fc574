"""Settings that were set while the robot ran, where its `robot.toml` cannot be written.

They are kept in `settings.toml` in the robot's state folder and laid over what robot.toml says.
`base` alone writes that file; all services of the host read it when they start. Whoever said it
last is right: the file remembers what robot.toml said of each setting, and once robot.toml says
something else, robot.toml counts.
"""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, cast

import msgspec
from msgspec import Struct

from trolley.config.changeable_settings import LIMITS, Name, acts, value_of, with_values
from trolley.config.load import ConfigError, KeptSetting, RobotConfig, checked, read_toml
from trolley.files import read_file
from trolley.state_file import Unreadable, parse, reason_of

KEPT_FILE = "settings.toml"


class KeptSettings(Struct, frozen=True, kw_only=True):
    """The file `settings.toml`: tables as in `robot.toml`, below `set` and `instead_of`."""

    NOTE: ClassVar[str] = """\
# What was set while the robot ran (`trolley config set`, or in the viewer), since robot.toml could
# not be written. It counts in place of what robot.toml says, for as long as robot.toml says what it
# said then (below `instead_of`): once you edit the same setting in robot.toml, your edit counts.
# Trolley writes this file anew at each change, so edit robot.toml rather than this.
"""

    set: dict[str, Any]
    instead_of: dict[str, Any]


class Loaded(NamedTuple):
    """What a service runs with."""

    config: RobotConfig
    edited: tuple[Name, ...] = ()
    """Kept settings for which robot.toml counts, since it was edited after they were set."""
    troubles: tuple[str, ...] = ()
    """What is kept and cannot be used: sentences for people."""


def load_with_kept(path: Path, state: Path) -> Loaded:
    """Read a `robot.toml`, and what is kept for its robot.

    Args:
        path: of the robot.toml.
        state: the host's state folder.

    Raises:
        ConfigError: As `load_config` does; what is kept is no reason.
    """
    robot_toml = read_toml(path)
    config = checked(robot_toml, path)
    file = state / config.robot.name / KEPT_FILE
    try:
        kept = parse(read_file(file), KeptSettings)
    except (FileNotFoundError, NotADirectoryError):
        return Loaded(config)
    except (Unreadable, OSError) as error:
        trouble = f"{file} cannot be read, so what is set there does not count: {reason_of(error)}."
        return Loaded(config, troubles=(trouble,))
    return lay_over(config, robot_toml, kept, file)


def lay_over(
    config: RobotConfig, robot_toml: Mapping[str, Any], kept: KeptSettings, file: Path
) -> Loaded:
    """Put what is kept in place of what `robot.toml` says.

    Args:
        config: what robot.toml says, checked.
        robot_toml: the same as it stands in the file.
        kept: what is kept.
        file: where it is kept.
    """
    counts: dict[str, list[KeptSetting]] = {}
    edited: list[Name] = []
    troubles: list[str] = []
    for one in settings_in(kept):
        name = Name(one.section, one.key)
        if acts(name) == "file":
            troubles.append(f"{file}: {name} is set only in robot.toml, so it does not count.")
        elif was_edited(robot_toml, one):
            edited.append(name)
        else:
            counts.setdefault(one.section, []).append(one)
    for section in counts.values():
        try:  # together first: one may be allowed only with the other
            config = _with_kept(config, section)
        except ConfigError:
            for one in section:
                try:
                    config = _with_kept(config, [one])
                except ConfigError as error:
                    troubles.append(f"{file}: {error}, so it does not count.")
    return Loaded(config, tuple(edited), tuple(dict.fromkeys(troubles)))


def _with_kept(config: RobotConfig, settings: list[KeptSetting]) -> RobotConfig:
    """Put settings of one section in place of others.

    Raises:
        ConfigError: They are not allowed.
    """
    section = settings[0].section
    after = with_values(config, section, {one.key: one.value for one in settings})
    if section == LIMITS:
        for name in (Name(section, one.key) for one in settings):
            if value_of(after, name) > value_of(config, name):
                raise ConfigError(f"{name} is higher than robot.toml allows")
    return msgspec.structs.replace(after, kept=(*config.kept, *settings))


def without_kept(config: RobotConfig) -> RobotConfig:
    """What `robot.toml` alone said."""
    plain = cast("dict[str, Any]", msgspec.to_builtins(config))
    for one in config.kept:
        _put(plain, Name(one.section, one.key), one.instead_of)
    return msgspec.convert({**plain, "kept": ()}, type=RobotConfig)


def settings_in(kept: KeptSettings) -> list[KeptSetting]:
    """The settings of a file, each once."""
    names = dict.fromkeys([*_names_in(kept.set), *_names_in(kept.instead_of)])
    return [
        KeptSetting(
            section=name.section,
            key=name.key,
            value=said_of(kept.set, name),
            instead_of=said_of(kept.instead_of, name),
        )
        for name in names
    ]


def file_of(settings: Iterable[KeptSetting]) -> KeptSettings:
    """The file with these settings."""
    kept = KeptSettings(set={}, instead_of={})
    for one in settings:
        name = Name(one.section, one.key)
        _put(kept.set, name, one.value)
        _put(kept.instead_of, name, one.instead_of)
    return kept


def was_edited(robot_toml: Mapping[str, Any], one: KeptSetting) -> bool:
    """Whether `robot.toml` says something else of a setting than when it was kept, so it counts."""
    return said_of(robot_toml, Name(one.section, one.key)) != one.instead_of


def said_of(tables: Mapping[str, Any], name: Name) -> Any:
    """What stands in nested tables about a setting, None for nothing."""
    found: Any = tables
    for part in _parts_of(name):
        if not isinstance(found, dict):
            return None
        found = cast("dict[str, Any]", found).get(part)
    return found


def _names_in(tables: Mapping[str, Any], section: str = "") -> Iterator[Name]:
    """The settings in nested tables; a value in braces (`pose`) is one of them."""
    for key, value in tables.items():
        if isinstance(value, dict) and acts(Name(section, key)) == "file":
            yield from _names_in(cast("dict[str, Any]", value), f"{section}.{key}".lstrip("."))
        else:
            yield Name(section, key)


def _parts_of(name: Name) -> list[str]:
    return [*filter(None, name.section.split(".")), name.key]


def _put(tables: dict[str, Any], name: Name, value: Any) -> None:
    """Set a value in nested tables; None takes it out."""
    table = tables
    if value is None and said_of(tables, name) is None:
        return
    for part in _parts_of(name)[:-1]:
        table = table.setdefault(part, {})
    if value is None:
        del table[name.key]
    else:
        table[name.key] = value
