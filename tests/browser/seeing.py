"""What a page's picture shows: colours where points of the floor are seen, and what moves."""

import base64
import contextlib
import io
import math
import re
import time
from collections.abc import Callable, Generator, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Frame, Locator, Page, expect
from support.waiting import PATIENCE_S

from trolley.gridmap import GridMap, load_map
from trolley_viz.graphics.camera import FIELD_OF_VIEW, bounds_of, stand

WORLDS = Path(__file__).parents[2] / "worlds"

Pixels = NDArray[np.int64]
"""A picture (height, width, 3): red, green, blue, 0 to 255."""
Colour = Callable[[Pixels], NDArray[np.bool_]]
"""Says of pixels (..., 3) which have a colour (...)."""


def scene(page: Page) -> Frame:
    """The frame in which the scene is drawn."""
    return next(frame for frame in page.frames if "/scene/" in frame.url)


def canvas(page: Page) -> Locator:
    """What the scene is drawn on."""
    return scene(page).locator("canvas[data-engine]")


def pixel_of(
    page: Page, point: tuple[float, float], grid: GridMap | None = None
) -> tuple[float, float]:
    """Where a point of the floor is seen, with the camera that shows all of the map.

    The viewer gives it to a new browser; without `grid` the map is the apartment's.
    """
    grid = grid or load_map(WORLDS / "apartment.yaml")
    known = np.argwhere(grid.cells >= 0)
    low, high = known.min(axis=0), known.max(axis=0) + 1
    corners = np.array([low, high])[:, ::-1] * grid.resolution
    box = canvas(page).bounding_box()
    assert box is not None
    bounds = bounds_of(grid.origin.transform_points(corners))
    position, look_at = stand(bounds, box["width"] / box["height"])
    forward = (look_at - position) / np.linalg.norm(look_at - position)
    right = np.array([1.0, 0.0, 0.0])
    ray = np.array([*point, 0.0]) - position
    scale = 0.5 * box["height"] / math.tan(0.5 * FIELD_OF_VIEW) / float(ray @ forward)
    up = float(ray @ np.cross(right, forward))
    return (
        box["x"] + 0.5 * box["width"] + scale * float(ray @ right),
        box["y"] + 0.5 * box["height"] - scale * up,
    )


def wait_for_frames(page: Page) -> None:
    """Let what was put into the scene be drawn; without a graphics card that takes a while."""
    scene(page).evaluate(
        "async () => { for (let i = 0; i < 4; i++) await new Promise(requestAnimationFrame) }"
    )


@contextlib.contextmanager
def undrawn(page: Page, period_ms: float = 1000.0) -> Generator[None]:
    """Hardly draw the scene meanwhile: without a graphics card that takes most of a processor."""
    frame = scene(page)
    frame.evaluate(f"framePeriod = {period_ms}")
    yield
    frame.evaluate("framePeriod = 250")


def picture(page: Page) -> Pixels:
    """What is seen now."""
    return pixels_of(page.screenshot())


def pixels_of(png: bytes) -> Pixels:
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(np.int64)


def is_magenta(pixels: Pixels) -> NDArray[np.bool_]:
    """As no part of the page is."""
    red, green, blue = np.moveaxis(pixels, -1, 0)
    return (red > 120) & (blue > 120) & (green < 0.4 * red)


def is_purple(pixels: Pixels) -> NDArray[np.bool_]:
    """As echoes of what is not on the map."""
    red, green, blue = np.moveaxis(pixels, -1, 0)
    return (red > green + 60) & (blue > green + 60) & (blue > 140)


def is_green(pixels: Pixels) -> NDArray[np.bool_]:
    """As what belongs to the goal."""
    red, green, blue = np.moveaxis(pixels, -1, 0)
    return (green > red + 30) & (green > blue + 15)


def is_blue(pixels: Pixels) -> NDArray[np.bool_]:
    """As the robot and its outline."""
    red, green, blue = np.moveaxis(pixels, -1, 0)
    return (blue > red + 60) & (blue > green + 40)


def share_seen(
    page: Page, points: Iterable[tuple[float, float]], colour: Colour, reach: int = 2
) -> float:
    """The share of points of the floor that are seen in a colour, give or take `reach` pixels."""
    seen = colour(picture(page))
    found = [
        seen[y - reach : y + reach + 1, x - reach : x + reach + 1].any()
        for x, y in (map(round, pixel_of(page, point)) for point in points)
    ]
    return sum(found) / len(found)


def count_seen(page: Page, point: tuple[float, float], colour: Colour, reach_m: float) -> int:
    """How many pixels of a colour are seen around a point of the floor."""
    x, y = point
    left, bottom = pixel_of(page, (x - reach_m, y - reach_m))
    right, top = pixel_of(page, (x + reach_m, y + reach_m))
    return int(colour(picture(page))[round(top) : round(bottom), round(left) : round(right)].sum())


NOT_DONE = re.compile(r"Nothing was done|Press again|Check whether it was done|No current pose")
"""What the page says of a press that it, the viewer or the robot came round to too late."""
WATCH_LINE = """() => {
  window.wasLost = false;
  window.lineWatch ??= new MutationObserver(() => {
    window.wasLost ||= document.body.dataset.line !== "open";
  });
  lineWatch.observe(document.body, { attributeFilter: ["data-line"] });
  document.querySelectorAll(".notice").forEach((one) => one.remove());
}"""
"""Note whether the line is lost from now on: then keys and the pointer are for nothing."""
LATE_MS = 3000
"""What was only late has happened after this."""


def press(
    page: Page,
    push: Callable[[], object],
    happened: Callable[[], bool],
    what: str,
    again_s: float = math.inf,
) -> None:
    """Press something as a person does: again where the page says that nothing was done.

    `again_s`: press it again after so long without a word, as what moves away just then is pressed
    for nothing.
    """
    refused = page.locator(".notice", has_text=NOT_DONE)
    pushed_s = 0.0

    def push_anew() -> None:
        nonlocal pushed_s
        pushed_s = time.monotonic()
        expect(page.locator("body")).to_have_attribute("data-line", "open")
        page.evaluate(WATCH_LINE)
        push()

    def has_happened() -> bool:
        if happened():
            return True
        is_overdue = time.monotonic() > pushed_s + again_s
        if is_overdue or refused.count() > 0 or page.evaluate("wasLost"):
            page.wait_for_timeout(LATE_MS)
            if not happened():
                push_anew()
        return happened()

    push_anew()
    poll(page, has_happened, what)


def poll(page: Page, happened: Callable[[], bool], what: str) -> None:
    """As `wait_until`, but leaves the browser time to draw."""
    for _ in range(round(4 * PATIENCE_S)):
        if happened():
            return
        page.wait_for_timeout(250)
    raise AssertionError(what)


@contextlib.contextmanager
def filmed(page: Page) -> Generator[list[Pixels]]:
    """All pictures that the page draws meanwhile; they come while `page` waits."""
    frames: list[Pixels] = []
    session = page.context.new_cdp_session(page)

    def take(frame: dict[str, Any]) -> None:
        frames.append(pixels_of(base64.b64decode(frame["data"])))
        session.send("Page.screencastFrameAck", {"sessionId": frame["sessionId"]})

    session.on("Page.screencastFrame", take)
    session.send("Page.startScreencast", {"format": "png"})
    yield frames
    session.send("Page.stopScreencast")
    session.detach()
