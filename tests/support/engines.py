"""Browsers with other engines than Chromium: Firefox over WebDriver BiDi, WebKit over WebDriver."""

import base64
import io
import itertools
import json
import os
import shutil
import subprocess
import urllib.request
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from websockets.sync.client import connect

from support.processes import find_free_port
from support.waiting import PATIENCE_S, wait_until

Step = dict[str, Any]
SIZE = (450, 780)
"""The window [px]: as small as WebKitGTK's own browser can be, and the page is as on a phone."""


class Engine(ABC):
    """A page in another browser."""

    @abstractmethod
    def open(self, url: str) -> None:
        """Open a page."""

    @abstractmethod
    def ask(self, expression: str) -> Any:
        """What an expression is worth in the page."""

    @abstractmethod
    def act(self, kind: str, *steps: Step) -> None:
        """Take steps with a "pointer" or "key", as WebDriver describes them; what is held stays."""

    @abstractmethod
    def picture(self) -> NDArray[np.int64]:
        """What is seen, as (height, width, 3): red, green, blue, 0 to 255."""

    def middle(self, selector: str) -> tuple[int, int]:
        """Where the middle of an element is."""
        box = f"document.querySelector({json.dumps(selector)}).getBoundingClientRect()"
        left, top, width, height = self.ask(f"(b => [b.x, b.y, b.width, b.height])({box})")
        return round(left + width / 2), round(top + height / 2)

    def press(self, selector: str, *by: tuple[int, int]) -> None:
        """Press an element and move by so much, without letting go."""
        x, y = self.middle(selector)
        steps = [move(x, y), {"type": "pointerDown", "button": 0}]
        self.act("pointer", *steps, *(move(x + dx, y + dy) for dx, dy in by))

    def let_go(self) -> None:
        """Let go of what is pressed."""
        self.act("pointer", {"type": "pointerUp", "button": 0})


def move(x: int, y: int) -> Step:
    return {"type": "pointerMove", "x": x, "y": y, "duration": 50}


def source(kind: str, steps: Sequence[Step]) -> Step:
    """What acts, as WebDriver names it."""
    pointing = {"parameters": {"pointerType": "mouse"}} if kind == "pointer" else {}
    return {"type": kind, "id": kind, "actions": steps, **pointing}


def pixels(png: str) -> NDArray[np.int64]:
    return np.array(Image.open(io.BytesIO(base64.b64decode(png))).convert("RGB"), np.int64)


@contextmanager
def running(command: Sequence[str], **environment: str) -> Iterator[None]:
    """A program, with all that it starts itself."""
    env = {**os.environ, **environment}
    process = subprocess.Popen(
        command, env=env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        yield
    finally:
        process.terminate()
        process.wait(PATIENCE_S)


class Firefox(Engine):
    """Firefox, over a socket."""

    def __init__(self, port: int) -> None:
        self._socket = wait_until(lambda: self._connect(port), "Firefox listens")
        self._numbers = itertools.count()
        self._send("session.new", capabilities={})
        tree = self._send("browsingContext.getTree")
        self._context = tree["contexts"][0]["context"]
        width, height = SIZE
        viewport = {"width": width, "height": height}
        self._send("browsingContext.setViewport", context=self._context, viewport=viewport)

    @staticmethod
    def _connect(port: int) -> Any:
        with suppress(ConnectionRefusedError):
            return connect(f"ws://127.0.0.1:{port}/session", max_size=None)
        return None

    def _send(self, method: str, **params: Any) -> dict[str, Any]:
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": params}))
        while (told := json.loads(self._socket.recv(PATIENCE_S))).get("id") != number:
            pass  # it tells of what happens, too
        assert told["type"] == "success", told
        return told["result"]

    def open(self, url: str) -> None:
        self._send("browsingContext.navigate", context=self._context, url=url, wait="complete")

    def ask(self, expression: str) -> Any:
        answer = self._send(
            "script.evaluate",
            expression=f"JSON.stringify({expression})",
            target={"context": self._context},
            awaitPromise=False,
        )
        return json.loads(answer["result"]["value"])

    def act(self, kind: str, *steps: Step) -> None:
        self._send("input.performActions", context=self._context, actions=[source(kind, steps)])

    def picture(self) -> NDArray[np.int64]:
        answer = self._send("browsingContext.captureScreenshot", context=self._context)
        return pixels(answer["data"])


class WebKit(Engine):
    """WebKitGTK's own small browser, over HTTP."""

    def __init__(self, port: int, browser: Path) -> None:
        self._url = f"http://127.0.0.1:{port}/session"
        wanted = {"binary": str(browser), "args": ["--automation"]}
        asked = {"capabilities": {"alwaysMatch": {"webkitgtk:browserOptions": wanted}}}
        wait_until(lambda: self._listens(port), "WebKitWebDriver listens")
        self._url += "/" + self._send("POST", "", asked)["sessionId"]
        width, height = SIZE
        self._send("POST", "/window/rect", {"width": width, "height": height})

    @staticmethod
    def _listens(port: int) -> bool:
        with suppress(OSError):
            urllib.request.urlopen(f"http://127.0.0.1:{port}/status", timeout=PATIENCE_S).close()
            return True
        return False

    def _send(self, method: str, path: str, body: Any = None) -> Any:
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(self._url + path, data, method=method)
        with urllib.request.urlopen(request, timeout=PATIENCE_S) as answer:
            return json.load(answer)["value"]

    def open(self, url: str) -> None:
        self._send("POST", "/url", {"url": url})

    def ask(self, expression: str) -> Any:
        return self._send("POST", "/execute/sync", {"script": f"return {expression}", "args": []})

    def act(self, kind: str, *steps: Step) -> None:
        self._send("POST", "/actions", {"actions": [source(kind, steps)]})

    def picture(self) -> NDArray[np.int64]:
        return pixels(self._send("GET", "/screenshot"))

    def end(self) -> None:
        self._send("DELETE", "")


def missing(name: str) -> str:
    """What has to be installed for an engine, "" where it is there."""
    if name == "Firefox":
        return "" if shutil.which("firefox-esr") else "firefox-esr"
    has_all = shutil.which("WebKitWebDriver") and shutil.which("Xvfb") and _mini_browser()
    return "" if has_all else "webkit2gtk-driver and xvfb"


def _mini_browser() -> Path | None:
    return next(Path("/usr/lib").glob("*/webkit2gtk-4.*/MiniBrowser"), None)


@contextmanager
def engine(name: str, folder: Path) -> Iterator[Engine]:
    """A browser with its own new profile."""
    port = find_free_port()
    if name == "Firefox":
        options = ["--headless", "--no-remote", "--profile", str(folder)]
        with running(["firefox-esr", *options, "--remote-debugging-port", str(port)]):
            yield Firefox(port)
        return
    browser, display = _mini_browser(), f":{port}"
    assert browser is not None
    # Its sandbox asks for rights that containers do not give; viser knows no language "C.UTF-8".
    settings = {"DISPLAY": display, "LC_ALL": "C", "LIBGL_ALWAYS_SOFTWARE": "1"}
    settings |= {"WEBKIT_DISABLE_SANDBOX_THIS_IS_DANGEROUS": "1", "HOME": str(folder)}
    with (
        running(["Xvfb", display, "-screen", "0", "800x900x24", "-nolisten", "tcp"]),
        running(["WebKitWebDriver", f"--port={port}"], **settings),
    ):
        wait_until(Path(f"/tmp/.X11-unix/X{port}").exists, "Xvfb listens")
        webkit = WebKit(port, browser)
        try:
            yield webkit
        finally:
            webkit.end()
