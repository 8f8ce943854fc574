"""What the viewer costs, and how late a browser sees what the robot publishes.

    python -m bench.viewer.cost [--full]

Real processes: a router, a pretend robot (see `pretend_robot.py`) and the viewer. First nobody
looks, then one client that speaks viser's protocol, then five, then Chromium, then ten at once, of
which in the end one stops reading for a while. Chromium renders in software here, so it draws few
frames.
"""

import argparse
import asyncio
import contextlib
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from bench.harness.figures import Figure, at_least, at_most, show
from bench.harness.paths import ROOT
from bench.viewer.clients import CHROMIUM, Chromium, ProtocolClient, Seen, open_chromium
from bench.viewer.pretend_robot import PARTICLES_HZ, SCAN_HZ

from trolley.runtime.zenoh_bus import open_router

CLOCK_TICKS = os.sysconf("SC_CLK_TCK")
MAX_CPU, MAX_AGE_S, MAX_BACKLOG = 0.10, 0.150, 2
MAX_CPU_BY_CLIENTS = {0: 0.8, 1: 6.7, 5: 11.8}
"""What it was before it had a page of its own [% of a core]."""
CONFIG = """[robot]
name = "bench"
footprint = {{length_m = 0.4, width_m = 0.4}}
[zenoh]
connect = ["tcp/127.0.0.1:{router}"]
[viz]
host = "{host}"
port = {viewer}
"""


class Used:
    """The CPU share of a process since the last query."""

    def __init__(self, pid: int) -> None:
        """Start now."""
        self._pid = pid
        self.begin()

    def begin(self) -> None:
        """Count anew."""
        self._cpu_s, self._since_s = self._cpu_now_s(), time.perf_counter()

    @property
    def cpu(self) -> float:
        """Share of one core since then."""
        return (self._cpu_now_s() - self._cpu_s) / (time.perf_counter() - self._since_s)

    @property
    def rss_mb(self) -> float:
        """Resident now [MB]."""
        pages = int(Path(f"/proc/{self._pid}/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 2**20

    def _cpu_now_s(self) -> float:
        fields = Path(f"/proc/{self._pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / CLOCK_TICKS


@contextlib.contextmanager
def started(folder: Path, host: str = "127.0.0.1") -> Iterator[tuple[Used, str]]:
    """Router, robot and viewer; gives the viewer's process and its address."""
    router, viewer = free_port(), free_port()
    config = folder / "robot.toml"
    config.write_text(CONFIG.format(router=router, viewer=viewer, host=host))
    environment = {**os.environ, "TROLLEY_STATE": str(folder / "state")}
    commands = (["-m", "trolley_viz"], ["-m", "bench.viewer.pretend_robot"])
    with open_router([f"tcp/127.0.0.1:{router}"]), (folder / "log").open("wb") as log:
        processes = [
            subprocess.Popen(
                [sys.executable, *command, "--config", str(config)],
                cwd=ROOT,
                env=environment,
                stdout=log,
                stderr=log,
            )
            for command in commands
        ]
        try:
            wait_for_port(viewer, host)
            yield Used(processes[0].pid), f"http://{host}:{viewer}"
            if any(process.poll() is not None for process in processes):
                raise RuntimeError((folder / "log").read_text())
        finally:
            for process in processes:
                process.terminate()
            for process in processes:
                process.wait(15.0)


def free_port() -> int:
    """A port that nobody listens on now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def wait_for_port(port: int, host: str, seconds: float = 60.0) -> None:
    """Wait until somebody listens."""
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        with socket.socket() as probe:
            if probe.connect_ex((host, port)) == 0:
                return
        time.sleep(0.1)
    raise TimeoutError(f"nobody listens on port {port}")


def told(who: str, seen: Seen) -> list[Figure]:
    """The figures of one browser."""
    return [
        at_least(f"{who}: scans", seen.scans_hz, 0.9 * SCAN_HZ, "Hz", 1),
        at_least(f"{who}: particles", seen.particles_hz, 0.8 * PARTICLES_HZ, "Hz", 1),
        Figure(f"{who}: from published to decoded, median", f"{seen.percentile(50):.3f} s"),
        at_most(f"{who}: from published to decoded, p95", seen.percentile(95), MAX_AGE_S, "s"),
        at_most(f"{who}: most scans in flight", seen.backlog, MAX_BACKLOG, digits=0),
    ]


class Clients:
    """Protocol clients that come and go."""

    def __init__(self, url: str) -> None:
        """None yet."""
        self._url = url
        self._tasks: list[asyncio.Task[None]] = []
        self.all: list[ProtocolClient] = []

    def add(self, count: int) -> None:
        """Connect some."""
        for _ in range(count):
            client = ProtocolClient(self._url)
            self.all.append(client)
            self._tasks.append(asyncio.create_task(client.run()))

    def clear(self) -> None:
        """Count anew."""
        for client in self.all:
            client.clear()

    async def close(self) -> None:
        """Disconnect all."""
        for task in self._tasks:
            task.cancel()
        for outcome in await asyncio.gather(*self._tasks, return_exceptions=True):
            if isinstance(outcome, Exception):
                raise outcome


async def measure_few(viewer: Used, url: str, seconds: float) -> None:
    """Nobody, one client, five."""
    figures: list[Figure] = []
    clients = Clients(url)

    async def measure(count: int) -> None:
        clients.add(count - len(clients.all))
        await asyncio.sleep(6.0)
        clients.clear()
        viewer.begin()
        await asyncio.sleep(seconds)
        most = MAX_CPU_BY_CLIENTS[count]
        figures.append(at_most(f"{count} clients: CPU", 100.0 * viewer.cpu, most, "%", 1))

    await measure(0)
    await measure(1)
    seen = clients.all[0].seen
    rate = seen.num_bytes / seconds / 1000.0
    figures += [
        Figure("one client: received", f"{rate:.0f} kB/s"),
        Figure("one client: memory of the viewer", f"{viewer.rss_mb:.0f} MB"),
        *told("one client", seen),
    ]
    await measure(5)
    await clients.close()
    show(figures)


async def measure_page(chromium: Chromium, viewer: Used, seconds: float) -> None:
    """Chromium alone."""
    await asyncio.sleep(5.0)
    await chromium.clear()
    viewer.begin()
    await asyncio.sleep(seconds)
    seen, taken, frames_hz = await chromium.seen()
    show(
        [
            Figure("Chromium: frames drawn", f"{frames_hz:.1f} Hz"),
            at_most("Chromium: CPU", 100.0 * viewer.cpu, 100.0 * MAX_CPU, "%", 1),
            *told("Chromium", seen),
            Figure(
                "Chromium: taken by the thread that draws, p95", f"{taken.percentile(95):.3f} s"
            ),
        ]
    )


async def measure_ten(chromium: Chromium, viewer: Used, url: str, seconds: float) -> None:
    """Chromium and nine clients; then one of them reads nothing for a while."""
    clients = Clients(url)
    clients.add(9)
    await asyncio.sleep(5.0)
    clients.clear()
    await chromium.clear()
    viewer.begin()
    before_mb = viewer.rss_mb
    await asyncio.sleep(seconds)
    seen, taken, frames_hz = await chromium.seen()
    worst = max((one.seen for one in clients.all), key=lambda one: one.percentile(95))
    show(
        [
            Figure("ten: CPU", f"{100.0 * viewer.cpu:.1f} %"),
            Figure("ten: memory of the viewer", f"{viewer.rss_mb:.0f} MB"),
            at_most("ten: memory grown", viewer.rss_mb - before_mb, 5.0, "MB", 1),
            Figure("ten, Chromium: frames drawn", f"{frames_hz:.1f} Hz"),
            *told("ten, Chromium", seen),
            Figure("ten, Chromium: taken, p95", f"{taken.percentile(95):.3f} s"),
            *told("ten, worst client", worst),
        ]
    )
    lazy, *others = clients.all
    lazy.is_reading.clear()
    clients.clear()
    before_mb = viewer.rss_mb
    await asyncio.sleep(seconds)
    worst = max((one.seen for one in others), key=lambda one: one.percentile(95))
    grown = viewer.rss_mb - before_mb
    lazy.clear()
    lazy.is_reading.set()
    await asyncio.sleep(5.0)
    stale = sum(age > 1.0 for age in lazy.seen.ages_s)
    lazy.clear()
    await asyncio.sleep(5.0)
    show(
        [
            at_most("one does not read: memory grown", grown, 20.0, "MB", 1),
            at_most("one does not read: p95 of the others", worst.percentile(95), MAX_AGE_S, "s"),
            Figure("read again: stale scans first", f"{stale}"),
            at_most("read again, after 5 s: p95", lazy.seen.percentile(95), MAX_AGE_S, "s"),
        ]
    )
    await clients.close()


async def measure(seconds: float) -> None:
    """All of it, one after the other."""
    with tempfile.TemporaryDirectory() as folder, started(Path(folder)) as (viewer, url):
        await measure_few(viewer, url, seconds)
        if not CHROMIUM.exists():
            print(f"skipped: {CHROMIUM} is not installed")
            return
        async with open_chromium(url) as chromium:
            await measure_page(chromium, viewer, seconds)
            await measure_ten(chromium, viewer, url, seconds)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--full", action="store_true", help="2 minutes for each figure")
    asyncio.run(measure(120.0 if parser.parse_args().full else 10.0))


if __name__ == "__main__":
    main()
