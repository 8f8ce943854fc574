"""How many robots a network carries: messages of one robot, and what a router does with many.

    python -m bench.fleet.sizing [--counts 10 30 100] [--seconds 10] [--port 7601]

First one simulated robot drives in lock-step, and its messages are counted. Then processes publish
messages of those sizes at those rates, as so many robots, through a router in Python, with one
subscriber that hears what a viewer hears. Printed is the processor time of the router for a second
of such traffic, whatever the machine has left for it: time for each message that it took, times the
messages that the robots have in a second. The variants: robots that hear each other's paths,
routers in a tree (ten robots behind each, the viewer at the top), and `downsampling` at the
viewer's side.
"""

import argparse
import json
import os
import subprocess
import sys
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import zenoh
from bench.harness.drives import CORRIDOR, ENTRANCE, open_robot, simulated
from bench.harness.figures import table
from bench.harness.paths import ROOT, WORLDS

from trolley import requests
from trolley.geometry import Pose2D
from trolley.messages import Tour
from trolley.messages.request_params import StartTour
from trolley.messages.touring import Stop
from trolley.runtime.bus import Sample
from trolley.runtime.zenoh_bus import ZenohBus, open_bus, router_config
from trolley.topics import Qos

VIEWER = ("robot", "clock", "pose", "odom", "base", "goal", "path", "trajectory", "tour")
"""What a viewer hears of every robot."""
WATCHED = ("scan", "beams", "particles", "costmap")
"""What it also hears of the robot that it shows."""
HEARD = ("robot", "pose", "goal", "path", "trajectory")
"""What a planner hears of the other robots."""
SLOWER = {"odom": 5.0, "pose": 5.0, "trajectory": 2.0, "clock": 2.0}
"""Rates of the variant with downsampling [1/s]."""
SESSIONS = 10
"""Robots of one process."""
CLOCK_TICKS = os.sysconf("SC_CLK_TCK")
Traffic = dict[str, tuple[float, float]]
"""Messages in a second and their mean size in bytes, by topic."""


def one_robot(seconds: float = 20.0) -> Traffic:
    """Count what one robot publishes while it drives in the apartment."""
    start = Pose2D(0.549, 0.218, 0.2579)
    config = simulated(WORLDS / "apartment.toml", WORLDS / "apartment.yaml", start, 7)
    counts: dict[str, list[int]] = defaultdict(list)
    with open_robot(config, 7) as lockstep:
        lockstep.run(5.0)
        tour = Tour(stops=[Stop(pose=CORRIDOR), Stop(pose=ENTRANCE)])
        lockstep.ask(requests.TOUR_START, StartTour(tour=tour))

        def count(sample: Sample) -> None:
            counts[sample.key.partition("/")[2].partition("/")[2]].append(len(sample.payload))

        lockstep.bus.subscribe("trolley/**", count)
        lockstep.run(seconds)
    return {
        topic: (len(sizes) / seconds, sum(sizes) / len(sizes)) for topic, sizes in counts.items()
    }


def show_traffic(traffic: Traffic) -> None:
    """Print the messages of one robot, the largest share first."""
    rows = [
        [topic, f"{rate:.1f}", f"{size:.0f}", f"{rate * size / 1000.0:.1f}"]
        for topic, (rate, size) in sorted(traffic.items(), key=lambda one: -one[1][0] * one[1][1])
    ]
    total = sum(rate for rate, _ in traffic.values())
    bytes_s = sum(rate * size for rate, size in traffic.values())
    rows.append(["together", f"{total:.0f}", "", f"{bytes_s / 1000.0:.0f}"])
    table(["one robot, driving", "messages/s", "bytes each", "kB/s"], rows)


# The processes.


def be_router(port: int, uplink: Sequence[str], rates: dict[str, float]) -> None:
    """Be a router until stdin ends."""
    config = router_config([f"tcp/127.0.0.1:{port}"], uplink)
    if rates:
        rules = [{"key_expr": f"trolley/*/{name}", "freq": freq} for name, freq in rates.items()]
        item = {"id": "viewers", "flows": ["egress"], "messages": ["put"], "rules": rules}
        config.insert_json5("downsampling", json.dumps([item]))
    with zenoh.open(config):
        print("ready", flush=True)
        sys.stdin.read()


def tell(counts: dict[str, int]) -> None:
    """Print what was counted so far for every line on stdin, until it ends."""
    for _ in sys.stdin:
        print(json.dumps(counts), flush=True)


def be_robots(port: int, first: int, count: int, traffic: Traffic, hears: bool) -> None:
    """Publish what so many robots publish until stdin ends, and count it."""
    stop, counts = threading.Event(), {"sent": 0, "heard": 0}
    threading.Thread(target=lambda: (tell(counts), stop.set()), daemon=True).start()
    with ExitStack() as stack:
        due: list[tuple[float, float, ZenohBus, str, bytes]] = []

        def hear(_: Sample) -> None:
            counts["heard"] += 1

        for robot in range(first, first + count):
            bus = stack.enter_context(open_bus([f"tcp/127.0.0.1:{port}"], 60.0))
            for name in HEARD if hears else ():
                bus.subscribe(f"trolley/*/{name}", hear)
            for index, (topic, (rate, size)) in enumerate(traffic.items()):
                key = f"trolley/robot{robot}/{topic}"
                phase = (index * 0.37 + robot * 0.11) % 1.0
                due.append((phase / rate, 1.0 / rate, bus, key, bytes(round(size))))
        print("ready", flush=True)
        began = time.monotonic()
        next_s = [phase for phase, *_ in due]
        while not stop.is_set():
            now_s = time.monotonic() - began
            for index, (_, period_s, bus, key, payload) in enumerate(due):
                if next_s[index] <= now_s:
                    bus.put(key, payload, "application/msgpack", Qos.SENSOR)
                    counts["sent"] += 1
                    # A process without time for all of them sends fewer, as a robot does.
                    next_s[index] = max(next_s[index] + period_s, now_s)
            time.sleep(0.005)


def be_viewer(port: int) -> None:
    """Hear what a viewer hears until stdin ends, and count it."""
    counts = {"heard": 0}

    def hear(_: Sample) -> None:
        counts["heard"] += 1

    with open_bus([f"tcp/127.0.0.1:{port}"], 60.0) as bus:
        for name in VIEWER:
            bus.subscribe(f"trolley/*/{name}", hear)
        for name in WATCHED:
            bus.subscribe(f"trolley/robot0/{name}", hear)
        print("ready", flush=True)
        tell(counts)


class Child:
    """A process of this program."""

    def __init__(self, *arguments: str) -> None:
        command = [sys.executable, "-m", "bench.fleet.sizing", *arguments]
        self._process = subprocess.Popen(
            command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def wait_ready(self) -> None:
        """Wait until it says so."""
        assert self._process.stdout is not None
        if self._process.stdout.readline().strip() != "ready":
            raise RuntimeError("a process of the bench did not come up")

    def cpu_s(self) -> float:
        """Processor time so far."""
        stat = Path(f"/proc/{self._process.pid}/stat").read_text()
        fields = stat.rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / CLOCK_TICKS

    def counts(self) -> Counter[str]:
        """What it has counted so far."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        print(file=self._process.stdin, flush=True)
        return Counter(json.loads(self._process.stdout.readline()))

    def end(self) -> None:
        """End it."""
        self._process.communicate(timeout=120.0)


def measure(count: int, traffic: Traffic, variant: str, port: int, seconds: float) -> list[str]:
    """Run one setting; return a row of the table."""
    is_tree = variant == "tree"
    rates = json.dumps(SLOWER if variant == "downsampling" else {})
    home = Child("--be-router", str(port), "--rates", rates)
    home.wait_ready()
    groups = range(0, count, SESSIONS)
    ports = [port + 1 + index if is_tree else port for index in range(len(groups))]
    leaves = [
        Child("--be-router", str(one), "--uplink", f"tcp/127.0.0.1:{port}")
        for one in (ports if is_tree else [])
    ]
    for leaf in leaves:
        leaf.wait_ready()
    viewer = Child("--be-viewer", str(port))
    viewer.wait_ready()
    hears = ["--hears"] if variant == "hear each other" else []
    robots = [
        Child("--be-robots", str(one), "--first", str(first), "--count",
              str(min(SESSIONS, count - first)), "--traffic", json.dumps(traffic), *hears)
        for one, first in zip(ports, groups, strict=True)
    ]  # fmt: skip
    for each in robots:
        each.wait_ready()
    before, seen_before = sum((one.counts() for one in robots), Counter[str]()), viewer.counts()
    before_s, began = home.cpu_s(), time.monotonic()
    time.sleep(seconds)
    used_s, lasted_s = home.cpu_s() - before_s, time.monotonic() - began
    counted = sum((one.counts() for one in robots), Counter[str]()) - before
    seen = (viewer.counts() - seen_before)["heard"]
    for child in (*robots, viewer, *leaves, home):
        child.end()
    sent, heard = counted["sent"], counted["heard"]
    wanted = count * sum(rate for rate, _ in traffic.values())
    share = min(1.0, sent / (wanted * lasted_s))
    return [
        f"{count}, {variant}",
        f"{wanted:.0f}",
        f"{100.0 * share:.0f} %",
        f"{seen / lasted_s:.0f}",
        f"{heard / lasted_s:.0f}",
        f"{100.0 * used_s / lasted_s:.1f} %",
        f"{100.0 * used_s / lasted_s / max(share, 1e-3):.1f} %",
    ]


def main() -> None:
    """Measure and print, or be one of the processes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--counts", type=int, nargs="*", default=[10, 30, 100])
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--port", type=int, default=7601)
    parser.add_argument("--variants", nargs="*",
                        default=["plain", "hear each other", "tree", "downsampling"])  # fmt: skip
    for name in ("--be-router", "--be-robots", "--be-viewer", "--first", "--count"):
        parser.add_argument(name, type=int, help=argparse.SUPPRESS)
    for name in ("--uplink", "--rates", "--traffic"):
        parser.add_argument(name, help=argparse.SUPPRESS)
    parser.add_argument("--hears", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.be_router is not None:
        uplink = [given.uplink] if given.uplink else []
        be_router(given.be_router, uplink, json.loads(given.rates or "{}"))
    elif given.be_robots is not None:
        traffic = json.loads(given.traffic)
        be_robots(given.be_robots, given.first, given.count, traffic, given.hears)
    elif given.be_viewer is not None:
        be_viewer(given.be_viewer)
    else:
        traffic = one_robot()
        show_traffic(traffic)
        rows: list[list[str]] = []
        for count in given.counts:
            for variant in given.variants:
                row = measure(count, traffic, variant, given.port, given.seconds)
                print("; ".join(row), file=sys.stderr, flush=True)
                rows.append(row)
        heads = ["robots", "messages/s", "sent", "to the viewer/s", "to robots/s",
                 "router", "router, had all been sent"]  # fmt: skip
        table(heads, rows)
        print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.0f}; one core is 100 %")


if __name__ == "__main__":
    main()
