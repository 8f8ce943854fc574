"""As whom the services run, and what that user may do with files."""

import dataclasses
import grp
import os
import pwd
import stat
from pathlib import Path

READ, WRITE, ENTER = 4, 2, 1


@dataclasses.dataclass(frozen=True)
class User:
    """A user of this system."""

    name: str
    uid: int
    group: int
    groups: frozenset[int]


def this_user() -> User:
    """Who runs this program."""
    uid = os.geteuid()
    try:
        name = pwd.getpwuid(uid).pw_name
    except KeyError:  # a container may run as a number without a name
        name = str(uid)
    return User(name, uid, os.getegid(), frozenset({os.getegid(), *os.getgroups()}))


def find_user(name: str) -> User | None:
    """A user of that name with the groups that its services get; None if there is none."""
    try:
        entry = pwd.getpwnam(name)
    except KeyError:
        return None
    return User(name, entry.pw_uid, entry.pw_gid, frozenset(os.getgrouplist(name, entry.pw_gid)))


def with_groups(user: User, names: list[str]) -> User:
    """The user as a unit's `SupplementaryGroups` runs it."""
    more = {entry.gr_gid for entry in grp.getgrall() if entry.gr_name in names}
    return dataclasses.replace(user, groups=user.groups | more)


def may(user: User, status: os.stat_result, wanted: int) -> bool:
    """Whether a file's rights let a user read, write or enter it."""
    if user.uid == 0:
        return True
    shift = 6 if user.uid == status.st_uid else 3 if status.st_gid in user.groups else 0
    return (status.st_mode >> shift) & wanted == wanted


def closed_at(user: User, path: Path, wanted: int) -> Path | None:
    """The file, or the folder on the way to it, that keeps a user out; None if nothing does.

    Raises:
        OSError: It is not there, or cannot be looked at.
    """
    path = path.resolve(strict=True)
    for folder in reversed(path.parents):
        if not may(user, folder.stat(), ENTER):
            return folder
    return None if may(user, path.stat(), wanted) else path


def rights_in_words(path: Path) -> str:
    """Owner, group and rights of a file, such as `root:dialout -rw-rw----`."""
    status = path.stat()
    try:
        owner = pwd.getpwuid(status.st_uid).pw_name
    except KeyError:
        owner = str(status.st_uid)
    return f"{owner}:{group_name(status.st_gid)} {stat.filemode(status.st_mode)}"


def group_name(group: int) -> str:
    """A group's name, or its number where it has none."""
    try:
        return grp.getgrgid(group).gr_name
    except KeyError:
        return str(group)
