"""Settings while the robot runs: answers what they are, checks and saves what is set."""

import json
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
from msgspec import Struct

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.config import ConfigError, RobotConfig
from trolley.config.changeable_settings import (
    LIMITS,
    Name,
    acts,
    all_keys,
    describe,
    value_of,
    with_changes,
    with_values,
)
from trolley.config.kept_settings import KEPT_FILE, KeptSettings, settings_in, without_kept
from trolley.messages import ChangedSetting, ConfigChanges, Setting, Settings
from trolley.messages.request_params import SetConfig, WhichConfig
from trolley.names import name_problem
from trolley.runtime.service import Later, Service, answers
from trolley.suggestions import did_you_mean
from trolley_base.settings_file import NO_FILE, NOT_ASKED, Saved, SettingsFiles

START_POSE = Name("start", "pose")
MOST_SAVING = 4
"""A stop waits until its latch is saved: no flood of changes may stand before it."""
MOST_SHOWN = 40
"""Number of characters of a refused value that the refusal repeats."""
SETTINGS_FILE = "base_settings.toml"


class SavedSetting(Struct, frozen=True, kw_only=True):
    """A setting that was set over the wire, and what people had written before."""

    section: str
    key: str
    value: bool | int | float | str
    written: bool | int | float | str


class SavedSettings(Struct, frozen=True, kw_only=True):
    """The file `base_settings.toml`.

    An entry counts while the settings' file still says the same. It tells services that
    have run on since before base was restarted, or on another host with a file of its own.
    """

    settings: list[SavedSetting]


class SettingsKeeper:
    """Owns what `robot.toml` and the wire together say.

    Args:
        service: base.
        config: what its file said when it started.
        use: lets base itself run with other settings.
    """

    def __init__(
        self, service: Service, config: RobotConfig, use: Callable[[RobotConfig], None]
    ) -> None:
        self._service = service
        self._use = use
        self._started = self._config = self._next = self._filed = config
        # Of these: what base started with, what the robot runs with, what it will run with after a
        # restart, and what the files say.
        self._people = without_kept(config)  # what robot.toml said when base started
        self._kept = {Name(one.section, one.key) for one in config.kept}  # in the state folder
        self._files: SettingsFiles | None = None
        self._set: dict[Name, SavedSetting] = {}
        self._num_saving = 0

    def start(self) -> None:
        """Tell what was set before, as far as it still counts."""
        found = self._service.state.read(KEPT_FILE, KeptSettings) if self._config.file else None
        kept = [] if found is None else settings_in(found)
        edited = {Name(one.section, one.key) for one in kept} - self._kept
        saved = self._service.state.read(SETTINGS_FILE, SavedSettings)
        for one in [] if saved is None else saved.settings:
            name = Name(one.section, one.key)
            still = value_of(self._config, name) == one.value and name not in edited
            if acts(name) == "at_once" and still:
                self._set[name] = one
        for name in sorted(self._kept - self._set.keys()):
            if acts(name) == "at_once":
                self._note(name)
        if self._config.file:
            path, state = Path(self._config.file), self._service.state
            self._files = SettingsFiles(path, self._people, state, kept)
            if kept:
                self._service.work(self._files.drop_edited, self._say_not_saved)
        self._publish()

    @answers(requests.CONFIG_GET)
    def tell(self, params: WhichConfig) -> Settings:
        """Tell what the settings are."""
        names = [
            name
            for name in all_keys()
            if params.section in (None, name.section) and params.key in (None, name.key)
        ]
        if not names:
            raise Refused(codes.UNKNOWN_NAME, _unknown(params.section, params.key))
        return Settings(settings=[self._describe(name) for name in names], file=self._config.file)

    @answers(requests.CONFIG_SET)
    def set(self, params: SetConfig) -> Later[Settings]:
        """Check, save and use other values of one section's settings; a bad one changes nothing."""
        self._check(params)
        if self._num_saving >= MOST_SAVING:
            raise Refused(codes.BUSY, "Other changes are still being saved; try again.")
        later: Later[Settings] = self._service.later()
        if self._files is None or not params.save:
            self._finish(params, later, NO_FILE if self._files is None else NOT_ASKED)
            return later
        self._num_saving += 1
        job = partial(self._files.save, params.section, params.values)
        self._service.work(job, partial(self._saved, params, later))
        return later

    # Inside.
    def _check(self, params: SetConfig) -> None:
        """Refuse what is not a setting, may not be set here, or is not allowed.

        Raises:
            Refused: saying why.
        """
        if not params.values:
            raise Refused(codes.BAD_REQUEST, "Say which setting is to have which value.")
        for key in params.values:
            name = Name(params.section, key)
            if name not in all_keys():
                raise Refused(codes.UNKNOWN_NAME, _unknown(*name))
            if acts(name) == "file":
                raise Refused(
                    codes.ONLY_IN_FILE,
                    f"{name} can only be changed in robot.toml itself, on the robot.",
                )
        try:
            after = with_values(self._next, params.section, params.values)
        except ConfigError as error:
            sentence = self._not_allowed(params) or str(error)
            raise Refused(codes.BAD_REQUEST, sentence) from error
        start = value_of(after, START_POSE)
        if params.section == START_POSE.section and isinstance(start, str):
            problem = name_problem(start)
            if problem is not None:
                raise Refused(codes.BAD_REQUEST, f"{START_POSE} names no place: {problem}.")
        if params.section == LIMITS:
            for key in params.values:
                self._check_limit(Name(LIMITS, key), after)

    def _not_allowed(self, params: SetConfig) -> str | None:
        """Say which value is not allowed and what is, None where they only do not go together."""
        for key, value in params.values.items():
            try:
                with_values(self._next, params.section, {key: value})
            except ConfigError:
                name = Name(params.section, key)
                allowed = all_keys()[name].allowed.replace("`", "")
                return f"{name} cannot be {_in_short(value)}. Allowed: {allowed}."
        return None

    def _check_limit(self, name: Name, after: RobotConfig) -> None:
        """Refuse a limit that is higher than people wrote for this robot.

        Raises:
            Refused: saying what is.
        """
        most = self._written(name)
        if value_of(after, name) > most:
            raise Refused(
                codes.BAD_REQUEST,
                f"{name} may be at most {most:g}, as robot.toml said for this robot; to raise it, "
                "edit the file and restart base.",
            )

    def _saved(self, params: SetConfig, later: Later[Settings], saved: Saved | Refused) -> None:
        self._num_saving -= 1
        self._finish(params, later, saved)

    def _finish(self, params: SetConfig, later: Later[Settings], saved: Saved | Refused) -> None:
        """Use what was saved, or could not be: then it counts until base is restarted."""
        if isinstance(saved, Refused):
            later.refuse(saved)
            return
        section, names = params.section, [Name(params.section, key) for key in params.values]
        waiting = [name for name in names if acts(name) == "restart"]
        if waiting and not saved.is_saved:
            why = f"{waiting[0]} counts only after a restart, and cannot be saved: {saved.why}."
            later.refuse(Refused(codes.NOT_SAVED, why))
            return
        try:
            after = with_values(self._next, section, params.values)
        except ConfigError as error:  # with what was set while this was being saved
            later.refuse(Refused(codes.BAD_REQUEST, str(error)))
            return
        self._next = after
        if saved.is_saved:
            self._filed = with_values(self._filed, section, params.values)
            self._kept.difference_update(names)
            self._kept.update(Name(section, key) for key in saved.kept)
        for name in names:
            if acts(name) == "at_once":
                self._note(name)
        self._config, _ = with_changes(self._started, self._changes())
        self._service.log.info("Settings changed", section=section, **_plain(self._next, names))
        self._use(self._config)
        self._publish()
        if saved.is_saved:
            self._keep()
        settings = [self._describe(name) for name in names]
        message = _message(settings, self._where(saved))
        later.reply(Settings(settings=settings, file=self._config.file, message=message))

    def _where(self, saved: Saved) -> str:
        """Say in a sentence where settings were saved, or why they were not."""
        if self._files is None or not saved.is_saved:
            return f"Not saved, so only until base is restarted: {saved.why}."
        if saved.is_written:
            return f"Saved in {self._config.file}."
        if not saved.kept:
            return "That is what robot.toml says."
        return (
            f"Saved in {self._files.keeps}, since {saved.why}. If you edit it in robot.toml later, "
            "that counts."
        )

    def _say_not_saved(self, error: OSError | None) -> None:
        if error is not None:
            self._service.log.warning("Not saved", file=KEPT_FILE, why=error.strerror)

    def _note(self, name: Name) -> None:
        """Note that a setting counts at once."""
        self._set[name] = SavedSetting(
            section=name.section,
            key=name.key,
            value=value_of(self._next, name),
            written=self._written(name),
        )

    def _written(self, name: Name) -> Any:
        """What people wrote, before it was set over the wire for the first time."""
        before = self._set.get(name)
        return value_of(self._people, name) if before is None else before.written

    def _changes(self) -> list[ChangedSetting]:
        """What counts at once. A limit higher than base started with waits for its restart."""
        return [
            ChangedSetting(
                section=name.section,
                key=name.key,
                value=min(one.value, value_of(self._started, name))  # limits are numbers
                if name.section == LIMITS
                else one.value,
                saved=self._is_saved(name),
            )
            for name, one in self._set.items()
        ]

    def _is_saved(self, name: Name) -> bool:
        return value_of(self._filed, name) == value_of(self._next, name)

    def _describe(self, name: Name) -> Setting:
        is_saved, is_kept = self._is_saved(name), name in self._kept
        return describe(name, self._config, self._next, is_saved=is_saved, is_kept=is_kept)

    def _publish(self) -> None:
        changes = ConfigChanges(stamp_ns=self._service.stamp_ns, changes=self._changes())
        self._service.publish(topics.CONFIG, changes)

    def _keep(self) -> None:
        """Save what the file says because it was set over the wire."""
        kept = [one for name, one in self._set.items() if self._is_saved(name)]
        self._service.save(SETTINGS_FILE, SavedSettings(settings=kept))


def _in_short(value: Any) -> str:
    """Return a value as people write it, if it is not too long for a sentence."""
    # msgspec writes null for NaN.
    text = json.dumps(msgspec.to_builtins(value), ensure_ascii=False)
    return text if len(text) <= MOST_SHOWN else f"{text[:MOST_SHOWN]} …"


def _plain(config: RobotConfig, names: list[Name]) -> Mapping[str, Any]:
    return {name.key: str(value_of(config, name)) for name in names}


def _unknown(section: str | None, key: str | None) -> str:
    """Say what there is in place of a setting that there is not."""
    known = [name for name in all_keys() if name.section == section]
    if known and key is not None:
        hint = did_you_mean(key, [name.key for name in known])
        return f"[{section}] has no setting {key!r}. {hint}"
    if section is None:
        return f"There is no setting {key!r}."
    names = dict.fromkeys(name.section for name in all_keys())
    return f"There is no section {section!r}. {did_you_mean(section, list(names))}"


def _message(settings: list[Setting], where: str) -> str:
    """Say in a sentence or two when settings count, and where they are saved."""
    services = sorted({one.service for one in settings if one.value != one.next})
    at_once = any(one.value == one.next for one in settings)
    said = ["It counts at once."] if at_once else []
    said += [f"It counts after a restart of the {name}." for name in services]
    return " ".join([*said, where])
