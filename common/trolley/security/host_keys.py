"""The folder with a host's certificate: where its files lie and what they mean."""

import dataclasses
from collections.abc import Iterable
from pathlib import Path

from trolley.files import open_file

DEFAULT_FOLDER = Path("/etc/trolley/keys")
AUTHORITY, CERTIFICATE, KEY, ALLOWED = "ca.pem", "cert.pem", "key.pem", "allowed.pem"


class KeysError(Exception):
    """Certificates are missing, unusable or already there; the text says what to do."""


@dataclasses.dataclass(frozen=True)
class HostKeys:
    """A folder that `trolley keys` made for one host."""

    folder: Path

    @property
    def authority(self) -> Path:
        """The certificate of the family's authority, which signed all others."""
        return self.folder / AUTHORITY

    @property
    def certificate(self) -> Path:
        """This host's certificate: its role and name."""
        return self.folder / CERTIFICATE

    @property
    def key(self) -> Path:
        """The private key that belongs to it."""
        return self.folder / KEY

    @property
    def allowed(self) -> Path:
        """The certificates that a router lets in; only routers have it."""
        return self.folder / ALLOWED

    @property
    def is_router(self) -> bool:
        """Whether other hosts may connect to the router of this one."""
        return self.allowed.exists()


def find_keys(folder: Path) -> HostKeys | None:
    """The keys in a folder, None where there is no such folder.

    Raises:
        KeysError: Only some of them are there, or they may not be read.
    """
    keys = HostKeys(folder.absolute())
    needed = (keys.authority, keys.certificate, keys.key)
    try:
        if not folder.exists():
            return None
        for path in needed:
            with open_file(path):
                pass
    except OSError as error:
        raise KeysError(
            f"{error.filename}: {error.strerror}; this folder holds {AUTHORITY}, {CERTIFICATE} "
            f"and {KEY} as `trolley keys` made them, readable by the user that runs Trolley"
        ) from error
    return keys


def keys_for(endpoints: Iterable[str], folder: Path) -> HostKeys | None:
    """The keys in a folder where an endpoint needs some.

    Raises:
        KeysError: They are missing or cannot be used.
    """
    if not any(endpoint.startswith("tls/") for endpoint in endpoints):
        return None
    keys = find_keys(folder)
    if keys is None:
        raise KeysError(
            f"a tls/ endpoint needs this host's keys in {folder}: `trolley keys` makes them"
        )
    return keys
