"""Who may talk to the web server."""

import socket

import pytest
import viser
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from trolley.config import VizConfig
from trolley_viz.server import PortTaken, open_server


@pytest.fixture
def port(server: viser.ViserServer) -> int:
    return server.get_port()


def knock(port: int, origin: str | None) -> None:
    """Open viser's web socket as a page of `origin` would."""
    protocol = f"viser-v{viser.__version__}"
    url = f"ws://127.0.0.1:{port}"
    with connect(url, origin=origin, subprotocols=[protocol], open_timeout=10):  # type: ignore[arg-type, list-item]
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
        open_server(VizConfig(port=port))


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
