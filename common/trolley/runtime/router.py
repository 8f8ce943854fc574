"""The router as a process of its own: `trolley router`."""

import signal
import threading
from collections.abc import Mapping, Sequence

from trolley.runtime.log import Log, set_up_logging
from trolley.runtime.supervision import Supervision
from trolley.runtime.zenoh_bus import open_router
from trolley.security.access import Security

LONGEST_WAIT_S = 3600.0


def run_router(
    listen: Sequence[str],
    uplink: Sequence[str] = (),
    security: Security | None = None,
    downsample: Mapping[str, float] | None = None,
) -> None:
    """Be the router until SIGTERM, SIGINT or SIGHUP; logs, and tells systemd when it is ready.

    The arguments are those of `router_config`.

    Raises:
        NotConnected: The port is taken, or the keys cannot be used.
    """
    set_up_logging()
    stop = threading.Event()

    def end(_number: int, _frame: object) -> None:
        stop.set()

    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, end)
    log, supervision = Log("router"), Supervision()
    with open_router(listen, uplink, security, downsample):
        log.info("Listening", at=", ".join(listen), uplink=", ".join(uplink) or "none")
        supervision.ready()
        while not stop.wait(supervision.period_s or LONGEST_WAIT_S):
            supervision.alive()
        supervision.stopping()
