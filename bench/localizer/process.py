"""Processor time of the localizer's whole process, driving and standing.

    python -m bench.localizer.process [--seconds 15]

A router, `base` with a simulated robot in the apartment, and the localizer, each a process of its
own; nobody else listens but this program, which counts poses. Driving, the robot turns on the
spot to and fro, so that each scan differs from the one before. Time per scan is that of all
threads; those with a share of it are listed.
"""

import argparse
import contextlib
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from bench.harness.figures import Figure, at_most, show
from bench.harness.paths import ROOT, WORLDS

from trolley import topics
from trolley.geometry import Twist2D
from trolley.messages import Clock, PoseEstimate, VelocityCommand
from trolley.runtime import codec
from trolley.runtime.bus import Sample
from trolley.runtime.zenoh_bus import ZenohBus, open_bus, open_router

ROBOT = "bench"
PORT = 7491
CONFIG = f"""
[robot]
name = "{ROBOT}"
footprint = {{ length_m = 0.30, width_m = 0.24 }}
[map]
file = "{WORLDS / "apartment.yaml"}"
[start]
pose = {{ x = 0.549, y = 0.218, yaw = 0.2579 }}
[base.simulated]
world = "{WORLDS / "apartment.toml"}"
seed = 1
[zenoh]
connect = ["tcp/127.0.0.1:{PORT}"]
"""
LIMIT_S = 90.0
"""A localizer that has to compile its kernels first is localized by then [s]."""


class Listener:
    """Counts poses, and keeps the newest pose and time."""

    def __init__(self, bus: ZenohBus) -> None:
        self.scans = 0
        self.state = ""
        self.stamp_ns = 0
        bus.subscribe(topics.POSE.key(ROBOT), self._take_pose)
        bus.subscribe(topics.CLOCK.key(ROBOT), self._take_clock)

    def _take_pose(self, sample: Sample) -> None:
        self.state = codec.decode(PoseEstimate, sample.payload, sample.encoding).state
        self.scans += 1

    def _take_clock(self, sample: Sample) -> None:
        self.stamp_ns = codec.decode(Clock, sample.payload, sample.encoding).stamp_ns


@contextlib.contextmanager
def started(folder: Path) -> Iterator[int]:
    """Router, base and localizer; gives the localizer's process id."""
    config = folder / "robot.toml"
    config.write_text(CONFIG)
    environment = {**os.environ, "TROLLEY_STATE": str(folder / "state")}
    with open_router([f"tcp/127.0.0.1:{PORT}"]), (folder / "log").open("wb") as log:
        processes = [
            subprocess.Popen(
                [sys.executable, "-m", module, "--config", str(config)],
                cwd=ROOT,
                env=environment,
                stdout=log,
                stderr=log,
            )
            for module in ("trolley_base", "trolley_localizer")
        ]
        try:
            yield processes[1].pid
        finally:
            for process in processes:
                process.terminate()
            for process in processes:
                process.wait(15.0)


def cpu_of_threads(pid: int) -> dict[str, float]:
    """Processor time so far of each thread [s]."""
    found: dict[str, float] = {}
    for task in Path(f"/proc/{pid}/task").iterdir():
        with contextlib.suppress(OSError):  # it has ended meanwhile
            name = f"{(task / 'comm').read_text().strip()} {task.name}"
            found[name] = int((task / "schedstat").read_text().split()[0]) * 1e-9
    return found


def measure(what: str, pid: int, bus: ZenohBus, heard: Listener, seconds: float) -> list[Figure]:
    """Drive or stand for a while [s]."""
    is_driving = what == "driving"
    move(bus, heard, 2.0, is_driving=is_driving)
    before, scans = cpu_of_threads(pid), heard.scans
    move(bus, heard, seconds, is_driving=is_driving)
    count = heard.scans - scans
    if heard.state != "localized":
        raise RuntimeError(f"the robot is {heard.state} while {what}")
    used = {name: value - before.get(name, 0.0) for name, value in cpu_of_threads(pid).items()}
    per_scan = {name: value / count * 1e3 for name, value in used.items()}
    limit_ms = 1.2 if is_driving else 0.4
    return [
        at_most(f"{what}: processor time a scan", sum(per_scan.values()), limit_ms, "ms"),
        Figure(f"{what}: scans", str(count)),
        *(
            Figure(f"    thread {name}", f"{value:.3f} ms")
            for name, value in sorted(per_scan.items(), key=lambda item: -item[1])
            if value >= 0.005
        ),
    ]


def move(bus: ZenohBus, heard: Listener, seconds: float, *, is_driving: bool) -> None:
    """Turn to and fro, or wait [s]."""
    until_s, step = time.monotonic() + seconds, 0
    while time.monotonic() < until_s:
        if is_driving:
            twist = Twist2D(0.0, 0.0, 0.5 if step // 40 % 2 == 0 else -0.5)
            command = VelocityCommand(stamp_ns=heard.stamp_ns, twist=twist, valid_for=0.3)
            payload = codec.encode(command, "msgpack")
            key = topics.COMMAND.key(ROBOT, "teleop")
            bus.put(key, payload, codec.MIME["msgpack"], topics.COMMAND.qos)
        step += 1
        time.sleep(0.1)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=15.0)
    options = parser.parse_args()
    with (
        tempfile.TemporaryDirectory() as name,
        started(Path(name)) as pid,
        open_bus([f"tcp/127.0.0.1:{PORT}"], 20.0) as bus,
    ):
        heard, until_s = Listener(bus), time.monotonic() + LIMIT_S
        while heard.state != "localized":
            if time.monotonic() > until_s:
                raise RuntimeError((Path(name) / "log").read_text())
            time.sleep(0.1)
        for what in ("driving", "standing"):
            show(measure(what, pid, bus, heard, options.seconds))


if __name__ == "__main__":
    main()
