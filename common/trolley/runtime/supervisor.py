"""Runs child processes and starts those again that end or hang: `trolley up`, `demo`, the door.

On a robot systemd does this for the services; here it is for a terminal.
"""

import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from types import TracebackType
from typing import Self

from trolley.start import program
from trolley.supervision import PARENT_VARIABLE, WATCHDOG_S, Watchdog

EXIT_CONFIG = 2
"""A service's exit code for settings that cannot be used: starting it again would not help."""
FIRST_DELAY_S = 0.2
LONGEST_DELAY_S = 10.0
SETTLED_AFTER_S = 20.0
"""A service that ran for so long is started again without delay."""
GRACE_S = 10.0
"""A child may take so long to end: `SAVING_S` and some."""
POLL_PERIOD_S = 0.1
QUEUE_PERIOD_S = 0.01
"""The same while a child waits for others to be ready."""
TURN_S = 5.0
"""A child that is not ready after so long, as one that never says so, no longer keeps the next one
waiting."""
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1"}
"""Matrices are small here: numpy's further threads would only take the cores from the others."""
AWAY_S = 2.0
"""A supervisor that did not turn for so long was stopped itself."""


class Child:
    """One service: its process, and when to start it again."""

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        *,
        is_held: bool,
        inherits: Sequence[int],
        watchdog_s: float,
    ) -> None:
        self.name = name
        self.restarts = 0
        self.is_held = is_held
        """Whether its first start waits to be released."""
        self.watchdog = Watchdog(watchdog_s)
        self._command = list(command)
        self._inherits = inherits
        self._process: subprocess.Popen[bytes] | None = None
        self._started_s = 0.0
        self._due_s = 0.0
        self._delay_s = FIRST_DELAY_S
        self._given_up = False

    @property
    def pid(self) -> int | None:
        """Its process, None while there is none."""
        return None if self._process is None else self._process.pid

    @property
    def is_due(self) -> bool:
        """Whether it is to be started now."""
        waits = self._process is None and not self._given_up and not self.is_held
        return waits and time.monotonic() >= self._due_s

    def is_starting(self, now_s: float) -> bool:
        """Whether it has been started, and needs a core of its own to become ready."""
        is_late = now_s - self._started_s > TURN_S
        return self._process is not None and not is_late and not self.watchdog.is_ready

    def start(self, environment: Mapping[str, str]) -> None:
        """Start it.

        Raises:
            OSError: No file, memory or process is left for it; it is due again later.
        """
        self.watchdog.begin()
        self._started_s = time.monotonic()
        try:
            # A group of its own: Ctrl-C is for the supervisor, which ends its children in order.
            self._process = subprocess.Popen(
                self._command,
                env={**environment, **self.watchdog.environment},
                stdin=subprocess.DEVNULL,
                pass_fds=self._inherits,
                process_group=0,
            )
        except OSError:
            self._wait_longer()
            raise

    def collect(self) -> int | None:
        """The exit code where it has just ended; from then on it is due again after a delay."""
        code = None if self._process is None else self._process.poll()
        if code is None:
            return None
        self._process = None
        if time.monotonic() - self._started_s > SETTLED_AFTER_S:
            self._delay_s = FIRST_DELAY_S
        self._wait_longer()
        self._given_up = code == EXIT_CONFIG
        self.restarts += not self._given_up
        return code

    def _wait_longer(self) -> None:
        self._due_s = time.monotonic() + self._delay_s
        self._delay_s = min(2.0 * self._delay_s, LONGEST_DELAY_S)

    def signal(self, number: int) -> None:
        """Send it a signal if it runs."""
        if self._process is not None and self._process.poll() is None:
            self._process.send_signal(number)

    def wait(self, timeout_s: float) -> bool:
        """Wait for its end; False if it still runs."""
        try:
            if self._process is not None:
                self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return False
        return True


class Supervisor:
    """The children of a context: started on entering, ended on leaving, restarted in between.

    Args:
        modules: What to run, by service: `{"base": "trolley_base"}` is `python -m trolley_base`;
            a list is a module with arguments.
        environment: Added to this process's environment.
        report: Called, on a thread of its own, with a sentence about each child that ended.
        held: Those that start only when `release` is called.
        inherits: Numbers of open files that each child gets.
        watchdog_s: A child that has not turned for so long hangs.
    """

    def __init__(
        self,
        modules: Mapping[str, str | Sequence[str]],
        environment: Mapping[str, str],
        report: Callable[[str], None],
        held: Collection[str] = (),
        inherits: Sequence[int] = (),
        watchdog_s: float = WATCHDOG_S,
    ) -> None:
        self.children = {
            name: Child(
                name,
                _command(module),
                is_held=name in held,
                inherits=inherits,
                watchdog_s=watchdog_s,
            )
            for name, module in modules.items()
        }
        self.failure: str | None = None
        """Why one cannot run at all; the main thread then gets SIGINT, or SIGTERM if it ignores
        that, as in the background of a script."""
        own = {PARENT_VARIABLE: str(os.getpid())}
        self._environment = {**ONE_THREAD, **os.environ, **environment, **own}
        self._most_starting = len(os.sched_getaffinity(0))
        self._report = report
        self._stop = threading.Event()
        self._main_thread = threading.main_thread().ident or 0
        # The kernel counts the end of the thread that started a child as the end of its parent, so
        # one thread does it all along.
        self._thread = threading.Thread(target=self._run, name="supervisor", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()

    def release(self, name: str) -> None:
        """Let a child start that was held."""
        self.children[name].is_held = False

    def stop(self) -> None:
        """End all children: SIGTERM, and SIGKILL to those that take longer than `GRACE_S`."""
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        turned_s = time.monotonic()
        while not self._stop.is_set():
            now_s = time.monotonic()
            was_away, turned_s = now_s - turned_s > AWAY_S, now_s
            has_queue = False
            for child in self.children.values():
                code = child.collect()
                if code is not None:
                    self._note_end(child, code)
                if child.is_due:
                    has_queue = self._must_wait(child, now_s)
                    if not has_queue:
                        self._start(child)
                elif was_away:
                    child.watchdog.pardon(now_s)
                elif child.watchdog.is_silent(now_s) and child.pid is not None:
                    self._report(f"{child.name} hangs; killing it")
                    child.signal(signal.SIGKILL)
                    child.watchdog.begin()
            self._stop.wait(QUEUE_PERIOD_S if has_queue else POLL_PERIOD_S)
        self._end_all()

    def _must_wait(self, child: Child, now_s: float) -> bool:
        """Whether a child that is due waits for others to be ready; one that has run never does."""
        num_starting = sum(one.is_starting(now_s) for one in self.children.values())
        return child.restarts == 0 and num_starting >= self._most_starting

    def _start(self, child: Child) -> None:
        try:
            child.start(self._environment)
        except OSError as problem:
            self._report(f"{child.name} cannot be started ({problem.strerror}); trying again")

    def _note_end(self, child: Child, code: int) -> None:
        if code == EXIT_CONFIG:
            # The child has said why. Whoever waits for the services in the main thread is called
            # back from there, as by Ctrl-C.
            self.failure = f"{child.name} cannot run with this configuration"
            is_deaf = signal.getsignal(signal.SIGINT) is signal.SIG_IGN
            number = signal.SIGTERM if is_deaf else signal.SIGINT
            signal.pthread_kill(self._main_thread, number)
        else:
            self._report(f"{child.name} {_how_it_ended(code)}; starting it again")

    def _end_all(self) -> None:
        children = list(self.children.values())
        for child in children:
            child.signal(signal.SIGTERM)
        deadline_s = time.monotonic() + GRACE_S
        for child in children:
            if not child.wait(max(0.0, deadline_s - time.monotonic())):
                self._report(f"{child.name} does not end; killing it")
                child.signal(signal.SIGKILL)
                child.wait(GRACE_S)
            child.watchdog.close()


def _command(module: str | Sequence[str]) -> list[str]:
    words = [module] if isinstance(module, str) else module
    return program(*words)


def _how_it_ended(code: int) -> str:
    if code < 0:
        names = {one.value: one.name for one in signal.Signals}
        return f"was killed by {names.get(-code, f'signal {-code}')}"
    return f"ended with exit code {code}"
