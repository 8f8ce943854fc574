"""Real processes for tests: the tests' own Python, output in a file, ended by their pid."""

import itertools
import os
import random
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from support.waiting import PATIENCE_S, wait_until
from trolley.ports import is_free
from trolley.runtime.zenoh_bus import open_router
from trolley.security.access import Security

TESTS = Path(__file__).resolve().parents[1]


PORTS = range(11_000, 32_000)
"""Ports that tests use. From 32768 on any connection that anybody opens may be given one, before
the test or its robot listens there."""
_first = random.SystemRandom().choice(PORTS)  # tests run side by side
_ports = itertools.cycle((*range(_first, PORTS.stop), *range(PORTS.start, _first)))


def find_free_port() -> int:
    """A port of the loopback interface that nobody listens on now, a new one each time."""
    return next(port for port in _ports if is_free(port))


class Process:
    """A Python process whose output goes to a file."""

    def __init__(
        self, arguments: Sequence[str], log: Path, environment: Mapping[str, str] | None = None
    ) -> None:
        self.log_path = log
        inherited = {name: os.environ[name] for name in os.environ if name != "NOTIFY_SOCKET"}
        paths = [str(TESTS), *filter(None, [os.environ.get("PYTHONPATH")])]
        with log.open("ab") as output:
            self._popen = subprocess.Popen(
                [sys.executable, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                env={**inherited, "PYTHONPATH": os.pathsep.join(paths), **(environment or {})},
            )

    @property
    def pid(self) -> int:
        """The process id."""
        return self._popen.pid

    @property
    def is_running(self) -> bool:
        """Whether it has not ended."""
        return self._popen.poll() is None

    @property
    def log(self) -> str:
        """What it wrote so far."""
        return self.log_path.read_text(encoding="utf-8", errors="replace")

    def send(self, number: signal.Signals) -> None:
        """Send it a signal."""
        self._popen.send_signal(number)

    def wait(self, patience_s: float = PATIENCE_S) -> int:
        """Its exit code; fails with its output where it does not end."""
        try:
            return self._popen.wait(patience_s)
        except subprocess.TimeoutExpired:
            raise AssertionError(
                f"process {self.pid} did not end within {patience_s} s:\n{self.log}"
            ) from None

    def terminate(self) -> int:
        """Ask it to end (SIGTERM); its exit code."""
        self.send(signal.SIGTERM)
        return self.wait()

    def kill(self) -> None:
        """End it without a word (SIGKILL); nothing happens where it has ended."""
        if self.is_running:
            self.send(signal.SIGKILL)
        self._popen.wait()


@contextmanager
def own_router(security: Security | None = None) -> Iterator[str]:
    """A router in this process; yields where it listens for this host's programs."""
    endpoint = f"tcp/127.0.0.1:{find_free_port()}"
    with open_router([endpoint], security=security):
        yield endpoint


class RouterProcess:
    """A router on a port of its own, which can go away and come back."""

    def __init__(self, port: int, log: Path) -> None:
        self.port = port
        self.endpoint = f"tcp/127.0.0.1:{port}"
        self._log = log
        self._process: Process | None = None

    def start(self) -> None:
        """Listen; returns when it does."""
        program = (
            "import sys; from trolley.runtime.router import run_router; run_router([sys.argv[1]])"
        )
        process = Process(["-c", program, self.endpoint], self._log)
        wait_until(lambda: self._answers() or not process.is_running, "the router listens")
        assert process.is_running, f"the router did not start:\n{process.log}"
        self._process = process

    def stop(self) -> None:
        """Go away as a crash would."""
        if self._process is not None:
            self._process.kill()
            self._process = None

    def _answers(self) -> bool:
        with socket.socket() as probe:
            probe.settimeout(0.2)
            return probe.connect_ex(("127.0.0.1", self.port)) == 0


def write_config(path: Path, endpoint: str, name: str = "tester", more: str = "") -> Path:
    """Write a small `robot.toml` for the robot `name` at this router and return its path."""
    path.write_text(
        f"""\
[robot]
name = "{name}"
footprint = {{length_m = 0.4, width_m = 0.3}}

[zenoh]
connect = ["{endpoint}"]
{more}""",
        encoding="utf-8",
    )
    return path


def children_of(pid: int) -> list[int]:
    """The processes that one has started and that run."""
    found: list[int] = []
    for thread in Path(f"/proc/{pid}/task").iterdir():
        with suppress(FileNotFoundError):  # it has ended meanwhile
            found += map(int, (thread / "children").read_text().split())
    return found
