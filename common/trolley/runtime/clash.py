"""The clash rule: of two processes of one service, the older one stays.

Each shows a liveliness token that names host, process and start, and reads those of the others of
its name; who has seen an older one ends.
"""

import dataclasses
import os
import re
import socket
import threading
import time
from collections.abc import Callable

from trolley import topics
from trolley.runtime.zenoh_bus import ZenohBus


@dataclasses.dataclass(frozen=True, order=True)
class Run:
    """A process of a service; of two of the same name the smaller stays."""

    started_ms: int
    host: str
    pid: int

    @classmethod
    def here(cls) -> "Run":
        """This process."""
        return cls(time.time_ns() // 1_000_000, host_name(), os.getpid())

    @classmethod
    def parse(cls, text: str) -> "Run | None":
        """Read `<host>-<pid>-<start>`, None where it is something else."""
        match = re.fullmatch(r"(.+)-([0-9]{1,18})-([0-9]{1,18})", text)
        return None if match is None else cls(int(match[3]), match[1], int(match[2]))

    def __str__(self) -> str:
        return f"{self.host}-{self.pid}-{self.started_ms}"


def host_name() -> str:
    """This host's name as it may stand in a key."""
    return re.sub(r"[^A-Za-z0-9_.-]", "-", socket.gethostname())[:32] or "host"


def label_of(service: str, *, one_per_host: bool) -> str:
    """The name in `health` and in the liveliness token: that of the host too where it matters."""
    return f"{service}-{host_name()}" if one_per_host else service


def is_one_per_host(label: str) -> bool:
    """Whether a label is that of a service which each host may run, such as a viewer."""
    return "-" in label


class Elders:
    """The older processes of this service that are alive now.

    Args:
        bus: Where tokens are shown.
        robot: The robot's name.
        label: The service's name in keys.
        run: This process.
        met: Called, on any thread, when an older one appears.
    """

    def __init__(
        self, bus: ZenohBus, robot: str, label: str, run: Run, met: Callable[[], None]
    ) -> None:
        self._run = run
        self._met = met
        self._lock = threading.Lock()
        self._known: set[Run] = set()
        bus.declare_token(topics.ALIVE.key(robot, label, str(run)))
        bus.watch_tokens(topics.ALIVE.key(robot, label, "*"), self._see)

    def oldest(self) -> Run | None:
        """The oldest of them, None if this process is the oldest."""
        with self._lock:
            return min(self._known, default=None)

    def _see(self, key: str, is_there: bool) -> None:
        other = Run.parse(key.rpartition("/")[2])
        if other is None or not other < self._run:
            return
        with self._lock:
            if is_there:
                self._known.add(other)
            else:
                self._known.discard(other)
        if is_there:
            self._met()
