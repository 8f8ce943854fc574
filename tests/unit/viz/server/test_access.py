"""Who is let in, and as what."""

from http import HTTPStatus

import pytest
from hypothesis import given
from hypothesis import strategies as st
from websockets.datastructures import Headers

from trolley.ports import is_loopback_host
from trolley_viz.server.access import (
    AccessControl,
    AccessDecision,
    AccessRequest,
    AccessTokens,
)

ACCESS = AccessTokens(operator="drives", viewer="looks")
LAN, HERE = "192.168.1.7", "127.0.0.1"
PORT = 8080


def ask(
    path: str = "/",
    *,
    peer: str = HERE,
    host: str = f"{HERE}:{PORT}",
    origins: tuple[str, ...] = (),
    always_ask: bool = False,
    is_socket: bool = False,
    **headers: str,
) -> AccessDecision:
    gate = AccessControl(PORT, origins, always_ask=always_ask, tokens=ACCESS)
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    return gate.decide(AccessRequest(path, peer, Headers({"Host": host, **named}), is_socket))


def ask_with(*names: str) -> AccessDecision:
    """Ask from this host, with more headers."""
    gate = AccessControl(PORT, (), always_ask=False, tokens=ACCESS)
    headers = Headers({"Host": f"{HERE}:{PORT}", **dict.fromkeys(names, "1")})
    return gate.decide(AccessRequest("/", HERE, headers))


def role(answer: AccessDecision) -> str | None:
    return None if answer.visitor is None else answer.visitor.role


def cookie_of(answer: AccessDecision) -> str:
    assert answer.cookie
    return answer.cookie.partition(";")[0]


def test_who_sits_here_needs_no_token_and_is_known_again() -> None:
    first = ask()
    assert role(first) == "operator"
    assert "HttpOnly" in first.cookie
    again = ask(Cookie=cookie_of(first))
    assert again.visitor is not None
    assert again.visitor.browser
    assert not again.cookie


@pytest.mark.parametrize(
    "how",
    [
        {"peer": LAN},
        {"peer": LAN, "host": "127.0.0.1:8080"},
        {"host": "robot.example"},
        {"Origin": "https://robot.example", "origins": ("https://robot.example",)},
        {"X_Forwarded_For": LAN},
        {"Forwarded": f"for={LAN}"},
        {"always_ask": True},
        {"peer": ""},
    ],
)
def test_everybody_else_is_asked(how: dict[str, object]) -> None:
    answer = ask(**how)  # type: ignore[arg-type]
    assert (role(answer), answer.status) == (None, HTTPStatus.UNAUTHORIZED)
    assert "trolley viewer-link" in answer.text


_ADDED = """
Forwarded Via X-Forwarded X-Forwarded-For X-Forwarded-Host X-Forwarded-Proto X-Forwarded-Port
X-Forwarded-By X-Forwarded-Server X-Forwarded-Ssl X-Forwarded-Prefix X-Forwarded-Scheme
Forwarded-For X-Real-IP X-Client-IP X-Cluster-Client-IP X-Original-Host X-ProxyUser-Ip
X-Original-Forwarded-For
CF-Connecting-IP CF-Connecting-IPv6 CF-IPCountry CF-Ray CF-Visitor CF-Worker CDN-Loop True-Client-IP
Fly-Client-IP Fly-Forwarded-Proto Fastly-Client-IP Fastly-SSL X-Azure-ClientIP X-Azure-SocketIP
X-Appengine-User-IP X-Envoy-External-Address X-Amzn-Trace-Id X-Vercel-Forwarded-For Client-IP
Proxy-Client-IP WL-Proxy-Client-IP Incap-Client-IP Ali-Cdn-Real-Ip X-ARR-SSL X-ARR-LOG-ID
Front-End-Https X-Url-Scheme X-Scheme Tailscale-User-Login X-Request-Id Proxy-Connection
X-Forwarded-Client-Cert Remote-User X-Remote-User X-Authenticated-User X-Ingress-Path X-Hass-Source
"""
PROXY_HEADERS = _ADDED.split()
"""What nginx, Apache, Caddy, Traefik, HAProxy, IIS, Cloudflare, Fastly, Akamai, Fly, Azure, Google,
Amazon, Vercel, Imperva, Tailscale, Home Assistant and others add."""


@pytest.mark.parametrize("name", PROXY_HEADERS)
def test_whatever_header_a_proxy_adds_it_speaks_for_somebody_else(name: str) -> None:
    assert role(ask_with(name)) is None
    assert role(ask_with(name.lower())) is None


@pytest.mark.parametrize(
    "sent",
    [
        """Connection Cache-Control sec-ch-ua sec-ch-ua-mobile sec-ch-ua-platform DNT User-Agent
        Upgrade-Insecure-Requests Accept Sec-Fetch-Site Sec-Fetch-Mode Sec-Fetch-User Sec-Fetch-Dest
        Sec-GPC Referer Accept-Encoding Accept-Language Cookie If-None-Match If-Modified-Since
        Range Priority TE Pragma Save-Data""",
        """Connection Pragma Cache-Control User-Agent Upgrade Sec-WebSocket-Version Accept-Encoding
        Accept-Language Sec-WebSocket-Key Sec-WebSocket-Extensions Sec-WebSocket-Protocol""",
        "User-Agent Accept",
    ],
    ids=["a page", "a WebSocket", "curl"],
)
def test_what_browsers_send_themselves_says_nothing_of_a_proxy(sent: str) -> None:
    assert role(ask_with(*sent.split())) == "operator"


@pytest.mark.parametrize(("token", "wanted"), [("drives", "operator"), ("looks", "viewer")])
def test_a_link_gives_a_cookie_that_lets_in(token: str, wanted: str) -> None:
    shown = ask(f"/?token={token}", peer=LAN, host="robot:8080")
    assert (shown.status, shown.location) == (HTTPStatus.SEE_OTHER, "/")
    cookie = cookie_of(shown)
    for is_socket in (False, True):
        found = ask(
            peer=LAN,
            host="robot:8080",
            is_socket=is_socket,
            Cookie=cookie,
            Origin="http://robot:8080",
        )
        assert role(found) == wanted


def test_a_lesser_link_counts_on_this_host_too() -> None:
    assert role(ask(Cookie=cookie_of(ask("/?token=looks")))) == "viewer"


@pytest.mark.parametrize("token", ["", "wrong", "drive", "drivess", "drives looks", "é"])
def test_no_other_token_counts(token: str) -> None:
    assert role(ask(f"/?token={token}", peer=LAN)) is None
    assert role(ask(peer=LAN, Cookie=f"trolley-{PORT}=0123456789abcdef.{token}")) is None


@pytest.mark.parametrize("path", ["/", "/line", "/scene/", "/line?page=abc&x=1"])
def test_a_link_lets_no_socket_in(path: str) -> None:
    shown = path + ("&" if "?" in path else "?") + "token=drives"
    assert role(ask(shown, peer=LAN, is_socket=True)) is None
    # Nor does it raise somebody who may only look.
    cookie = cookie_of(ask("/?token=looks"))
    assert role(ask(shown, peer=LAN, is_socket=True, Cookie=cookie)) == "viewer"


@pytest.mark.parametrize("path", ["//evil.example/", "////evil.example", "/\\a.example", "/\\/a"])
def test_a_link_leads_to_no_other_host(path: str) -> None:
    shown = ask(f"{path}?token=drives", peer=LAN)
    assert shown.status == HTTPStatus.SEE_OTHER
    assert not shown.location[1:].startswith(("/", "\\"))


@pytest.mark.parametrize("is_socket", [False, True])
def test_the_cookie_of_another_port_is_another_viewers(*, is_socket: bool) -> None:
    cookie = cookie_of(ask("/?token=drives")).replace(f"trolley-{PORT}", f"trolley-{PORT + 1}")
    assert role(ask(peer=LAN, Cookie=cookie, is_socket=is_socket)) is None
    both = f"{cookie}; {cookie_of(ask('/?token=looks'))}"
    assert role(ask(peer=LAN, Cookie=both, is_socket=is_socket)) == "viewer"


@pytest.mark.parametrize(
    ("how", "device"),
    [
        ({}, "the computer that runs this page"),
        ({"peer": LAN}, "Firefox on Android"),
        ({"X_Forwarded_For": LAN}, "Firefox on Android"),
        ({"host": "evil.example:8080"}, "Firefox on Android"),
    ],
)
def test_a_browser_is_known_by_what_it_says_it_is(how: dict[str, str], device: str) -> None:
    agent = "Mozilla/5.0 (Android 14; Mobile; rv:133.0) Gecko/133.0 Firefox/133.0"
    cookie = cookie_of(ask("/?token=drives"))
    answer = ask(Cookie=cookie, User_Agent=agent, **how)  # type: ignore[arg-type]
    assert answer.visitor is not None
    assert answer.visitor.device == device
    # Its page is the same after an update.
    later = ask(Cookie=cookie, User_Agent="other", **how)  # type: ignore[arg-type]
    assert later.visitor == answer.visitor


@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.example",
        "http://127.0.0.1.evil.example",
        "null",
        "http://localhost@x",
        "file://",
    ],
)
def test_pages_of_other_sites_are_refused_whoever_they_are(origin: str) -> None:
    answer = ask(Origin=origin, Cookie=cookie_of(ask("/?token=drives")))
    assert (role(answer), answer.status) == (None, HTTPStatus.FORBIDDEN)


@pytest.mark.parametrize("name", ["127.0.0.1:8080", "localhost:9999", "[::1]:8080"])
def test_pages_of_this_host_are_its_own_on_any_port(name: str) -> None:
    assert role(ask(Origin=f"http://{name}")) == "operator"


@pytest.mark.parametrize("path", ["/", "/line", "/scene/"])
@pytest.mark.parametrize("is_socket", [False, True])
def test_a_strangers_name_that_leads_here_is_asked(path: str, *, is_socket: bool) -> None:
    names = {"host": "evil.example:8080", "Origin": "http://evil.example:8080"}
    rebound = ask(path, is_socket=is_socket, **names)  # type: ignore[arg-type]
    assert (role(rebound), rebound.status) == (None, HTTPStatus.UNAUTHORIZED)


def test_behind_a_proxy_with_its_name_a_token_lets_in() -> None:
    proxy = {"origins": ("https://robot.example/",), "X_Forwarded_Proto": "https"}
    shown = ask("/?token=drives", host="robot.example", **proxy)  # type: ignore[arg-type]
    assert "; Secure" in shown.cookie
    found = ask(Origin="https://robot.example", Cookie=cookie_of(shown), **proxy)  # type: ignore[arg-type]
    assert role(found) == "operator"


@given(cookie=st.text(), path=st.text(), host=st.text())
def test_rubbish_neither_breaks_nor_opens(cookie: str, path: str, host: str) -> None:
    gate = AccessControl(PORT, (), always_ask=False, tokens=ACCESS)
    headers = {"Host": host, "Cookie": cookie}
    assert gate.decide(AccessRequest(path, LAN, headers)).visitor is None


def test_only_loopback_is_loopback() -> None:
    assert all(map(is_loopback_host, ("127.0.0.1", "localhost", "::1", "127.9.9.9")))
    assert not any(map(is_loopback_host, ("0.0.0.0", "::", "192.168.1.2", "robot", "")))
