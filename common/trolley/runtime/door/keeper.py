"""Keeps a door open: listens for other hosts, and starts the process that stands there again.

The listening socket stays here, so nobody is refused while there is a new process.
"""

import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Generator
from contextlib import ExitStack, contextmanager, suppress

from trolley.runtime.log import Log
from trolley.runtime.supervision import Watchdog
from trolley.runtime.uplink_sockets import UNANSWERED_MS

MODULE = "trolley.runtime.door"
CHECK_S = 0.1
AGAIN_S = 1.0
"""A process that ended is started again after so long."""
WATCHDOG_S = 5.0
GRACE_S = 2.0
AWAY_S = 2.0
"""If this process did not turn for so long, the other may have stood still as well."""
BACKLOG = 4096
LOOPBACK = "127.0.0.1"
EVERYWHERE = "::"
"""All addresses, those of IPv4 as well."""
_FAR = re.compile(r"tls/(.+):(\d+)")


def is_far(endpoint: str) -> bool:
    """Whether a router listens there for other hosts, behind a door."""
    return endpoint.startswith("tls/")


class Door:
    """A listening socket for other hosts, and the process that leads them inside.

    Args:
        endpoint: Where other hosts connect to: `tls/0.0.0.0:7448`.

    Raises:
        OSError: The port is taken, or the address is not one of this host.
        ValueError: It is no such endpoint.
    """

    def __init__(self, endpoint: str) -> None:
        found = _FAR.fullmatch(endpoint)
        if found is None:
            raise ValueError(f"{endpoint!r} must read tls/host:port, and no more")
        host, port = found[1].removeprefix("[").removesuffix("]"), int(found[2])
        family, _, _, _, where = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        self._listener = socket.create_server(
            where, family=family, backlog=BACKLOG, dualstack_ipv6=host == EVERYWHERE
        )
        # What it accepts inherits this.
        self._listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, UNANSWERED_MS)
        with socket.create_server((LOOPBACK, 0)) as free:
            self._port: int = free.getsockname()[1]
        self.inside = f"tls/{LOOPBACK}:{self._port}"
        """Where the router listens for those who are led in."""
        self._log = Log("door")

    def close(self) -> None:
        """Listen no more."""
        self._listener.close()

    @contextmanager
    def kept_open(self) -> Generator[None]:
        """Have a process stand at the door while the context lasts."""
        end = threading.Event()
        keeper = threading.Thread(target=self._keep, args=(end,), name="door", daemon=True)
        keeper.start()
        try:
            yield
        finally:
            end.set()
            keeper.join()

    def _keep(self, end: threading.Event) -> None:
        with ExitStack() as stack:
            watchdog = Watchdog(WATCHDOG_S)
            stack.callback(watchdog.close)
            process: subprocess.Popen[bytes] | None = None
            due_s = turned_s = time.monotonic()
            while True:
                now_s = time.monotonic()
                was_away, turned_s = now_s - turned_s > AWAY_S, now_s
                if process is not None and process.poll() is not None:
                    self._log.warning("The door has closed; opening it again", code=process.poll())
                    process, due_s = None, now_s + AGAIN_S
                if process is None and now_s >= due_s:
                    watchdog.begin()
                    process = self._start(watchdog)
                    due_s = now_s + AGAIN_S
                elif was_away:
                    watchdog.pardon(now_s)
                elif process is not None and watchdog.is_silent(now_s):
                    self._log.warning("The door hangs")
                    process.kill()
                if end.wait(CHECK_S):
                    break
            if process is not None:
                _end(process)

    def _start(self, watchdog: Watchdog) -> subprocess.Popen[bytes] | None:
        file = self._listener.fileno()
        command = [sys.executable, "-m", MODULE, str(file), LOOPBACK, str(self._port)]
        try:
            # It ends when its standard input is closed, as it is when this process has died.
            # A group of its own: Ctrl-C is not for it.
            return subprocess.Popen(
                command,
                env={**os.environ, **watchdog.environment},
                stdin=subprocess.PIPE,
                pass_fds=[file],
                process_group=0,
            )
        except OSError as problem:
            self._log.limited("start", "The door cannot be opened", why=problem.strerror)
            return None


def _end(process: subprocess.Popen[bytes]) -> None:
    with process:
        process.send_signal(signal.SIGTERM)
        with suppress(subprocess.TimeoutExpired):
            process.wait(GRACE_S)
        process.kill()
