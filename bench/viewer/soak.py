"""Leave a browser open while the robot drives a tour without end: does anything grow?

    python -m bench.viewer.soak --minutes 30

Every 10 s it reads the memory of the viewer's process, of the page's JavaScript and of the
browser's process behind it. What grows is told from what swings by the slope of a line through the
second half, when everything has been touched once: in two minutes 90 MB an hour seem to grow, in
half an hour 4. Needs Debian's Chromium.
"""

import argparse
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from bench.harness.figures import Figure, at_least, at_most, show
from bench.harness.paths import ROOT
from bench.viewer.clients import ARGUMENTS, CHROMIUM
from playwright.sync_api import Browser, CDPSession, sync_playwright

sys.path.append(str(ROOT / "tests"))
from support.demo import Demo
from support.processes import find_free_port
from support.waiting import wait_until

from trolley import requests, topics
from trolley.client import Robot
from trolley.messages import Stop, Tour
from trolley.messages.request_params import StartTour

PERIOD_S = 10.0
WARM_UP_S = 20.0
"""Until the page has loaded and drawn all that it keeps; only then growth means something."""
MB = 2**20


@dataclass(frozen=True)
class Reading:
    """Memory at one moment [MB]."""

    seconds: float
    server: float
    script: float
    page: float


def private_mb(pid: int) -> float:
    """What a process holds for itself, without files and what it shares with others."""
    (line,) = (
        one
        for one in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
        if one.startswith("Pss_Anon:")
    )
    return int(line.split()[1]) * 1024 / MB


def renderer_of(browser: Browser) -> int:
    """The process that draws the page: the largest of its kind."""
    session = browser.new_browser_cdp_session()
    found = session.send("SystemInfo.getProcessInfo")["processInfo"]
    return max((one["id"] for one in found if one["type"] == "renderer"), key=private_mb)


def script_mb(session: CDPSession) -> float:
    """What the page's JavaScript holds, without what it merely has not tidied up yet."""
    session.send("HeapProfiler.collectGarbage")
    metrics = session.send("Performance.getMetrics")["metrics"]
    return next(one["value"] for one in metrics if one["name"] == "JSHeapUsedSize") / MB


def growth(readings: list[Reading], what: str) -> float:
    """The slope over the second half [MB / h]."""
    half = readings[len(readings) // 2 :]
    hours = np.array([one.seconds for one in half]) / 3600.0
    return float(np.polyfit(hours, [getattr(one, what) for one in half], 1)[0])


def start_endless(robot: Robot) -> None:
    """Let the robot drive round forever."""
    saved = robot.latest(topics.POSES)
    assert saved is not None
    names = [one.name for one in saved.poses]
    stops = [Stop(name=name, on_failure="skip") for name in names]
    robot.ask(requests.TOUR_START, StartTour(tour=Tour(name="", stops=stops, repeat=0)))


def watch(demo: Demo, url: str, minutes: float) -> list[Reading]:
    """Look at the page for so long."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=str(CHROMIUM), args=ARGUMENTS)
        page = browser.new_page(viewport={"width": 480, "height": 400})
        page.set_default_timeout(120_000.0)
        page.goto(url)
        page.locator("#scene-wait").wait_for(state="hidden")
        time.sleep(WARM_UP_S)
        session = page.context.new_cdp_session(page)
        session.send("Performance.enable")
        renderer, began_s = renderer_of(browser), time.monotonic()
        readings: list[Reading] = []
        while (seconds := time.monotonic() - began_s) < 60.0 * minutes:
            reading = Reading(
                seconds,
                private_mb(demo.children()["viz"]),
                script_mb(session),
                private_mb(renderer),
            )
            readings.append(reading)
            print(
                f"{seconds / 60.0:6.1f} min  viewer {reading.server:6.1f} MB  "
                f"script {reading.script:6.1f} MB  page {reading.page:6.1f} MB",
                flush=True,
            )
            time.sleep(PERIOD_S)
        browser.close()
    return readings


def main() -> None:
    """Run the demo with its viewer and a browser, and print what grows."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=30.0)
    minutes = parser.parse_args().minutes
    with tempfile.TemporaryDirectory() as folder:
        port = find_free_port()
        demo = Demo(Path(folder), "--viz-port", str(port), "--seed", "5")
        robot = Robot(demo.name, [demo.endpoint])
        try:
            wait_until(
                lambda: (
                    (stored := robot.latest(topics.TOURS)) is not None
                    and len(stored.tours) > 0
                    and (pose := robot.latest(topics.POSE)) is not None
                    and pose.state == "localized"
                ),
                "the robot is localized, and its places and tour are stored",
            )
            start_endless(robot)
            readings = watch(demo, f"http://127.0.0.1:{port}", minutes)
            truth, trip = robot.latest(topics.SIM_TRUTH), robot.latest(topics.TOUR)
        finally:
            robot.close()
            demo.end()
    laps = 0 if trip is None else trip.lap
    show(
        [
            Figure("readings", f"{len(readings)}"),
            Figure("rounds driven", f"{laps}"),
            at_most("growth of the viewer", growth(readings, "server"), 10.0, "MB/h", 1),
            at_most("growth of the page's script", growth(readings, "script"), 10.0, "MB/h", 1),
            at_most("growth of the page's process", growth(readings, "page"), 20.0, "MB/h", 1),
            at_least("rounds", laps, 1 if minutes >= 5 else 0, "", 0),
            at_most("collisions", -1 if truth is None else truth.collisions, 0, "", 0),
        ]
    )


if __name__ == "__main__":
    main()
