"""The Zenoh runtime: one process per service.

Zenoh's threads only store and wake; this thread calls the service's methods. SIGTERM, SIGINT and
SIGHUP end it cleanly, an exception ends it with a trace for the supervisor to restart it.
"""

import argparse
import ctypes
import gc
import math
import os
import queue
import secrets
import signal
import sys
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from trolley.config import ConfigError, RobotConfig, find_config
from trolley.config.kept_settings import load_with_kept
from trolley.runtime.clash import OlderRuns, Run, label_of
from trolley.runtime.log import Log, set_up_logging
from trolley.runtime.memory import give_back
from trolley.runtime.node import Node
from trolley.runtime.service import Service
from trolley.runtime.state import StateFolder, state_root
from trolley.runtime.zenoh_bus import NotConnected, ZenohBus, open_bus_patiently
from trolley.sanitize import fit
from trolley.security.host_keys import KeysError, keys_for
from trolley.start import leave
from trolley.supervision import START_S, Supervision, end_with_parent

EXIT_CRASHED, EXIT_CONFIG, EXIT_CLASH = 1, 2, 3
STOPS = signal.SIGTERM, signal.SIGINT, signal.SIGHUP
CRASH = "The service ends because of an internal error"
POLL_S = 0.05
TELLS_AFTER_S = 2.0
"""A service that has waited for so long says so: a router may start at the same time [s]."""
LONGEST_WAIT_S = 1.0
SAVING_S = 8.0
"""How long a service that ends waits for its last files; an SD card stalls for seconds."""
STARTED_S = 10.0
"""After this long a service has warmed up where its kernels are compiled, and gives back memory."""
_STA_UNSYNC = 0x0040
_LIBC = ctypes.CDLL(None)
_ID_LENGTH = 12


class ProcessHost:
    """Real time, files, random ids and a worker thread; `wake` is called when a job fails."""

    def __init__(self, robot: str, log: Log, wake: Callable[[], None] = lambda: None) -> None:
        root = state_root()
        self.state = StateFolder(root / robot, log)
        self.maps = StateFolder(root / "maps", log)
        self._wake = wake
        self._jobs: queue.SimpleQueue[tuple[Callable[[], Any], Callable[[Any], None]] | None] = (
            queue.SimpleQueue()
        )
        self._worker = threading.Thread(target=self._run_jobs, name="work", daemon=True)
        self._worker.start()
        self.failure: BaseException | None = None
        """The exception that ended the worker."""
        self._cpu_s, self._measured_s = time.process_time(), time.monotonic()

    monotonic_ns = staticmethod(time.monotonic_ns)
    """The local monotonic clock."""

    def since_boot_ns(self) -> int:
        """Time since the computer was started, which goes on while it sleeps."""
        return time.clock_gettime_ns(time.CLOCK_BOOTTIME)

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

    def finish(self, timeout_s: float = SAVING_S) -> bool:
        """Finish the waiting jobs; False if one failed or they take too long."""
        self._jobs.put(None)
        self._worker.join(timeout_s)
        return self.failure is None and not self._worker.is_alive()

    def _run_jobs(self) -> None:
        while (job := self._jobs.get()) is not None:
            fn, done = job
            try:
                done(fn())
            except Exception as error:  # handed to the service's thread, which ends the process
                self.failure = error
                self._wake()
                return


def clock_is_synchronised() -> bool:
    """Whether the kernel says that the host's clock is synchronised (`adjtimex`)."""
    buffer = ctypes.create_string_buffer(512)
    if _LIBC.adjtimex(buffer) < 0:
        return False
    # struct timex: modes (int, padded), offset, freq, maxerror, esterror (long), then status (int).
    status = ctypes.c_int.from_buffer(buffer, 5 * ctypes.sizeof(ctypes.c_long)).value
    return not status & _STA_UNSYNC


class ServiceProcess:
    """Runs one service until it is told to stop."""

    def __init__(self, service: Service, config: RobotConfig) -> None:
        self._service = service
        self._label = label_of(service.name, one_per_host=service.one_per_host)
        self._log = Log(service.name)
        self._config = config
        self._robot = config.robot.name
        self._run = Run.here()
        self._supervision = Supervision()
        self._patience_until_s = 0.0
        self._tells_from_s = time.monotonic() + TELLS_AFTER_S
        self._node: Node | None = None
        # A plain flag: a threading.Event may not be set by a signal that interrupts its `wait`.
        self._should_stop = False

    def main(self) -> int:
        """Connect, settle clashes, serve; return the exit code."""
        self._supervision.alive()  # one that begins anew is watched already
        for number in STOPS:
            signal.signal(number, self._request_stop)
        zenoh = self._config.zenoh
        try:
            keys = keys_for(zenoh.connect, self._config.path(zenoh.keys))
            bus = open_bus_patiently(
                zenoh.connect, self._wait_for_router, keys, puts_apart=self._service.hears_apart
            )
        except (KeysError, NotConnected) as error:
            self._log.error(str(error))
            return EXIT_CONFIG
        if bus is None:
            # Zenoh's thread still waits for the router and cannot be interrupted.
            os._exit(0)
        try:
            code = self._serve(bus)
        finally:
            bus.close()
        if code == 0 and self._service.is_spent:
            self._begin_anew()
        return code

    def _wait_for_router(self) -> bool:
        now_s = time.monotonic()
        if now_s >= self._tells_from_s:
            self._tells_from_s = math.inf
            where = ", ".join(self._config.zenoh.connect)
            self._log.warning("Waiting for the router; `trolley router` starts one", where=where)
        if now_s >= self._patience_until_s:
            self._supervision.waiting("waiting for the router")
            self._patience_until_s = now_s + 0.5 * START_S
        return not self._should_stop

    def _serve(self, bus: ZenohBus) -> int:
        older = OlderRuns(bus, self._robot, self._label, self._run, self._wake)
        while not older.settle():
            if self._should_stop:
                return 0
            older.ask()
            time.sleep(POLL_S)
        oldest = older.oldest()
        if oldest is not None:
            return self._give_way(oldest)
        host = ProcessHost(self._robot, self._log, self._wake)
        node = self._node = Node(self._service, self._robot, bus, host, self._label, str(self._run))
        try:
            node.open()
            older.serves()
            bus.on_connection(lambda is_up: node.reconnected() if is_up else None)
            self._supervision.ready()
            # What start-up made stays for good: the collector need not look at it again.
            gc.collect()
            gc.freeze()
            code = self._loop(node, host, older)
        except Exception:
            self._log.crash(CRASH)
            code = EXIT_CRASHED
        if code != 0 or self._should_stop:
            self._supervision.stopping()
        return self._end(node, host) or code

    def _loop(self, node: Node, host: ProcessHost, older: OlderRuns) -> int:
        next_alive_s = 0.0
        give_back_s: float | None = time.monotonic() + STARTED_S
        while not self._should_stop:
            node.step()
            if self._service.is_spent:
                return 0
            if host.failure is not None:
                raise host.failure
            older.ask()
            oldest = older.oldest()
            if oldest is not None:
                return self._give_way(oldest)
            if give_back_s is not None and time.monotonic() >= give_back_s:
                give_back_s = None
                host.work(give_back, lambda _: None)
            period_s = self._supervision.period_s
            if period_s is not None and time.monotonic() >= next_alive_s:
                self._supervision.alive()
                next_alive_s = time.monotonic() + period_s
            wait_s = (node.next_due_ns() - host.monotonic_ns()) * 1e-9
            node.inbox.wait(min(max(wait_s, 0.0), period_s or LONGEST_WAIT_S))
        return 0

    def _end(self, node: Node, host: ProcessHost) -> int:
        """Stop the service and finish what it saves; not 0 if that failed."""
        code = 0
        try:
            node.close()
        except Exception:
            self._log.crash("The service could not stop properly")
            node.silence()
            code = EXIT_CRASHED
        if not host.finish():
            self._log.error("Saving was not completed", why=str(host.failure or ""))
            code = EXIT_CRASHED
        return code

    def _begin_anew(self) -> None:
        """Replace this program by itself in its process, unless it is to stop."""
        for number in STOPS:  # from here on they end it, so that none is lost
            signal.signal(number, signal.SIG_DFL)
        if not self._should_stop:
            self._supervision.alive()
            os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])

    def _give_way(self, oldest: Run) -> int:
        self._log.error(
            "Another process of this service is running, so this one ends: stop that one, or give "
            "this robot another [robot] name",
            robot=self._robot,
            host=oldest.host,
            pid=oldest.pid,
        )
        return EXIT_CLASH

    def _wake(self) -> None:
        if self._node is not None:
            self._node.inbox.wake()

    def _request_stop(self, _number: int, _frame: object) -> None:
        self._should_stop = True
        self._wake()


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
            "No robot.toml found: give --config, set TROLLEY_CONFIG, or run `trolley init`.\n"
        )
        sys.exit(EXIT_CONFIG)
    try:
        loaded = load_with_kept(path, state_root())
        service = service_class(loaded.config)
    except ConfigError as error:
        sys.stderr.write(fit(f"{error}\n", sys.stderr.encoding))
        sys.exit(EXIT_CONFIG)
    for trouble in loaded.troubles:
        Log(service.name).warning(trouble)
    try:
        code = ServiceProcess(service, loaded.config).main()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else EXIT_CRASHED
    except Exception:
        Log(service.name).crash(CRASH)
        code = EXIT_CRASHED
    # Without Python's own shutdown, which threads of Zenoh's that still run would abort.
    leave("", code)
