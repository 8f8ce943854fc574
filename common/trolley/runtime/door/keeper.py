"""Keeps a door open: listens for other hosts, and starts the process that stands there again.

The listening socket stays here, so nobody is refused while there is a new process.
"""

import re
import socket
from contextlib import ExitStack

from trolley.runtime.log import Log
from trolley.runtime.supervisor import Supervisor
from trolley.runtime.uplink_sockets import UNANSWERED_MS

MODULE = "trolley.runtime.door"
WATCHDOG_S = 5.0
"""A process that has not turned for so long hangs [s]."""
BACKLOG = 4096
LOOPBACK = "127.0.0.1"
ENTRANCES = 16
"""Sockets at which the router listens behind a door: at each it rests after one that failed."""
EVERYWHERE = "::"
"""All addresses, those of IPv4 as well."""
_FAR = re.compile(r"tls/(.+):(\d+)")


class Door:
    """A listening socket for other hosts, and the process that leads them inside.

    Args:
        endpoint: Where other hosts connect to: `tls/0.0.0.0:7448`.

    Raises:
        OSError: The port is taken, or the address is not one of this host.
        ValueError: It is not such an endpoint.
    """

    def __init__(self, endpoint: str) -> None:
        match = _FAR.fullmatch(endpoint)
        if match is None:
            raise ValueError(f"{endpoint!r} must read tls/host:port, and no more")
        host, port = match[1].removeprefix("[").removesuffix("]"), int(match[2])
        family, _, _, _, where = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        self._listener = socket.create_server(
            where, family=family, backlog=BACKLOG, dualstack_ipv6=host == EVERYWHERE
        )
        # What it accepts inherits this.
        self._listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, UNANSWERED_MS)
        with ExitStack() as free:
            found = [
                free.enter_context(socket.create_server((LOOPBACK, 0))) for _ in range(ENTRANCES)
            ]
            self._ports: list[int] = [one.getsockname()[1] for one in found]
        self.inside = [f"tls/{LOOPBACK}:{port}" for port in self._ports]
        """Where the router listens for those who are led in."""
        self._log = Log("door")

    def close(self) -> None:
        """Listen no more."""
        self._listener.close()

    def kept_open(self) -> Supervisor:
        """Return what has a process stand at the door while its context lasts."""
        file = self._listener.fileno()
        return Supervisor(
            {"the door": (MODULE, str(file), LOOPBACK, *map(str, self._ports))},
            {},
            self._log.warning,
            inherits=[file],
            watchdog_s=WATCHDOG_S,
        )
