"""Access control: by where a request comes from, the page that makes it, and its token.

Whoever sits at this host needs no token, as with any program there. Everybody else shows one: in
the link that `trolley viewer-link` prints, and from then on in a cookie. Nothing here touches a
socket.
"""

import hmac
import re
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, urlsplit

from msgspec import Struct

from trolley.ports import is_loopback
from trolley_viz.server.devices import HERE, device_name
from trolley_viz.server.visitors import Role, Visitor

FILE = "viewer_access.toml"
COOKIE_DAYS = 400
"""The longest that browsers keep any cookie."""
LOCAL_HOSTS = re.compile(r"(localhost|127\.\d+\.\d+\.\d+|\[::1\])(:\d+)?")
SENT_BY_BROWSERS = re.compile(
    r"""host | connection | upgrade | upgrade-insecure-requests | keep-alive | origin | referer
    | user-agent | accept(-.+)? | sec-.+ | cookie | cache-control | pragma | if-.+ | range
    | dnt | te | priority | save-data | purpose | content-(length|type)""",
    re.IGNORECASE | re.VERBOSE,
)
"""Headers that a browser sends by itself. Any other was added by a proxy on this host, for somebody
else: there are too many such headers to list."""
BROWSER = re.compile(r"[0-9a-f]{16}")


class AccessTokens(Struct, frozen=True, kw_only=True):
    """The tokens in `viewer_access.toml`; without the file new ones are made."""

    operator: str
    viewer: str

    @classmethod
    def new(cls) -> "AccessTokens":
        """Return tokens that nobody can guess."""
        return cls(operator=secrets.token_urlsafe(24), viewer=secrets.token_urlsafe(24))

    def role(self, token: str) -> Role | None:
        """Return what a token allows, None for an unknown token."""
        given = token.encode()
        if hmac.compare_digest(given, self.operator.encode()):
            return "operator"
        return "viewer" if hmac.compare_digest(given, self.viewer.encode()) else None


@dataclass(frozen=True)
class AccessRequest:
    """What matters of a request."""

    path: str
    peer: str
    """The address that it comes from."""
    headers: Mapping[str, str]
    """By name; `get` must not care about capitals."""
    is_socket: bool = False


@dataclass(frozen=True)
class AccessDecision:
    """The decision on a request: let in as `visitor`, or answered with `status` and `text`."""

    visitor: Visitor | None = None
    status: HTTPStatus = HTTPStatus.OK
    text: str = ""
    cookie: str = ""
    """The cookie to set, whole."""
    location: str = ""
    """Where to go on."""


class AccessControl:
    """The rules for one server.

    Args:
        port: tells the cookies of several viewers on one host apart.
        origins: further addresses under which its page is known, as `https://robot.example`.
        always_ask: whether a token is asked on this host, too.
        access: the tokens.
    """

    def __init__(
        self, port: int, origins: Sequence[str], *, always_ask: bool, tokens: AccessTokens
    ) -> None:
        self._cookie = f"trolley-{port}"
        self._origins = {origin.rstrip("/").lower() for origin in origins}
        self._always_ask = always_ask
        self._tokens = tokens

    def decide(self, request: AccessRequest) -> AccessDecision:
        """Decide on a request."""
        host, origin = request.headers.get("Host") or "", request.headers.get("Origin")
        if origin is not None and not self._is_own_page(origin, host):
            return AccessDecision(
                status=HTTPStatus.FORBIDDEN,
                text=f"The page {origin} may not talk to this viewer. If it is the viewer's own, "
                "behind a proxy, add it to [viz] origins in robot.toml.",
            )
        browser, token = self._cookie_of(request)
        is_local = self._is_local(request, host, origin)
        shown = parse_qs(urlsplit(request.path).query).get("token", [""])[0]
        if shown and not request.is_socket:
            return self._let_in_by_link(request, shown, browser)
        role = self._tokens.role(token) if token else None
        if role is None and is_local and not self._always_ask:
            role = "operator"
        if role is None:
            return AccessDecision(
                status=HTTPStatus.UNAUTHORIZED,
                text="This viewer asks for a token: open the link that `trolley viewer-link` "
                "prints on its host.",
            )
        device = HERE if is_local else device_name(request.headers.get("User-Agent") or "")
        if browser:
            return AccessDecision(Visitor(browser, role, device))
        cookie = self._set_cookie(request, secrets.token_hex(8), token)
        return AccessDecision(Visitor("", role, device), cookie=cookie)

    def _let_in_by_link(self, request: AccessRequest, token: str, browser: str) -> AccessDecision:
        role = self._tokens.role(token)
        if role is None:
            return AccessDecision(
                status=HTTPStatus.UNAUTHORIZED,
                text="This link is no longer valid. Ask for a new one.",
            )
        browser = browser or secrets.token_hex(8)
        # On to the page without the token, which else would stand in the history; to no other
        # host, as browsers understand //name and /\name.
        path = urlsplit(request.path).path.lstrip("/\\")
        return AccessDecision(
            Visitor(browser, role),
            HTTPStatus.SEE_OTHER,
            cookie=self._set_cookie(request, browser, token),
            location=f"/{path}",
        )

    def _is_own_page(self, origin: str, host: str) -> bool:
        """Whether a page may talk to the server.

        One that is called as the request's own host may. A stranger's name that was made to lead
        here (DNS rebinding) gets so far, but it is not local, and no browser gives it our cookie.
        """
        scheme, _, name = origin.lower().partition("://")
        if scheme not in ("http", "https"):
            return False
        if origin.lower() in self._origins or name == host.lower():
            return True
        # Ports may be forwarded: a page of this host is its own on any port.
        return bool(LOCAL_HOSTS.fullmatch(name) and LOCAL_HOSTS.fullmatch(host))

    def _is_local(self, request: AccessRequest, host: str, origin: str | None) -> bool:
        """Whether somebody at this host asks, and not through a proxy."""
        pages = [host] if origin is None else [host, origin.partition("://")[2]]
        return (
            is_loopback(request.peer)
            and all(LOCAL_HOSTS.fullmatch(name) for name in pages)
            and all(SENT_BY_BROWSERS.fullmatch(name) for name in request.headers)
        )

    def _cookie_of(self, request: AccessRequest) -> tuple[str, str]:
        """The browser's name and the token that it was given, "" each where there is none."""
        try:
            cookie = SimpleCookie(request.headers.get("Cookie") or "").get(self._cookie)
        except CookieError:
            return "", ""
        browser, _, token = ("" if cookie is None else cookie.value).partition(".")
        return (browser, token) if BROWSER.fullmatch(browser) else ("", "")

    def _set_cookie(self, request: AccessRequest, browser: str, token: str) -> str:
        secure = "; Secure" if request.headers.get("X-Forwarded-Proto") == "https" else ""
        return (
            f"{self._cookie}={browser}.{token}; Path=/; Max-Age={COOKIE_DAYS * 86_400}; "
            f"HttpOnly; SameSite=Lax{secure}"
        )
