"""Who may talk to the web server, and what it serves."""

import base64
import contextlib
import gc
import hashlib
import http.client
import json
import os
import re
import secrets
import socket
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pytest
import viser
from support.processes import find_free_port
from support.waiting import PATIENCE_S, wait_until
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.sync.connection import Connection

from trolley.config import VizConfig
from trolley_viz.languages.catalogue import catalogues
from trolley_viz.server.access import AccessControl, AccessTokens
from trolley_viz.server.lines import MOST_UNHEARD, Line, Lines
from trolley_viz.server.messages import Answer, Said, Told
from trolley_viz.server.thinning import unpacked
from trolley_viz.server.web_server import PortTaken, WebServer, close_scene, open_scene
from trolley_viz.threads import Post

pytestmark = pytest.mark.drives

VISER = [f"viser-v{viser.__version__}"]


@dataclass
class Served:
    """A web server with its scene, and what its lines heard."""

    port: int
    scene: viser.ViserServer
    tokens: AccessTokens
    lines: list[Line]
    said: list[Said]
    closed: list[Line]


JPEG = b"\xff\xd8\xff" + bytes(50_000)


async def photo_of(robot: str, name: str) -> bytes | None:
    return JPEG if (robot, name) == ("kiwi", "t1-0") else None


def serve(*, always_ask: bool = False, post: Post = lambda call: call()) -> Iterator[Served]:
    port = find_free_port()
    served = Served(port, open_scene(), AccessTokens.new(), [], [], [])
    access = AccessControl(port, (), always_ask=always_ask, tokens=served.tokens)
    lines = Lines(
        post,
        served.lines.append,
        lambda _, said: served.said.append(said),
        served.closed.append,
    )
    web = WebServer(VizConfig(port=port), access, lines, served.scene, photo_of)
    yield served
    web.close()
    close_scene(served.scene)


@pytest.fixture
def served() -> Iterator[Served]:
    """One that lets in whoever sits at this host."""
    yield from serve()


@pytest.fixture
def asking() -> Iterator[Served]:
    """One that asks everybody for a token."""
    yield from serve(always_ask=True)


def knock(port: int, origin: str | None, path: str = "/scene/") -> None:
    """Open a socket as a page of `origin` would."""
    url = f"ws://127.0.0.1:{port}{path}"
    protocols = VISER if path == "/scene/" else None
    with connect(url, origin=origin, subprotocols=protocols, open_timeout=PATIENCE_S):  # type: ignore[arg-type]
        pass


@pytest.mark.parametrize("path", ["/scene/", "/line"])
@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "[::1]"])
def test_own_pages_are_let_in(served: Served, host: str, path: str) -> None:
    knock(served.port, f"http://{host}:{served.port}", path)


def test_programs_without_a_page_are_let_in(served: Served) -> None:
    knock(served.port, None)


@pytest.mark.parametrize("path", ["/scene/", "/line"])
@pytest.mark.parametrize(
    "origin", ["http://evil.example", "http://127.0.0.1.evil.example", "null", "http://localhost@x"]
)
def test_pages_of_other_sites_are_refused(served: Served, origin: str, path: str) -> None:
    with pytest.raises(InvalidStatus, match="403"):
        knock(served.port, origin, path)


def test_a_taken_port_is_refused_rather_than_left(served: Served) -> None:
    access = AccessControl(0, (), always_ask=False, tokens=served.tokens)
    lines = Lines(lambda call: None, lambda _: None, lambda *_: None, lambda _: None)
    taken = rf"port {served.port} is taken by .*\(pid {os.getpid()}\); end it"
    with pytest.raises(PortTaken, match=taken):
        WebServer(VizConfig(port=served.port), access, lines, served.scene, photo_of)


def test_it_listens_on_loopback_only(served: Served) -> None:
    others = {
        info[4][0]
        for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)
        if not str(info[4][0]).startswith("127.")
    }
    for address in others:
        with socket.socket() as stranger:
            stranger.settimeout(2.0)
            assert stranger.connect_ex((str(address), served.port)) != 0


def test_the_scene_is_where_nobody_looks(served: Served) -> None:
    for host in ("127.0.0.1", "::1"):
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        with socket.socket(family) as stranger:
            assert stranger.connect_ex((host, served.scene.get_port())) != 0


def fetch(port: int, path: str = "/", cookie: str = "") -> tuple[int, dict[str, str], bytes]:
    """Get a page, without following where it leads."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
    with contextlib.closing(connection):
        connection.request("GET", path, headers={"Cookie": cookie} if cookie else {})
        response = connection.getresponse()
        return response.status, dict(response.getheaders()), response.read()


def test_a_photo_is_served_as_nothing_but_a_picture(served: Served) -> None:
    status, headers, body = fetch(served.port, "/photo/kiwi/t1-0")
    assert (status, headers["Content-Type"], body) == (200, "image/jpeg", JPEG)
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["Cache-Control"].startswith("private")
    for path in ("/photo/kiwi/t1-1", "/photo/lime/t1-0", "/photo/kiwi/..%2Ft1-0", "/photo/kiwi/"):
        assert fetch(served.port, path)[0] == 404


def test_a_photo_is_for_whoever_was_let_in(asking: Served) -> None:
    assert fetch(asking.port, "/photo/kiwi/t1-0")[0] == 401


def test_without_a_token_there_is_neither_page_nor_socket(asking: Served) -> None:
    for path in ("/", "/page/main.js", "/scene/", "/page/icon/home.svg", "/?token=wrong", "/x"):
        status, _, body = fetch(asking.port, path)
        assert status == 401
        assert b"<script" not in body.lower()
    for path in ("/line", "/scene/"):
        url = f"ws://127.0.0.1:{asking.port}{path}"
        with pytest.raises(InvalidStatus, match="401"), connect(url):
            pass


def upgrade(port: int, path: str, **headers: str) -> int:
    """Ask for a socket under any names, and return the status."""
    names = {
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
    }
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
    with contextlib.closing(connection):
        connection.request("GET", path, headers={**names, **headers})
        return connection.getresponse().status


@pytest.mark.parametrize("path", ["/line", "/line?page=abc", "/scene/"])
def test_no_socket_is_opened_under_a_strangers_name(served: Served, path: str) -> None:
    assert upgrade(served.port, path) == 101
    rebound = f"evil.example:{served.port}"
    assert upgrade(served.port, path, Host=rebound) == 401
    assert upgrade(served.port, path, Host=rebound, Origin=f"http://{rebound}") == 401
    assert upgrade(served.port, path, Origin=f"http://{rebound}") == 403
    operator = f"trolley-{served.port}=0123456789abcdef.{served.tokens.operator}"
    assert upgrade(served.port, path, Origin=f"http://{rebound}", Cookie=operator) == 403


@pytest.mark.parametrize("path", ["/line", "/scene/"])
def test_a_token_opens_no_socket_by_its_address(asking: Served, path: str) -> None:
    for token in (asking.tokens.operator, asking.tokens.viewer):
        assert upgrade(asking.port, f"{path}?token={token}") == 401
        other = f"trolley-{asking.port + 1}=0123456789abcdef.{token}"
        assert upgrade(asking.port, path, Cookie=other) == 401
        own = f"trolley-{asking.port}=0123456789abcdef.{token}"
        assert upgrade(asking.port, path, Cookie=own) == 101
    assert all(line.visitor.browser == "0123456789abcdef" for line in asking.lines)


def test_a_name_that_is_far_too_long_ends_the_line_and_nothing_else(served: Served) -> None:
    with connect(f"ws://127.0.0.1:{served.port}/line", max_queue=1) as line:
        wait_until(lambda: served.lines, "the line is open")
        press = {"id": 1, "at_ms": 0, "control": 1, "value": "x" * 10**6}
        line.send(json.dumps({"press": press}))
        with pytest.raises(ConnectionClosed):
            line.recv(timeout=PATIENCE_S)
    assert served.said == []
    assert fetch(served.port)[0] == 200


def test_a_link_opens_the_page_and_its_sockets(asking: Served) -> None:
    status, headers, _ = fetch(asking.port, f"/?token={asking.tokens.viewer}")
    assert (status, headers["Location"]) == (303, "/")
    cookie = headers["Set-Cookie"].partition(";")[0]
    status, headers, body = fetch(asking.port, "/", cookie)
    assert status == 200
    assert b"STOP" in body
    url, known = f"ws://127.0.0.1:{asking.port}", {"Cookie": cookie}
    with connect(f"{url}/scene/", subprotocols=VISER, additional_headers=known) as page:  # type: ignore[arg-type]
        assert page.recv(timeout=PATIENCE_S)
    with connect(f"{url}/line", additional_headers=known):
        wait_until(lambda: asking.lines, "a line")
    assert asking.lines[0].visitor.role == "viewer"


def test_the_page_runs_nothing_from_elsewhere(served: Served) -> None:
    _, headers, body = fetch(served.port)
    policy = headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert "frame-ancestors 'none'" in policy
    text = body.decode()
    assert "style=" not in text
    assert "onload=" not in text
    assert "http" not in text.replace("http-equiv", "")
    _, headers, body = fetch(served.port, "/scene/")
    assert "frame-ancestors 'self'" in headers["Content-Security-Policy"]
    assert len(body) > 100_000


def test_files_outside_of_the_page_are_not_served(served: Served) -> None:
    for path in ("/page/../service.py", "/page/%2e%2e/service.py", "/scene/../page/main.py"):
        assert fetch(served.port, path)[0] in (403, 404)
    assert fetch(served.port, "/page/icon/home.svg")[0] == 200
    assert fetch(served.port, "/page/icon/nothing-of-that-name.svg")[0] == 404


def test_the_words_of_the_page_are_served_in_every_language(served: Served) -> None:
    for code, catalogue in catalogues().items():
        status, _, body = fetch(served.port, f"/page/words/{code}.json")
        assert status == 200
        assert json.loads(body) == catalogue.page
    listed = re.search('name="languages" content="(.*?)"', fetch(served.port)[2].decode())
    assert listed is not None
    assert listed[1].split() == [*catalogues()]
    for code in ("en", "xx", "..", "de.toml", "%2e%2e%2fde"):
        assert fetch(served.port, f"/page/words/{code}.json")[0] == 404


@pytest.mark.parametrize(
    ("accepted", "said"),
    [
        ("de-DE,de;q=0.9,en;q=0.8", "Dieser Viewer verlangt einen Zugang"),
        ("tlh, en", "This viewer asks for a token"),
        ("", "This viewer asks for a token"),
        ("<script>", "This viewer asks for a token"),
    ],
)
def test_who_is_refused_is_told_so_in_their_language(
    asking: Served, accepted: str, said: str
) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", asking.port, timeout=PATIENCE_S)
    with contextlib.closing(connection):
        connection.request("GET", "/", headers={"Accept-Language": accepted})
        assert said in connection.getresponse().read().decode()


def test_who_is_refused_sees_a_page_with_its_style(asking: Served) -> None:
    """No other file is given to them."""
    status, headers, body = fetch(asking.port)
    assert status == 401
    style = re.search("<style>(.*?)</style>", body.decode(), re.DOTALL)
    assert style is not None
    assert "min-height: 44px" in style[1]
    digest = base64.b64encode(hashlib.sha256(style[1].encode()).digest()).decode()
    assert f"style-src 'sha256-{digest}'" in headers["Content-Security-Policy"]


def test_what_to_type_is_told_from_the_rest(asking: Served) -> None:
    assert b"<code>trolley viewer-link</code>" in fetch(asking.port)[2]


def test_a_page_is_shown_all_at_once_however_long_the_viewer_has_run(served: Served) -> None:
    """Each number that a message ever had, tried in turn, would take days here."""
    served.scene._websock_server.get_message_buffer().message_counter = 10**12
    nodes = {f"/late{i}" for i in range(300)}
    for node in nodes:
        served.scene.scene.add_frame(node)
    url = f"ws://127.0.0.1:{served.port}/scene/"
    with connect(url, subprotocols=VISER, max_size=None) as page:  # type: ignore[arg-type]
        seen: list[str] = []
        while "ReplayDoneMessage" not in seen:
            parts = unpacked(page.recv(timeout=PATIENCE_S, decode=False))[1]
            seen += [one.message.get("name") or one.message["type"] for one in parts]
        assert {"/light", *nodes} <= set(seen)
        served.scene.scene.add_frame("/new")
        while "/new" not in seen:
            parts = unpacked(page.recv(timeout=PATIENCE_S, decode=False))[1]
            seen += [one.message.get("name") or one.message["type"] for one in parts]


@pytest.fixture
def line(served: Served) -> Iterator[Connection]:
    """A page's end of a line, which is as quiet as a browser's: no ping ends it."""
    url = f"ws://127.0.0.1:{served.port}/line?page=abc"
    with connect(url, max_queue=1, ping_interval=None) as line:
        wait_until(lambda: served.lines, "the line is open")
        yield line


def test_page_and_viewer_hear_each_other(served: Served, line: Connection) -> None:
    assert served.lines[0].key == "abc"
    served.lines[0].send(Told(answer=Answer(id=7, is_done=True)))
    assert json.loads(line.recv(timeout=PATIENCE_S)) == {
        "answer": {"id": 7, "is_done": True, "text": ""}
    }
    line.send('{"stop": {"id": 1, "robots": []}}')
    wait_until(lambda: served.said, "it is heard")
    assert served.said[0].stop is not None


@pytest.mark.parametrize(
    "rubbish",
    [
        "",
        "{",
        "[]",
        '{"press": 1}',
        '{"stop": {"id": -1, "robots": []}}',
        "[" * 5000,
        b"\x00",
        "x" * 30_000,
    ],
)
def test_rubbish_ends_the_line_and_nothing_else(
    served: Served, line: Connection, rubbish: str | bytes
) -> None:
    line.send(rubbish)
    wait_until(lambda: served.closed == served.lines, "the line is closed")
    with pytest.raises(ConnectionClosed):
        line.recv(timeout=PATIENCE_S)
    assert served.said == []
    assert fetch(served.port)[0] == 200


def test_a_page_that_floods_a_busy_viewer_takes_nobody_the_room() -> None:
    waiting: deque[Callable[[], None]] = deque()
    with contextlib.contextmanager(serve)(post=waiting.append) as served:
        url = f"ws://127.0.0.1:{served.port}/line"
        with connect(f"{url}?page=flood") as flood, connect(f"{url}?page=calm") as calm:
            for number in range(10 * MOST_UNHEARD):
                flood.send(json.dumps({"stop": {"id": number, "robots": []}}))
            wait_until(lambda: len(waiting) >= 2 + MOST_UNHEARD, "it floods")
            calm.send('{"stop": {"id": 5000, "robots": []}}')
            wait_until(lambda: len(waiting) > 2 + MOST_UNHEARD, "the calm one is read")
            assert len(waiting) == 3 + MOST_UNHEARD

            def hear() -> bool:
                while waiting:
                    waiting.popleft()()
                return len(served.said) > 10 * MOST_UNHEARD

            wait_until(hear, "all that was said is heard in the end")
        heard = [said.stop.id for said in served.said if said.stop is not None]
        assert heard.index(5000) <= MOST_UNHEARD
        heard.remove(5000)
        assert heard == list(range(10 * MOST_UNHEARD))


def test_a_line_that_nobody_reads_is_not_clear_and_can_be_closed(
    served: Served, line: Connection
) -> None:
    mine = served.lines[0]
    assert mine.is_clear
    for _ in range(200):  # what is the same again and again would be compressed to nothing
        text = secrets.token_urlsafe(40_000)
        mine.send(Told(answer=Answer(id=1, is_done=False, text=text)))
    wait_until(lambda: not mine.is_clear, "it fills")
    mine.close()
    wait_until(lambda: served.closed == [mine], "it is closed without being read")


def test_a_browser_that_stops_reading_misses_what_is_old(served: Served) -> None:
    cloud = served.scene.scene.add_point_cloud("/cloud", np.zeros((10_000, 3)), (0, 0, 0))
    url = f"ws://127.0.0.1:{served.port}/scene/"
    with connect(url, subprotocols=VISER, max_size=None, max_queue=2) as page:  # type: ignore[arg-type]
        page.recv()
        for i in range(150):
            cloud.points = np.full((10_000, 3), i, np.float32)
            time.sleep(0.02)
        old = 0
        while np.full(8, 149, np.float16).tobytes() not in page.recv(
            timeout=PATIENCE_S, decode=False
        ):
            old += 1
    # Of 9 MB that were offered; with the system's own buffers it is most of them, twice over.
    assert old < 60


def test_who_calls_while_it_closes_is_hung_up_on() -> None:
    # What is left open says so when it is cleared away, and that makes this test fail.
    for _ in range(6):
        with contextlib.ExitStack() as calls:
            with contextlib.contextmanager(serve)() as served:
                for _ in range(8):
                    calls.enter_context(socket.create_connection(("127.0.0.1", served.port)))
            gc.collect()
