"""Browsers for `cost.py`: clients that speak the page's and viser's protocols, and a real Chromium.

Both note for each scan that they received and decoded how long ago it was published, and how many
updates of the particles came.
"""

import asyncio
import contextlib
import re
import secrets
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
from playwright.async_api import Frame, async_playwright
from viser._messages import ViewerCameraMessage
from websockets.asyncio.client import ClientConnection, connect

CHROMIUM = Path("/usr/bin/chromium")
ARGUMENTS = [
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--no-sandbox",
]
SCAN_NODE, PARTICLE_NODE, ROBOT_NODE = "/scan/points", "/particles/arrows", "/robot/base_link"
PICTURE = "/floor", "/robot/base_link/body"
"""How the names of the nodes end without which a picture is of no use; a map has a number."""
SECRET = re.compile(r'data-secret="(\w+)"')
"""By which viser's connection is known to be the same page's."""


@dataclass
class Seen:
    """What one browser received since `clear`."""

    since_s: float = field(default_factory=time.perf_counter)
    ages_s: list[float] = field(default_factory=list)
    """Of each scan, when it was decoded."""
    poses_s: list[float] = field(default_factory=list[float])
    """Of each place of the robot, its age when it was decoded."""
    stops_s: list[float] = field(default_factory=list[float])
    """How long each press of Stop took to be answered."""
    num_particles: int = 0
    num_bytes: int = 0
    """Over viser's connection."""
    num_line_bytes: int = 0
    """Over the life line, as it is unpacked."""

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
    """Receives and decodes all that a page is sent, on both its connections, and draws nothing."""

    def __init__(self, url: str, headers: dict[str, str] | None = None) -> None:
        """Connect with `run`; with `headers`, such as a cookie."""
        self._url = url.replace("http", "ws")
        self._headers = headers or {}
        self._line: asyncio.Future[ClientConnection] = asyncio.get_running_loop().create_future()
        self._stops: dict[int, float] = {}
        self._zstd = zstandard.ZstdDecompressor()
        self._secret: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self.seen = Seen()
        self.is_robot_there = asyncio.Event()
        """Whether the map and the robot have come, and where it is."""
        self._nodes: set[str] = set()
        """The nodes of the scene that have come."""
        self.is_reading = asyncio.Event()
        self.is_reading.set()

    def clear(self) -> None:
        """Count anew."""
        self.seen = Seen()

    async def run(self) -> None:
        """Receive until it is cancelled; does not read while `is_reading` is not set."""
        async with asyncio.TaskGroup() as both:
            both.create_task(self._hold_line())
            both.create_task(self._watch_scene())

    async def _hold_line(self) -> None:
        """Answer beats, and claim the scene as soon as its secret is known."""
        key = secrets.token_hex(16)
        url = f"{self._url}/line?page={key}"
        async with connect(url, additional_headers=self._headers, max_size=None) as socket:
            self._line.set_result(socket)
            claims = asyncio.create_task(self._claim(socket))
            try:
                async for data in socket:
                    await self._hear(socket, data)
                await claims
            finally:
                claims.cancel()

    async def _hear(self, socket: ClientConnection, data: str | bytes) -> None:
        self.seen.num_line_bytes += len(data)
        told = msgspec.json.decode(data)
        if "beat_ms" in told:
            await socket.send(msgspec.json.encode({"beat_ms": told["beat_ms"]}).decode())
        if "answer" in told and told["answer"]["id"] in self._stops:
            pressed_s = self._stops.pop(told["answer"]["id"])
            self.seen.stops_s.append(time.monotonic() - pressed_s)

    async def press_stop(self, robot: str) -> None:
        """Press Stop; how long its answer takes is noted."""
        socket = await self._line
        number = len(self._stops) + 1000 + len(self.seen.stops_s)
        self._stops[number] = time.monotonic()
        said = {"stop": {"id": number, "robots": [robot]}}
        await socket.send(msgspec.json.encode(said).decode())

    async def _claim(self, socket: ClientConnection) -> None:
        await socket.send(msgspec.json.encode({"scene": await self._secret}).decode())

    async def _watch_scene(self) -> None:
        protocol: Any = f"viser-v{viser.__version__}"
        url = f"{self._url}/scene/"
        async with connect(
            url, subprotocols=[protocol], additional_headers=self._headers, max_size=None
        ) as socket:
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
            if "data-secret" in str(message.get("props", "")) and not self._secret.done():
                self._secret.set_result(SECRET.findall(str(message["props"]))[0])
            name, updates = message.get("name") or "", message.get("updates")
            if "props" in message:
                self._nodes.add(name)
            if message["type"] == "SetPositionMessage" and name.endswith(ROBOT_NODE):
                self.seen.poses_s.append((now_s - message["position"][1]) % SPAN_S)
                if all(any(one.endswith(node) for one in self._nodes) for node in PICTURE):
                    self.is_robot_there.set()
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

WATCH_SCENE = f"""
if (location.pathname === "/scene/") {{
  const make = URL.createObjectURL.bind(URL), Plain = window.Worker;
  const now = () => (performance.timeOrigin + performance.now()) / 1000;
  const missing = new Set({list(PICTURE)});
  const {{marks}} = top;
  addEventListener("DOMContentLoaded", () => {{ marks.loaded = now(); }});
  URL.createObjectURL = (thing) => make(
    thing instanceof Blob && thing.type.includes("javascript")
      ? new Blob([`{IN_WORKER}`, thing], {{type: thing.type}}) : thing);
  window.Worker = class extends Plain {{
    constructor(...rest) {{
      super(...rest);
      this.addEventListener("message", (event) => {{
        if (event.data.type !== "message_batch" || missing.size === 0) return;
        for (const {{name, props}} of event.data.messages)
          for (const node of missing)
            if (props !== undefined && name?.endsWith(node)) missing.delete(node);
        if (missing.size > 0) return;
        marks.decoded = event.data.decoded_s;
        marks.taken = now();
        // What is taken is drawn with one of the next two pictures, and seen when the third begins.
        const draw = requestAnimationFrame;
        draw(() => draw(() => draw(() => {{ marks.drawn = now(); }})));
      }});
    }}
  }};
}}
"""
"""Notes in `marks` of the page when the map and the robot have come, and when they are drawn."""

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

    def __init__(self, scene: Frame) -> None:
        """Use `open_chromium`."""
        self._scene = scene
        self._since_s = 0.0

    async def clear(self) -> None:
        """Count anew."""
        await self._scene.evaluate("seen.scans = []; seen.particles = seen.frames = 0")
        self._since_s = time.perf_counter()

    async def seen(self) -> tuple[Seen, Seen, float]:
        """What came since: as decoded, as taken by the main thread; and the frames per second."""
        found = await self._scene.evaluate("seen")
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
        page = await browser.new_page(viewport={"width": 640, "height": 400})
        page.set_default_timeout(90_000)
        await page.add_init_script(WATCH)
        await page.goto(url)
        await page.get_by_text("Localized").first.wait_for()
        await page.locator("#scene-wait").wait_for(state="hidden")
        (scene,) = [frame for frame in page.frames if "/scene/" in frame.url]
        yield Chromium(scene)
        await browser.close()
