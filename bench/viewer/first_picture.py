"""How long it takes until a page that is opened for the first time shows the map and the robot.

    python -m bench.viewer.first_picture [--runs 5]

Real processes: a router, a pretend robot (see `pretend_robot.py`) and the viewer; then the page in
Chromium with an empty cache, each time anew. The same is asked for by a client that draws nothing
(see `clients.py`), one file after the other: what it needs is what network and viewer take. What
Chromium needs besides is for reading the scripts and drawing, which it does in software here.
"""

import argparse
import asyncio
import os
import re
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import aiohttp
from bench.harness.figures import Figure, at_most, show
from bench.viewer.clients import ARGUMENTS, CHROMIUM, WATCH_SCENE, ProtocolClient
from bench.viewer.cost import Used, started
from playwright.async_api import Browser, async_playwright

MAX_PICTURE_S, MAX_SHELL_KB = 2.0, 300.0
WIDTH, HEIGHT = 1440, 900
PATIENCE_S = 60.0
FILE = re.compile(r'(?:from "\.|(?:src|href)="/page)(/[\w./-]+)"')
"""Files that a page or a module of ours names."""
NOW = "(performance.timeOrigin + performance.now()) / 1000"
WATCH_SHELL = f"""
if (window === top) {{
  window.marks = {{}};
  const look = setInterval(() => {{
    const lines = document.getElementById("lines"), frame = document.getElementById("scene");
    if (lines?.textContent.includes("Localized")) marks.sentence ??= {NOW};
    if (frame?.src) marks.frame ??= {NOW};
    if (marks.sentence && marks.frame) clearInterval(look);
  }}, 10);
}}
"""
"""Notes when the page says where the robot is, and when it asks for viser's page."""


async def without_browser(url: str) -> tuple[float, float, float]:
    """Fetch all that a page needs: how long it takes [s], sizes of page and scene [B]."""
    began_s = time.perf_counter()
    sizes: dict[str, int] = {}
    async with aiohttp.ClientSession(headers={"Accept-Encoding": "gzip"}) as session:
        waiting = ["/"]
        while waiting:
            path = waiting.pop()
            async with session.get(url + path) as answer:
                text = await answer.text(errors="replace")
                sizes[path] = len(text.encode())
            if path == "/" or path.endswith(".js"):
                found = {f"/page{name}" for name in FILE.findall(text)}
                waiting += found - sizes.keys() - set(waiting)
        shell = sum(sizes.values())
        async with session.get(f"{url}/scene/") as answer:
            scene = len(await answer.read())
    client = ProtocolClient(url)
    running = asyncio.create_task(client.run())
    await asyncio.wait_for(client.is_robot_there.wait(), PATIENCE_S)
    needed_s = time.perf_counter() - began_s
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
    return needed_s, shell, scene


async def in_chromium(browser: Browser, url: str) -> dict[str, float]:
    """Open the page with an empty cache; what happened when [s], and bytes received."""
    context = await browser.new_context(viewport={"width": WIDTH, "height": HEIGHT})
    page = await context.new_page()
    await page.add_init_script(WATCH_SHELL)
    await page.add_init_script(WATCH_SCENE)
    cdp = await context.new_cdp_session(page)
    await cdp.send("Network.enable")
    received = {"shell": 0.0, "scene": 0.0}
    is_scene: dict[str, bool] = {}

    def note_request(event: Any) -> None:
        is_scene[event["requestId"]] = "/scene/" in event["request"]["url"]

    def note_end(event: Any) -> None:
        of_scene = is_scene.get(event["requestId"], False)
        received["scene" if of_scene else "shell"] += event["encodedDataLength"]

    cdp.on("Network.requestWillBeSent", note_request)
    cdp.on("Network.loadingFinished", note_end)
    await page.goto(url, wait_until="commit")
    began_s = await page.evaluate("performance.timeOrigin / 1000")
    marks = await _marks(page)
    await context.close()
    return {name: at_s - began_s for name, at_s in marks.items()} | received


async def _marks(page: Any) -> dict[str, float]:
    """What was noted, once the picture is drawn."""
    end_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < end_s:
        await asyncio.sleep(0.2)
        marks = await page.evaluate("window.marks")
        if "drawn" in marks:
            return marks
    raise TimeoutError(f"no picture within {PATIENCE_S:.0f} s")


def told(runs: list[dict[str, float]], plain_s: list[float], sizes: tuple[float, float]) -> None:
    """Print the medians of all runs."""

    def median(name: str) -> float:
        return statistics.median(run[name] for run in runs)

    show(
        [
            at_most("map and robot drawn", median("drawn"), MAX_PICTURE_S, "s", 2),
            Figure("  the page says where the robot is", f"{median('sentence'):.2f} s"),
            Figure("  it asks for the scene's page", f"{median('frame'):.2f} s"),
            Figure("  the scene's page is there", f"{median('loaded'):.2f} s"),
            Figure("  map and robot are decoded", f"{median('decoded'):.2f} s"),
            Figure("  the thread that draws takes them", f"{median('taken'):.2f} s"),
            Figure("of it drawing, in software", f"{median('drawn') - median('taken'):.2f} s"),
            Figure("of it network and viewer alone", f"{statistics.median(plain_s):.2f} s"),
            at_most("received before the scene", median("shell") / 1e3, MAX_SHELL_KB, "kB", 0),
            Figure("received for the scene's page", f"{median('scene') / 1e3:.0f} kB"),
            Figure("files of the page, unpacked", f"{sizes[0] / 1e3:.0f} kB"),
            Figure("viewer: CPU of one opening", f"{median('cpu'):.2f} s"),
        ]
    )


async def measure(num_runs: int) -> None:
    """All of it."""
    print(f"load of this machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    with tempfile.TemporaryDirectory() as folder, started(Path(folder)) as (viewer, url):
        await asyncio.sleep(3.0)
        plain_s: list[float] = []
        sizes = 0.0, 0.0
        for _ in range(num_runs):
            needed_s, *sizes = await without_browser(url)
            plain_s.append(needed_s)
        if not CHROMIUM.exists():
            print(f"skipped: {CHROMIUM} is not installed")
            return
        async with async_playwright() as playwright:
            browser = await playwright.chromium.launch(
                executable_path=str(CHROMIUM), args=ARGUMENTS
            )
            runs = [await _opened(browser, viewer, url) for _ in range(num_runs)]
            await browser.close()
    told(runs, plain_s, (sizes[0], sizes[1]))


async def _opened(browser: Browser, viewer: Used, url: str) -> dict[str, float]:
    """Open it once, and note what that costs the viewer [s of a core]."""
    viewer.begin()
    began_s = time.perf_counter()
    marks = await in_chromium(browser, url)
    return marks | {"cpu": viewer.cpu * (time.perf_counter() - began_s)}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=5)
    asyncio.run(measure(parser.parse_args().runs))


if __name__ == "__main__":
    main()
