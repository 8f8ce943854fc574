"""Who may talk to the web server."""

import contextlib
import http.client
import socket
import time
from collections.abc import Iterator

import numpy as np
import pytest
import viser
from support.waiting import PATIENCE_S
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from trolley.config import VizConfig
from trolley_viz.server.access import AccessControl, AccessTokens
from trolley_viz.server.web_server import PortTaken, open_server

pytestmark = pytest.mark.drives

GATE = AccessControl(0, (), always_ask=False, tokens=AccessTokens.new())


@pytest.fixture
def port(server: viser.ViserServer) -> int:
    return server.get_port()


def knock(port: int, origin: str | None) -> None:
    """Open viser's web socket as a page of `origin` would."""
    protocol = f"viser-v{viser.__version__}"
    url = f"ws://127.0.0.1:{port}"
    with connect(url, origin=origin, subprotocols=[protocol], open_timeout=PATIENCE_S):  # type: ignore[arg-type, list-item]
        pass


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "[::1]"])
def test_own_pages_are_let_in(port: int, host: str) -> None:
    knock(port, f"http://{host}:{port}")


def test_programs_without_a_page_are_let_in(port: int) -> None:
    knock(port, None)


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "http://127.0.0.1.evil.example", "null", "http://localhost@x"]
)
def test_pages_of_other_sites_are_refused(port: int, origin: str) -> None:
    with pytest.raises(InvalidStatus, match="403"):
        knock(port, origin)


def test_a_taken_port_is_refused_rather_than_left(port: int) -> None:
    with pytest.raises(PortTaken, match=f"port {port}"):
        open_server(VizConfig(port=port), GATE)


def test_it_listens_on_loopback_only(port: int) -> None:
    others = {
        info[4][0]
        for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)
        if not str(info[4][0]).startswith("127.")
    }
    for address in others:
        with socket.socket() as stranger:
            stranger.settimeout(2.0)
            assert stranger.connect_ex((str(address), port)) != 0


@pytest.fixture
def asking() -> Iterator[tuple[int, AccessTokens]]:
    """A viewer that asks everybody for a token: its port and its tokens."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    access = AccessTokens.new()
    gate = AccessControl(port, (), always_ask=True, tokens=access)
    server = open_server(VizConfig(port=port), gate)
    yield port, access
    server.stop()


def fetch(port: int, path: str = "/", cookie: str = "") -> tuple[int, dict[str, str], bytes]:
    """Get a page, without following where it leads."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
    with contextlib.closing(connection):
        connection.request("GET", path, headers={"Cookie": cookie} if cookie else {})
        response = connection.getresponse()
        return response.status, dict(response.getheaders()), response.read()


def test_without_a_token_there_is_neither_page_nor_socket(asking: tuple[int, AccessTokens]) -> None:
    port, _ = asking
    for path in ("/", "/index.html", "/assets/x.js", "/?token=wrong"):
        status, _, body = fetch(port, path)
        assert status == 401
        assert b"<script" not in body.lower()
    for path in ("", "/joystick?client=0"):
        with pytest.raises(InvalidStatus, match="401"), connect(f"ws://127.0.0.1:{port}{path}"):
            pass


def test_a_link_opens_the_page_and_its_socket(asking: tuple[int, AccessTokens]) -> None:
    port, access = asking
    status, headers, _ = fetch(port, f"/?token={access.viewer}")
    assert (status, headers["Location"]) == (303, "/")
    cookie = headers["Set-Cookie"].partition(";")[0]
    status, headers, body = fetch(port, "/", cookie)
    assert status == 200
    assert b"<script" in body.lower()
    assert headers["X-Frame-Options"] == "SAMEORIGIN"
    protocol = f"viser-v{viser.__version__}"
    with connect(
        f"ws://127.0.0.1:{port}",
        subprotocols=[protocol],  # type: ignore[list-item]
        additional_headers={"Cookie": cookie},
    ) as page:
        assert page.recv(timeout=PATIENCE_S)


def test_a_browser_that_stops_reading_misses_what_is_old(
    server: viser.ViserServer, port: int
) -> None:
    cloud = server.scene.add_point_cloud("/cloud", np.zeros((10_000, 3)), (0, 0, 0))
    protocol = f"viser-v{viser.__version__}"
    url = f"ws://127.0.0.1:{port}"
    with connect(url, subprotocols=[protocol], max_size=None, max_queue=2) as page:  # type: ignore[list-item]
        page.recv()
        for i in range(150):
            cloud.points = np.full((10_000, 3), i, np.float32)
            time.sleep(0.02)
        old = 0
        while np.full(8, 149, np.float16).tobytes() not in page.recv(
            timeout=PATIENCE_S, decode=False
        ):
            old += 1
    # Of 9 MB that were offered; with the system's own buffers it is most of them.
    assert old < 40
