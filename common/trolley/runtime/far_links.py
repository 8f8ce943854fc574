"""What a router makes of its links with other hosts: what it logs, and which must end."""

import time
from collections.abc import Callable, Collection, Sequence
from contextlib import AbstractContextManager

from trolley.runtime.log import Log
from trolley.runtime.uplink_sockets import FarLink, far_ports, hang_up, looked_after

PATIENCE_S = 10.0
"""A home router that has been away for so long is worth a line."""
LASTING_S = 2.0
"""A link that lasts so long was not only accepted to be ended."""


class FarLinks:
    """Logs when the home router is there or has been away for a while, and who is not let in.

    Args:
        uplink: The home routers that this one links itself to.
        allowed: The common names of the certificates that it lets in.
        log: The router's.
        now_s: When it began.
    """

    def __init__(
        self, uplink: Sequence[str], allowed: Collection[str], log: Log, now_s: float
    ) -> None:
        self._uplink, self._ports = uplink, far_ports(uplink)
        self._allowed = allowed
        self._strangers: set[str] = set()
        self._log = log
        self._is_linked: bool | None = None
        """What was logged last."""
        self._absent_s = self._linked_s = now_s
        """When it was last without a link, and when it last had one that lasts."""

    def update(self, links: Collection[FarLink], now_s: float) -> list[FarLink]:
        """Take in which links there are now; return those that have to end.

        TLS takes every certificate of the family's authority, a revoked one, too. It may do
        nothing, but would keep a place.
        """
        homes = [one.certificate for one in links if one.port in self._ports]
        if not homes:
            self._absent_s = now_s
        if now_s - self._absent_s >= LASTING_S:
            self._linked_s = now_s
            if not self._is_linked:
                self._is_linked = True
                self._log.info("Linked to the home router", certificate=", ".join(homes))
        elif self._ports and now_s - self._linked_s >= PATIENCE_S and self._is_linked is not False:
            self._is_linked = False
            self._log.warning(
                "No link to the home router: `trolley doctor` says why", at=", ".join(self._uplink)
            )
        strangers = [
            one
            for one in links
            if one.port not in self._ports and one.certificate not in self._allowed
        ]
        for name in {one.certificate for one in strangers} - self._strangers:
            self._strangers.add(name)
            self._log.warning("A host that is not in allowed.pem is sent away", certificate=name)
        return strangers


def watched(links: Callable[[], list[FarLink]], far: FarLinks) -> AbstractContextManager[None]:
    """While the context lasts, look after the links of this process's router."""
    return looked_after(lambda: hang_up(far.update(links(), time.monotonic())))
