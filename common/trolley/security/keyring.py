"""The folder in which a family keeps its authority and the keys of all its hosts.

One folder each, named `<role>-<name>`, ready to be copied to its host. A router's folder also holds
the certificates that it lets in.
"""

import contextlib
import dataclasses
import shutil
from collections.abc import Generator, Sequence
from datetime import datetime
from pathlib import Path

from trolley.files import READABLE_BY_ALL, SECRET, read_file, write_atomically
from trolley.security.certificates import (
    Certificate,
    Pair,
    Role,
    check_name,
    make_authority,
    make_certificate,
    read_certificates,
)
from trolley.security.host_keys import ALLOWED, AUTHORITY, HostKeys, KeysError

AUTHORITY_KEY = "ca.key"


@dataclasses.dataclass(frozen=True)
class Keyring:
    """The family's keys in `folder`."""

    folder: Path

    def host(self, role: Role, name: str) -> HostKeys:
        """The folder for one host."""
        return HostKeys(self.folder / f"{role}-{check_name(name)}")

    def create(self, now: datetime) -> None:
        """Make the authority.

        Raises:
            KeysError: It is there already, or cannot be written.
        """
        if (self.folder / AUTHORITY).exists() or (self.folder / AUTHORITY_KEY).exists():
            raise KeysError(
                f"{self.folder} already holds an authority; not overwritten: a new one would lock "
                "out every host"
            )
        pair = make_authority(now)
        with _reported(self.folder):
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            write_atomically(self.folder / AUTHORITY_KEY, pair.key, SECRET)
            write_atomically(self.folder / AUTHORITY, pair.certificate, READABLE_BY_ALL)

    def issue(
        self, role: Role, name: str, until: datetime, hosts: Sequence[str] = (), *, replace: bool
    ) -> HostKeys:
        """Make a host's keys, and have every router of this folder accept them.

        Raises:
            KeysError: They are there and are not to be replaced, or something cannot be done.
        """
        keys = self.host(role, name)
        if keys.folder.exists() and not replace:
            raise KeysError(
                f"{keys.folder} already exists; --replace makes new keys, and the old ones stop "
                "working"
            )
        authority = self._authority()
        pair = make_certificate(authority, role, name, hosts, until)
        new = HostKeys(self.folder / f".{role}-{name}.new")
        old = self.folder / f".{role}-{name}.old"
        with _reported(self.folder):
            for left in (new.folder, old):  # by an earlier run that was killed
                shutil.rmtree(left, ignore_errors=True)
            new.folder.mkdir(mode=0o700)
            write_atomically(new.authority, authority.certificate, READABLE_BY_ALL)
            write_atomically(new.certificate, pair.certificate, READABLE_BY_ALL)
            write_atomically(new.key, pair.key, SECRET)
            if role == "router":
                write_atomically(new.allowed, b"", READABLE_BY_ALL)
            if keys.folder.exists():
                keys.folder.rename(old)
            new.folder.rename(keys.folder)
            shutil.rmtree(old, ignore_errors=True)
        self._tell_routers()
        return keys

    def remove(self, role: Role, name: str) -> None:
        """Revoke a host's certificate.

        Raises:
            KeysError: There is none of that name, or its folder cannot be removed.
        """
        keys = self.host(role, name)
        if not keys.folder.exists():
            raise KeysError(f"there are no keys of {role} {name} in {self.folder}")
        with _reported(keys.folder):
            shutil.rmtree(keys.folder)
        self._tell_routers()

    def certificates(self) -> list[Certificate]:
        """Every host's certificate, by role and name.

        Raises:
            KeysError: One cannot be read.
        """
        folders = [path.parent for path in self.folder.glob(f"[!.]*/{AUTHORITY}")]
        found = [
            one
            for folder in folders
            for one in read_certificates(folder)
            if one.path == HostKeys(folder).certificate
        ]
        return sorted(found, key=lambda one: (one.role, one.name))

    def authority(self) -> Certificate:
        """The authority's own certificate.

        Raises:
            KeysError: There is none yet.
        """
        self._authority()
        return next(one for one in read_certificates(self.folder) if one.path.name == AUTHORITY)

    def _authority(self) -> Pair:
        try:
            return Pair(read_file(self.folder / AUTHORITY), read_file(self.folder / AUTHORITY_KEY))
        except FileNotFoundError as error:
            raise KeysError(
                f"there is no authority in {self.folder}: start with `trolley keys init`"
            ) from error
        except OSError as error:
            raise KeysError(f"{error.filename}: {error.strerror}") from error

    def _tell_routers(self) -> None:
        """Write the accepted certificates into every router's folder."""
        certificates = self.certificates()
        content = b"".join(read_file(one.path) for one in certificates)
        for one in certificates:
            if one.role == "router":
                folder = one.path.parent
                with _reported(folder):
                    write_atomically(folder / ALLOWED, content, READABLE_BY_ALL)


@contextlib.contextmanager
def _reported(folder: Path) -> Generator[None]:
    try:
        yield
    except OSError as error:
        raise KeysError(f"{error.filename or folder}: {error.strerror}") from error
