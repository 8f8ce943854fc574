"""Checks of who may read and write what: configuration, state, secrets."""

import dataclasses
import itertools
import stat
from pathlib import Path

from trolley.doctor.finding import Finding, ok, problem, warning
from trolley.doctor.users import ENTER, READ, WRITE, User, closed_at, may, rights_in_words

MOST_FILES = 5000
OTHERS = stat.S_IRWXG | stat.S_IRWXO


@dataclasses.dataclass(frozen=True)
class Access:
    """What the user of the services may not do."""

    user: str
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
                "`sudo chmod a+r` that file (a+rx where it is a folder).",
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


def check_secrets(files: list[tuple[str, int]]) -> list[Finding]:
    """Whether others can read what is secret; `files` are paths with their modes."""
    open_ones = [path for path, mode in files if mode & OTHERS]
    if open_ones:
        return [
            warning(
                "permissions",
                f"Others can read the secret file {path}.",
                f"`sudo chmod 600 {path}`; make a new one if somebody may have copied it.",
            )
            for path in open_ones
        ]
    return [ok("permissions", f"{len(files)} secret files are closed to others.")] if files else []
