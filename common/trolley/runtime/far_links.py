"""What a router logs of its links with other hosts."""

import dataclasses
from collections.abc import Collection, Sequence

from trolley.runtime.log import Log
from trolley.runtime.uplink_sockets import far_ports

PATIENCE_S = 10.0
"""A home router that has been away for so long is worth a line."""


@dataclasses.dataclass(frozen=True)
class FarLink:
    """A link over TLS."""

    port: int
    """At the other end."""
    certificate: str
    """The common name of the other end's certificate."""


class FarLinks:
    """Logs when the home router is there, and when it has not been for a while.

    Args:
        uplink: The home routers that this one links itself to.
        log: The router's.
        now_s: When it began.
    """

    def __init__(self, uplink: Sequence[str], log: Log, now_s: float) -> None:
        self._uplink, self._ports = uplink, far_ports(uplink)
        self._log = log
        self._is_linked = False
        self._since_s = now_s
        self._is_told = False

    def update(self, links: Collection[FarLink], now_s: float) -> None:
        """Take in which links there are now."""
        homes = [one.certificate for one in links if one.port in self._ports]
        if bool(homes) != self._is_linked:
            self._is_linked, self._since_s, self._is_told = bool(homes), now_s, False
            if homes:
                self._log.info("Linked to the home router", certificate=", ".join(homes))
        is_late = self._ports and not homes and now_s - self._since_s >= PATIENCE_S
        if is_late and not self._is_told:
            self._is_told = True
            self._log.warning(
                "No link to the home router: `trolley doctor` says why", at=", ".join(self._uplink)
            )
