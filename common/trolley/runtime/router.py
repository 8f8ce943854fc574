"""The router as a process of its own: `trolley router`."""

import signal
import time
from collections.abc import Mapping, Sequence

from trolley.interrupts import Interrupts
from trolley.runtime.endpoints import is_far
from trolley.runtime.log import Log, set_up_logging
from trolley.runtime.zenoh_bus import open_router, takes_new_sessions
from trolley.security.access import Security
from trolley.supervision import Supervision

UNWATCHED_PERIOD_S = 60.0
"""How often new sessions are tried where nobody restarts a router that takes none."""
SLICE_S = 0.5


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
    asked: list[int] = []

    def end(number: int, _frame: object) -> None:
        asked.append(number)

    for number in Interrupts.ENDING:
        signal.signal(number, end)
    log, supervision = Log("router"), Supervision()
    with open_router(listen, uplink, security, downsample):
        log.info("Listening", at=", ".join(listen), uplink=", ".join(uplink) or "none")
        supervision.ready()
        near = [one for one in listen if not is_far(one)]
        period_s = supervision.period_s or UNWATCHED_PERIOD_S
        due_s = time.monotonic()
        while not asked:
            # In slices: a signal that the kernel gives to a thread of Zenoh's wakes nobody here.
            time.sleep(min(SLICE_S, period_s))
            if time.monotonic() < due_s:
                continue
            due_s = time.monotonic() + period_s
            if takes_new_sessions(near, period_s):
                supervision.alive()
            else:
                log.limited("session", "A program that starts now gets no new session", at=near[0])
        supervision.stopping()
