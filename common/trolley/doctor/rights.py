"""Checks of who may read and write what: configuration, state, secrets."""

import dataclasses
import itertools
import stat
from collections.abc import Sequence
from pathlib import Path

from trolley.config import HostConfig
from trolley.doctor.finding import Finding, ok, problem, warning
from trolley.doctor.users import (
    ENTER,
    READ,
    WRITE,
    User,
    closed_at,
    group_name,
    may,
    rights_in_words,
)

MOST_FILES = 5000


@dataclasses.dataclass(frozen=True)
class Access:
    """What the user of the services may not do."""

    user: str
    group: str
    """Its own group."""
    config_closed: str = ""
    """What keeps it from reading robot.toml, with its rights; "" if nothing does."""
    state: str = ""
    """The state folder."""
    state_closed: str = ""
    """What keeps it from writing there."""
    foreign: tuple[str, ...] = ()
    """Files of the state that it may not write."""
    key_closed: str = ""
    """What keeps it from reading this host's private key."""


def read_access(user: User, config: Path | None, state: Path, key: Path | None = None) -> Access:
    """Look at the rights of configuration, state, and the private key where there is one.

    Raises:
        OSError: You may not even look.
    """
    closed = None if config is None or not config.exists() else closed_at(user, config, READ)
    key_closed = None if key is None or not key.exists() else closed_at(user, key, READ)
    there = next(one for one in (state, *state.absolute().parents) if one.exists())
    state_closed = closed_at(user, there, READ | WRITE | ENTER)
    foreign: list[str] = []
    if there == state and state_closed is None:
        for path in itertools.islice(state.rglob("*"), MOST_FILES):
            wanted = READ | WRITE | ENTER if path.is_dir() else READ | WRITE
            if not path.is_symlink() and not may(user, path.stat(), wanted):
                foreign.append(str(path))
    return Access(
        user.name,
        group_name(user.group),
        "" if closed is None else f"{closed}: {rights_in_words(closed)}",
        str(state),
        "" if state_closed is None else f"{state_closed}: {rights_in_words(state_closed)}",
        tuple(foreign),
        "" if key_closed is None else f"{key_closed}: {rights_in_words(key_closed)}",
    )


def check_access(facts: Access) -> list[Finding]:
    """Whether the services can read their settings and save what is theirs."""
    found: list[Finding] = []
    if facts.config_closed:
        found.append(
            problem(
                "permissions",
                f"{facts.user} may not read robot.toml ({facts.config_closed}).",
                f"`sudo chgrp {facts.group}` and `sudo chmod g+r` that file; a folder: "
                "`sudo chmod a+rx`.",
            )
        )
    if facts.key_closed:
        found.append(
            problem(
                "permissions",
                f"{facts.user} may not read this computer's private key ({facts.key_closed}).",
                f"`sudo chown {facts.user}` that file.",
            )
        )
    if facts.state_closed:
        found.append(
            problem(
                "permissions",
                f"{facts.user} cannot save anything in {facts.state} ({facts.state_closed}).",
                f"`sudo mkdir -p {facts.state}; sudo chown -R {facts.user} {facts.state}`",
            )
        )
    if facts.foreign:
        found.append(
            problem(
                "permissions",
                f"{facts.user} may not write {len(facts.foreign)} of its own files, such as "
                f"{facts.foreign[0]}.",
                f"`sudo chown -R {facts.user} {facts.state}` (was a service started as root?)",
            )
        )
    return found or [
        ok("permissions", f"{facts.user} can read its settings and save in {facts.state}.")
    ]


def named_secrets(config: HostConfig) -> list[Path]:
    """Files with secrets that robot.toml names, and itself where an address in it may be one."""
    named = (config.mqtt.password_file, config.webhook.token_file)
    found = [config.path(one) for one in named if one]
    return [*found, Path(config.file)] if config.webhook.urls else found


def check_secrets(files: Sequence[Path], user: User) -> list[Finding]:
    """Whether others than the services' user and its own group can read what is secret."""
    there = [(path, path.stat()) for path in files if path.exists()]
    open_ones = [
        path
        for path, status in there
        if status.st_mode & stat.S_IRWXO
        or (status.st_mode & stat.S_IRWXG and status.st_gid != user.group)
    ]
    if open_ones:
        return [
            warning(
                "permissions",
                f"Others can read the secret file {path}.",
                f"`sudo chgrp {group_name(user.group)} {path}; sudo chmod 640 {path}`; make a new "
                "secret if somebody may have copied it.",
            )
            for path in open_ones
        ]
    return [ok("permissions", f"{len(there)} secret files are closed to others.")] if there else []
