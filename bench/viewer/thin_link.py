"""What a page sees over a thin link: how old the robot's place is, and how long Stop takes.

    python -m bench.viewer.thin_link [--kbit 400] [--round-trip 0.2] [--seconds 60]

A busy robot (see `pretend_robot.py`) and its viewer; in a network namespace behind an emulated link
(see `bench/harness/thin_link.py`) a client that speaks the page's and viser's protocols, and loads
viser's page meanwhile, as a phone does that has just opened the viewer. Needs root.
"""

import argparse
import asyncio
import subprocess
import sys
import tempfile
import time
import tomllib
import urllib.request
from pathlib import Path

import msgspec
import numpy as np
from bench.harness.figures import Figure, at_most, show
from bench.harness.paths import ROOT
from bench.harness.thin_link import OUTSIDE, may_open, thin_link
from bench.viewer.clients import ProtocolClient
from bench.viewer.cost import started

MAX_POSE_AGE_S, MAX_STOP_S = 0.5, 0.5
SETTLE_S = 5.0
"""The first seconds, in which the map comes, are not counted."""
STOP_PERIOD_S = 2.0


class Outcome(msgspec.Struct):
    """What the client saw."""

    poses_s: list[float]
    stops_s: list[float]
    scans_hz: float
    particles_hz: float
    kb_per_s: float
    loaded_s: float | None
    """How long viser's page took, None if it was not there in the end."""


async def look(url: str, token: str, seconds: float) -> Outcome:
    """Look at the robot, load viser's page, and press Stop now and then."""
    port = url.rpartition(":")[2]
    headers = {"Cookie": f"trolley-{port}={'0' * 16}.{token}"}
    client = ProtocolClient(url, headers)
    watching = asyncio.create_task(client.run())
    loading = asyncio.create_task(asyncio.to_thread(load, f"{url}/scene/", headers))
    await asyncio.sleep(SETTLE_S)
    client.clear()
    started_s = time.monotonic()
    while time.monotonic() - started_s < seconds:
        await client.press_stop("bench")
        await asyncio.sleep(STOP_PERIOD_S)
    seen = client.seen
    watching.cancel()
    return Outcome(
        seen.poses_s,
        seen.stops_s,
        seen.scans_hz,
        seen.particles_hz,
        seen.num_bytes / 1000.0 / (time.monotonic() - started_s),
        loading.result() if loading.done() else None,
    )


def load(url: str, headers: dict[str, str]) -> float:
    """Load viser's page; returns how long it took [s]."""
    started_s = time.monotonic()
    request = urllib.request.Request(url, headers={"Accept-Encoding": "gzip", **headers})
    with urllib.request.urlopen(request, timeout=300.0) as answer:
        answer.read()
    return time.monotonic() - started_s


def token_in(state: Path) -> str:
    """Return the token for those who look only, once the viewer has saved it."""
    while not (found := [*state.rglob("viewer_access.toml")]):
        time.sleep(0.1)
    return tomllib.loads(found[0].read_text())["viewer"]


def look_through(kbit: float, round_trip_s: float, seconds: float) -> Outcome:
    """Let a client look through a link of so many kbit/s each way."""
    with (
        tempfile.TemporaryDirectory() as folder,
        thin_link(kbit, round_trip_s) as inside,
        started(Path(folder), OUTSIDE) as (_, url),
    ):
        token = token_in(Path(folder, "state"))
        command = [sys.executable, "-m", "bench.viewer.thin_link", "--seconds", str(seconds)]
        found = subprocess.run(
            ["ip", "netns", "exec", inside, *command, "--look", url, f"--token={token}"],
            cwd=ROOT,
            check=True,
            stdout=subprocess.PIPE,
        )
    return msgspec.json.decode(found.stdout, type=Outcome)


def measure(kbit: float, round_trip_s: float, seconds: float) -> None:
    """Look through the link and print what was seen."""
    outcome = look_through(kbit, round_trip_s, seconds)
    loaded = "not yet" if outcome.loaded_s is None else f"{outcome.loaded_s:.1f} s"
    poses, stops = (np.percentile(ages, 95) for ages in (outcome.poses_s, outcome.stops_s))
    show(
        [
            at_most("age of the robot's place, p95", float(poses), MAX_POSE_AGE_S, "s"),
            Figure("age of the robot's place, median", f"{np.median(outcome.poses_s):.2f} s"),
            Figure("places", f"{len(outcome.poses_s) / seconds:.1f} Hz"),
            at_most("Stop until it is answered, p95", float(stops), MAX_STOP_S, "s"),
            Figure("Stop, worst", f"{max(outcome.stops_s):.2f} s"),
            Figure("scans", f"{outcome.scans_hz:.1f} Hz"),
            Figure("particles", f"{outcome.particles_hz:.1f} Hz"),
            Figure("scene", f"{outcome.kb_per_s:.0f} kB/s"),
            Figure("viser's page was loaded after", loaded),
        ]
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kbit", type=float, default=400.0)
    parser.add_argument("--round-trip", type=float, default=0.2)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--look", help=argparse.SUPPRESS)
    parser.add_argument("--token", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.look:
        outcome = asyncio.run(look(given.look, given.token, given.seconds))
        sys.stdout.buffer.write(msgspec.json.encode(outcome))
    elif may_open():
        measure(given.kbit, given.round_trip, given.seconds)
    else:
        print("skipped: network namespaces need root, `ip` and /dev/net/tun")


if __name__ == "__main__":
    main()
