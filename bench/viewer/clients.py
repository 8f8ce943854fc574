"""Browsers for `cost.py`: clients that speak viser's protocol, and a real Chromium.

Both note for each scan that they received and decoded how long ago it was published, and how many
updates of the particles came.
"""

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import viser
import zstandard
from bench.viewer.pretend_robot import NEAREST_M, SCAN_HZ, SPAN_S
from playwright.async_api import Page, async_playwright
from viser._messages import ViewerCameraMessage
from websockets.asyncio.client import connect

CHROMIUM = Path("/usr/bin/chromium")
ARGUMENTS = [
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--no-sandbox",
]
SCAN_NODE, PARTICLE_NODE = "/scan/points", "/particles/arrows"


@dataclass
class Seen:
    """What one browser received since `clear`."""

    since_s: float = field(default_factory=time.perf_counter)
    ages_s: list[float] = field(default_factory=list)
    """Of each scan, when it was decoded."""
    num_particles: int = 0
    num_bytes: int = 0

    def take_scan(self, first_x: float, now_s: float) -> None:
        """Note a scan by the x of its first point."""
        self.ages_s.append((now_s - (first_x - NEAREST_M)) % SPAN_S)

    @property
    def scans_hz(self) -> float:
        """Scans per second."""
        return len(self.ages_s) / (time.perf_counter() - self.since_s)

    @property
    def particles_hz(self) -> float:
        """Updates of the particles per second."""
        return self.num_particles / (time.perf_counter() - self.since_s)

    @property
    def backlog(self) -> int:
        """The most scans that were published and not yet decoded at any time."""
        return int(max(self.ages_s, default=SPAN_S) * SCAN_HZ)

    def percentile(self, percent: float) -> float:
        """Of the ages [s]; as long as can be told where nothing came."""
        return float(np.percentile(self.ages_s, percent)) if self.ages_s else SPAN_S


class ProtocolClient:
    """Receives and decodes all that viser sends, as the page does, and draws nothing."""

    def __init__(self, url: str) -> None:
        """Connect with `run`."""
        self._url = url.replace("http", "ws")
        self._zstd = zstandard.ZstdDecompressor()
        self.seen = Seen()
        self.is_reading = asyncio.Event()
        self.is_reading.set()

    def clear(self) -> None:
        """Count anew."""
        self.seen = Seen()

    async def run(self) -> None:
        """Receive until it is cancelled; does not read while `is_reading` is not set."""
        protocol: Any = f"viser-v{viser.__version__}"
        async with connect(self._url, subprotocols=[protocol], max_size=None) as socket:
            await socket.send(camera_message())
            while True:
                await self.is_reading.wait()
                data = await socket.recv()
                if isinstance(data, bytes):
                    self._take(data)

    def _take(self, data: bytes) -> None:
        self.seen.num_bytes += len(data)
        inner_size, packed = (int.from_bytes(data[i : i + 8], "little") for i in (0, 8))
        inner = self._zstd.decompress(data[16 : 16 + packed], max_output_size=inner_size)
        batch = msgspec.msgpack.decode(inner)
        at, offsets = 16 + packed, []
        for length in batch["binaryBufferLengths"]:
            at = -(-at // 8) * 8
            offsets.append(at)
            at += length
        now_s = time.time()
        for message in batch["messages"]:
            name, updates = message.get("name") or "", message.get("updates")
            if message["type"] != "SceneNodeUpdateMessage" or "points" not in updates:
                continue
            if name.endswith(SCAN_NODE):
                first = offsets[updates["points"]["__binary_index"]]
                self.seen.take_scan(float(np.frombuffer(data, "<f4", 1, first)[0]), now_s)
            elif name.endswith(PARTICLE_NODE):
                self.seen.num_particles += 1


def camera_message() -> bytes:
    """What a page says first; viser waits for it."""
    message = ViewerCameraMessage(
        wxyz=(1.0, 0.0, 0.0, 0.0),
        position=(0.0, 0.0, 10.0),
        fov=0.7,
        near=0.1,
        far=1000.0,
        image_height=400,
        image_width=400,
        look_at=(0.0, 0.0, 0.0),
        up_direction=(0.0, 0.0, 1.0),
    )
    return msgspec.msgpack.encode(message.as_serializable_dict())


IN_WORKER = """{
  const hand = self.postMessage.bind(self);
  self.postMessage = (data, transfer) => {
    data.decoded_s = (performance.timeOrigin + performance.now()) / 1000;
    hand(data, transfer);
  };
}"""
"""Runs in the worker in which viser receives and decodes, before viser's own script."""

WATCH = f"""
const make = URL.createObjectURL.bind(URL), Plain = window.Worker;
window.seen = {{scans: [], particles: 0, frames: 0}};
URL.createObjectURL = (thing) => make(
  thing instanceof Blob && thing.type.includes("javascript")
    ? new Blob([`{IN_WORKER}`, thing], {{type: thing.type}}) : thing);
window.Worker = class extends Plain {{
  constructor(...rest) {{
    super(...rest);
    this.addEventListener("message", (event) => {{
      if (event.data.type !== "message_batch") return;
      const taken_s = (performance.timeOrigin + performance.now()) / 1000;
      for (const {{type, name, updates}} of event.data.messages) {{
        if (type !== "SceneNodeUpdateMessage" || updates.points === undefined) continue;
        if (name.endsWith("{SCAN_NODE}"))
          seen.scans.push([updates.points[0], event.data.decoded_s, taken_s]);
        else if (name.endsWith("{PARTICLE_NODE}")) seen.particles++;
      }}
    }});
  }}
}};
(function count() {{ seen.frames++; requestAnimationFrame(count); }})();
"""
"""Notes when viser's worker has decoded a scan, and when the page's main thread, which also draws,
takes it."""


class Chromium:
    """A page in Debian's Chromium, rendered in software on a small canvas."""

    def __init__(self, page: Page) -> None:
        """Use `open_chromium`."""
        self._page = page
        self._since_s = 0.0

    async def clear(self) -> None:
        """Count anew."""
        await self._page.evaluate("seen.scans = []; seen.particles = seen.frames = 0")
        self._since_s = time.perf_counter()

    async def seen(self) -> tuple[Seen, Seen, float]:
        """What came since: as decoded, as taken by the main thread; and the frames per second."""
        found = await self._page.evaluate("seen")
        decoded = Seen(since_s=self._since_s, num_particles=found["particles"])
        taken = Seen(since_s=self._since_s)
        for first_x, decoded_s, taken_s in found["scans"]:
            decoded.take_scan(first_x, decoded_s)
            taken.take_scan(first_x, taken_s)
        return decoded, taken, found["frames"] / (time.perf_counter() - self._since_s)


@contextlib.asynccontextmanager
async def open_chromium(url: str) -> AsyncIterator[Chromium]:
    """Open the viewer in Chromium and wait until the robot is seen."""
    async with async_playwright() as playwright:
        browser = await playwright.chromium.launch(executable_path=str(CHROMIUM), args=ARGUMENTS)
        page = await browser.new_page(viewport={"width": 320, "height": 240})
        page.set_default_timeout(90_000)
        await page.add_init_script(WATCH)
        await page.goto(url)
        await page.get_by_text("Localized").first.wait_for()
        yield Chromium(page)
        await browser.close()
