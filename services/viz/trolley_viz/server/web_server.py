"""The web server: the page, its sockets and viser's scene, on one address behind access control.

viser binds where it is told, but lets everybody in, talks to the pages of any site, and lets any
visitor ask for a public tunnel; none of that is for a program that drives a robot. So it listens on
an address of this host that nobody can guess, and what goes to it and comes from it goes through
here.
"""

import asyncio
import base64
import contextlib
import errno
import hashlib
import html
import io
import logging
import re
import secrets
import socket
import threading
import warnings
from collections.abc import Awaitable, Callable
from http import HTTPStatus
from importlib import resources
from pathlib import Path
from typing import Any

import aiohttp
import viser
from aiohttp import web

from trolley import ports
from trolley.config.viz import VizConfig
from trolley_viz.graphics import camera
from trolley_viz.graphics.icons import icon_svg
from trolley_viz.languages.catalogue import ENGLISH, catalogues, known_language
from trolley_viz.languages.translator import translator_of
from trolley_viz.server.access import AccessControl, AccessDecision, AccessRequest
from trolley_viz.server.lines import Line, Lines
from trolley_viz.server.scene_buffer import LoopEvent, SceneBuffer
from trolley_viz.server.scene_link import SceneLink
from trolley_viz.server.sending import wait_for_room

PAGE = Path(str(resources.files("trolley_viz").joinpath("frontend")))
LANGUAGES = PAGE.parent / "languages"
SCENE = "/scene/"
"""Where viser's page is, in a frame of ours."""
HEADERS = {"Referrer-Policy": "no-referrer", "X-Content-Type-Options": "nosniff"}
PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
    "connect-src 'self'; frame-src 'self'; manifest-src 'self'; base-uri 'none'; "
    "form-action 'self'; frame-ancestors 'none'"
)
"""Nothing inline and nothing from elsewhere; nobody lays a page of his own over Stop."""
SCENE_POLICY = (
    "default-src 'self' 'unsafe-inline' 'unsafe-eval' blob: data:; frame-ancestors 'self'"
)
"""viser's page is one file with its script inside."""
REFUSAL = """<!doctype html><html lang="{language}"><meta charset="utf-8"><title>Trolley</title>
<meta name="viewport" content="width=device-width,initial-scale=1">
<style>{style}</style><main><h1>Trolley</h1><p>{text}</p>{form}</main>"""
REFUSAL_STYLE = (PAGE / "refusal.css").read_text(encoding="utf-8")
"""Inside of the page: who is refused gets no other file."""
REFUSAL_POLICY = (
    "default-src 'none'; style-src 'sha256-"
    + base64.b64encode(hashlib.sha256(REFUSAL_STYLE.encode()).digest()).decode()
    + "'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
COMMAND = re.compile("`([^`]+)`")
"""What is to be typed in a terminal, as our texts mark it."""
ASKING = """<form><label>{paste} <input name="token" autocomplete="off"></label>
<button>{open}</button></form>"""

KEEP = {"Cache-Control": "max-age=86400"}
KEEP_PRIVATE = {"Cache-Control": "private, max-age=86400"}
"""A photo never changes, and is for whoever was let in."""
MAX_LINE_BYTES = 20_000
"""Nobody types more into a field."""
MAX_KEY = 64
MAX_UNSENT_BYTES = 16_384
"""What is buffered for a slow browser cannot be replaced by anything newer."""
SCENE_BUFFER_BYTES = 16_384
"""What waits between viser and here; viser drops what is old only before it."""
LET_IN_S = 0.02
"""How long it takes to let somebody in who has called: some turns of the loop [s]."""
CHUNK_BYTES = 8192
"""Viser's page is sent in pieces of this size."""
SEGMENT_BYTES = 1460
"""Size of a segment on Ethernet [bytes]; on one host they are large, and the system lets ten of
them wait."""
MAX_SCENE_REPLY_BYTES = 1 << 20
"""A browser answers viser with its camera and with where it was pressed."""


DECISION = web.RequestKey("decision", AccessDecision)
"""What was decided on a request."""


FetchPhoto = Callable[[str, str], Awaitable[bytes | None]]

AMBIENT_LIGHT = 2.0
"""How bright what viser's lamps leave dark is, as three.js counts."""


class PortTaken(RuntimeError):
    """The viewer cannot listen on its port."""


class SceneServer(viser.ViserServer):
    """A viser server that sends at once and never opens a tunnel to the outside."""

    def __init__(self, host: str, port: int) -> None:
        """Open it, and say nothing of it."""
        super().__init__(host, port, verbose=False)
        buffer = self._websock_server.get_message_buffer()
        buffer.__class__ = SceneBuffer
        buffer.message_event = LoopEvent(buffer.event_loop)

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refuse: a public address would let strangers drive the robot."""
        del verbose
        return None


def open_scene() -> SceneServer:
    """Open viser's server, at an address of this host that is drawn by chance."""
    # A browser that leaves early is no error of ours with a traceback.
    logging.getLogger("websockets.server").setLevel(logging.CRITICAL)
    # A browser may leave while something is said to it: nobody misses that.
    warnings.filterwarnings("ignore", "Queued a .* on a closed connection", UserWarning)
    host = "127." + ".".join(str(1 + secrets.randbelow(254)) for _ in range(3))
    with socket.socket() as probe:
        probe.bind((host, 0))
        port = probe.getsockname()[1]
    # viser prints a banner whatever it is told; what people need to know stands in the log.
    with contextlib.redirect_stdout(io.StringIO()):
        scene = SceneServer(host, port)
    scene.gui.configure_theme(show_logo=False, show_share_button=False)
    # Drawing the shadows would be most of the work for each picture, and nothing here needs one.
    scene.scene.configure_default_lights(cast_shadow=False)
    # Nor a picture of surroundings to be lit by: to prepare it takes a weak processor seconds.
    scene.scene.configure_environment_map(None)
    scene.scene.add_light_ambient("/light", intensity=AMBIENT_LIGHT)
    # Set from the beginning: the first change moves the cameras that are there, later ones do not.
    camera.set_initial(scene, camera.UNKNOWN_MAP)
    scene.initial_camera.near = 0.1  # a distant near plane keeps flat layers from flickering
    scene.initial_camera.far = 1000.0
    return scene


def close_scene(scene: viser.ViserServer) -> None:
    """Stop viser's server."""
    with contextlib.redirect_stdout(io.StringIO()):  # its farewell, see above
        scene.stop()


class WebServer:
    """Serves the viewer at exactly the configured address, on a thread of its own.

    Args:
        config: the address.
        access: who is let in.
        lines: serves the sockets of the pages.
        scene: viser's server.
        photo: fetches a robot's photo by its name, None where there is none.

    Raises:
        PortTaken: Something else listens there, or the address is not this host's.
    """

    def __init__(
        self,
        config: VizConfig,
        access: AccessControl,
        lines: Lines,
        scene: viser.ViserServer,
        photo: FetchPhoto,
    ) -> None:
        self._access = access
        self._fetch_photo = photo
        self._lines = lines
        self._scene = f"{scene.get_host()}:{scene.get_port()}"
        self._socket = _bind(config.host, config.port)
        self._loop = asyncio.new_event_loop()
        self._ends = asyncio.Event()
        started = threading.Event()
        self._thread = threading.Thread(
            target=lambda: self._loop.run_until_complete(self._run(started)),
            name="web",
            daemon=True,
        )
        self._thread.start()
        started.wait()

    def close(self) -> None:
        """Close all connections and stop serving."""
        self._loop.call_soon_threadsafe(self._ends.set)
        self._thread.join()
        self._loop.close()

    async def _run(self, started: threading.Event) -> None:
        app = web.Application(middlewares=[self._check])
        app.on_response_prepare.append(_add_headers)
        app.router.add_get("/", _index)
        app.router.add_get("/line", self._line)
        app.router.add_get("/page/icon/{name}.svg", _icon)
        app.router.add_get("/page/words/{language}.json", _words)
        app.router.add_static("/page/", PAGE)
        app.router.add_get("/photo/{robot}/{name}", self._photo)
        app.router.add_get(SCENE + "{path:.*}", self._pass_to_scene)
        runner = web.AppRunner(app, handle_signals=False, access_log=None, shutdown_timeout=0.5)
        await runner.setup()
        await web.SockSite(runner, self._socket).start()
        async with aiohttp.ClientSession(
            connector=aiohttp.TCPConnector(limit=0, socket_factory=_small_socket),
            auto_decompress=False,
        ) as self._to_scene:
            started.set()
            await self._ends.wait()
            # Who is being let in while the server closes would never be closed (gh-109564).
            self._loop.remove_reader(self._socket)
            await asyncio.sleep(LET_IN_S)
            await runner.cleanup()

    @web.middleware
    async def _check(
        self, request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
    ) -> web.StreamResponse:
        decided = self._access.decide(
            AccessRequest(
                path=request.path_qs,
                peer=request.remote or "",
                headers=request.headers,
                is_socket=request.headers.get("Upgrade", "").lower() == "websocket",
            )
        )
        request[DECISION] = decided
        if decided.status != HTTPStatus.OK:
            return _refusal(decided, request.headers.get("Accept-Language", ""))
        try:
            return await handler(request)
        except ConnectionResetError:  # a browser that leaves early is no error of ours
            return web.Response(status=HTTPStatus.REQUEST_TIMEOUT)

    async def _line(self, request: web.Request) -> web.StreamResponse:
        if not _wants_socket(request):
            raise web.HTTPUpgradeRequired
        # The first word is all controls: five times as much without compression.
        socket = web.WebSocketResponse(max_msg_size=MAX_LINE_BYTES, compress=True)
        await socket.prepare(request)
        _keep_backlog_short(request)
        transport, visitor = request.transport, request[DECISION].visitor
        if transport is not None and visitor is not None:
            key = request.query.get("page", "")[:MAX_KEY]
            await self._lines.serve(Line(socket, transport, key, visitor))
        return socket

    async def _pass_to_scene(self, request: web.Request) -> web.StreamResponse:
        if _wants_socket(request):
            return await self._join_with_scene(request)
        if request.match_info["path"]:
            raise web.HTTPNotFound  # viser's page is one file
        accepts = {"Accept-Encoding": request.headers.get("Accept-Encoding", "identity")}
        async with self._to_scene.get(f"http://{self._scene}/", headers=accepts) as answer:
            body = await answer.read()
            encoding = answer.headers.get("Content-Encoding", "identity")
        page = web.StreamResponse(headers={"Content-Encoding": encoding, "ETag": _etag(body)})
        if request.headers.get("If-None-Match") == page.headers["ETag"]:
            raise web.HTTPNotModified
        page.content_type = "text/html"
        await _write_slowly(request, page, body)
        return page

    async def _photo(self, request: web.Request) -> web.StreamResponse:
        found = request.match_info
        jpeg = await self._fetch_photo(found["robot"], found["name"])
        if jpeg is None:
            raise web.HTTPNotFound
        answer = web.StreamResponse(headers=KEEP_PRIVATE)
        answer.content_type = "image/jpeg"
        await _write_slowly(request, answer, jpeg)
        return answer

    async def _join_with_scene(self, request: web.Request) -> web.StreamResponse:
        """Connect a browser with viser, and pass on what each says."""
        asked = request.headers.get("Sec-WebSocket-Protocol", "")
        protocols = [name.strip() for name in asked.split(",") if name.strip()]
        browser = web.WebSocketResponse(
            protocols=protocols, max_msg_size=MAX_SCENE_REPLY_BYTES, compress=False
        )
        async with self._to_scene.ws_connect(
            f"ws://{self._scene}/", protocols=protocols, max_msg_size=0, compress=0
        ) as scene:
            await browser.prepare(request)
            _keep_backlog_short(request)
            transport = request.transport
            if transport is not None:
                await SceneLink(browser, transport, scene).run()
            await browser.close()
        return browser


async def _index(_: web.Request) -> web.StreamResponse:
    text = (PAGE / "index.html").read_text(encoding="utf-8")
    text = text.replace("{build}", BUILD).replace("{languages}", " ".join(catalogues()))
    return web.Response(text=text, content_type="text/html")


async def _write_slowly(request: web.Request, answer: web.StreamResponse, body: bytes) -> None:
    """Write what is larger than all else, so that what is small gets past it."""
    answer.content_length = len(body)
    await answer.prepare(request)
    for start in range(0, len(body), CHUNK_BYTES):
        if request.transport is not None:
            await wait_for_room(request.transport, CHUNK_BYTES)
        await answer.write(body[start : start + CHUNK_BYTES])


async def _words(request: web.Request) -> web.StreamResponse:
    """Say what the page's own words are in another language."""
    catalogue = catalogues().get(request.match_info["language"])
    if catalogue is None:
        raise web.HTTPNotFound
    return web.json_response(catalogue.page)


async def _icon(request: web.Request) -> web.StreamResponse:
    """Draw a Tabler icon, for the page to colour."""
    svg = icon_svg(request.match_info["name"])
    if svg is None:
        raise web.HTTPNotFound
    return web.Response(text=svg, content_type="image/svg+xml", headers=KEEP)


async def _add_headers(request: web.Request, response: web.StreamResponse) -> None:
    response.headers.update(HEADERS)
    is_scene = request.path.startswith(SCENE)
    policy = SCENE_POLICY if is_scene else PAGE_POLICY
    response.headers.setdefault("Content-Security-Policy", policy)
    response.headers["X-Frame-Options"] = "SAMEORIGIN" if is_scene else "DENY"
    response.headers.setdefault("Cache-Control", "no-cache")
    decided = request.get(DECISION)
    if decided is not None and decided.cookie:
        response.headers["Set-Cookie"] = decided.cookie


def _refusal(decided: AccessDecision, tags: str) -> web.Response:
    """Make the page that refuses somebody in one of their languages, or sends them on."""
    codes = (known_language(tag.strip()) for tag in tags.split(","))
    language = next(filter(None, codes), ENGLISH)
    words = translator_of(language)
    say = str if words is None else words.text
    is_asking = decided.status == HTTPStatus.UNAUTHORIZED
    asking = ASKING.format(paste=say("or paste the token here"), open=say("Open"))
    text = REFUSAL.format(
        language=language,
        style=REFUSAL_STYLE,
        text=COMMAND.sub(r"<code>\1</code>", html.escape(say(decided.text))),
        form=asking if is_asking else "",
    )
    headers = {"Content-Security-Policy": REFUSAL_POLICY}
    if decided.location:
        headers["Location"] = decided.location
    return web.Response(text=text, status=decided.status, content_type="text/html", headers=headers)


def _etag(body: bytes) -> str:
    return f'"{hashlib.sha256(body).hexdigest()[:16]}"'


def _wants_socket(request: web.Request) -> bool:
    return request.headers.get("Upgrade", "").lower() == "websocket"


def _small_socket(address: tuple[Any, ...]) -> socket.socket:
    """Return a socket to viser on which little waits; the system counts in segments."""
    connection = socket.socket(*address[:3])  # family, kind, protocol
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, SCENE_BUFFER_BYTES)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_MAXSEG, SEGMENT_BYTES)
    return connection


def _keep_backlog_short(request: web.Request) -> None:
    """Limit how much the system buffers for a slow browser.

    By default it takes several megabytes, seconds of scans that nobody wants any more.
    """
    transport = request.transport
    if transport is not None:
        connection: socket.socket = transport.get_extra_info("socket")
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, MAX_UNSENT_BYTES)
        transport.set_write_buffer_limits(high=MAX_UNSENT_BYTES)


def _bind(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
        listener.listen()
    except OSError as error:
        listener.close()
        why = f"cannot listen on {host}, port {port}: {error.strerror}"
        if error.errno == errno.EADDRINUSE:
            why = f"{ports.taken(port)}; end it, or change `[viz] port`"
        raise PortTaken(why) from error
    return listener


def _build() -> str:
    """Return what tells this page from an older one that is still open."""
    digest = hashlib.sha256()
    for path in sorted([*PAGE.rglob("*"), *LANGUAGES.glob("*.toml")]):
        if path.is_file():
            digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


BUILD = _build()
