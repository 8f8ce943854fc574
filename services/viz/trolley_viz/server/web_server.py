"""The web server behind the viewer: viser, on one address and port, behind a gate.

viser binds all interfaces, moves silently to the next port where its own is taken, talks to the
pages of any site and lets any visitor ask for a public tunnel; none of that is for a program that
drives a robot.
"""

import contextlib
import html
import io
import logging
import socket
import warnings
from collections.abc import Awaitable, Callable, Generator, Mapping
from http import HTTPStatus
from typing import Any, cast

import viser
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from trolley.config.viz import VizConfig
from trolley_viz.graphics import camera
from trolley_viz.server import visitors
from trolley_viz.server.access import AccessControl, AccessDecision, AccessRequest

HEADERS = {
    "X-Frame-Options": "SAMEORIGIN",  # nobody lays a page of his own over Stop
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
PAGE = """<!doctype html><meta charset="utf-8"><title>Trolley</title>
<meta name="viewport" content="width=device-width,initial-scale=1">
<meta name="color-scheme" content="light dark">
<body style="font:18px/1.5 system-ui,sans-serif;max-width:32em;margin:15vh auto;padding:0 1em">
<h1>Trolley</h1><p>{text}</p>{form}"""
ASKING = """<form><input name="token" placeholder="or paste the token here" autocomplete="off"
style="font:inherit;width:17em;max-width:100%;padding:.4em"> <button style="font:inherit;
padding:.4em 1em">Open</button></form>"""

MAX_UNSENT_BYTES = 16_384

Serve = Callable[[ServerConnection], Awaitable[None]]
"""Serves one browser's connection until either side closes it."""


class PortTaken(RuntimeError):
    """The viewer cannot listen on its port."""


class LocalServer(viser.ViserServer):
    """A viser server that never opens a tunnel to the outside."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refuse: a public address would let strangers drive the robot."""
        del verbose
        return None


def open_server(
    config: VizConfig, gate: AccessControl, sockets: Mapping[str, Serve] = {}
) -> LocalServer:
    """Serve the viewer at exactly the configured address.

    Args:
        config: the address.
        gate: who is let in.
        sockets: who serves the WebSocket of a path; viser's own is at "/".

    Raises:
        PortTaken: Something else listens there, or the address is not this host's.
    """
    _check_port(config.host, config.port)
    # A probe of the port, or a browser that leaves early, is no error of ours with a traceback.
    logging.getLogger("websockets.server").setLevel(logging.CRITICAL)
    # A browser may leave while something is said to it: nobody misses that.
    warnings.filterwarnings("ignore", "Queued a .* on a closed connection", UserWarning)
    # viser prints a banner whatever it is told; what people need to know stands in the log.
    with contextlib.redirect_stdout(io.StringIO()), _changed_serving(gate, sockets):
        server = LocalServer(host=config.host, port=config.port, verbose=False)
    if server.get_port() != config.port:
        close_server(server)
        raise PortTaken(f"port {config.port} on {config.host} has just been taken")
    configure_look(server.gui, dark=False)
    server.gui.set_panel_label("Trolley")
    server.gui.main_panel.dock_right()
    # Drawing the shadows would be most of the work for each picture, and nothing here needs one.
    server.scene.configure_default_lights(cast_shadow=False)
    # Set from the beginning: the first change moves the cameras that are there, later ones do not.
    camera.set_initial(server, camera.UNKNOWN_MAP)
    server.initial_camera.near = 0.1  # a distant near plane keeps flat layers from flickering
    server.initial_camera.far = 1000.0
    return server


def close_server(server: viser.ViserServer) -> None:
    """Stop serving."""
    with contextlib.redirect_stdout(io.StringIO()):  # its farewell, see above
        server.stop()


def configure_look(gui: viser.GuiApi, *, dark: bool) -> None:
    """Set the look of the page, without viser's own buttons."""
    gui.configure_theme(dark_mode=dark, show_logo=False, show_share_button=False)


@contextlib.contextmanager
def _changed_serving(gate: AccessControl, sockets: Mapping[str, Serve]) -> Generator[None]:
    """Put access control before viser's server, and serve more paths than its own.

    viser lets everybody in and does not ask which site's page talks to it; it has no place to say
    otherwise, so the check is put under it while it starts.
    """
    plain = websockets.asyncio.server.serve

    def serve(viser_serves: Serve, *args: Any, **options: Any) -> Any:
        viser_answers = options["process_request"]

        def answer(connection: ServerConnection, request: Request) -> Response | None:
            answered = gate.decide(_access_request(connection, request))
            if answered.status != HTTPStatus.OK:
                response = _sentence(answered)
            else:
                page: Response | None = viser_answers(connection, request)
                if page is None:
                    return None  # a socket: the handshake goes on
                response = page
            if answered.cookie:
                response.headers["Set-Cookie"] = answered.cookie
            for name, value in HEADERS.items():
                response.headers[name] = value
            return response

        async def route(connection: ServerConnection) -> None:
            request = connection.request
            assert request is not None  # the handshake is over
            visitor = gate.decide(_access_request(connection, request)).visitor
            assert visitor is not None  # as it was let in
            visitors.present.set(visitor)
            keep_backlog_short(connection.transport.get_extra_info("socket"))
            path = request.path.partition("?")[0]
            await sockets.get(path, viser_serves)(connection)

        return plain(route, *args, **{**options, "process_request": answer})

    websockets.asyncio.server.serve = cast(Any, serve)
    try:
        yield
    finally:
        websockets.asyncio.server.serve = plain


def keep_backlog_short(connection: socket.socket) -> None:
    """Limit how much the system buffers for a slow browser.

    viser leaves out what newer messages replace, but only of what it has not handed over; by
    default the system takes several megabytes, seconds of scans that nobody wants any more.
    """
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, MAX_UNSENT_BYTES)


def _sentence(answered: AccessDecision) -> Response:
    """Make the page that refuses somebody, or redirects."""
    form = ASKING if answered.status == HTTPStatus.UNAUTHORIZED else ""
    body = PAGE.format(text=html.escape(answered.text), form=form).encode()
    headers = Headers({"Content-Type": "text/html; charset=utf-8"})
    headers["Content-Length"] = str(len(body))
    if answered.location:
        headers["Location"] = answered.location
    return Response(answered.status, answered.status.phrase, headers, body)


def _access_request(connection: ServerConnection, request: Request) -> AccessRequest:
    peer = connection.remote_address
    return AccessRequest(
        path=request.path,
        peer=str(peer[0]) if peer else "",
        headers=request.headers,
        is_socket=request.headers.get("Upgrade", "").lower() == "websocket",
    )


def _check_port(host: str, port: int) -> None:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise PortTaken(f"cannot listen on {host}, port {port}: {error.strerror}") from error
