"""The web server behind the viewer: viser, on one address and port, closed to everybody else.

viser binds all interfaces, moves silently to the next port where its own is taken, talks to the
pages of any site and lets any visitor ask for a public tunnel; none of that is for a program that
drives a robot.
"""

import contextlib
import io
import logging
import re
import socket
from collections.abc import Awaitable, Callable, Generator, Mapping
from typing import Any, cast

import viser
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection

from trolley.config.viz import VizConfig
from trolley_viz import camera

OWN_PAGES = re.compile(r"https?://(localhost|127\.\d+\.\d+\.\d+|\[::1\])(:\d+)?")
"""Origins of pages that this host serves itself, on any port, since ports may be forwarded."""


Serve = Callable[[ServerConnection], Awaitable[None]]
"""Talks with one browser until one of them has enough."""


class PortTaken(RuntimeError):
    """The viewer's port cannot be had."""


class LocalServer(viser.ViserServer):
    """A viser server that never opens a tunnel to the outside."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refuse: a public address would let strangers drive the robot."""
        del verbose
        return None


def open_server(config: VizConfig, sockets: Mapping[str, Serve] = {}) -> LocalServer:
    """Serve the viewer at exactly the configured address.

    Args:
        config: the address.
        sockets: who serves the WebSocket of a path; viser's own is at "/".

    Raises:
        PortTaken: Something else listens there, or the address is not this host's.
    """
    _check_port(config.host, config.port)
    # A probe of the port, or a browser that leaves early, is no error of ours with a traceback.
    logging.getLogger("websockets.server").setLevel(logging.CRITICAL)
    # viser prints a banner whatever it is told; what people need to know stands in the log.
    with contextlib.redirect_stdout(io.StringIO()), _changed_serving(config.host, sockets):
        server = LocalServer(host=config.host, port=config.port, verbose=False)
    if server.get_port() != config.port:
        close_server(server)
        raise PortTaken(f"port {config.port} on {config.host} was taken just now")
    configure_look(server.gui, dark=False)
    server.gui.set_panel_label("Trolley")
    server.gui.main_panel.dock_right()
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
def _changed_serving(host: str, sockets: Mapping[str, Serve]) -> Generator[None]:
    """Refuse the pages of other sites, and serve more paths than viser's own.

    A browser lets any page talk to a server on its host. viser does not ask where a page comes
    from, so the check is put under it while it starts, and the other sockets beside it. The check
    holds on loopback only; elsewhere the server does not know the names that it is called by.
    """
    plain = websockets.asyncio.server.serve

    def serve(viser_serves: Serve, *args: Any, **options: Any) -> Any:
        async def route(connection: ServerConnection) -> None:
            request = connection.request
            path = "/" if request is None else request.path.partition("?")[0]
            await sockets.get(path, viser_serves)(connection)

        if _is_loopback(host):
            options["origins"] = [OWN_PAGES, None]
        return plain(route, *args, **options)

    websockets.asyncio.server.serve = cast(Any, serve)
    try:
        yield
    finally:
        websockets.asyncio.server.serve = plain


def _is_loopback(host: str) -> bool:
    return host == "localhost" or host == "::1" or host.startswith("127.")


def _check_port(host: str, port: int) -> None:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise PortTaken(f"cannot listen on {host}, port {port}: {error.strerror}") from error
