"""The Zenoh runtime: one process per service.

Zenoh's threads only store and wake; this thread calls the service's methods. SIGTERM and SIGINT
end it cleanly, an exception ends it with a trace for the supervisor to restart it.
"""

import argparse
import ctypes
import dataclasses
import gc
import os
import queue
import re
import secrets
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from trolley import topics
from trolley.config import ConfigError, RobotConfig, find_config, load_config
from trolley.runtime.log import Log, set_up_logging
from trolley.runtime.node import Node
from trolley.runtime.parent import end_with_parent
from trolley.runtime.service import Service
from trolley.runtime.state import StateFolder, state_root
from trolley.runtime.systemd import Supervision
from trolley.runtime.zenoh_bus import ZenohBus, open_bus_or_stop

EXIT_CRASHED, EXIT_CONFIG, EXIT_CLASH = 1, 2, 3
CLASH_WAIT_S = 1.5
LONGEST_WAIT_S = 1.0
_STA_UNSYNC = 0x0040
_ID_LENGTH = 12


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
        match = re.fullmatch(r"(.+)-(\d+)-(\d+)", text)
        return None if match is None else cls(int(match[3]), match[1], int(match[2]))

    def __str__(self) -> str:
        return f"{self.host}-{self.pid}-{self.started_ms}"


def host_name() -> str:
    """This host's name as it may stand in a key."""
    return re.sub(r"[^A-Za-z0-9_.-]", "-", socket.gethostname())[:32] or "host"


class ProcessHost:
    """Real time, files, random ids and a worker thread."""

    def __init__(self, robot: str, log: Log) -> None:
        root = state_root()
        self.state = StateFolder(root / robot, log)
        self.maps = StateFolder(root / "maps", log)
        self._jobs: queue.SimpleQueue[tuple[Callable[[], Any], Callable[[Any], None]] | None] = (
            queue.SimpleQueue()
        )
        self._worker = threading.Thread(target=self._run_jobs, name="work", daemon=True)
        self._worker.start()
        self.failure: BaseException | None = None
        """What a job died of."""
        self._cpu_s, self._measured_s = time.process_time(), time.monotonic()

    def monotonic_ns(self) -> int:
        """The local monotonic clock."""
        return time.monotonic_ns()

    def unix_ns(self) -> int:
        """The host's clock, synchronised or not."""
        return time.time_ns()

    def utc_now(self) -> str | None:
        """UTC as ISO 8601, None until the host's clock is synchronised."""
        if not clock_is_synchronised():
            return None
        return datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")

    def new_id(self) -> str:
        """A fresh random id."""
        return secrets.token_hex(_ID_LENGTH // 2)

    def work(self, fn: Callable[[], Any], done: Callable[[Any], None]) -> None:
        """Run `fn` on the worker thread."""
        self._jobs.put((fn, done))

    def usage(self) -> tuple[float, int]:
        """Share of one core since the last call, resident bytes."""
        cpu_s, now_s = time.process_time(), time.monotonic()
        share = (cpu_s - self._cpu_s) / max(now_s - self._measured_s, 1e-6)
        self._cpu_s, self._measured_s = cpu_s, now_s
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return round(share, 4), pages * os.sysconf("SC_PAGE_SIZE")

    def finish(self, timeout_s: float = 5.0) -> None:
        """Let the jobs that wait be done."""
        self._jobs.put(None)
        self._worker.join(timeout_s)

    def _run_jobs(self) -> None:
        while (job := self._jobs.get()) is not None:
            fn, done = job
            try:
                done(fn())
            except Exception as error:  # handed to the service's thread, which ends the process
                self.failure = error
                return


def clock_is_synchronised() -> bool:
    """Whether the kernel says that the host's clock is synchronised (`adjtimex`)."""
    buffer = ctypes.create_string_buffer(512)
    if ctypes.CDLL(None, use_errno=True).adjtimex(buffer) < 0:
        return False
    # struct timex: modes (int, padded), offset, freq, maxerror, esterror (long), then status (int).
    status = ctypes.c_int.from_buffer(buffer, 5 * ctypes.sizeof(ctypes.c_long)).value
    return not status & _STA_UNSYNC


class ServiceProcess:
    """Runs one service until it is told to stop."""

    def __init__(self, service: Service, config: RobotConfig) -> None:
        name = config.robot.name
        self._service = service
        self._label = f"viz-{host_name()}" if service.name == "viz" else service.name
        self._log = Log(service.name)
        self._config = config
        self._robot = name
        self._stop = threading.Event()
        self._run = Run.here()
        self._elder: Run | None = None
        self._node: Node | None = None

    def main(self) -> int:
        """Connect, settle who stays, serve; the exit code."""
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._request_stop)
        bus = open_bus_or_stop(self._config.zenoh.connect, self._stop)
        if bus is None:
            # Zenoh's thread still waits for the router and cannot be interrupted.
            os._exit(0)
        try:
            return self._serve(bus)
        finally:
            bus.close()

    def _serve(self, bus: ZenohBus) -> int:
        if not self._settle_clash(bus):
            return EXIT_CLASH if self._elder is not None else 0
        host = ProcessHost(self._robot, self._log)
        node = self._node = Node(self._service, self._robot, bus, host, self._label)
        supervision = Supervision()
        code = 0
        try:
            node.open()
            bus.on_connection(lambda is_up: node.reconnected() if is_up else None)
            supervision.ready()
            # What start-up made stays for good: the collector need not look at it again.
            gc.collect()
            gc.freeze()
            code = self._loop(node, host, supervision)
        except Exception:
            self._log.crash("The service ends because of an error of its own")
            code = EXIT_CRASHED
        finally:
            supervision.stopping()
            node.close()
            host.finish()
        return code

    def _loop(self, node: Node, host: ProcessHost, supervision: Supervision) -> int:
        next_alive_s = 0.0
        while not self._stop.is_set():
            node.step()
            if host.failure is not None:
                raise host.failure
            if self._elder is not None:
                self._log.error(
                    "Another process of this service is older, so this one ends",
                    host=self._elder.host,
                    pid=self._elder.pid,
                )
                return EXIT_CLASH
            now_s = time.monotonic()
            if supervision.period_s is not None and now_s >= next_alive_s:
                supervision.alive()
                next_alive_s = now_s + supervision.period_s
            wait_s = (node.next_due_ns() - node.monotonic_ns) * 1e-9
            node.inbox.wait(min(max(wait_s, 0.0), supervision.period_s or LONGEST_WAIT_S))
        return 0

    def _settle_clash(self, bus: ZenohBus) -> bool:
        """Show our token and look for an older run for 1.5 s; False: do not serve."""
        elders: set[Run] = set()
        others = topics.ALIVE.key(self._robot, self._label, "*")

        def see(key: str, is_there: bool) -> None:
            other = Run.parse(key.rpartition("/")[2])
            if other is None or not other < self._run:
                return
            if not is_there:
                elders.discard(other)
            else:
                elders.add(other)
                if self._node is not None:  # met after a reconnection
                    self._elder = other
                    self._node.inbox.wake()

        bus.declare_token(topics.ALIVE.key(self._robot, self._label, str(self._run)))
        bus.watch_tokens(others, see)
        if self._stop.wait(CLASH_WAIT_S):
            return False
        if elders:
            self._elder = min(elders)
            self._log.error(
                "Already running, so this process ends",
                robot=self._robot,
                host=self._elder.host,
                pid=self._elder.pid,
            )
            return False
        return True

    def _request_stop(self, _number: int, _frame: object) -> None:
        self._stop.set()
        if self._node is not None:
            self._node.inbox.wake()


def main(
    service_class: Callable[[RobotConfig], Service], arguments: list[str] | None = None
) -> None:
    """Run a service as this process: `python -m trolley_localizer --config robot.toml`."""
    parser = argparse.ArgumentParser(description=service_class.__doc__)
    parser.add_argument(
        "--config", type=Path, help="robot.toml (else TROLLEY_CONFIG, else /etc/trolley)"
    )
    options = parser.parse_args(arguments)
    end_with_parent()
    set_up_logging()
    path = find_config(options.config)
    if path is None:
        sys.stderr.write(
            "No robot.toml: give --config, set TROLLEY_CONFIG, or run `trolley init`.\n"
        )
        sys.exit(EXIT_CONFIG)
    try:
        config = load_config(path)
        service = service_class(config)
    except ConfigError as error:
        sys.stderr.write(f"{error}\n")
        sys.exit(EXIT_CONFIG)
    sys.exit(ServiceProcess(service, config).main())
