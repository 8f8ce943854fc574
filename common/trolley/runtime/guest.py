"""A service on a thread of a program that is not a service: for as long as the program lasts.

Several may run at once, on any host. Each has a name of its own in `health` and among the tokens.
"""

import os
import threading
import time
from collections.abc import Generator, Sequence
from contextlib import contextmanager

from trolley import topics
from trolley.runtime.clash import Run, host_name
from trolley.runtime.log import Log
from trolley.runtime.node import Node
from trolley.runtime.process import CRASH, EXIT_CRASHED, LONGEST_WAIT_S, ProcessHost
from trolley.runtime.service import Service
from trolley.runtime.zenoh_bus import open_bus
from trolley.security.host_keys import HostKeys
from trolley.start import leave


@contextmanager
def guest(
    service: Service,
    robot: str,
    endpoints: Sequence[str],
    keys: HostKeys | None = None,
    connect_timeout_s: float = 5.0,
) -> Generator[None]:
    """Run a service while the context lasts; an error of it ends the program.

    Raises:
        NotConnected: No router answers.
    """
    label = f"{service.name}-{host_name()}-{os.getpid()}"
    run, log = Run.here(), Log(service.name)
    with open_bus(endpoints, connect_timeout_s, keys) as bus:
        node = Node(service, robot, bus, ProcessHost(robot, log), label, str(run))
        bus.declare_token(topics.ALIVE.key(robot, label, str(run)))
        bus.on_connection(lambda is_up: node.reconnected() if is_up else None)
        node.open()
        should_end = threading.Event()

        def loop() -> None:
            try:
                while not should_end.is_set():
                    node.step()
                    wait_s = (node.next_due_ns() - time.monotonic_ns()) * 1e-9
                    node.inbox.wait(min(max(wait_s, 0.0), LONGEST_WAIT_S))
            except Exception:
                log.crash(CRASH)
                leave("", EXIT_CRASHED)

        thread = threading.Thread(target=loop, name=service.name, daemon=True)
        thread.start()
        try:
            yield
        finally:
            should_end.set()
            node.inbox.wake()
            thread.join()
            node.close()
