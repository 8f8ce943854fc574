"""What a router is started with: its own keys, and what each certificate it lets in may do."""

import dataclasses
from collections.abc import Mapping
from typing import Any

from trolley.files import read_file
from trolley.security.host_keys import HostKeys, KeysError


@dataclasses.dataclass(frozen=True)
class Security:
    """How a router shows who it is, and whom it lets do what."""

    keys: HostKeys
    access_control: Mapping[str, Any] | None
    """In Zenoh's words; None: it lets nobody in but its own host's programs."""

    @property
    def allowed(self) -> frozenset[str]:
        """The common names of the certificates that it lets in."""
        subjects = [] if self.access_control is None else self.access_control["subjects"]
        return frozenset(name for one in subjects for name in one.get("cert_common_names", ()))


def security_of(keys: HostKeys) -> Security:
    """What the router with these keys goes by, read at each of its starts.

    Raises:
        KeysError: The list of those who are let in cannot be read.
    """
    if not keys.is_router:
        return Security(keys, None)
    # Not at the top: a robot's router lets nobody in, and need not read certificates.
    from trolley.security.certificates import parse_certificates
    from trolley.security.roles import access_control

    try:
        content = read_file(keys.allowed)
    except OSError as error:
        raise KeysError(f"{keys.allowed}: {error.strerror}") from error
    return Security(keys, access_control(parse_certificates(content, keys.allowed)))
