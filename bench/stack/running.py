"""The whole stack as real processes at real time: start, reaction, processor, memory, threads.

    python -m bench.stack.running [--port 7461] [--emulate] [--standing]

Starts the demo without a browser, drives its tour, and prints, as one subscriber on the bus sees
them, the times from the start to the first scan and to `localized`, the time from each scan to the
first command computed with it, and per process the share of one core, the proportional set size
(PSS) and the threads while the robot drives. With `--emulate` base talks to an emulated board and
lidar through its real drivers; the world is in a process beside it, which no robot has, so "the
robot" is what a robot pays. Otherwise the world is simulated within base. With `--standing` it
drives no tour, and is measured once it has come to rest.
"""

import argparse
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from trolley import topics
from trolley.messages import PoseEstimate, Scan, VelocityCommand
from trolley.runtime import codec
from trolley.runtime.bus import Sample
from trolley.runtime.zenoh_bus import ZenohBus, open_bus

ROBOT = "bench"
EMULATOR = "emulated devices"
SETTLED_S = 5.0
"""After this long, localized, a standing robot has come to rest."""
CLOCK_TICKS = os.sysconf("SC_CLK_TCK")


class Reaction:
    """Pairs scans with the first commands computed with them."""

    def __init__(self) -> None:
        """Start empty."""
        self._lock = threading.Lock()
        self._scans: dict[int, float] = {}
        self.delays_s: list[float] = []
        self.num_scans = 0
        self.num_commands = 0

    def scan(self, sample: Sample) -> None:
        """Take a scan."""
        now_s = time.perf_counter()
        scan = codec.decode(Scan, sample.payload, sample.encoding)
        with self._lock:
            self._scans[scan.stamp_ns] = now_s
            self.num_scans += 1

    def command(self, sample: Sample) -> None:
        """Take a command."""
        now_s = time.perf_counter()
        command = codec.decode(VelocityCommand, sample.payload, sample.encoding)
        with self._lock:
            self.num_commands += 1
            seen_s = self._scans.pop(command.scan_ns, None)
            if seen_s is not None:
                self.delays_s.append(now_s - seen_s)


class Start:
    """When the robot was first heard of, from the start of its processes [s]."""

    def __init__(self, bus: ZenohBus, began_s: float) -> None:
        """Listen from now on; the processes were started at `began_s` by `time.perf_counter`."""
        self._began_s = began_s
        self.seconds: dict[str, float] = {}
        self._listening = [
            bus.subscribe(topics.SCAN.key(ROBOT), lambda _: self._note("first scan")),
            bus.subscribe(topics.POSE.key(ROBOT), self._hear_pose),
            bus.subscribe(topics.COMMAND.key(ROBOT, "planner"), lambda _: self._note("driving")),
        ]

    def end(self) -> None:
        """Listen no more."""
        for one in self._listening:
            one.close()

    def _hear_pose(self, sample: Sample) -> None:
        pose = codec.decode(PoseEstimate, sample.payload, sample.encoding)
        if pose.state == "localized":
            self._note("localized")

    def _note(self, what: str) -> None:
        self.seconds.setdefault(what, time.perf_counter() - self._began_s)


def num_threads(pid: int) -> int:
    """How many threads a process has."""
    return len(list(Path(f"/proc/{pid}/task").iterdir()))


def tree(root: int) -> Iterator[tuple[int, str]]:
    """A process and all below it: pid and what it is."""
    command = Path(f"/proc/{root}/cmdline").read_bytes().decode().split("\0")
    modules = [part for part in command if part.startswith("trolley_")]
    other = EMULATOR if "emulate" in command else "router and supervisor"
    yield root, modules[0] if modules else other
    for task in Path(f"/proc/{root}/task").iterdir():
        for child in (task / "children").read_text().split():
            yield from tree(int(child))


def cpu_s(pid: int) -> float:
    """Seconds of processor time used so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / CLOCK_TICKS


def pss_mb(pid: int) -> float:
    """Proportional set size [MB]."""
    for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines():
        if line.startswith("Pss:"):
            return int(line.split()[1]) * 1024 / 1e6
    return 0.0


def report_process(what: str, share: float, size_mb: float, threads: int) -> None:
    """Print what a process costs."""
    print(f"{what:24s} {100 * share:5.1f} % of a core  {size_mb:6.1f} MB PSS  {threads:3d} threads")


def report_reaction(reaction: Reaction) -> None:
    """Print the delays."""
    delays_ms = np.array(reaction.delays_s) * 1000.0
    print(
        f"{reaction.num_scans} scans, {reaction.num_commands} commands;"
        f" scan to first command: p50 {np.quantile(delays_ms, 0.5):.1f} ms,"
        f" p95 {np.quantile(delays_ms, 0.95):.1f} ms, p99 {np.quantile(delays_ms, 0.99):.1f} ms,"
        f" max {delays_ms.max():.1f} ms over {len(delays_ms)} scans"
    )


def main() -> None:
    """Run the demo and measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--port", type=int, default=7461)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--with-viewer", action="store_true", help="no browser, but the viewer runs"
    )
    parser.add_argument("--emulate", action="store_true", help="a board and a lidar, emulated")
    parser.add_argument("--standing", action="store_true", help="no tour")
    options = parser.parse_args()
    trolley = Path(sys.executable).with_name("trolley")
    command = [str(trolley), "demo", "--name", ROBOT, "--port", str(options.port)]
    command += [] if options.standing else ["--tour"]
    command += ["--seed", str(options.seed)]
    command += ["--viz-port", str(options.port + 1000)] if options.with_viewer else ["--headless"]
    command += ["--emulate", "linorobot,ld19"] if options.emulate else []
    reaction = Reaction()
    started_s = time.perf_counter()
    demo = subprocess.Popen(command)
    try:
        with open_bus([f"tcp/127.0.0.1:{options.port}"], 20.0) as bus:
            start = Start(bus, started_s)
            awaited = "localized" if options.standing else "driving"
            while awaited not in start.seconds and time.perf_counter() < started_s + 60.0:
                time.sleep(0.1)
            start.end()
            time.sleep(SETTLED_S if options.standing else 0.0)
            before = {pid: (what, cpu_s(pid)) for pid, what in tree(demo.pid)}
            started_s = time.monotonic()
            bus.subscribe(topics.SCAN.key(ROBOT), reaction.scan)
            bus.subscribe(topics.COMMAND.key(ROBOT, "planner"), reaction.command)
            time.sleep(20.0)
            elapsed_s = time.monotonic() - started_s
            totals: dict[str, tuple[float, float, int]] = {}
            for pid, (what, used_s) in before.items():
                share, size_mb = (cpu_s(pid) - used_s) / elapsed_s, pss_mb(pid)
                threads = num_threads(pid)
                report_process(what, share, size_mb, threads)
                for name in ("together",) if what == EMULATOR else ("together", "the robot"):
                    cpu, size, number = totals.get(name, (0.0, 0.0, 0))
                    totals[name] = cpu + share, size + size_mb, number + threads
            for name, total in totals.items():
                report_process(name, *total)
    finally:
        demo.terminate()
        demo.wait(20.0)
    print(", ".join(f"{what} after {seconds:.1f} s" for what, seconds in start.seconds.items()))
    if not options.standing:
        report_reaction(reaction)


if __name__ == "__main__":
    main()
