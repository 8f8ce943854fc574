"""Sends what has happened to a web address. A thread of its own waits for it; nobody else does."""

import http.client
import socket
import ssl
import threading
import time
import urllib.parse
from collections import deque
from collections.abc import Callable, Generator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass

import msgspec
from msgspec import Struct

from trolley.config import ConfigError, RobotConfig
from trolley_mqtt.credentials import read_secret, trust
from trolley_mqtt.events import Happened
from trolley_mqtt.unreachable import why_unreachable

VERSION = 1
"""Of the body. Fields may be added to it; where one changes its meaning, this number grows."""


class Notification(Struct, frozen=True, kw_only=True):
    """The JSON body of one request."""

    version: int = VERSION
    id: str
    """The same if it is sent again: whoever has seen it may drop it."""
    at: str | None
    """UTC, ISO 8601; null where the robot's computer does not know the time."""
    robot: str
    """`[robot] name`."""
    title: str
    """What people call it."""
    event_type: str
    message: str
    reason: str
    place: str | None
    tour: str | None


def notification(
    event: Happened, new_id: str, at: str | None, robot: str, title: str
) -> Notification:
    """An event, as it is sent."""
    return Notification(
        id=new_id,
        at=at,
        robot=robot,
        title=title,
        event_type=event.event_type,
        message=event.message,
        reason=event.reason,
        place=event.place,
        tour=event.tour,
    )


class WebhookParams(Struct, frozen=True, kw_only=True):
    """How patiently a notification is sent."""

    time_limit_s: float = 10.0
    """For opening the connection, and again for the answer; then it is cut."""
    first_pause_s: float = 1.0
    """Between the first attempts; doubled each time."""
    longest_pause_s: float = 60.0
    """The longest pause between two attempts."""
    max_waiting: int = 100
    """Notifications that wait for one address; the oldest are dropped for newer ones."""
    keep_s: float = 3600.0
    """A notification that could not be sent for so long is old news, and is dropped."""
    goodbye_s: float = 1.0
    """How long a service that ends waits for what is being sent."""


PARAMS = WebhookParams()
TRY_AGAIN = (408, 425, 429)
"""Refusals that a later attempt may not meet, as RFC 9110, 8470 and 6585 have them."""


@dataclass(frozen=True, kw_only=True)
class Endpoint:
    """A web address, and how to speak to it."""

    url: str
    token: str = ""
    tls: ssl.SSLContext | None = None

    def __repr__(self) -> str:
        """Only where it is: path and query may be the secret."""
        return f"Endpoint({self.host})"

    @property
    def host(self) -> str:
        """Host and port, which is all that is ever shown of it."""
        parts = urllib.parse.urlsplit(self.url)
        port = "" if parts.port is None else f":{parts.port}"
        return f"{parts.hostname}{port}"


@dataclass(frozen=True)
class Report:
    """What became of an attempt, or of a notification that was dropped."""

    problem: str = ""
    """One sentence; "" where it was taken."""
    num_sent: int = 0
    num_dropped: int = 0


class Webhook:
    """Sends to one address, one notification after another.

    Args:
        endpoint: Where.
        tell: Is called on the webhook's thread with what became of each attempt.
        params: How patiently.
    """

    def __init__(
        self, endpoint: Endpoint, tell: Callable[[Report], None], params: WebhookParams = PARAMS
    ) -> None:
        self.endpoint = endpoint
        self._tell = tell
        self._params = params
        self._waiting: deque[tuple[float, bytes]] = deque()
        self._changed = threading.Condition()
        self._is_closed = False
        self._thread = threading.Thread(
            target=self._run, name=f"webhook {endpoint.host}", daemon=True
        )

    def start(self) -> None:
        """Begin to send."""
        self._thread.start()

    def send(self, body: Notification) -> None:
        """Send it as soon as possible; returns at once."""
        with self._changed:
            is_full = len(self._waiting) >= self._params.max_waiting
            if is_full:
                self._waiting.popleft()
            self._waiting.append((time.monotonic(), msgspec.json.encode(body)))
            self._changed.notify()
        if is_full:
            self._tell(Report(f"{self._who} is too slow: old notifications are lost.", 0, 1))

    def close(self) -> None:
        """End; what waits is lost, what is under way has a moment to be done."""
        with self._changed:
            self._is_closed = True
            self._changed.notify()
        self._thread.join(self._params.goodbye_s)

    @property
    def _who(self) -> str:
        return f"The webhook at {self.endpoint.host}"

    # On the thread.
    def _run(self) -> None:
        while (one := self._next()) is not None:
            self._deliver(*one)

    def _next(self) -> tuple[float, bytes] | None:
        """Take the oldest that waits, once there is one; None at the end."""
        with self._changed:
            while not self._waiting and not self._is_closed:
                self._changed.wait()
            return None if self._is_closed else self._waiting.popleft()

    def _deliver(self, since_s: float, body: bytes) -> None:
        """Send one again and again, until it is taken, refused for good, or old."""
        pause_s = self._params.first_pause_s
        while not self._is_closed:
            problem, is_final = self._attempt(body)
            is_old = time.monotonic() - since_s > self._params.keep_s
            is_lost = bool(problem) and (is_final or is_old)
            if not self._is_closed:
                self._tell(Report(problem, int(not problem), int(is_lost)))
            if not problem or is_lost:
                return
            self._wait(pause_s)
            pause_s = min(2.0 * pause_s, self._params.longest_pause_s)

    def _wait(self, pause_s: float) -> None:
        """Pause, also where more comes to wait meanwhile."""
        until_s = time.monotonic() + pause_s
        with self._changed:
            while not self._is_closed and (left_s := until_s - time.monotonic()) > 0.0:
                self._changed.wait(left_s)

    def _attempt(self, body: bytes) -> tuple[str, bool]:
        """What went wrong ("" nothing), and whether it would again."""
        try:
            with self._connection() as connection:
                status, elsewhere = _post(connection, self.endpoint, body)
        except (OSError, http.client.HTTPException) as error:
            return f"{self._who} {_words_of(error, self._params.time_limit_s)}.", False
        if 200 <= status < 300:
            return "", True
        if 300 <= status < 400:
            to = f" to {elsewhere}" if elsewhere else ""
            return f"{self._who} redirects{to}: write the new address into [webhook] urls.", True
        is_final = 400 <= status < 500 and status not in TRY_AGAIN
        phrase = http.client.responses.get(status, "")
        word = f"{status} {phrase}".strip()
        if is_final:
            return f"{self._who} refuses what is sent to it: it answers {word}.", True
        return f"{self._who} cannot take anything at the moment: it answers {word}.", False

    @contextmanager
    def _connection(self) -> Generator[http.client.HTTPConnection]:
        """A connection that is cut when the time is up, however slowly something comes."""
        limit_s = self._params.time_limit_s
        parts = urllib.parse.urlsplit(self.endpoint.url)
        host = parts.hostname or ""
        if parts.scheme == "https":
            connection = http.client.HTTPSConnection(
                host, parts.port, timeout=limit_s, context=self.endpoint.tls
            )
        else:
            connection = http.client.HTTPConnection(host, parts.port, timeout=limit_s)
        with closing(connection):
            connection.connect()
            # The socket's own limit begins anew with each byte.
            until_s = time.monotonic() + limit_s
            cut = threading.Timer(limit_s, _shut, (connection.sock,))
            cut.daemon = True
            cut.start()
            try:
                yield connection
            except (OSError, http.client.HTTPException) as error:
                if time.monotonic() >= until_s:
                    raise TimeoutError from error
                raise
            finally:
                cut.cancel()


def _shut(sock: socket.socket) -> None:
    """End what goes over a connection, which wakes whoever waits for it."""
    with suppress(OSError):  # it has just been closed
        sock.shutdown(socket.SHUT_RDWR)


def _post(
    connection: http.client.HTTPConnection, endpoint: Endpoint, body: bytes
) -> tuple[int, str]:
    """The status of the answer, and the host that it points to. The answer's body is not read.

    Raises:
        OSError, http.client.HTTPException: There is no answer.
    """
    parts = urllib.parse.urlsplit(endpoint.url)
    target = urllib.parse.urlunsplit(("", "", parts.path or "/", parts.query, ""))
    headers = {"Content-Type": "application/json", "User-Agent": "trolley"}
    if endpoint.token:
        headers["Authorization"] = f"Bearer {endpoint.token}"
    connection.request("POST", target, body, headers)
    answer = connection.getresponse()
    try:
        elsewhere = urllib.parse.urlsplit(answer.getheader("Location", "")).netloc
    except ValueError:
        elsewhere = ""
    return answer.status, elsewhere.rpartition("@")[2][:100]


def _words_of(error: OSError | http.client.HTTPException, limit_s: float) -> str:
    if isinstance(error, OSError):
        return why_unreachable(error, limit_s, "is it http:// instead of https://?")
    return "does not answer as a web server does"


def endpoints_of(config: RobotConfig) -> list[Endpoint]:
    """The web addresses that the configuration names.

    Raises:
        ConfigError: A file that it names cannot be used.
    """
    webhook = config.webhook
    if not webhook.urls:
        return []
    token = ""
    if webhook.token_file:
        token = read_secret(config, "[webhook] token_file", webhook.token_file)
        if not token.isascii() or not token.isprintable() or not token:
            path = config.path(webhook.token_file)
            raise ConfigError(f"[webhook] token_file {path}: its first line is not a token")
    tls = trust(config, "[webhook] tls_ca", webhook.tls_ca)
    return [Endpoint(url=url, token=token, tls=tls) for url in webhook.urls]
